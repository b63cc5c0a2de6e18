"""Self-calibration filter: update with one frame after another, and detect a changed head.

The initial frames are kept and relinearised when more is known. Each update tests whether the last
frames are far likelier if a camera was turned, or the head is outside the covariance of its
calibration. Some updates also test the sum of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import reading_kinds
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import (
    contradicts_prior,
    evidence_about,
    kalman_update,
    log_likelihood,
    predict,
)
from vergence.self_calibration.keyframe import track_keyframe, worth_tracking
from vergence.self_calibration.match_noise import no_revisits
from vergence.self_calibration.prior import (
    BUMP,
    UNCALIBRATED,
    Tolerance,
    remaining_covariance,
    tolerance_covariance,
)
from vergence.self_calibration.state import (
    FilterState,
    FrameEstimate,
    FrameRecord,
    HeadChange,
    TrackedFeatures,
)

_CHANGES: dict[HeadChange, Tolerance] = {"camera turned": BUMP, "head uncalibrated": UNCALIBRATED}
"""Hypotheses, each with the tolerance by which the head may have changed."""
_WINDOW = 3
"""Frames that are examined together; a change is detected from at least two."""
_RELINEARISED = (4, 8, 16, 32, 64)
"""Numbers of initial frames after which all of them are relinearised; the last takes 0.6 s."""


def update(
    state: FilterState, estimate: FrameEstimate, tracked: TrackedFeatures | None = None
) -> FilterState:
    """Update the filter with a frame that was estimated from its predicted state.

    Features of the keyframe are tracked where the frame has images, unless they are given.
    """
    state = replace(state, change=None)
    if estimate.evidence is None:
        return state
    if tracked is None and worth_tracking(state, estimate):
        tracked = track_keyframe(state, estimate)
    records = (*state.records, _record(state, estimate, tracked))
    changed = _detect_change(records[-_WINDOW:])
    if changed is not None:
        return changed
    records = records[-_WINDOW:] if state.settled else records[-_RELINEARISED[-1] :]
    if estimate.status == "contradiction":
        return replace(state, records=records, keyframe=None)
    updated = replace(kalman_update(state, estimate, tracked), records=records)
    if state.settled:
        tested = updated.frames % 8 == 0  # a test takes 0.9 ms
    else:
        consistent = tuple(r for r in records if r.estimate.status != "contradiction")
        tested = len(consistent) in _RELINEARISED
        settled = len(records) >= _RELINEARISED[-1]
        if tested or settled:
            updated = _relinearise(consistent, updated)
        kept = updated.records[-_WINDOW:] if settled else updated.records
        updated = replace(updated, settled=settled, records=kept)
    return _restart(updated) if tested and contradicts_prior(updated) else updated


def _release(state: FilterState, tolerance: Tolerance) -> FilterState:
    """Add a tolerance to the covariance of the head, and start again from there."""
    C = state.covariance + tolerance_covariance(state.head, state.names, tolerance)
    return replace(state, covariance=C, prior_head=state.head, prior_covariance=C, settled=False)


def _restart(state: FilterState) -> FilterState:
    """Start again with the uncertainty of a head that is known from its drawing only."""
    return replace(
        _release(state, UNCALIBRATED),
        revisits=no_revisits(len(state.noise_ratios)),
        joint_weight=FilterState.joint_weight,
        records=(),
        keyframe=None,
        change="head uncalibrated",
    )


def _record(
    state: FilterState, estimate: FrameEstimate, tracked: TrackedFeatures | None
) -> FrameRecord:
    """Keep a frame with its log likelihoods without a change, and after each hypothesis."""
    assert estimate.evidence is not None
    before = replace(state, records=(), keyframe=None)
    states = [before, *(_release(before, tolerance) for tolerance in _CHANGES.values())]
    likelihoods = tuple(log_likelihood(each, estimate.evidence) for each in states)
    return FrameRecord(before, replace(estimate, images=None), tracked, likelihoods)


def _detect_change(records: tuple[FrameRecord, ...]) -> FilterState | None:
    """Find the state after the likeliest change before one of the frames; None: no change."""
    best, found = np.log(1e5), None  # the odds of a change are low
    for k, (change, tolerance) in enumerate(_CHANGES.items(), start=1):
        ratios = [each.log_likelihoods[k] - each.log_likelihoods[0] for each in records]
        if max(ratios) <= -6:  # a bump costs about 12, which three frames regain together
            continue
        for first, record in enumerate(records):
            changed = replace(record, state=_release(record.state, tolerance))
            frames = (changed, *records[first + 1 :])
            after, likelihood = _filter_again(frames)
            gain = likelihood - sum(each.log_likelihoods[0] for each in records[first:])
            if gain > best:
                best, found = gain, (change, frames, after)
    if found is None or len(found[1]) < 2:
        return None
    change, frames, after = found
    after = replace(after, keyframe=None)
    return replace(_relinearise(frames, after), change=change, settled=False)


def _filter_again(
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
        evidence = estimate.evidence
        if evidence is None or estimate.status == "contradiction":
            return state, -np.inf
        # A board alone fills a fifth of the image, and errors of its corners look like a change.
        supports = 2 * evidence.inliers >= len(estimate.weights) and evidence.filled >= 0.25
        if at is None and not supports:
            return state, -np.inf
        estimate = replace(estimate, evidence=evidence_about(state, evidence, about.head))
        again.append(_record(state, estimate, record.tracked))
        likelihood += again[-1].log_likelihoods[0]
        state = kalman_update(state, estimate, record.tracked, at=at)
    return replace(state, records=tuple(again)), likelihood


def _relinearise(records: tuple[FrameRecord, ...], after: FilterState) -> FilterState:
    """Filter recorded frames again, all linearised at the head of the state after them.

    Frames that are linearised at different heads seem to determine the scale of the scene, and the
    first ones were weighted by the prior noise of the readings. The state keeps its keyframe, with
    the joints as estimated again.
    """
    before = records[0].state
    start = replace(records[0], state=replace(before, reading_std=after.reading_std))
    again, likelihood = _filter_again((start, *records[1:]), at=after.head)
    if not np.isfinite(likelihood):
        return after
    old, new = after.keyframe, again.keyframe
    if old is None or new is None or not np.array_equal(old.readings, new.readings):
        key = None
    else:
        key = replace(new, images=old.images, pixels=old.pixels, depths_m=old.depths_m)
    kept = (replace(again.records[0], state=before), *again.records[1:])
    return replace(again, keyframe=key, records=kept)


def learned_head(state: FilterState) -> HeadCalibration:
    """Take the current mean as a calibration, with its covariance.

    Parameters that are not estimated keep the calibration's covariance or, without one, the usual
    tolerances of lenses.
    """
    before = state.head.accuracy
    others, C = remaining_covariance(state.head, state.names)
    stds, kinds = state.reading_std_rad, np.array(reading_kinds(state.head.kinematics))
    by_kind = tuple(float(stds[kinds == kind].mean()) for kind in range(kinds.max() + 1))
    accuracy = Accuracy(
        method="self-calibration",
        parameters=(*state.names, *others),
        covariance=np.asarray(block_diag(state.covariance, C), float),
        pixel_std_px=before.pixel_std_px if before else None,
        camera_std_px=before.camera_std_px if before else {},
        joint_std=by_kind if np.ptp(stds) else by_kind[:1],
        findings=before.void if before else (),
        systematic_px=before.systematic_px if before else {},
    )
    return replace(state.head, accuracy=accuracy)
