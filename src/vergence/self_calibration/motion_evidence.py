"""What features tracked from the keyframe say of the head and of how far each eye has turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_between, change_named
from vergence.self_calibration.match_noise import EXPECTED_DESIGN_EFFECT
from vergence.self_calibration.residuals import motion_coordinates, motion_residuals
from vergence.self_calibration.robust_fit import (
    FEWEST,
    GATE,
    LINEAR_RAD,
    MOST,
    LinearisedResiduals,
    robust_fit,
)
from vergence.self_calibration.state import (
    Evidence,
    FrameEstimate,
    SelfCalibration,
    TrackedFeatures,
)

_DEPTH_STD = 0.05
"""Relative, of the depth of each feature; the cameras are displaced by millimetres only."""
_COMMON_DEPTH_STD = 1.0
"""Relative, of all depths together: as good as unknown. How far the cameras are from the axes of
their joints would else be learned from the parallax, which is so small that hundredths of a pixel
of the lens model make it wrong by percents, and the scale of depth with it."""
_LINEAR_DEPTH = 0.1
"""Change of it up to which residuals are linear: what a parallax of a pixel then lacks is 0.005."""
_SHARED = 2.5
"""Variance inflation by what all motions have in common, errors of the lens model above all. Fitted
to rendered images: with it, tracked features leave the squared Mahalanobis distance of what is
learned about as it is without them."""


def by_each_eye(
    state: SelfCalibration, seen: FrameEstimate, tracked: TrackedFeatures
) -> FrameEstimate:
    """Return a frame that both eyes together show too little of, as each of them shows it.

    An eye in which too few features fit keeps its readings.

    Args:
        state: before the frame.
        seen: the frame, with nothing but the prior.
        tracked: features of the keyframe that were found in it.
    """
    P, r = len(state.names), len(seen.readings)
    prior = prior_information(state)
    N, b = with_motion(state, seen, tracked, 1.0, prior, np.zeros(len(prior)))
    if N is prior:
        return seen
    C = np.asarray(np.linalg.inv(N), float)
    change = C @ b
    return replace(
        seen,
        head=change_named(state.head, state.names, change[:P]),
        joints=seen.readings + change[P : P + r],
        covariance=C[: P + r, : P + r],
    )


def prior_information(state: SelfCalibration) -> Array:
    """Return what is known before a frame (K, K): of head, readings and the keyframe's joints."""
    C, key = state.before_frame, state.keyframe
    if key is not None:
        shared = np.concatenate([key.with_head, np.zeros_like(key.covariance)])
        C = np.block([[C, shared], [shared.T, key.covariance]])
    N = np.asarray(np.linalg.inv(C), float)
    return (N + N.T) / 2


def with_motion(
    state: SelfCalibration,
    seen: FrameEstimate,
    tracked: TrackedFeatures,
    inflation: float,
    N: Array,
    b: Array,
    *,
    at: HeadCalibration | None = None,
) -> tuple[Array, Array]:
    """Return normal equations (K, K) and (K,) with what tracked features say, where it fits.

    Unknown are changes of the P parameters, of the present readings (r) and of the keyframe's
    joints (r). What the features say counts less by the variance inflation of the frame, and not
    at all if they are of another keyframe than the state's. Residuals are linearised at a head
    that is nearly right or, without one, where the frame itself would have it.
    """
    if state.keyframe is None or not np.array_equal(tracked.readings, state.keyframe.readings):
        return N, b
    for k in range(len(state.cameras)):
        if len(tracked.depths_m[k]) < FEWEST:
            continue
        C = np.asarray(np.linalg.inv(N), float)
        about = C @ b if at is None else _at_head(state, at, N, b)
        fixed = 0 if at is None else len(state.names)
        change, weights, says = _fit(state, seen, tracked, k, about, C, fixed)
        posterior = np.linalg.inv(N + says.information)
        observed = float(np.trace(posterior @ says.information))
        believed = float(change @ N @ change) < chdtri(max(observed, 1.0), GATE)
        if believed and says.inliers > MOST * len(weights):
            information = says.information / inflation
            N, b = N + information, b + says.vector / inflation + information @ about
    return N, b


