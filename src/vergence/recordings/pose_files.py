"""Write the poses and lenses of cameras by image as a table, or as transforms into a bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow
from pyarrow import csv, parquet
from scipy.spatial.transform import Rotation

from vergence.files import whole_file
from vergence.geometry.camera import intrinsics_names
from vergence.geometry.eye_motion import measured
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import lens_vector
from vergence.recordings.bag import message, write_bag
from vergence.recordings.camera_poses import CameraPoses
from vergence.recordings.recording import FramePose, Message


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
        write_bag(path, _transforms(poses), storage="ros1" if path.suffix == ".bag" else "mcap")
        return
    table = pyarrow.concat_tables(
        [pose_table(each, head) for each in poses], promote_options="default"
    )
    with whole_file(path) as part:
        (csv.write_csv if format == "csv" else parquet.write_table)(table, part)


def pose_table(poses: CameraPoses, head: HeadCalibration) -> pyarrow.Table:
    """Arrange the poses of a camera as a table of N rows, with its lens.

    The pose maps coordinates of the camera into frame head; its quaternion is (qx, qy, qz, qw).
    """
    lens, N = head.cameras[poses.camera].intrinsics, len(poses.index)
    turns = Rotation.from_matrix(poses.T_head_cam[:, :3, :3]).as_quat(canonical=True)
    readings = [] if measured(poses.readings) else [f"{r}_rad" for r in head.kinematics.readings]
    of_images = [np.full(N, poses.camera), poses.image.astype(str), poses.index, poses.stamp_ns]
    of_images += [*poses.T_head_cam[:, :3, 3].T, *turns.T, *poses.std.T]
    of_images += [*poses.readings.T] if readings else []
    names = ["camera", "image", "index", "stamp_ns", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    names += ["angle_std_rad", "position_std_m", *readings]
    of_camera = [lens.width, lens.height, lens.model, lens.matrix[0, 1]]
    of_camera += lens_vector(lens).tolist()
    constant = ["width", "height", "lens", "skew", *intrinsics_names(lens)]
    columns = {
        name: pyarrow.array(column, from_pandas=True)  # NaN is null
        for name, column in zip(names, of_images, strict=True)
    }
    columns |= {name: [value] * N for name, value in zip(constant, of_camera, strict=True)}
    return pyarrow.table(columns)


def _transforms(poses: Sequence[CameraPoses]) -> list[Message]:
    """Make a message of each transform, in order of time."""
    found = [
        message("/tf", stamp_ns, (FramePose("head", each.camera, T),))
        for each in poses
        for stamp_ns, T in zip(each.stamp_ns.tolist(), each.T_head_cam, strict=True)
    ]
    return sorted(found, key=lambda each: each.stamp_ns)
