"""The rows of a dataset in which both eyes see, with the readings at the moments of the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Dataset, Frame, runs
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError
from vergence.geometry.camera import check_image_fits
from vergence.geometry.head import HeadCalibration, pair_names


@dataclass(frozen=True, eq=False)
class StereoRows:
    """N rows of a dataset that have an image of each of two cameras, in order of time."""

    dataset: Dataset
    cameras: tuple[str, str]
    """Names of the cameras of the left and the right eye."""
    rows: np.ndarray
    """(N,) of int: which rows."""
    joints: Array
    """(N, r) readings at the moments of the images [rad], or eye poses (N, 2, 4, 4)."""

    def __len__(self) -> int:
        return len(self.rows)

    def frame(self, k: int) -> Frame:
        """Read the k-th row with the images of both cameras; errors as in `Dataset.image`."""
        row = int(self.rows[k])
        images = {name: self.dataset.image(name, row) for name in self.cameras}
        time_s = float(self.dataset.time_s[row])
        measured = self.joints.ndim > 2
        angles = self.dataset.eye_angles[row] if measured else self.joints[k]  # NaN if measured
        neck = self.dataset.neck_angles[row]
        shown = {name: image for name, image in images.items() if image is not None}
        return Frame(time_s, time_s, angles, neck, shown)


def stereo_rows(dataset: Dataset, head: HeadCalibration) -> StereoRows:
    """Select the rows with images of both main cameras of a head.

    While the eyes move, readings are moved to the moments of the images by the calibrated time
    offset or, without one, by the time stamps.

    Raises:
        VergenceError: the head has one eye, or the dataset does not have its main cameras, its
            readings or images of its size, or no row has images of both cameras.
    """
    cameras = pair_names(head)
    folder, stated = dataset.folder, dataset.description.cameras
    for name in cameras:
        if name not in dataset.files:
            raise VergenceError(
                f"The calibration's main cameras are {' and '.join(cameras)}; {folder} has "
                f"{', '.join(dataset.files)}."
            )
        shape = stated[name].height, stated[name].width
        check_image_fits(name, head.camera(name).intrinsics, shape, whose=f"those of {folder}")
    if dataset.T_base_eye is None:
        check_readings_match(dataset, head)
    both = [
        k
        for k in range(len(dataset))
        if all(dataset.files[name][k] is not None for name in cameras)
    ]
    if not both:
        raise VergenceError(f"No row of {folder} has images of both {' and '.join(cameras)}.")
    rows = np.array(both)
    return StereoRows(dataset, cameras, rows, _at_the_images(dataset, head)[rows])


def check_readings_match(dataset: Dataset, head: HeadCalibration) -> None:
    """Raise VergenceError if a dataset has other joint readings than a head."""
    read, known = dataset.description.head_kinematics.readings, head.kinematics.readings
    if read != known:
        raise VergenceError(
            f"The calibration is for the joint readings {', '.join(known)}; {dataset.folder} has "
            f"{', '.join(read) or 'none'}."
        )


def _at_the_images(dataset: Dataset, head: HeadCalibration) -> Array:
    """Move readings (M, r) [rad], or eye poses, of all rows to the moments of their images."""
    readings = dataset.eye_angles if dataset.T_base_eye is None else dataset.T_base_eye
    if not dataset.moving.any():
        return readings
    apart = (dataset.time_s - dataset.joint_time_s)[dataset.moving]
    offset_s = head.time_offset_s or float(np.median(apart))
    timing = Timing(dataset.joint_time_s, runs(dataset))
    return moved_readings(readings, timing, offset_s)
