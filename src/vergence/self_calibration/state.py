"""What is known of a head and what a pair of images says of it: the data of self-calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, pair_names, reading_stds
from vergence.self_calibration.match_noise import (
    EXPECTED_DESIGN_EFFECT,
    EXPECTED_MATCH_SCALE,
    Recurrence,
)
from vergence.self_calibration.prior import (
    JOINT_STD_RAD,
    LEAST_JOINT_STD_RAD,
    Changed,
    learned_names,
    prior_covariance,
)
from vergence.vision.matching.scene_features import Matches

JOINT_WEIGHT = 5.0
"""How many readings what is assumed of their noise counts for."""
_LEAST_RATIO = 0.1
"""Noise of a reading, relative to the others', that is assumed at least: none is exact."""
FrameStatus = Literal["seen", "little seen", "contradiction"]


@dataclass(frozen=True, eq=False)
class Origin:
    """What was known of a head before it was learned, or when it was last found to have changed."""

    head: HeadCalibration
    covariance: Array
    """(P, P) with what it may have drifted since."""


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """What is known of a head so far, from its calibration and from what its eyes have seen."""

    head: HeadCalibration
    """As it is believed to be now."""
    cameras: tuple[str, str]
    """The pair that is used."""
    names: tuple[str, ...]
    """The P parameters that may be wrong, as in `parameters.parameter_names`."""
    covariance: Array
    """(P, P) of them."""
    origin: Origin
    """From where it was learned."""
    joint_std_rad: float
    """Noise of the readings in terms of the joints that they turn: the standard deviation of each,
    times its factor; rms over the readings."""
    noise_ratios: Array
    """(r,) standard deviation of each reading over `joint_std_rad`, as calibrated; constant."""
    match_scale: float
    """Noise of the matches, relative to what their contrast tells."""
    systematic_px: tuple[float, float] = (0.0, 0.0)
    """Systematic errors of the two lenses, rms of one coordinate: of `Accuracy.systematic_px`."""
    design_effect: float = EXPECTED_DESIGN_EFFECT
    """Variance inflation by errors that neighbouring matches share."""
    recurrence: Recurrence | None = None
    """How far errors recur where the eyes stood before; None: no frame was learned."""
    joint_weight: float = JOINT_WEIGHT
    """Number of readings from which an estimate of their noise would be as certain as it is now."""
    frames: int = 0
    """From which it was learned."""
    time_s: float = 0.0
    """Since it began, as `update.drifted` has counted."""
    bumped: bool = False
    """Whether the last frame showed that a camera had been turned."""
    uncalibrated: bool = False
    """Whether it showed that the head is farther from its calibration than the stated covariance
    allows."""
    settled: bool = False
    """Whether the first frames are over, which are kept to be linearised again."""
    past: tuple[Past, ...] = ()
    """The last frames, by which a change is told from noise; all of the first ones."""
    keyframe: Keyframe | None = None
    """From which features are tracked; None: there is none yet, or none that can be believed."""

    @property
    def reading_std_rad(self) -> Array:
        """(r,) noise of each reading."""
        return self.joint_std_rad * self.noise_ratios

    @property
    def before_frame(self) -> Array:
        """(K, K) covariance of the P parameters and of the errors of r readings."""
        P, stds = len(self.names), self.reading_std_rad
        C = np.zeros(2 * (P + len(stds),))
        C[:P, :P], C[P:, P:] = self.covariance, np.diag(stds**2)
        return C


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the matches of one frame say, as normal equations about the state's head."""

    information: Array
    """(K, K) of P parameters and r readings."""
    vector: Array
    """(K,): the information times the change that fits the matches best."""
    inliers: float
    """How many matches fit."""
    match_scale: float
    """Noise of the matches, relative to what the state assumes of them."""
    design_effect: float
    """Variance inflation by errors that neighbouring matches share."""
    blocks: Array
    """(B,) sums of residuals in blocks of the left image, of `match_noise.design_effect`."""
    systematic: float
    """Share of the variance of what they say that is by systematic errors of the lenses."""
    misfit: float
    """Twice the negative logarithm of the likelihood of no change, up to a constant of the
    matches."""


