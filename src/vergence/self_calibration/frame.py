"""One pair of images: joint angles and head as both the readings and the scene tell.

Unknown are what the readings of this moment miss (joint noise) and the parameters of the head
that persist, with their prior. Both are Gaussian, so that where the scene shows little the result
is the prior, and the covariance says so. Matches may be wrong: the best of many hypotheses from
three matches each starts a robust fit with a fixed scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_named, parameter_names
from vergence.geometry.projection import T_rcam_lcam, pair_names
from vergence.self_calibration.epipolar import epipolar_residuals
from vergence.self_calibration.match_noise import (
    CUT,
    EXPECTED_DESIGN_EFFECT,
    EXPECTED_MATCH_SCALE,
    LongRunVariance,
    design_effect,
    noise_variance,
    tukey_weights,
)
from vergence.self_calibration.prior import (
    BUMP,
    JOINT_STD_RAD,
    learned_names,
    prior_covariance,
    tolerance_covariance,
)
from vergence.stereo.uncertainty import LocatedPoints, locate_jointly
from vergence.vision.scene_features import Matches, match_scene

Status = Literal["seen", "little seen", "contradiction"]
_HYPOTHESES = 300
_STEPS = 4
"""Of reweighted least squares in a fit; a frame is fitted twice."""
_JUDGES = 250
"""Matches that choose among them; more take longer, and choose no better."""
_GATE = 1e-7
"""Probability by chance of a change that is not believed from one frame alone."""
_GATE_OF_FEW = 1e-3
"""The same where most matches contradict each other."""
_FEWEST = 12.0
"""Matches that must fit; a few always do, whatever they show."""
_MOST = 0.5
"""Share of the matches that is most of them."""
_LITTLE = 1.5
"""Degrees of freedom of the pair, of five, below which the scene showed too little."""


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
    joint_std_rad: float
    """Noise of a reading."""
    match_scale: float
    """Noise of the matches, relative to what their contrast tells."""
    design_effect: float = EXPECTED_DESIGN_EFFECT
    """Variance inflation by errors that neighbouring matches share."""
    long_run: LongRunVariance | None = None
    """Variance inflation by errors that successive frames share; None: no frame was learned."""
    joint_weight: float = 5.0
    """Readings from which their noise is known."""
    frames: int = 0
    """From which it was learned."""
    bumped: bool = False
    """Whether the last frame showed that a camera had been turned."""
    past: tuple[Past, ...] = ()
    """The last frames, by which a bump is told from noise."""


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
    """Noise of the matches, relative to what their contrast tells."""
    design_effect: float
    """Variance inflation by errors that neighbouring matches share."""
    blocks: Array
    """(B,) sums of residuals in blocks of the left image, of `match_noise.design_effect`."""


@dataclass(frozen=True, eq=False)
class Past:
    """A frame that may have to be estimated again."""

    head: HeadCalibration
    """Before the frame."""
    covariance: Array
    """(P, P) before the frame."""
    change: Array
    """(P,) of the head by the frame."""
    evidence: Evidence


@dataclass(frozen=True, eq=False)
class SelfCalibrated:
    """A head and its joint angles at the moment of a pair of images."""

    head: HeadCalibration
    cameras: tuple[str, str]
    joints: Array
    """(r,) the readings, corrected [rad]."""
    names: tuple[str, ...]
    covariance: Array
    """(P + r, P + r) of the head's parameters and the corrected readings."""
    matches: Matches
    weights: Array
    """(N,) from 0, a match that does not fit, to 1."""
    status: Status
    evidence: Evidence | None
    """None: too few matches fit."""


def initial_self_calibration(
    head: HeadCalibration, *, cameras: tuple[str, str] | None = None
) -> SelfCalibration:
    """Return what is known of a head before its eyes have seen anything.

    VergenceError for a head of one eye.
    """
    pair = pair_names(head, cameras)
    names = learned_names(head, pair)
    stated = head.accuracy.joint_std if head.accuracy else ()
    std = float(np.sqrt(np.mean(np.square(stated)))) if stated else float(JOINT_STD_RAD)
    C = prior_covariance(head, names, pair)
    return SelfCalibration(head, pair, names, C, std, EXPECTED_MATCH_SCALE)


