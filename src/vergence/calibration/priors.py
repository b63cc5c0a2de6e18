"""What is known of a calibration's unknowns without images: scales, and priors.

The scales are standard deviations by a ruler, a data sheet or a drawing. They are the yardstick for
what images determine (`estimation.observability`). Priors are residuals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vergence.arrays import Array
from vergence.estimation.residual import Levels, Residual, Rows
from vergence.estimation.variables import Block, Variables
from vergence.geometry import parameters
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import joint_parameters
from vergence.geometry.kinematics import EYES
from vergence.geometry.lens import PINHOLE, CameraModel
from vergence.geometry.parameters import (
    camera_columns,
    change_between,
    lens_of_vector,
    lens_vector,
    named_columns,
)
from vergence.geometry.se3 import boxplus

EQUIDISTANT = 21 / 13, 105 / 143, 35 / 429
"""k4, k5 and k6 of the rational lens that is nearest to the equidistant one: the denominator of the
Pade approximant [6/6] of arctan(r) / r, which differs from it by 0.001 at 65 degrees."""

FISHEYE_STD = 0.3
"""Of each coefficient of a fisheye lens."""
LAST_ASSUMED = {"rational": "k6", "fisheye": "k4"}
"""Last coefficient of the lenses that have a prior; they have none where it is fixed."""
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
BOARD_SCALE = 0.01
"""Size of a printed board, relative to the stated one, unless its description states another."""
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


@dataclass(frozen=True, eq=False, kw_only=True)
class LensPrior(Residual):
    """The prior of one lens: of a camera of the head, or of the block "lens".

    Numerator and denominator of a rational lens may nearly cancel, so that corners leave some of
    its coefficients open, and the fit has a pole. A lens has none. So each coefficient of the
    denominator has a gamma distribution of shape 2, zero at zero, whose density is largest for an
    equidistant lens. The last coefficients of a fisheye lens are open where boards do not reach its
    edge. Those of all projections that lenses are designed for are a third at most (a pinhole has
    1/3, 2/15, 17/315, 62/2835), so each is normally distributed about zero.
    """

    camera: str | None = None
    """Its name in the head; None: the block "lens"."""
    robust: bool = False

    def lens(self, x: Variables) -> Camera:
        """Take the lens at the unknowns."""
        return x["lens"] if self.camera is None else x["head"].cameras[self.camera].intrinsics

    def error(self, x: Variables) -> Array:
        """Compute k / std (1, 4) of a fisheye lens, k / mode - 1 (1, 3) of a rational one."""
        lens = self.lens(x)
        if lens.model == "fisheye":
            return lens.distortion[None] / FISHEYE_STD
        return lens.distortion[None, -3:] / EQUIDISTANT - 1

    def rows(self, x: Variables) -> Rows:
        """Compute derivatives that give the gradient and curvature of the log density."""
        lens = self.lens(x)
        if self.camera is None:
            columns = x.columns("lens")
        else:
            columns = x.columns("head")[camera_columns(x["head"], self.camera)]
        end = len(PINHOLE) + len(lens.distortion)
        # Of a rational lens half the gradient is 1 / mode - 1 / k, half the curvature 1 / k^2.
        fisheye = lens.model == "fisheye"
        slope = np.full(4, 1 / FISHEYE_STD) if fisheye else 1 / lens.distortion[-3:]
        return Rows(np.diag(slope)[None], columns[None, end - len(slope) : end])

    def costs(self, errors: Array, levels: Levels, outlier: float) -> Array:
        """Compute -2 log of the density, relative to the largest."""
        if errors.shape[1] == len(EQUIDISTANT):
            possible = np.maximum(errors, -1)
            with np.errstate(divide="ignore"):
                return 2 * (possible - np.log1p(possible)).sum(axis=1)
        return (errors**2).sum(axis=1)


def lens_priors(lens: Camera, free: bool, camera: str | None = None) -> list[LensPrior]:
    """Make the prior of a lens whose last coefficient is free; some lenses have none."""
    possible = lens.model == "fisheye" or (
        lens.model == "rational" and bool((lens.distortion[-3:] > 0).all())
    )
    return [LensPrior(camera=camera)] if possible and free else []


def known_lens_std(lens: Camera, percent: float) -> Array:
    """Compute the deviations (n,) of intrinsics whose focal lengths are known to a percentage.

    Errors of one deviation in the others displace the image's edge or corner by the same share.
    """
    K, reach = lens.matrix, np.hypot(lens.width, lens.height) / 2 / lens.matrix[0, 0]
    distortion = 1 / reach ** np.array(_POWERS[lens.model])
    pinhole = [K[0, 0], K[1, 1], lens.width / 2, lens.height / 2]
    return np.array([*pinhole, *distortion]) * percent / 100


@dataclass(frozen=True, eq=False, kw_only=True)
class BoardSize(Residual):
    """The side of the board's squares, measured by hand or stated by a printer."""

    std: float
    """Relative to the side."""
    robust: bool = False

    def error(self, x: Variables) -> Array:
        return np.array([[(x["board_scale"] - 1) / self.std]])

    def rows(self, x: Variables) -> Rows:
        return Rows(np.array([[[1 / self.std]]]), x.columns("board_scale")[None])


@dataclass(frozen=True, eq=False, kw_only=True)
class ParametersPrior(Residual):
    """Parameters of the head that were estimated before, with their covariance."""

    names: tuple[str, ...]
    """(p,) see geometry.parameters."""
    head: HeadCalibration
    """With their values."""
    covariance: Array
    """(p, p); directions without variance count as known to a millionth of the largest."""
    robust: bool = False

    @cached_property
    def _whitening(self) -> Array:
        std = np.sqrt(np.diag(self.covariance))
        values, vectors = np.linalg.eigh(self.covariance / np.outer(std, std))
        return vectors.T / np.sqrt(np.maximum(values, 1e-12))[:, None] / std

    def error(self, x: Variables) -> Array:
        return (self._whitening @ change_between(x["head"], self.head, self.names))[None]

    def rows(self, x: Variables) -> Rows:
        columns = x.columns("head")[named_columns(self.head, self.names)]
        return Rows(self._whitening[None].copy(), columns[None])
