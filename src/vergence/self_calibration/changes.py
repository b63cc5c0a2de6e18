"""Detection of a changed head: hypotheses about the last frames, and their estimation again.

A turned camera, or a head outside the covariance of its calibration, makes the last few frames far
likelier if the head may have changed before them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import (
    evidence_about,
    kalman_update,
    log_likelihood,
    predict,
)
from vergence.self_calibration.match_noise import filled_share
from vergence.self_calibration.prior import BUMP, UNCALIBRATED, Tolerance, tolerance_covariance
from vergence.self_calibration.state import (
    FilterState,
    FrameEstimate,
    FrameRecord,
    HeadChange,
    PriorSnapshot,
    TrackedFeatures,
)

CHANGES: Mapping[HeadChange, Tolerance] = {
    "camera turned": BUMP,
    "head uncalibrated": UNCALIBRATED,
}
"""Hypotheses, each with the covariance that it adds to the head's."""
WINDOW = 3
"""Frames that are examined together; a change is detected from at least two."""
_EXAMINED = -6.0
"""Log likelihood ratio of one frame from which the window is examined: a bump costs about 12, and
where each of three frames gains half of that, they show it together."""
_DETECTED = np.log(1e5)
"""Log likelihood ratio of the window from which a change is detected; the prior odds are low."""
_LEAST_FILLED = 0.25
"""Share of the left image that matches fill where they support a change: a board alone fills a
fifth, and errors that its corners share look like a change."""


def release(state: FilterState, tolerance: Tolerance) -> FilterState:
    """Add a tolerance to the covariance of the head, and start the filter again from there."""
    C = state.covariance + tolerance_covariance(state.head, state.names, tolerance)
    return replace(state, covariance=C, prior=PriorSnapshot(state.head, C), settled=False)


def record_frame(
    state: FilterState, estimate: FrameEstimate, tracked: TrackedFeatures | None
) -> FrameRecord:
    """Keep a frame with its log likelihoods without a change, and after each hypothesis."""
    assert estimate.evidence is not None
    before = replace(state, records=(), keyframe=None)
    states = [before, *(release(before, tolerance) for tolerance in CHANGES.values())]
    likelihoods = tuple(log_likelihood(each, estimate.evidence) for each in states)
    return FrameRecord(before, replace(estimate, images=None), tracked, likelihoods)


def detect_change(records: tuple[FrameRecord, ...]) -> FilterState | None:
    """Find the likeliest change of the head before one of the recorded frames.

    Returns:
        The state after the frames with that change, linearised at its head; None: no change.
    """
    best, found = _DETECTED, None
    for k, (change, tolerance) in enumerate(CHANGES.items(), start=1):
        ratios = [each.log_likelihoods[k] - each.log_likelihoods[0] for each in records]
        if max(ratios) <= _EXAMINED:
            continue
        for first, record in enumerate(records):
            changed = replace(record, state=release(record.state, tolerance))
            frames = (changed, *records[first + 1 :])
            after, likelihood = estimate_again(frames)
            gain = likelihood - sum(each.log_likelihoods[0] for each in records[first:])
            if gain > best:
                best, found = gain, (change, frames, after)
    if found is None or len(found[1]) < 2:
        return None
    change, frames, after = found
    return replace(relinearise(frames, after), change=change, settled=False, keyframe=None)


def estimate_again(
    records: tuple[FrameRecord, ...], *, at: HeadCalibration | None = None
) -> tuple[FilterState, float]:
    """Filter recorded frames from the state before the first; return also their log likelihood.

    Each frame is linearised at a head, or at the predicted state. The log likelihood is -inf where
    a frame fails the innovation gate or, without a head, does not support a change.
    """
    state, likelihood, again = records[0].state, 0.0, list[FrameRecord]()
    for record in records:
        state = predict(state, max(record.state.time_s - state.time_s, 0.0))
        about = state if at is None else replace(state, head=at)
        old = record.estimate
        estimate = estimate_from_matches(about, old.matches, old.readings, at_head=at is not None)
        if estimate.evidence is None or estimate.status == "contradiction":
            return state, -np.inf
        if at is None and not _supports_change(state, estimate):
            return state, -np.inf
        evidence = evidence_about(state, estimate.evidence, about.head)
        estimate = replace(estimate, evidence=evidence)
        again.append(record_frame(state, estimate, record.tracked))
        likelihood += again[-1].log_likelihoods[0]
        state = kalman_update(state, estimate, record.tracked, at=at)
    return replace(state, records=tuple(again)), likelihood


def _supports_change(state: FilterState, estimate: FrameEstimate) -> bool:
    """Decide whether enough matches fit, all over the image."""
    evidence = estimate.evidence
    assert evidence is not None
    size = state.head.camera(state.cameras[0]).intrinsics.size
    agree = 2 * evidence.inliers >= len(estimate.weights)
    return agree and filled_share(evidence.blocks, size) >= _LEAST_FILLED


def relinearise(records: tuple[FrameRecord, ...], after: FilterState) -> FilterState:
    """Filter recorded frames again, all linearised at the head of the state after them.

    Frames that are linearised at different heads seem to determine the scale of the scene, and the
    first ones were weighted by the prior noise of the readings.
    """
    before = records[0].state
    start = replace(before, joint_std_rad=after.joint_std_rad)
    records = (replace(records[0], state=start), *records[1:])
    again, likelihood = estimate_again(records, at=after.head)
    if not np.isfinite(likelihood):
        return after
    return replace(again, records=(replace(again.records[0], state=before), *again.records[1:]))
