"""Exported poses are those by which the head projects, at the moments of the images."""

from dataclasses import replace

import numpy as np
import pytest
from pyarrow import csv, parquet
from scipy.spatial.transform import Rotation

from simulated_head import random_head
from simulated_recording import BOARD
from vergence.arrays import Array
from vergence.data.description import DatasetJoint, Description
from vergence.errors import VergenceError
from vergence.geometry.camera import intrinsics_names, project
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, base_pose, parameter_names
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Side
from vergence.geometry.parameters import change_named, lens_vector
from vergence.geometry.projection import camera_pose, project_point
from vergence.geometry.se3 import boxminus, inverse, transform
from vergence.recordings.camera_poses import CameraPoses, scanned_poses
from vergence.recordings.formats import open_recording
from vergence.recordings.pose_files import (
    write_csv,
    write_parquet,
    write_transforms,
)
from vergence.recordings.recording_map import CameraSource, RecordingMap, describe
from vergence.recordings.scan import ImageTrack, JointTrack, PoseTrack, Scan, scan

START_NS = 1_700_000_000_123_456_789
OFFSET_S = 0.045
RATE_RAD_S = np.array([0.3, -0.2, 0.25, 0.1])


def sweep(t_s: Array) -> Array:
    """Return readings (N, 4) of eyes that turn evenly."""
    return np.outer(t_s - 1.0, RATE_RAD_S)


def timed_head(seed: int = 0) -> HeadCalibration:
    return replace(random_head(np.random.default_rng(seed)), time_offset_s=OFFSET_S)


def recorded(head: HeadCalibration, seed: int = 0) -> tuple[Scan, Description, RecordingMap]:
    """Return two seconds at 30 Hz, with joints at 97 Hz of which a tenth is missing."""
    rng = np.random.default_rng(seed)
    t = np.arange(2 * 97) / 97
    t = t[(rng.random(len(t)) > 0.1) | (t == t[0]) | (t == t[-1])]
    stamp_ns = np.round(t * 1e9).astype(np.int64) + START_NS
    readings = np.degrees(sweep((stamp_ns - START_NS) * 1e-9))
    image_ns = START_NS + np.round(np.arange(60) / 30 * 1e9).astype(np.int64)
    size = next(iter(head.cameras.values())).intrinsics.size
    images = ImageTrack(image_ns, image_ns + 10**7, np.full(60, np.nan), size)
    scanned = Scan(
        images={f"/{name}/image": images for name in head.cameras},
        joints={
            ("/joints", name): JointTrack(stamp_ns, -readings[:, k])
            for k, name in enumerate(EYE_JOINTS)
        },
        lenses={},
        poses={},
    )
    mapped = RecordingMap(
        cameras={n: CameraSource(m.eye, f"/{n}/image") for n, m in head.cameras.items()},
        board=BOARD,
        joints={name: DatasetJoint(name, "deg", -1) for name in EYE_JOINTS},
    )
    return scanned, describe(mapped, dict.fromkeys(scanned.images, size), {}), mapped


def poses_of(head: HeadCalibration) -> CameraPoses:
    return scanned_poses(*recorded(head), head)


def test_poses_of_moving_cameras_project_points_to_the_pixels_of_the_head():
    head = timed_head()
    found = poses_of(head)
    t_s = (found.stamp_ns - START_NS) * 1e-9
    point = np.array([0.6, 0.05, -0.02])
    in_head = transform(base_pose(head, "left"), point)
    for k in range(0, len(found.camera), 7):
        lens = head.cameras[found.camera[k]].intrinsics
        by_pose = project(lens, transform(inverse(found.T_head_cam[k]), in_head))
        expected = project_point(head, found.camera[k], sweep(t_s[[k]] + OFFSET_S)[0], point)
        assert np.isfinite(expected).all() or "narrow" in found.camera[k]
        seen = np.isfinite(expected)
        np.testing.assert_allclose(by_pose[seen], expected[seen], atol=1e-9)
    used = np.array([[name.startswith(each.split("_")[0]) for name in EYE_JOINTS]
                     for each in found.camera])  # fmt: skip
    np.testing.assert_array_equal(np.isfinite(found.readings), used)


