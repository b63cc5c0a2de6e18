"""Exported poses are those by which the head projects, at the moments of the images."""

from dataclasses import replace

import numpy as np
import pytest
from pyarrow import csv, parquet
from scipy.spatial.transform import Rotation

from drawn_bag import IMAGE_NS, MAP, messages, two_eyes, usual, write_bag
from simulated_head import random_head
from simulated_recording import BOARD
from vergence import cli
from vergence.arrays import Array
from vergence.data.description import DatasetJoint, Description
from vergence.errors import VergenceError
from vergence.geometry.camera import intrinsics_names, project
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, base_pose, parameter_names, save_head
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYE_JOINTS, EYES
from vergence.geometry.parameters import change_named, lens_vector
from vergence.geometry.projection import camera_pose, project_point
from vergence.geometry.se3 import boxminus, inverse, transform
from vergence.recordings.camera_poses import CameraPoses, recording_poses, write_poses
from vergence.recordings.formats import open_recording
from vergence.recordings.recording_map import CameraSource, RecordingMap, describe
from vergence.recordings.scan import Scan, Track, scan

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
    images = Track(image_ns, image_ns + 10**7, np.full(60, np.nan))
    scanned = Scan(
        images={f"/{name}/image": images for name in head.cameras},
        sizes={f"/{name}/image": size for name in head.cameras},
        joints={
            ("/joints", name): Track(stamp_ns, stamp_ns, -readings[:, k])
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
    return scanned, describe(mapped, scanned.sizes, {}), mapped


def poses_of(head: HeadCalibration) -> list[CameraPoses]:
    return recording_poses(*recorded(head), head)


def test_poses_of_moving_cameras_project_points_to_the_pixels_of_the_head():
    head = timed_head()
    point = np.array([0.6, 0.05, -0.02])
    in_head = transform(base_pose(head, "left"), point)
    for found in poses_of(head):
        mounted, t_s = head.cameras[found.camera], (found.stamp_ns - START_NS) * 1e-9
        expected = project_point(head, found.camera, sweep(t_s + OFFSET_S), point)
        by_pose = project(mounted.intrinsics, transform(inverse(found.T_head_cam), in_head))
        seen = np.isfinite(expected)
        assert seen.all() or "narrow" in found.camera
        np.testing.assert_allclose(by_pose[seen], expected[seen], atol=1e-9)
        np.testing.assert_allclose(found.readings, sweep(t_s + OFFSET_S), atol=1e-9)
        # The last reading is 1.99 s after the first, and the last images at 1.933 and 1.967 s.
        assert (found.left_out, found.index.max()) == (1, 58)


def test_stated_deviations_are_those_of_sampled_heads():
    rng = np.random.default_rng(1)
    head = timed_head(1)
    names = tuple(name for name in parameter_names(head) if ".T_" in f".{name}" or "pan" in name)
    root = rng.normal(size=(len(names), len(names))) * 1e-3 / np.sqrt(len(names))
    accuracy = Accuracy(
        method="bundle", parameters=names, covariance=root @ root.T, joint_std=(2e-4,)
    )
    stated = poses_of(replace(head, accuracy=accuracy))[2]
    mounted, k = head.cameras[stated.camera], 20
    readings = sweep((stated.stamp_ns[[k]] - START_NS) * 1e-9 + OFFSET_S)[0]
    errors = []
    for z in rng.normal(size=(2000, len(names))):
        other = change_named(head, names, root @ z)
        T_eyes = eye_poses(other, readings + rng.normal(0, 2e-4, 4))[EYES.index(mounted.eye)]
        T_lbase_cam = camera_pose(other.cameras[stated.camera], other.T_rbase_lbase, T_eyes)
        errors.append(boxminus(base_pose(other, "left") @ T_lbase_cam, stated.T_head_cam[k]))
    sampled = np.sqrt((np.array(errors) ** 2).mean(axis=0).reshape(2, 3).sum(axis=1))
    np.testing.assert_allclose(stated.std[k], sampled, rtol=0.06)


def test_a_calibration_of_other_cameras_is_refused():
    head = timed_head()
    other = replace(head, cameras={"left_0": head.cameras["left_wide"]})
    with pytest.raises(VergenceError, match="No camera is called 'left_wide'"):
        recording_poses(*recorded(head), other)


def test_tables_hold_the_poses(tmp_path):
    head = timed_head()
    found = poses_of(head)
    write_poses(found, head, tmp_path / "poses.csv", "csv")
    write_poses(found, head, tmp_path / "poses.parquet", "parquet")
    read = parquet.read_table(tmp_path / "poses.parquet")
    same_types = csv.ConvertOptions(column_types=read.schema)
    assert read.equals(csv.read_csv(tmp_path / "poses.csv", convert_options=same_types))
    every = {name: read[name].to_numpy() for name in read.column_names}
    for each in found:
        own = every["camera"] == each.camera
        table = {name: column[own] for name, column in every.items()}
        np.testing.assert_array_equal(table["stamp_ns"], each.stamp_ns)
        readings = np.stack([table[f"{name}_rad"] for name in EYE_JOINTS], axis=-1)
        np.testing.assert_array_equal(readings, each.readings)
        quaternion = np.stack([table[name] for name in ("qx", "qy", "qz", "qw")], axis=-1)
        R = Rotation.from_quat(quaternion).as_matrix()
        np.testing.assert_allclose(R, each.T_head_cam[:, :3, :3], atol=1e-12)
        lens = head.cameras[each.camera].intrinsics
        values = [table[name][0] for name in intrinsics_names(lens)]
        np.testing.assert_array_equal(values, lens_vector(lens))


@pytest.mark.parametrize("name", ["poses.bag", "poses"])
def test_transforms_are_read_back_from_a_bag(name: str, tmp_path):
    head = timed_head()
    found = poses_of(head)
    write_poses(found, head, tmp_path / name, "tf")
    with open_recording(tmp_path / name) as recording:
        scanned = scan(recording, ["/tf"])
    for each in found:
        poses = scanned.poses["head", each.camera]
        np.testing.assert_array_equal(poses.stamp_ns, each.stamp_ns)
        np.testing.assert_allclose(poses.values, each.T_head_cam, atol=1e-12)


def test_poses_are_exported_by_a_command(tmp_path, monkeypatch):
    session = usual(1, 1)
    write_bag(tmp_path / "bag", messages(session, two_eyes()))
    (tmp_path / "map.toml").write_text(MAP)
    save_head(two_eyes(), tmp_path / "head.json")
    arguments = ["head.json", "bag", "--out", "poses.csv"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["vergence", "export-poses", *arguments])
    cli.main()
    assert len(csv.read_csv("poses.csv")) == 2 * (session.end_ns // IMAGE_NS + 1)