def self_calibrate_frame(
    state: SelfCalibration, left: np.ndarray, right: np.ndarray, joints: Array
) -> SelfCalibrated:
    """Return the head and its joint angles as a pair of images shows them.

    Args:
        state: what is known of the head; it is not changed, see `learning.learn`.
        left: (H, W, 3) RGB or (H, W) grey image of the left camera, uint8.
        right: the same moment in the right camera.
        joints: (r,) readings [rad].
    """
    cameras = [state.head.camera(name).intrinsics for name in state.cameras]
    matches = match_scene(
        left,
        right,
        left_camera=cameras[0],
        right_camera=cameras[1],
        T_rcam_lcam=T_rcam_lcam(state.head, joints, cameras=state.cameras),
    )
    return from_matches(state, matches, joints)


def from_matches(state: SelfCalibration, matches: Matches, joints: Array) -> SelfCalibrated:
    """Return the head and its joint angles as matches of a pair of images show them."""
    C = _prior(state, len(joints))
    if len(matches.left) < _FEWEST:
        return _unseen(state, matches, joints, C, "little seen")
    z, weights, evidence = _fit(state, matches, joints, C)
    if evidence.inliers < _FEWEST:
        return replace(_unseen(state, matches, joints, C, "little seen"), weights=weights)
    if evidence.inliers < _MOST * len(weights):
        # Either much is matched wrongly, or a camera has been turned.
        P = len(state.names)
        turned = C.copy()
        turned[:P, :P] += tolerance_covariance(state.head, state.names, BUMP)
        _, other_weights, other = _fit(state, matches, joints, turned)
        if other.inliers > max(_MOST * len(weights), 1.3 * evidence.inliers):
            seen = _unseen(state, matches, joints, C, "contradiction")
            return replace(seen, weights=other_weights, evidence=other)
    covariance = np.asarray(np.linalg.inv(evidence.information + np.linalg.inv(C)), float)
    observed = float(np.trace(covariance @ evidence.information))
    gate = _GATE if evidence.inliers > _MOST * len(weights) else _GATE_OF_FEW
    if float(z @ np.linalg.solve(C, z)) > chi2.isf(gate, max(observed, 1.0)):
        seen = _unseen(state, matches, joints, C, "contradiction")
        return replace(seen, weights=weights, evidence=evidence)
    head, now = _changed(state, joints, z)
    return SelfCalibrated(
        head=head,
        cameras=state.cameras,
        joints=now,
        names=state.names,
        covariance=covariance,
        matches=matches,
        weights=weights,
        status="seen" if observed > _LITTLE else "little seen",
        evidence=evidence,
    )


def _fit(
    state: SelfCalibration, matches: Matches, joints: Array, C: Array
) -> tuple[Array, Array, Evidence]:
    """Return the change (K,) that matches and prior give, weights (N,), and what matches say."""
    y, A = _whitened(state, state.head, joints, matches)
    first = _robust(y, A, C, _best_hypothesis(y, A, C))
    y, A = _whitened(state, *_changed(state, joints, first), matches)
    y = y + A @ first  # of the linear model about the state's head
    z = _robust(y, A, C, first)
    weights, scale2 = tukey_weights(y - A @ z), noise_variance(y - A @ z)
    normal = (y - A @ z) / np.sqrt(scale2)
    inflation, blocks = design_effect(normal, matches.left, state.design_effect)
    weighted = A * (weights / (scale2 * inflation))[:, None]
    information, vector = weighted.T @ A, weighted.T @ y
    z = np.asarray(np.linalg.solve(information + np.linalg.inv(C), vector), float)
    scale = float(np.sqrt(scale2)) * state.match_scale
    inliers = float((weights > 0.3).sum())
    return z, weights, Evidence(information, vector, inliers, scale, inflation, blocks)


