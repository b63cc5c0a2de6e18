"""How well the calibration of a head is known: what its file states of its accuracy."""

from __future__ import annotations

from collections import Counter
from dataclasses import field
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Matrix
from vergence.errors import counted
from vergence.findings import Finding, select

_FINITE = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Settings of the dataclasses: unknown fields, NaN and infinity are refused."""
SMALLEST_VARIANCE = 1e-60
"""Smallest variance of an estimated parameter; numbers far from one would overflow where variances
are compared."""


@dataclass(frozen=True, eq=False, config=_FINITE)
class HeldOut:
    """How well views were predicted that the calibration had not seen."""

    folds: int
    """Into how many parts the views were divided; each was predicted from the others."""
    transfer_views: int
    """Views that both eyes saw."""
    transfer_px: float | None
    """Root mean square distance of corners from where the board's pose in the other eye, the
    joint readings and the calibration put them; None: no such view."""
    point_views: int
    """Views of a board at rest that other views show too."""
    point_mm: float | None
    """Root mean square distance of triangulated corners from where the other views put them."""
    expected_mm: float | None
    """What point_mm should be by the stated noise and covariance; None: these are not stated."""
    distance_m: float | None
    """Mean distance of these corners from the left eye."""
    jackknife_ratio: float | None = None
    """Differences between the calibrations of the folds and that of all views, relative to what is
    stated; 1 where the noise model is right."""
    prediction_px: float | None = None
    """Root mean square distance of corners from where the view's reading, the calibration and the
    board, as other views of its placement show it, put them; None: no other view."""


@dataclass(frozen=True, config=_FINITE)
class LensAccuracy:
    """Standard deviations of a fitted lens, by the errors of corners and by how the views differ.

    What all views of a board have in common is not in them: its bend makes the focal length wrong.
    """

    focal: Annotated[float, Field(ge=0)]
    """Of the focal length, relative to it."""
    centre_px: Annotated[float, Field(ge=0)]
    """Of one coordinate of the principal point."""
    distortion_px: Annotated[float, Field(ge=0)]
    """Root mean square over the image, of what the coefficients of the distortion displace; 0 where
    none was fitted."""


@dataclass(frozen=True, eq=False, config=_FINITE)
class Accuracy:
    """How well a calibration is known; see docs/method.md."""

    method: Literal["bundle", "paper", "self-calibration"]
    """Bundle adjustment, the paper's steps alone, or either as corrected by what the eyes saw."""
    parameters: tuple[str, ...] = ()
    """Names of what was estimated, such as left_wide.fx, left_wide.T_eye_cam.rx, left.pan_gain;
    px, rad, m, s. Empty for the paper's method, which states no covariance."""
    covariance: Matrix = field(default_factory=lambda: np.empty((0, 0)))
    """In the order of parameters. Poses change by the increment of `se3.boxplus`."""
    pixel_std_px: Annotated[float, Field(ge=0)] | None = None
    """Noise of one coordinate of a corner, in a typical image."""
    joint_std: tuple[Annotated[float, Field(ge=0)], ...] = ()
    """Noise of the readings [rad]: of all, or of each kind (`kinematics.reading_kinds`), such as
    pan and tilt; for eyes whose poses are given, rotation [rad] and translation [m], as corrected
    by the head's pose_errors."""
    eye_motion: Literal["pan-tilt", "poses", "fixed"] = "pan-tilt"
    """Whether the eyes were read as angles or as poses, or stand still."""
    held_out: HeldOut | None = None
    findings: tuple[Finding, ...] = ()
    """What was noticed about the data and the result, the most severe first. A calibration with a
    finding of severity void must not be used."""
    lenses: dict[str, LensAccuracy] = field(default_factory=dict)
    """By camera, where there is no covariance: how well the views of the board determined it."""
    systematic_px: dict[str, Annotated[float, Field(ge=0)]] = field(default_factory=dict)
    """By camera, where they show: errors of the corners that are smooth over the image and the
    same in all views, since the lens is not as its model; rms of one coordinate."""
    camera_std_px: dict[str, Annotated[float, Field(ge=0)]] = field(default_factory=dict)
    """By camera: noise of one coordinate of a corner, rms over its images; empty: pixel_std_px."""
    backlash_rad: dict[str, tuple[float, Annotated[float, Field(ge=0)]]] = field(
        default_factory=dict
    )
    """By reading, or by eye and reading (such as left_tilt) where joints of both eyes share one:
    width of the backlash [rad of the reading], positive where the eye lags behind the reading and
    negative where the sensor lags behind the eye, and its standard deviation."""

    @property
    def void(self) -> tuple[Finding, ...]:
        """The findings that forbid the use of the calibration."""
        return select(self.findings, "void")

    def __post_init__(self) -> None:
        n, C = len(self.parameters), self.covariance
        if C.shape != (n, n):
            raise ValueError(
                f"covariance has a row and a column for each of {counted(n, 'parameter')}, found "
                f"{C.shape[0]} x {C.shape[1]} numbers"
            )
        if len(set(self.parameters)) < n:
            name, _ = Counter(self.parameters).most_common(1)[0]
            raise ValueError(f"parameters has {name!r} twice")
        possible = (np.diag(C) > SMALLEST_VARIANCE) & (np.diag(C) < 1 / SMALLEST_VARIANCE)
        if not possible.all():
            name = self.parameters[int(np.argmin(possible))]
            raise ValueError(f"the variance of {name!r} is not positive, or not possible")
        if np.abs(C).max(initial=0.0) > 1 / SMALLEST_VARIANCE:
            raise ValueError(f"covariance has the number {np.abs(C).max():g}")
        if n:
            std = np.sqrt(np.diag(C))
            correlation = C / std / std[:, None]
            if np.abs(correlation - correlation.T).max() > 1e-6:
                raise ValueError("covariance is not symmetric")
            if np.linalg.eigvalsh(correlation)[0] < -1e-6 * n:
                raise ValueError("covariance is not positive semidefinite")
