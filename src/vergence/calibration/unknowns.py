"""The shared unknowns of a calibration, and how well each is known without one.

The scales are standard deviations by a ruler, a data sheet or a drawing. They are the yardstick for
what images determine (`estimation.observability`).
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.lens_prior import EQUIDISTANT
from vergence.estimation.variables import Block
from vergence.geometry import parameters
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import joint_parameters
from vergence.geometry.kinematics import EYES
from vergence.geometry.lens import CameraModel
from vergence.geometry.parameters import lens_of_vector, lens_vector
from vergence.geometry.se3 import boxplus

POSE_SCALE = (0.05, 0.05, 0.05, 0.01, 0.01, 0.01)
"""A mounting by hand and ruler: 3 degrees [rad] and a centimetre [m]."""
JOINT_SCALE = {
    "gain": 0.1,
    "offset_rad": 0.05,
    "nonorthogonality_rad": 0.05,
    "inclination_rad": 0.05,
    "axis_distance_m": 0.005,
    "slide_m": 0.005,
}
"""Errors of a joint: its drawing and common servos."""
FACTOR_SCALE = 0.1
"""Factor of one of several readings of a joint, as its gain."""
TIME_SCALE_S = 0.1
"""Time offset of images and readings: a few frames."""
BOARD_SCALE = 0.02
"""Size of a printed board, relative to the stated one."""
_POWERS: dict[CameraModel, tuple[int, ...]] = {
    "radial-tangential": (2, 4, 1, 1, 6),
    "rational": (2, 4, 1, 1, 6, 2, 4, 6),
    "fisheye": (2, 4, 6, 8),
}
"""Power of the radius with which each coefficient moves a point, relative to its distance."""
_MOVED = 0.2
"""Distortion in the image's corner by one coefficient, relative to its distance from the centre."""


def lens_scale(lens: Camera) -> Array:
    """Compute the scales (n,) of the intrinsics of a lens."""
    f = lens.matrix[0, 0]
    # Of the image's corner: normalised radius or, for a fisheye lens, angle.
    reach = np.hypot(lens.width, lens.height) / 2 / f
    distortion = _MOVED / reach ** np.array(_POWERS[lens.model])
    if lens.model == "rational":  # the numerator moves with what is assumed of the denominator
        distortion[-3:] = EQUIDISTANT
        distortion[[0, 1, 4]] = np.hypot(distortion[[0, 1, 4]], distortion[-3:])
    pinhole = [0.2 * f, 0.2 * f, 0.1 * lens.width, 0.1 * lens.height]
    return np.array([*pinhole, *distortion])


def lens_block(lens: Camera, free: np.ndarray) -> Block:
    """Make unknowns of the intrinsics (n,) of a lens; those with indices `free` may change."""
    scale = lens_scale(lens)
    return Block(lens, scale, _moved_lens, np.isin(np.arange(len(scale)), free))


def _moved_lens(lens: Camera, step: Array) -> Camera:
    return lens_of_vector(lens, lens_vector(lens) + step)


def head_block(head: HeadCalibration, free: np.ndarray) -> Block:
    """Make unknowns of the parameters (c,) of a head; free is (c,) of bool."""
    scales: list[float] = []
    for mounted in head.cameras.values():
        scales += [*lens_scale(mounted.intrinsics), *POSE_SCALE]
    joints = head.kinematics.eyes
    names = [name for eye in EYES for _, name in joint_parameters(joints[eye])]
    errors = [JOINT_SCALE.get(name, FACTOR_SCALE) for name in names]
    scale = np.array([*scales, *POSE_SCALE, *errors, TIME_SCALE_S])
    return Block(head, scale, parameters.boxplus, free)


def boards_block(T: Array) -> Block:
    """Make unknowns of poses (P, 4, 4) of boards."""
    return Block(T, np.tile(POSE_SCALE, len(T)), _moved_poses, nuisance=True)


def _moved_poses(T: Array, step: Array) -> Array:
    return boxplus(T, step.reshape(-1, 6))


def board_scale_block(free: bool) -> Block:
    """Make an unknown of the board's size, relative to the stated one."""
    return Block(1.0, np.array([BOARD_SCALE]), _moved_number, np.array([free]), nuisance=True)


def _moved_number(value: float, step: Array) -> float:
    return value + float(step[0])
