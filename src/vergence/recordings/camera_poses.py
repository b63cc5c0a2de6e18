"""Where the cameras of a head were when they took the images of a recording, as a table or a bag.

The joint readings of an image are those of its moment: they are interpolated between the readings
around it, by the time stamps and the calibrated time offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow
from pyarrow import csv, parquet
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.data.dataset import Dataset, check_fits, readings_at_images
from vergence.data.description import Description
from vergence.files import whole_file
from vergence.geometry.camera import intrinsics_names
from vergence.geometry.eye_motion import camera_motion, eye_poses, measured
from vergence.geometry.head import (
    HeadCalibration,
    base_pose,
    parameter_names,
    reading_stds,
    stated_covariance,
    states_covariance,
)
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import lens_vector, named_columns
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import POSE, hat
from vergence.progress import Progress, silent
from vergence.recordings.bag import message, write_bag
from vergence.recordings.readings import postures
from vergence.recordings.recording import FramePose
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import Scan


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses of one camera of a head in those N of its images that have joint readings."""

    camera: str
    image: np.ndarray
    """(N,) of str: file of a dataset, or channel of a recording."""
    index: np.ndarray
    """(N,) of int: row of a dataset, or number of the image in its channel, from 0."""
    stamp_ns: np.ndarray
    """(N,) of int: time stamps of the images [ns]."""
    readings: Array
    """(N, r) [rad] as used, in the order of head.kinematics.readings; (N, 2, 4, 4) where poses of
    the eyes were measured."""
    T_head_cam: Array
    """(N, 4, 4)."""
    std: Array
    """(N, 2) root mean square of the errors of rotation [rad] and position [m], by the covariance
    of the calibration and the noise of the readings; NaN where the head does not state them, and
    for measured poses."""
    left_out: int
    """Images without readings at their moments."""


def dataset_poses(
    dataset: Dataset, head: HeadCalibration, *, progress: Progress = silent
) -> list[CameraPoses]:
    """Compute the poses of each camera in the images of a dataset.

    VergenceError if its cameras or readings are not those of the head.
    """
    check_fits(dataset.description, head, dataset.folder, dataset.files)
    joints = readings_at_images(dataset, head)
    stamp_ns, poses = np.round(dataset.time_s * 1e9).astype(np.int64), []
    for name, files in dataset.files.items():
        rows = np.flatnonzero([file is not None for file in files])
        taken = np.array(files)[rows], rows, stamp_ns[rows]
        poses.append(_poses(head, name, taken, joints[rows], progress))
    return poses


def recording_poses(
    scanned: Scan,
    description: Description,
    mapped: RecordingMap,
    head: HeadCalibration,
    *,
    progress: Progress = silent,
) -> list[CameraPoses]:
    """Compute the poses of each camera in the images of a recording, see `scan_mapped`.

    VergenceError if its cameras or readings are not those of the head.
    """
    check_fits(description, head, "the recording", mapped.cameras)
    poses = []
    for name, source in mapped.cameras.items():
        stamp_ns = scanned.images[source.images].stamp_ns
        at_ns = stamp_ns + round(head.time_offset_s * 1e9)
        eye_angles, _, T_base_eye = postures(scanned, mapped, description, at_ns)
        joints = eye_angles if T_base_eye is None else T_base_eye
        taken = np.full(len(at_ns), source.images), np.arange(len(at_ns)), stamp_ns
        poses.append(_poses(head, name, taken, joints, progress))
    return poses


def _poses(
    head: HeadCalibration,
    camera: str,
    taken: tuple[np.ndarray, np.ndarray, np.ndarray],
    joints: Array,
    progress: Progress,
) -> CameraPoses:
    """Compute the poses of a camera in images `taken`; NaN stands for readings not known."""
    mounted = head.camera(camera)
    known = np.isfinite(joints).all(axis=tuple(range(1, joints.ndim)))
    joints = joints[known]
    T_base_eye = eye_poses(head, joints)[:, EYES.index(mounted.eye)]
    T_lbase_cam = camera_pose(mounted, head.T_rbase_lbase, T_base_eye)
    std = np.full((len(joints), 2), np.nan)
    if states_covariance(head) and not measured(joints):
        for k, readings in enumerate(joints):
            std[k] = _deviations(head, camera, readings)
            progress(f"poses of {camera}", k + 1, len(joints))
    image, index, stamp_ns = (each[known] for each in taken)
    T_head_cam = base_pose(head, "left") @ T_lbase_cam
    left_out = int((~known).sum())
    return CameraPoses(camera, image, index, stamp_ns, joints, T_head_cam, std, left_out)


