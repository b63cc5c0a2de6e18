"""Iterated extended Kalman filter over the head parameters: predict and update.

The frame's joint angles are marginalised, except those of the keyframe. The noise of the readings
is estimated from the innovations of the joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.estimation.linear import posterior
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_between, change_named
from vergence.self_calibration.keyframe import add_tracked, augmented_covariance, next_keyframe
from vergence.self_calibration.match_noise import PACE
from vergence.self_calibration.prior import DRIFT, tolerance_covariance
from vergence.self_calibration.robust_fit import gate
from vergence.self_calibration.state import Evidence, FilterState, FrameEstimate, TrackedFeatures


def predict(state: FilterState, elapsed_s: float) -> FilterState:
    """Add process noise, the drift of the head over a time; VergenceError if it is negative."""
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
        prior_covariance=state.prior_covariance + drift,
        revisits=state.revisits.predict(elapsed_s),
        time_s=state.time_s + elapsed_s,
    )


def kalman_update(
    state: FilterState,
    estimate: FrameEstimate,
    tracked: TrackedFeatures | None,
    *,
    at: HeadCalibration | None = None,
) -> FilterState:
    """Update head and noise levels with a frame that passed the innovation gate.

    The state is predicted for the frame, whose evidence is about its head. All frames are
    linearised `at` one head or, without it, each at its own.
    """
    evidence, P = estimate.evidence, len(state.names)
    assert evidence is not None
    inflation = state.revisits.inflation(estimate.novelty)
    C = augmented_covariance(state)
    information, vector = np.zeros_like(C), np.zeros(len(C))
    K = len(evidence.vector)
    information[:K, :K], vector[:K] = evidence.information / inflation, evidence.vector / inflation
    variance, weight = _reading_variance(state, information[:K, :K], vector[:K])
    if tracked is not None:
        information, vector = add_tracked(state, estimate, tracked, (information, vector), at=at)
    change, C = posterior(information, vector, C)
    reference, of_head = state.head, change[:P]
    if at is not None:  # rotations add up exactly along the axes of one head
        reference, of_head = at, change_between(state.head, at, state.names) + of_head
    head = change_named(reference, state.names, of_head)
    return replace(
        state,
        head=head,
        covariance=C[:P, :P],
        revisits=state.revisits.update(
            state.head.kinematics.gear_ratios * estimate.readings,
            estimate.novelty,
            evidence.systematic,
        ),
        match_scale=state.match_scale * (1 + PACE * (evidence.match_scale - 1)),
        design_effect=(1 - PACE) * state.design_effect + PACE * evidence.design_effect,
        reading_std=float(np.sqrt(variance)),
        joint_weight=weight,
        frames=state.frames + 1,
        keyframe=next_keyframe(state, estimate, head=head, change=change, C=C),
    )


def _reading_variance(state: FilterState, N: Array, b: Array) -> tuple[float, float]:
    """Estimate the variance [rad^2] of the readings after a frame, and its weight in readings.

    Each direction of the whitened joints that the images determine is a sample, weighted by how
    well it is determined.
    """
    P, ratios = len(state.names), state.noise_ratios
    gain = np.linalg.solve(N[:P, :P] + np.linalg.inv(state.covariance), N[:P, P:]).T
    H, h = N[P:, P:] - gain @ N[:P, P:], b[P:] - gain @ b[:P]
    H, h = H * ratios * ratios[:, None], h * ratios
    values, directions = np.linalg.eigh((H + H.T) / 2)
    determined = values > 1e-9 * values[-1]
    noise = 1 / values[determined]
    samples = (directions[:, determined].T @ h * noise) ** 2 - noise
    expected = state.reading_std**2
    weights = (expected / (expected + noise)) ** 2
    weight = state.joint_weight + float(weights.sum())
    variance = (state.joint_weight * expected + float(weights @ samples)) / weight
    return max(variance, 1e-2 * expected), weight


def contradicts_prior(state: FilterState) -> bool:
    """Test whether what was learned is inconsistent with the prior: the sum of all updates.

    The difference of two estimates, the prior and the state, is distributed by the difference of
    their covariances. It shows a change that is too small for a few frames, such as that of a gain.
    """
    before = state.prior_covariance
    change = change_between(state.head, state.prior_head, state.names)
    std = np.sqrt(np.diag(before))
    size, axes = np.linalg.eigh(before / std / std[:, None])
    whiten = axes.T / std / np.sqrt(np.maximum(size, 1e-12))[:, None]
    after = whiten @ state.covariance @ whiten.T
    values, directions = np.linalg.eigh((after + after.T) / 2)
    learned = values < 0.98  # a smaller decrease is about the process noise
    moved = directions[:, learned].T @ (whiten @ change)
    distance = float((moved**2 / (1 - values[learned])).sum())
    return distance > gate(float(learned.sum()))


def log_likelihood(state: FilterState, evidence: Evidence) -> float:
    """Compute the log likelihood of a frame under the predicted state, up to a constant.

    Without inflation for revisits: recurring errors were learned with the head, and do not look
    like a change.
    """
    C = state.frame_covariance
    ratio = np.eye(len(C)) + evidence.information @ C
    _, log_det = np.linalg.slogdet(ratio)
    gain = float(evidence.vector @ C @ np.linalg.solve(ratio, evidence.vector))
    return (gain - float(log_det) - evidence.misfit) / 2


def evidence_about(state: FilterState, evidence: Evidence, head: HeadCalibration) -> Evidence:
    """Shift evidence about a nearby head to the head of a state."""
    if head is state.head:
        return evidence
    P, change = len(state.names), change_between(state.head, head, state.names)
    shift = evidence.information[:, :P] @ change
    misfit = evidence.misfit + float(change @ (shift[:P] - 2 * evidence.vector[:P]))
    return replace(evidence, vector=evidence.vector - shift, misfit=misfit)