def _at_head(state: SelfCalibration, at: HeadCalibration, N: Array, b: Array) -> Array:
    """Return the changes (K,) to a head, with the joints that it makes likeliest."""
    P = len(state.names)
    to_head = change_between(at, state.head, state.names)
    joints = np.linalg.solve(N[P:, P:], b[P:] - N[P:, :P] @ to_head)
    return np.asarray(np.concatenate([to_head, joints]), float)


def _fit(
    state: SelfCalibration,
    seen: FrameEstimate,
    tracked: TrackedFeatures,
    k: int,
    about: Array,
    C: Array,
    fixed: int,
) -> tuple[Array, Array, Evidence]:
    """Return what features of camera k say about changes from those (K,) that are believed.

    The first ones, as many as are fixed, stay where residuals are linearised again.
    """
    matches, K, P = tracked.matches[k], len(C), len(state.names)
    with_depth, factors = np.eye(K + 1), np.tile(state.head.kinematics.factors, 2)
    with_depth[:K, :K] = C

    def linear(z: Array) -> bool:
        return bool(np.abs(factors * z[P:K]).max() < LINEAR_RAD and abs(z[K]) < _LINEAR_DEPTH)

    def linearised(z: Array, some: np.ndarray) -> LinearisedResiduals:
        found = _whitened(state, seen, tracked, k, about + z[:K], float(z[K]))
        y, A = found.residuals[some], found.by_coordinates[some]
        return replace(found, residuals=y, by_coordinates=A)

    change, weights, says = robust_fit(
        linearised,
        with_depth,
        pixels=np.tile(matches.left, (2, 1)),
        size=state.head.camera(state.cameras[k]).intrinsics.size,
        expected_design_effect=EXPECTED_DESIGN_EFFECT,
        fixed=fixed,
        linear=linear if state.settled else None,
    )
    N, b = says.information / _SHARED, says.vector / _SHARED
    follows = N[:K, K] / (N[K, K] + 1)
    information, vector = N[:K, :K] - np.outer(follows, N[K, :K]), b[:K] - follows * b[K]
    return change[:K], weights, replace(says, information=information, vector=vector)


def _whitened(
    state: SelfCalibration,
    seen: FrameEstimate,
    tracked: TrackedFeatures,
    k: int,
    change: Array,
    deeper: float,
) -> LinearisedResiduals:
    """Return residuals (2 N,), all u before all v, in standard deviations; unknowns are K + 1.

    After a change (K,), and with all depths larger by so many of their standard deviations, which
    is the last unknown.
    """
    assert state.keyframe is not None
    P, r = len(state.names), len(seen.readings)
    head = change_named(state.head, state.names, change[:P])
    matches = tracked.matches[k]
    before, now = state.keyframe.joints + change[P + r :], seen.readings + change[P : P + r]
    coordinates = motion_coordinates(head, state.names, before, now, state.cameras[k])
    found = motion_residuals(
        coordinates.lenses[0],
        coordinates.T_second_first,
        earlier=matches.left,
        later=matches.right,
        depths_m=tracked.depths_m[k] * np.exp(_COMMON_DEPTH_STD * deeper),
    )
    deeper_all = _COMMON_DEPTH_STD * found.by_depth[..., None]
    A = np.concatenate([found.by_coordinates, deeper_all], axis=2)
    by_depth = _DEPTH_STD * found.by_depth
    whole = np.concatenate([A, found.residuals[..., None]], axis=2)
    good = np.asarray(np.isfinite(whole).all(axis=(1, 2)))
    C = state.match_scale**2 * matches.covariance + np.einsum("ni,nj->nij", by_depth, by_depth)
    C[~good] = np.eye(2)
    systematic = 2 * state.systematic_px[k] ** 2  # then and now, in two places of the image
    random = float(np.median(C[:, 0, 0] + C[:, 1, 1])) / 2
    C += systematic * np.eye(2)
    whiten = np.linalg.inv(np.linalg.cholesky(C))
    y = np.where(good[:, None], (whiten @ found.residuals[..., None])[..., 0], 1e3)
    A = np.where(good[:, None, None], whiten @ A, 0.0)
    by_unknowns = np.asarray(block_diag(coordinates.by_unknowns, 1.0), float)
    share = systematic / (systematic + random)
    A = A.swapaxes(0, 1).reshape(-1, A.shape[-1])
    return LinearisedResiduals(y.T.reshape(-1), A, by_unknowns, share)
