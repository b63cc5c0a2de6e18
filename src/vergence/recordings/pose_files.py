"""Write the poses and lenses of cameras by image as tables, or as transforms into a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow
from pyarrow import csv, parquet
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.files import whole_file
from vergence.geometry.camera import intrinsics_names
from vergence.geometry.parameters import lens_vector
from vergence.recordings.bag import message, write_bag
from vergence.recordings.camera_poses import CameraPoses
from vergence.recordings.recording import FramePose

PoseFormat = Literal["csv", "parquet", "tf"]
"""Comma-separated values, Apache Parquet, and a bag of ROS with transforms."""
HEAD = "head"
"""Name of frame head in transforms; those of cameras are the cameras' names."""


def pose_table(poses: CameraPoses) -> pyarrow.Table:
    """Arrange poses as a table of N rows; null where a row has no such number.

    The pose maps coordinates of the camera into frame head; its quaternion is (qx, qy, qz, qw).
    """
    table: dict[str, np.ndarray] = {
        "camera": poses.camera,
        "image": poses.image,
        "index": poses.index,
        "stamp_ns": poses.stamp_ns,
    }
    table |= dict(zip(("x_m", "y_m", "z_m"), poses.T_head_cam[:, :3, 3].T, strict=True))
    quaternions = quaternions_xyzw(poses.T_head_cam)
    table |= dict(zip(("qx", "qy", "qz", "qw"), quaternions.T, strict=True))
    table["position_std_m"] = poses.position_std_m
    table["angle_std_rad"] = poses.angle_std_rad
    if poses.readings.size:
        names = [f"{name}_rad" for name in poses.head.kinematics.readings]
        table |= dict(zip(names, poses.readings.T, strict=True))
    table |= _lens_columns(poses)
    return pyarrow.table({
        name: pyarrow.array(column, from_pandas=True) for name, column in table.items()
    })  # fmt: skip


def quaternions_xyzw(T: Array) -> Array:
    """Compute unit quaternions (..., 4), scalar last and not negative, of poses (..., 4, 4)."""
    return Rotation.from_matrix(T[..., :3, :3]).as_quat(canonical=True)


def _lens_columns(poses: CameraPoses) -> dict[str, np.ndarray]:
    """Give each row the size, model and intrinsics of its camera."""
    lenses = {name: poses.head.cameras[name].intrinsics for name in np.unique(poses.camera)}
    values: dict[str, dict[str, Any]] = {
        name: {"width": lens.width, "height": lens.height, "lens": lens.model}
        | dict(zip(intrinsics_names(lens), lens_vector(lens).tolist(), strict=True))
        | {"skew": float(lens.matrix[0, 1])}
        for name, lens in lenses.items()
    }
    columns = dict.fromkeys(column for own in values.values() for column in own)
    return {
        column: np.array([values[name].get(column, np.nan) for name in poses.camera])
        for column in columns
    }


def write_csv(poses: CameraPoses, path: Path) -> None:
    """Write poses as comma-separated values; VergenceError if the file cannot be written."""
    with whole_file(path) as part:
        csv.write_csv(pose_table(poses), part)


def write_parquet(poses: CameraPoses, path: Path) -> None:
    """Write poses as an Apache Parquet file; VergenceError if the file cannot be written."""
    with whole_file(path) as part:
        parquet.write_table(pose_table(poses), part)


def write_transforms(poses: CameraPoses, path: Path) -> None:
    """Write poses as transforms from frame head to the cameras, stamped as their images.

    A path that ends in .bag becomes a bag of ROS 1, any other a folder with one of ROS 2 in MCAP.
    VergenceError if it exists or cannot be written.
    """
    stamps, group = np.unique(poses.stamp_ns, return_inverse=True)
    order = np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1])
    messages = (
        message("/tf", stamp, tuple(
            FramePose(HEAD, str(poses.camera[k]), poses.T_head_cam[k]) for k in rows
        ))
        for stamp, rows in zip(stamps.tolist(), order, strict=True)
    )  # fmt: skip
    write_bag(path, messages, storage="ros1" if path.suffix == ".bag" else "mcap")


WRITERS: dict[PoseFormat, Callable[[CameraPoses, Path], None]] = {
    "csv": write_csv,
    "parquet": write_parquet,
    "tf": write_transforms,
}
"""What writes each format."""