def _deviations(head: HeadCalibration, camera: str, readings: Array) -> Array:
    """Compute the deviations (2,) of a camera's rotation [rad] and position [m] in frame head."""
    motion = camera_motion(head, camera, readings)
    by_parameters = motion.by_parameters.copy()
    # The origin of frame head is half way to the right eye, at R^T t / 2 of T_rbase_lbase.
    R_T, t = head.T_rbase_lbase[:3, :3].T, head.T_rbase_lbase[:3, 3]
    between = named_columns(head, [f"T_rbase_lbase.{name}" for name in POSE])
    by_parameters[3:, between] += np.concatenate([-R_T @ hat(t), R_T], axis=1) / 2
    stated, covariance = stated_covariance(head, parameter_names(head))
    J = by_parameters[:, stated]
    variances = np.einsum("ij,jk,ik->i", J, covariance, J)
    variances += ((motion.by_readings * reading_stds(head)) ** 2).sum(axis=1)
    return np.sqrt(variances.reshape(2, 3).sum(axis=1))


def write_poses(
    poses: Sequence[CameraPoses],
    head: HeadCalibration,
    path: Path,
    format: Literal["csv", "parquet", "tf"],
) -> None:
    """Write poses as a table, or into a new bag as transforms (tf) from frame head to the cameras.

    A bag is one of ROS 1 if the path ends in .bag, else a folder with one of ROS 2 in MCAP.
    VergenceError if it cannot be written.
    """
    if format == "tf":
        messages = [
            message("/tf", stamp_ns, (FramePose("head", each.camera, T),))
            for each in poses
            for stamp_ns, T in zip(each.stamp_ns.tolist(), each.T_head_cam, strict=True)
        ]
        messages.sort(key=lambda each: each.stamp_ns)
        write_bag(path, messages, storage="ros1" if path.suffix == ".bag" else "mcap")
        return
    tables = [pose_table(each, head) for each in poses]
    table = pyarrow.concat_tables(tables, promote_options="default")
    with whole_file(path) as part:
        (csv.write_csv if format == "csv" else parquet.write_table)(table, part)


def pose_table(poses: CameraPoses, head: HeadCalibration) -> pyarrow.Table:
    """Arrange the poses of a camera as a table of N rows, with its lens.

    The pose maps coordinates of the camera into frame head; its quaternion is (qx, qy, qz, qw).
    """
    lens, N = head.cameras[poses.camera].intrinsics, len(poses.index)
    turns = Rotation.from_matrix(poses.T_head_cam[:, :3, :3]).as_quat(canonical=True)
    columns = {
        "camera": np.full(N, poses.camera),
        "image": poses.image.astype(str),
        "index": poses.index,
        "stamp_ns": poses.stamp_ns,
    }
    columns |= zip(("x_m", "y_m", "z_m"), poses.T_head_cam[:, :3, 3].T, strict=True)
    columns |= zip(("qx", "qy", "qz", "qw"), turns.T, strict=True)
    columns |= zip(("angle_std_rad", "position_std_m"), poses.std.T, strict=True)
    if not measured(poses.readings):
        names = [f"{name}_rad" for name in head.kinematics.readings]
        columns |= zip(names, poses.readings.T, strict=True)
    of_camera = {"width": lens.width, "height": lens.height, "lens": lens.model}
    of_camera |= {"skew": lens.matrix[0, 1]}
    of_camera |= zip(intrinsics_names(lens), lens_vector(lens), strict=True)
    columns |= {name: np.full(N, value) for name, value in of_camera.items()}
    # NaN is null.
    return pyarrow.table({n: pyarrow.array(each, from_pandas=True) for n, each in columns.items()})
