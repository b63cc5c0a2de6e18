"""The recursive filter: what is known of a head after one more frame.

The frame's joint angles are marginalised, but for those of one keyframe, from which features are
tracked; what the frame says of the head is kept, with a slow random walk for drift. What is seen
again errs again: a frame counts by how far its posture is new. The noise of the readings is
estimated from what the images say of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import fdtri

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_between, change_named
from vergence.self_calibration.keyframe import next_keyframe
from vergence.self_calibration.match_noise import aged, noise_degrees, with_frame
from vergence.self_calibration.motion_evidence import prior_information, with_motion
from vergence.self_calibration.robust_fit import GATE
from vergence.self_calibration.state import (
    Evidence,
    FrameEstimate,
    SelfCalibration,
    TrackedFeatures,
)
from vergence.self_calibration.tolerances import DRIFT, tolerance_covariance

_PACE = 0.1
"""Share of a frame in the running means of how much matches err."""
_LONGEST_MEMORY = 4000.0
"""Readings from which their noise is estimated."""
_LEARNED = 0.02
"""Share of a variance that is gone where something was learned; less is hardly more than drift."""
_FIXED = 1e-12
"""Variance of a combination, relative to its parameters', below which it does not change."""


def updated(
    state: SelfCalibration,
    seen: FrameEstimate,
    says: Evidence,
    tracked: TrackedFeatures | None,
    *,
    at: HeadCalibration | None = None,
) -> SelfCalibration:
    """Return the state after a frame that is believed.

    Args:
        state: just before the frame.
        seen: the frame.
        says: what its matches say about the state's head.
        tracked: features of an earlier frame that were found in it.
        at: a head that is nearly right, at which what they say is linearised; None: where the frame
            itself would have it.
    """
    P, factors = len(state.names), state.head.kinematics.factors
    recurrence, inflation = with_frame(
        state.recurrence, factors * seen.readings, says.blocks, says.systematic
    )
    # Only what it says beyond the frames before, whose errors it shares.
    information, vector = says.information / inflation, says.vector / inflation
    N, known = prior_information(state), len(vector)
    N[:known, :known] += information
    b = np.zeros(len(N))
    b[:known] = vector
    if tracked is not None:
        N, b = with_motion(state, seen, tracked, inflation, N, b, at=at)
    C = np.asarray(np.linalg.inv(N), float)
    change = C @ b
    about, of_head = state.head, change[:P]
    if at is not None:  # turns add up exactly along the axes of one head
        about, of_head = at, change_between(state.head, at, state.names) + of_head
    head = change_named(about, state.names, of_head)
    variance, weight = _joint_variance(state, information, vector)
    return replace(
        state,
        head=head,
        covariance=(C[:P, :P] + C[:P, :P].T) / 2,
        recurrence=recurrence,
        match_scale=state.match_scale * (1 + _PACE * (says.match_scale - 1)),
        design_effect=state.design_effect + _PACE * (says.design_effect - state.design_effect),
        joint_std_rad=float(np.sqrt(variance)),
        joint_weight=weight,
        frames=state.frames + 1,
        keyframe=next_keyframe(state, seen, head, C, change),
    )


def drifted(state: SelfCalibration, elapsed_s: float) -> SelfCalibration:
    """Return the state some time later, in which the head may have changed a little.

    VergenceError if the time is not finite, or negative.
    """
    if not 0 <= elapsed_s < np.inf:
        raise VergenceError(
            f"Frames follow each other after 0 s or more; found {elapsed_s:g} s between two."
        )
    if elapsed_s == 0:
        return state
    drift = tolerance_covariance(state.head, state.names, DRIFT) * elapsed_s / 60
    return replace(
        state,
        covariance=state.covariance + drift,
        origin=replace(state.origin, covariance=state.origin.covariance + drift),
        recurrence=None if state.recurrence is None else aged(state.recurrence, elapsed_s),
        time_s=state.time_s + elapsed_s,
    )


def _joint_variance(state: SelfCalibration, N: Array, b: Array) -> tuple[float, float]:
    """Return the variance [rad^2] of the readings after a frame, and how many of them it is from.

    Each direction that the images determine, in a space where all readings have the same noise, is
    a sample, weighted by how well they do.
    """
    P = len(state.names)
    head = N[:P, :P] + np.linalg.inv(state.covariance)
    follows = np.linalg.solve(head, N[:P, P:]).T
    H, h = N[P:, P:] - follows @ N[:P, P:], b[P:] - follows @ b[:P]
    ratios = state.noise_ratios
    H, h = H * ratios * ratios[:, None], h * ratios
    values, directions = np.linalg.eigh((H + H.T) / 2)
    sure = values > 1e-9 * values[-1]
    noise = 1 / values[sure]
    samples = (directions[:, sure].T @ h * noise) ** 2 - noise
    expected = state.joint_std_rad**2
    weights = (expected / (expected + noise)) ** 2
    weight = state.joint_weight + float(weights.sum())
    variance = (state.joint_weight * expected + float(weights @ samples)) / weight
    return max(variance, 1e-2 * expected), min(weight, _LONGEST_MEMORY)


def change_exceeds_prior(state: SelfCalibration) -> bool:
    """Return whether what was learned is farther from where it began than chance explains.

    A head that is learned changes by the square of what was known less what is known still. Many
    frames show a change that is too small for a few, such as that of a gain.
    """
    before = state.origin
    change = change_between(state.head, before.head, state.names)
    std = np.sqrt(np.diag(before.covariance))
    size, axes = np.linalg.eigh(before.covariance / std / std[:, None])
    # To a variance of one before; a calibration may hold combinations fixed, up to rounding.
    whiten = axes.T / std / np.sqrt(np.maximum(size, _FIXED))[:, None]
    left = whiten @ state.covariance @ whiten.T
    values, directions = np.linalg.eigh((left + left.T) / 2)
    learned = values < 1 - _LEARNED
    moved = directions[:, learned].T @ (whiten @ change)
    distance = float((moved**2 / (1 - values[learned])).sum())
    # An F-test, since the noise of matches is estimated too, of a small scene from few of them.
    degrees = max(float(learned.sum()), 1.0)
    return distance > degrees * fdtri(degrees, noise_degrees(state.recurrence), 1 - GATE)


def log_likelihood(state: SelfCalibration, seen: FrameEstimate) -> float:
    """Return the log likelihood of a frame given what is known before, up to a constant."""
    assert seen.evidence is not None
    # In full, unlike in `updated`: errors that recur were there when the state was learned, so that
    # they do not look like a change.
    says = seen.evidence
    C = state.before_frame
    added = np.eye(len(C)) + says.information @ C
    _, log_det = np.linalg.slogdet(added)
    pull = float(says.vector @ C @ np.linalg.solve(added, says.vector))
    return (pull - float(log_det) - says.misfit) / 2


def evidence_about(state: SelfCalibration, says: Evidence, head: HeadCalibration) -> Evidence:
    """Return evidence about a state's head that was given about another one near it."""
    if head is state.head:
        return says
    P, change = len(state.names), change_between(state.head, head, state.names)
    of_change = says.information[:, :P] @ change
    misfit = says.misfit + float(change @ (of_change[:P] - 2 * says.vector[:P]))
    return replace(says, vector=says.vector - of_change, misfit=misfit)