def _prior(state: SelfCalibration, readings: int) -> Array:
    P = len(state.names)
    C = np.zeros((P + readings, P + readings))
    C[:P, :P] = state.covariance
    C[P:, P:] = state.joint_std_rad**2 * np.eye(readings)
    return C


def _unseen(
    state: SelfCalibration, matches: Matches, joints: Array, C: Array, status: Status
) -> SelfCalibrated:
    """Return the prior."""
    return SelfCalibrated(
        head=state.head,
        cameras=state.cameras,
        joints=joints,
        names=state.names,
        covariance=C,
        matches=matches,
        weights=np.zeros(len(matches.left)),
        status=status,
        evidence=None,
    )


def _changed(state: SelfCalibration, joints: Array, z: Array) -> tuple[HeadCalibration, Array]:
    P = len(state.names)
    return change_named(state.head, state.names, z[:P]), joints + z[P:]


def _whitened(
    state: SelfCalibration, head: HeadCalibration, joints: Array, matches: Matches
) -> tuple[Array, Array]:
    """Return residuals (N,) and derivatives (N, P + r), in standard deviations of the matches."""
    found = epipolar_residuals(head, joints, matches.left, matches.right, state.cameras)
    known = parameter_names(head)
    columns = [known.index(name) for name in state.names]
    n = found.normals[:, 2:]
    std = state.match_scale * np.sqrt(np.einsum("ni,nij,nj->n", n, matches.covariance, n))
    A = np.concatenate([found.by_parameters[:, columns], found.by_readings], axis=1)
    good = np.isfinite(found.residuals) & np.isfinite(A).all(axis=1) & (std > 0)
    y = np.where(good, found.residuals / std, 1e3)
    return y, np.where(good[:, None], A / std[:, None], 0.0)


def _best_hypothesis(y: Array, A: Array, C: Array) -> Array:
    """Return the change (K,) that three matches and the prior give, and most others agree with."""
    rng = np.random.default_rng(0)
    if len(y) > _JUDGES:
        some = rng.choice(len(y), _JUDGES, replace=False)
        y, A = y[some], A[some]
    AC = A @ C
    G = AC @ A.T
    triples = rng.integers(0, len(y), (_HYPOTHESES, 3))
    G3 = G[triples[:, :, None], triples[:, None, :]]
    pull = np.linalg.solve(G3 + np.eye(3), y[triples][..., None])[..., 0]
    pull = np.concatenate([np.zeros((1, 3)), pull])  # and that nothing is wrong
    G3, triples = np.concatenate([G3[:1], G3]), np.concatenate([triples[:1], triples])
    predicted = (pull[:, None] @ G[triples])[:, 0]
    prior = np.einsum("hi,hij,hj->h", pull, G3, pull)
    cost = np.minimum((y - predicted) ** 2, CUT**2).sum(axis=1) + prior
    best = int(cost.argmin())
    return pull[best] @ AC[triples[best]]


def _robust(y: Array, A: Array, C: Array, z: Array) -> Array:
    """Return the change (K,) by iteratively reweighted least squares with the prior."""
    inverse = np.linalg.inv(C)
    for _ in range(_STEPS):
        weighted = A * tukey_weights(y - A @ z)[:, None]
        z = np.asarray(np.linalg.solve(weighted.T @ A + inverse, weighted.T @ y), float)
    return z


def locate_seen(
    seen: SelfCalibrated, *, left: Array, right: Array, pixel_std_px: ArrayLike
) -> LocatedPoints:
    """Return where points are that both eyes see at the moment of a self-calibrated frame.

    Pixels are (N, 2) in the left and the right camera; the covariance has what the frame leaves
    open of the head and the joints. Other arguments and errors are those of `uncertainty.locate`.
    """
    return locate_jointly(
        seen.head,
        left=left,
        right=right,
        joints=seen.joints,
        parameters=seen.names,
        covariance=seen.covariance,
        pixel_std_px=pixel_std_px,
        cameras=seen.cameras,
    )
