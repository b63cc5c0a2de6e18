"""Data of the self-calibration filter: its state, and the estimate of one frame.

The state vector is the change of the P head parameters that may be wrong. A frame adds the errors
of its r joint readings; the readings of one keyframe stay in the state. With P, r and the keyframe
there are K unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.match_noise import RevisitCorrelation
from vergence.vision.matching.scene_features import Matches

HeadChange = Literal["camera turned", "head uncalibrated"]
"""A camera was turned, or the head is outside the covariance of its calibration."""


@dataclass(frozen=True, eq=False)
class FilterState:
    """Mean, covariance and noise levels of the self-calibration filter."""

    head: HeadCalibration
    """Current mean."""
    cameras: tuple[str, str]
    """Names of the left and the right camera."""
    names: tuple[str, ...]
    """The P estimated parameters, as in `head.parameter_names`."""
    covariance: Array
    """(P, P)"""
    prior_head: HeadCalibration
    """From which the filter started, or restarted after a change."""
    prior_covariance: Array
    """(P, P) at that start, with the process noise since then."""
    reading_std: float
    """Noise of the readings times their gear factors, rms over the readings."""
    noise_ratios: Array
    """(r,) standard deviation of each reading over `reading_std`, as calibrated; constant."""
    revisits: RevisitCorrelation
    """Correlation of match errors with those of earlier frames."""
    systematic_px: tuple[float, float] = (0.0, 0.0)
    """Systematic error of each lens, rms of one coordinate, from `Accuracy.systematic_px`."""
    match_scale: float = 1.3
    """Noise of the matches over what their windows state; at first that of windows with relief."""
    design_effect: float = 2.0
    """Variance inflation by errors that neighbouring matches share; 1.1 to 1.8 in a furnished
    room."""
    joint_weight: float = 5.0
    """Number of readings from which `reading_std` was estimated; the prior counts for five."""
    frames: int = 0
    """Number of updates."""
    time_s: float = 0.0
    """Since the start, summed by `kalman.predict`."""
    change: HeadChange | None = None
    """Change of the head that the last update detected."""
    settled: bool = False
    """Whether the initial frames are over."""
    records: tuple[FrameRecord, ...] = ()
    """The initial frames, which are relinearised; afterwards those of the change window."""
    keyframe: Keyframe | None = None
    """Frame from which features are tracked; None before the first and after a contradiction."""

    @property
    def reading_std_rad(self) -> Array:
        """(r,) noise of each reading."""
        return self.reading_std * self.noise_ratios

    def largest_turn_rad(self, readings: Array, others: Array) -> float:
        """Compute the largest turn of a joint between two readings (r,) [rad]."""
        return float(np.abs(self.head.kinematics.gear_ratios * (readings - others)).max())

    @property
    def frame_covariance(self) -> Array:
        """(P + r, P + r) prior covariance of head and readings in a frame."""
        P, stds = len(self.names), self.reading_std_rad
        C = np.zeros(2 * (P + len(stds),))
        C[:P, :P], C[P:, P:] = self.covariance, np.diag(stds**2)
        return C


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurement of one frame as normal equations about a change from the state's head."""

    information: Array
    """(K, K)"""
    vector: Array
    """(K,) information times the change that minimises the residuals."""
    inliers: float
    """Number of matches that fit."""
    match_scale: float
    """Noise of the residuals over their assumed noise."""
    design_effect: float
    """Variance inflation by errors that neighbouring matches share."""
    filled: float
    """Share of the image that inliers fill."""
    systematic: float
    """Share of the measurement's variance that is due to systematic lens errors."""
    distance: float
    """Squared Mahalanobis distance of the fit from its prior mean."""
    degrees: float
    """Degrees of freedom that the residuals determine better than the prior."""
    misfit: float
    """Minus twice the log likelihood of no change, up to a constant of the matches."""


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """Head and joint angles at the moment of a pair of images."""

    head: HeadCalibration
    cameras: tuple[str, str]
    joints: Array
    """(r,) corrected readings [rad]."""
    readings: Array
    """(r,) measured readings [rad]."""
    names: tuple[str, ...]
    covariance: Array
    """(P + r, P + r) of the head's parameters and the corrected readings."""
    matches: Matches
    weights: Array
    """(N,) robust weights, from 0 for an outlier to 1."""
    status: Literal["seen", "little seen", "contradiction"]
    evidence: Evidence | None
    """None: too few matches fit."""
    novelty: float = 1.0
    """Equivalent number of independent frames that this one adds to the earlier ones."""
    images: tuple[np.ndarray, np.ndarray] | None = None
    """Grey images of both cameras, to track features; None: there are only matches."""


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """A frame that may be estimated again."""

    state: FilterState
    """Predicted state before the frame, without records and keyframe."""
    estimate: FrameEstimate
    """Without images."""
    tracked: TrackedFeatures | None
    log_likelihoods: tuple[float, ...]
    """Up to a constant: without a change of the head, and after each hypothetical change."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Earlier frame whose features are tracked, with its joint angles as part of the state."""

    readings: Array
    """(r,) measured readings, which identify the keyframe [rad]."""
    images: tuple[np.ndarray, np.ndarray] | None
    """(H, W) grey; None: features cannot be tracked."""
    joints: Array
    """(r,) estimated readings [rad]."""
    covariance: Array
    """(r, r)"""
    cross_covariance: Array
    """(P, r) of the head's parameters with the joints."""
    pixels: tuple[Array, Array]
    """(N, 2) features in each image."""
    depths_m: tuple[Array, Array]
    """(N,) depths of the features along the optical axes."""


@dataclass(frozen=True, eq=False)
class TrackedFeatures:
    """Features of a keyframe that were found in a later frame."""

    readings: Array
    """(r,) of the keyframe [rad]."""
    matches: tuple[Matches, Matches]
    """Pixels at the keyframe and now, in the left and in the right camera."""
    depths_m: tuple[Array, Array]
    """(N,) at the keyframe, along the optical axes."""