def test_images_after_the_last_reading_are_left_out_and_counted():
    found = poses_of(timed_head())
    # The last reading is 1.99 s after the first, and the last images at 1.933 and 1.967 s.
    assert set(found.left_out.values()) == {1}
    assert found.index.max() == 58


def test_stated_deviations_are_those_of_sampled_heads():
    rng = np.random.default_rng(1)
    head = timed_head(1)
    names = tuple(name for name in parameter_names(head) if ".T_" in f".{name}" or "pan" in name)
    names = (*names, "time_offset_s")
    root = rng.normal(size=(len(names), len(names))) * 1e-3 / np.sqrt(len(names))
    accuracy = Accuracy(method="bundle", parameters=names, covariance=root @ root.T)
    stated = poses_of(replace(head, accuracy=accuracy))
    k = 100
    eye: Side = head.cameras[stated.camera[k]].eye
    t_s = (stated.stamp_ns[[k]] - START_NS) * 1e-9
    errors = []
    for z in rng.normal(size=(2000, len(names))):
        other = change_named(head, names, root @ z)
        T_eyes = eye_poses(other, sweep(t_s + other.time_offset_s)[0])
        mounted = other.cameras[stated.camera[k]]
        T_lbase_cam = camera_pose(mounted, other.T_rbase_lbase, T_eyes[EYES.index(eye)])
        errors.append(boxminus(base_pose(other, "left") @ T_lbase_cam, stated.T_head_cam[k]))
    turn, shift = np.sqrt((np.array(errors) ** 2).mean(axis=0).reshape(2, 3).sum(axis=1))
    assert stated.angle_std_rad[k] == pytest.approx(turn, rel=0.06)
    assert stated.position_std_m[k] == pytest.approx(shift, rel=0.06)


def test_a_calibration_of_other_cameras_or_joints_is_refused():
    head = timed_head()
    scanned, description, mapped = recorded(head)
    other = replace(head, cameras={"left_0": head.cameras["left_wide"]})
    with pytest.raises(VergenceError, match="No camera is called 'left_wide'"):
        scanned_poses(scanned, description, mapped, other)
    for late_s in (-5.0, 5.0):
        late = replace(head, time_offset_s=late_s)
        with pytest.raises(VergenceError, match="None of 240 images has joint readings"):
            scanned_poses(scanned, description, mapped, late)


def test_tables_hold_the_poses(tmp_path):
    found = poses_of(timed_head())
    write_csv(found, tmp_path / "poses.csv")
    write_parquet(found, tmp_path / "poses.parquet")
    read = parquet.read_table(tmp_path / "poses.parquet")
    same_types = csv.ConvertOptions(column_types=read.schema)
    assert read.equals(csv.read_csv(tmp_path / "poses.csv", convert_options=same_types))
    table = {name: read[name].to_numpy() for name in read.column_names}
    np.testing.assert_array_equal(table["stamp_ns"], found.stamp_ns)
    np.testing.assert_array_equal(table["camera"], found.camera)
    readings = np.stack([table[f"{name}_rad"] for name in EYE_JOINTS], axis=-1)
    np.testing.assert_array_equal(readings, found.readings)
    quaternion = np.stack([table[name] for name in ("qx", "qy", "qz", "qw")], axis=-1)
    R = Rotation.from_quat(quaternion).as_matrix()
    np.testing.assert_allclose(R, found.T_head_cam[:, :3, :3], atol=1e-12)
    for name, mounted in found.head.cameras.items():
        own = (table["camera"] == name).argmax()
        lens = mounted.intrinsics
        values = [table[each][own] for each in intrinsics_names(lens)]
        np.testing.assert_array_equal(values, lens_vector(lens))


@pytest.mark.parametrize("name", ["poses.bag", "poses"])
def test_transforms_are_read_back_from_a_bag(name: str, tmp_path):
    found = poses_of(timed_head())
    write_transforms(found, tmp_path / name)
    with open_recording(tmp_path / name) as recording:
        poses: PoseTrack = scan(recording).poses["head", "right_wide"]
    mine = found.camera == "right_wide"
    np.testing.assert_array_equal(poses.stamp_ns, found.stamp_ns[mine])
    np.testing.assert_allclose(poses.T_parent_child, found.T_head_cam[mine], atol=1e-12)