@dataclass(frozen=True, eq=False)
class Past:
    """A frame that may have to be estimated again."""

    state: SelfCalibration
    """Just before the frame; without past frames and keyframe of its own."""
    seen: FrameEstimate
    """The frame, without images."""
    tracked: TrackedFeatures | None
    """Features of an earlier frame that were found in it."""
    likelihoods: tuple[float, ...]
    """Logarithms, up to a constant, given the head as it was known and given each change that it
    may have undergone before the frame."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """An earlier frame whose features are found again, with its joint angles."""

    readings: Array
    """(r,) as they were, by which it is known again [rad]."""
    images: tuple[np.ndarray, np.ndarray] | None
    """(H, W) grey or (H, W, 3) RGB of both cameras; None: nothing can be found in them."""
    joints: Array
    """(r,) the readings then, corrected by all that was seen since [rad]."""
    covariance: Array
    """(r, r) of these."""
    with_head: Array
    """(P, r) covariance of the parameters of the head with these."""
    pixels: tuple[Array, Array]
    """(N, 2) of its features in each image."""
    depths_m: tuple[Array, Array]
    """(N,) of these along the optical axes."""


@dataclass(frozen=True, eq=False)
class TrackedFeatures:
    """Features of a keyframe, found again."""

    readings: Array
    """(r,) of the keyframe [rad]."""
    matches: tuple[Matches, Matches]
    """Matches of then and now in the left and in the right camera."""
    depths_m: tuple[Array, Array]
    """(N,) then, along the optical axes."""


@dataclass(frozen=True, eq=False)
class FrameEstimate:
    """A head and its joint angles at the moment of a pair of images."""

    head: HeadCalibration
    cameras: tuple[str, str]
    joints: Array
    """(r,) the readings, corrected [rad]."""
    readings: Array
    """(r,) as they were [rad]."""
    names: tuple[str, ...]
    covariance: Array
    """(P + r, P + r) of the head's parameters and the corrected readings."""
    matches: Matches
    weights: Array
    """(N,) from 0, a match that does not fit, to 1."""
    status: FrameStatus
    evidence: Evidence | None
    """None: too few matches fit."""
    images: tuple[np.ndarray, np.ndarray] | None = None
    """In which the matches were found; None: matches were given without images."""


def initial_self_calibration(
    head: HeadCalibration,
    *,
    cameras: tuple[str, str] | None = None,
    changed: Changed = "little",
) -> SelfCalibration:
    """Return what is known of a head before its eyes have seen anything.

    Args:
        head: with a camera in each eye.
        cameras: names of the left and the right camera that see the scene; None: the main ones.
        changed: what may have changed since the calibration: nothing, little or anything. In the
            last case usual tolerances take the place of its covariance; noise is kept.

    Raises:
        VergenceError: the head has one eye, no joint readings, or was calibrated with measured eye
            poses; or `changed` is another word.
    """
    if changed not in get_args(Changed):
        raise VergenceError(f"changed is {' or '.join(get_args(Changed))}, found {changed!r}.")
    pair = pair_names(head, cameras)
    accuracy = head.accuracy
    if accuracy is not None and accuracy.eye_motion == "poses":
        raise VergenceError(
            "Self-calibration corrects joint readings; this head was calibrated with measured eye "
            "poses, so that nothing is known of its joints."
        )
    if not head.kinematics.readings:
        raise VergenceError(
            "Self-calibration follows eyes that move by their joint readings; this head has none."
        )
    if accuracy is not None and changed == "anything":
        unknown = replace(accuracy, parameters=(), covariance=np.empty((0, 0)), lenses={})
        head = replace(head, accuracy=unknown)
    names = learned_names(head, pair)
    factors = head.kinematics.factors
    stds = reading_stds(head) * factors
    if not stds.any():
        stds = np.full(len(factors), JOINT_STD_RAD)
    std = float(np.sqrt(np.mean(stds**2)))
    ratios = np.maximum(stds / std, _LEAST_RATIO) / factors
    systematic = accuracy.systematic_px if accuracy else {}
    left, right = (systematic.get(name, 0.0) for name in pair)
    C = prior_covariance(head, names, pair, moved=changed != "nothing")
    return SelfCalibration(
        head=head,
        cameras=pair,
        names=names,
        covariance=C,
        origin=Origin(head, C),
        joint_std_rad=max(std, float(LEAST_JOINT_STD_RAD)),
        noise_ratios=ratios,
        match_scale=EXPECTED_MATCH_SCALE,
        systematic_px=(left, right),
    )
