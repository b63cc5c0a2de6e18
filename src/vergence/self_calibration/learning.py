"""What persists, learned from frame to frame: a recursive estimate with its covariance.

Each frame's joint angles are marginalised, but for those of one keyframe, from which features are
followed; what the frame says of the head is kept, with a slow random walk for drift. What is seen
again errs again: a frame counts by how far its errors are new. The noise of the readings is
estimated from what the images say of them. A camera that was bumped shows in a few frames together:
when turned mountings explain them far better than noise does, the head is estimated again from
where these frames began, with the mountings free.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import Accuracy, HeadCalibration
from vergence.geometry.parameters import change_named
from vergence.self_calibration.keyframe import (
    Followed,
    follow_keyframe,
    next_keyframe,
    with_motion,
)
from vergence.self_calibration.match_noise import long_run_variance
from vergence.self_calibration.prior import BUMP, DRIFT, tolerance_covariance
from vergence.self_calibration.state import Evidence, Past, SelfCalibrated, SelfCalibration

_WINDOW = 3
"""Frames that are examined together for a bump; two at least."""
_BUMP_EVIDENCE = 2 * np.log(1e5)
"""Twice the logarithm of how much likelier a bump must make the window: it is rare."""
_PACE = 0.1
"""Share of a frame in the running means of how much matches err."""
_LONGEST_MEMORY = 4000.0
"""Readings from which their noise is estimated."""


def learn(state: SelfCalibration, seen: SelfCalibrated, elapsed_s: float) -> SelfCalibration:
    """Return the state after a frame that was estimated from it.

    Args:
        state: before the frame.
        seen: the frame, of `frame.self_calibrate_frame`.
        elapsed_s: since the frame before.
    """
    return learn_followed(state, seen, follow_keyframe(state, seen), elapsed_s)


def learn_followed(
    state: SelfCalibration, seen: SelfCalibrated, followed: Followed | None, elapsed_s: float
) -> SelfCalibration:
    """Return the state after a frame in which features of the keyframe were found; None: not."""
    P = len(state.names)
    drift = tolerance_covariance(state.head, state.names, DRIFT) * elapsed_s / 60
    state = replace(state, bumped=False)
    if seen.evidence is None:
        return replace(state, covariance=state.covariance + drift, past=(), keyframe=None)
    errors = long_run_variance(state.long_run, seen.evidence.blocks, elapsed_s)
    evidence = _weakened(seen.evidence, errors.ratio)
    N, b = _normal_equations(state, evidence)
    if followed is not None:
        N, b = with_motion(state, seen, followed, N, b)
    C = np.asarray(np.linalg.inv(N), float)
    change = C @ b
    past = (*state.past, Past(state.head, state.covariance, change[:P], evidence))
    past = past[-_WINDOW:]
    state = replace(state, long_run=errors)
    bumped = _after_bump(state, past)
    if bumped is not None:
        return bumped
    if seen.status == "contradiction":
        stays = replace(past[-1], change=np.zeros(P))
        past = (*past[:-1], stays)
        return replace(state, covariance=state.covariance + drift, past=past, keyframe=None)
    variance, weight = _joint_variance(state, evidence)
    head = change_named(state.head, state.names, change[:P])
    return replace(
        state,
        head=head,
        covariance=(C[:P, :P] + C[:P, :P].T) / 2 + drift,
        match_scale=state.match_scale + _PACE * (evidence.match_scale - state.match_scale),
        design_effect=state.design_effect + _PACE * (evidence.design_effect - state.design_effect),
        joint_std_rad=float(np.sqrt(variance)),
        joint_weight=weight,
        frames=state.frames + 1,
        past=past,
        keyframe=next_keyframe(state, seen, head, C, change),
    )


def _weakened(evidence: Evidence, ratio: float) -> Evidence:
    """Return what a frame says beyond the frames before, whose errors it shares."""
    return replace(
        evidence, information=evidence.information / ratio, vector=evidence.vector / ratio
    )


def _normal_equations(state: SelfCalibration, evidence: Evidence) -> tuple[Array, Array]:
    """Return what is known of head, present readings and joints of the keyframe, if there is one.

    Information (K, K) and vector (K,), about the state's head and the joints as they are.
    """
    P, known = len(state.names), len(evidence.vector)
    key = state.keyframe
    if key is None:
        before, K = np.linalg.inv(state.covariance), known
    else:
        C = np.block([[state.covariance, key.with_head], [key.with_head.T, key.covariance]])
        before, K = np.linalg.inv(C), known + len(key.joints)
    N, b = np.zeros((K, K)), np.zeros(K)
    lasting = np.r_[:P, known:K]
    N[np.ix_(lasting, lasting)] = (before + before.T) / 2
    N[P:known, P:known] = np.eye(known - P) / state.joint_std_rad**2
    N[:known, :known] += evidence.information
    b[:known] = evidence.vector
    return N, b


def _of_head(state: SelfCalibration, evidence: Evidence) -> tuple[Array, Array]:
    """Return information (P, P) and vector (P,) of the head alone; the joints are marginalised."""
    P = len(state.names)
    N, b = evidence.information, evidence.vector
    joints = N[P:, P:] + np.eye(len(b) - P) / state.joint_std_rad**2
    follows = np.linalg.solve(joints, N[P:, :P]).T
    return N[:P, :P] - follows @ N[P:, :P], b[:P] - follows @ b[P:]


def _after_bump(state: SelfCalibration, past: tuple[Past, ...]) -> SelfCalibration | None:
    """Return the state after a bump in the last frames; None: there was none."""
    free = tolerance_covariance(state.head, state.names, BUMP)
    best, found = 0.0, None
    for first in range(len(past)):
        frames = past[first:]
        total, vector = np.zeros_like(free), np.zeros(len(free))
        moved = np.zeros(len(free))  # of the head, from the first of these frames
        for each in frames:
            N, b = _of_head(state, each.evidence)
            total, vector = total + N, vector + b + N @ moved
            moved = moved + each.change
        before = frames[0].covariance
        gain = _log_evidence(before + free, total, vector) - _log_evidence(before, total, vector)
        if gain > best:
            best, found = gain, (frames, total, vector)
    # One frame alone may be a wrong one: the next will tell.
    if found is None or len(found[0]) < 2 or 2 * best < _BUMP_EVIDENCE:
        return None
    frames, total, vector = found
    C = np.linalg.inv(np.linalg.inv(frames[0].covariance + free) + total)
    head = change_named(frames[0].head, state.names, C @ vector)
    return replace(state, head=head, covariance=C, bumped=True, past=(), keyframe=None)


def _log_evidence(C: Array, information: Array, vector: Array) -> float:
    """Return the log likelihood of normal equations under a Gaussian prior, up to a constant."""
    posterior = np.linalg.inv(np.linalg.inv(C) + information)
    _, log_det = np.linalg.slogdet(np.eye(len(C)) + C @ information)
    return float(vector @ posterior @ vector - log_det) / 2


def _joint_variance(state: SelfCalibration, evidence: Evidence) -> tuple[float, float]:
    """Return the variance [rad^2] of a reading after a frame, and how many readings it is from.

    Each direction of the joints' space that the images determine is a sample, weighted by how well
    they do.
    """
    P = len(state.names)
    N, b = evidence.information, evidence.vector
    head = N[:P, :P] + np.linalg.inv(state.covariance)
    follows = np.linalg.solve(head, N[:P, P:]).T
    H, h = N[P:, P:] - follows @ N[:P, P:], b[P:] - follows @ b[:P]
    values, directions = np.linalg.eigh((H + H.T) / 2)
    sure = values > 1e-9 * values[-1]
    noise = 1 / values[sure]
    samples = (directions[:, sure].T @ h * noise) ** 2 - noise
    expected = state.joint_std_rad**2
    weights = (expected / (expected + noise)) ** 2
    weight = state.joint_weight + float(weights.sum())
    variance = (state.joint_weight * expected + float(weights @ samples)) / weight
    return max(variance, 1e-2 * expected), min(weight, _LONGEST_MEMORY)


def learned_head(state: SelfCalibration) -> HeadCalibration:
    """Return the learned head with its accuracy, to be saved and used as any calibration."""
    before = state.head.accuracy
    accuracy = Accuracy(
        method=before.method if before else "bundle",
        parameters=state.names,
        covariance=state.covariance,
        pixel_std_px=before.pixel_std_px if before else None,
        joint_std=(state.joint_std_rad,),
        eye_motion=before.eye_motion if before else "pan-tilt",
    )
    return replace(state.head, accuracy=accuracy)
