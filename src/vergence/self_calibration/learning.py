"""What persists, learned from frame to frame: a recursive estimate with its covariance.

Frame after frame goes through the filter of `update`. The first ones are linearised again, all at
one head, when more is known. A camera that was bumped, or a head that is not as it was calibrated,
shows in a few frames together: when mountings that turned, or a head that is hardly known, explain
them far better than noise does, the head is estimated again from where these frames began, with
these free. What shows in many frames only, such as gains, shows in the sum of what was learned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import reading_kinds
from vergence.self_calibration.frame import from_matches
from vergence.self_calibration.keyframe import track_keyframe, worth_tracking
from vergence.self_calibration.match_noise import share_filled
from vergence.self_calibration.prior import covariance_of_others
from vergence.self_calibration.robust_fit import MOST
from vergence.self_calibration.state import (
    JOINT_WEIGHT,
    Evidence,
    FrameEstimate,
    Keyframe,
    Origin,
    Past,
    SelfCalibration,
    TrackedFeatures,
)
from vergence.self_calibration.tolerances import (
    BUMP,
    UNCALIBRATED,
    Tolerance,
    tolerance_covariance,
)
from vergence.self_calibration.update import (
    change_exceeds_prior,
    drifted,
    evidence_about,
    log_likelihood,
    updated,
)

_WINDOW = 3
"""Frames that are examined together for a change of the head; two at least."""
_LINEARISED_AGAIN = (4, 8, 16, 32, 64)
"""Numbers of first frames, after which all of them are linearised again; then they are dropped."""
_TESTED = 8
"""How many frames, after the first ones, are learned between tests of what they have shown
together: it shows in many, and a test takes 0.9 ms."""
_CHANGES = (BUMP, UNCALIBRATED)
"""How far a bump, or an uncalibrated head, may be from what was known before a frame."""
_HARDLY_LESS_LIKELY = 6.0
"""Logarithm of how much less likely a change may make each frame alone, for the window to be
examined: a bump costs some 12, and where each frame gains half of that, three of them show it. In
undisturbed runs one frame in fifty is examined."""
_CHANGE_MATCHES = 50.0
"""Matches of a frame that fit a change at least, and most of them: a few wrong ones always fit some
head. Rooms show 370 and more."""
_CHANGE_SHARE = 0.25
"""Share of the left image that they fill at least: of a board alone, which fills about a fifth,
errors that its corners share look like a change. Rooms fill about a half and more."""
_CHANGE_EVIDENCE = 2 * np.log(1e5)
"""Twice the logarithm of how much likelier a change must make the window: it is rare."""


def learn(state: SelfCalibration, seen: FrameEstimate) -> SelfCalibration:
    """Return the state after a frame that was estimated from it.

    Args:
        state: just before the frame: `update.drifted` by the time since the one before.
        seen: the frame, of `frame.self_calibrate_frame`.
    """
    tracked = None
    if seen.evidence is not None and worth_tracking(state, seen):
        tracked = track_keyframe(state, seen)
    return learn_tracked(state, seen, tracked)


def learn_tracked(
    state: SelfCalibration, seen: FrameEstimate, tracked: TrackedFeatures | None
) -> SelfCalibration:
    """Return the state after a frame in which features of the keyframe were found; None: not."""
    state = without_reports(state)
    if seen.evidence is None:
        return state
    past = (*state.past, _remembered(state, replace(seen, images=None), tracked))
    changed = _after_change(past[-_WINDOW:])
    if changed is not None:
        return changed
    past = past[-_WINDOW:] if state.settled else past[-_LINEARISED_AGAIN[-1] :]
    if seen.status == "contradiction":
        return replace(state, past=past, keyframe=None)
    learned = replace(updated(state, seen, seen.evidence, tracked), past=past)
    if state.settled:
        tested = learned.frames % _TESTED == 0
    else:
        tested, learned = len(_believed(past)) in _LINEARISED_AGAIN, _settling(learned)
    return _begun_anew(learned) if tested and change_exceeds_prior(learned) else learned


def _begun_anew(state: SelfCalibration) -> SelfCalibration:
    """Return what is known of a head that is as uncertain as one known from its drawing."""
    return replace(
        _freed(state, UNCALIBRATED),
        recurrence=None,
        joint_weight=JOINT_WEIGHT,
        past=(),
        keyframe=None,
        settled=False,
        uncalibrated=True,
    )


def without_reports(state: SelfCalibration) -> SelfCalibration:
    """Return the state after a frame that reported no change of the head."""
    changed = state.bumped or state.uncalibrated
    return replace(state, bumped=False, uncalibrated=False) if changed else state


def _remembered(
    state: SelfCalibration, seen: FrameEstimate, tracked: TrackedFeatures | None
) -> Past:
    """Return a frame, seen from a state, as it is kept."""
    before = replace(state, past=(), keyframe=None)
    known = [before, *(_freed(before, tolerance) for tolerance in _CHANGES)]
    likelihoods = tuple(log_likelihood(each, seen) for each in known)
    return Past(before, seen, tracked, likelihoods)


def _freed(state: SelfCalibration, tolerance: Tolerance) -> SelfCalibration:
    """Return what is known of a head that may have changed, too far for a linear model."""
    C = state.covariance + tolerance_covariance(state.head, state.names, tolerance)
    return replace(state, covariance=C, origin=Origin(state.head, C), settled=False)


def _settling(state: SelfCalibration) -> SelfCalibration:
    """Return the state after one of the first frames, at times with all of them linearised anew."""
    past = state.past
    settled = len(past) >= _LINEARISED_AGAIN[-1]
    believed = _believed(past)
    if settled or len(believed) in _LINEARISED_AGAIN:
        again = _linearised_again(believed, state)
        state = replace(again, keyframe=_same_keyframe(state.keyframe, again.keyframe))
        past = state.past
    return replace(state, settled=settled, past=past[-_WINDOW:] if settled else past)


def _believed(past: tuple[Past, ...]) -> tuple[Past, ...]:
    return tuple(each for each in past if each.seen.status != "contradiction")


def _same_keyframe(before: Keyframe | None, again: Keyframe | None) -> Keyframe | None:
    """Return a keyframe with its joints as they were estimated again; None: they were not."""
    if before is None or again is None or not np.array_equal(before.readings, again.readings):
        return None
    return replace(
        before, joints=again.joints, covariance=again.covariance, with_head=again.with_head
    )


def _after_change(past: tuple[Past, ...]) -> SelfCalibration | None:
    """Return the state after a change of the head in the last frames; None: there was none.

    Either a camera was bumped, or the head is not as it was calibrated.
    """
    best, found = 0.0, None
    for k, tolerance in enumerate(_CHANGES, start=1):
        if not any(
            each.likelihoods[k] > each.likelihoods[0] - _HARDLY_LESS_LIKELY for each in past
        ):
            continue
        for first, frame in enumerate(past):
            changed = replace(frame, state=_freed(frame.state, tolerance))
            frames = (changed, *past[first + 1 :])
            after, likelihood = _estimated_again(frames)
            gain = likelihood - sum(each.likelihoods[0] for each in past[first:])
            if gain > best:
                best, found = gain, (frames, after, tolerance is BUMP)
    # One frame alone may be a wrong one: the next will tell.
    if found is None or len(found[0]) < 2 or 2 * best < _CHANGE_EVIDENCE:
        return None
    frames, after, bumped = found
    after = _linearised_again(frames, after)
    return replace(after, bumped=bumped, uncalibrated=not bumped, settled=False, keyframe=None)


def _estimated_again(
    past: tuple[Past, ...], *, at: HeadCalibration | None = None
) -> tuple[SelfCalibration, float]:
    """Return the state after frames, from the state before the first, and their log likelihood.

    Each is linearised anew, at a head, or else where the ones before it have led.
    """
    state, likelihood, again = past[0].state, 0.0, list[Past]()
    for each in past:
        state = drifted(state, max(each.state.time_s - state.time_s, 0.0))
        about = state if at is None else replace(state, head=at)
        seen = from_matches(about, each.seen.matches, each.seen.readings, at_head=at is not None)
        if seen.evidence is None or seen.status == "contradiction":
            return state, -np.inf
        if at is None and not _may_show_change(state, seen, seen.evidence):
            return state, -np.inf
        evidence = evidence_about(state, seen.evidence, about.head)
        seen = replace(seen, evidence=evidence)
        again.append(_remembered(state, seen, each.tracked))
        likelihood += again[-1].likelihoods[0]
        state = updated(state, seen, evidence, each.tracked, at=at)
    return replace(state, past=tuple(again)), likelihood


def _may_show_change(state: SelfCalibration, seen: FrameEstimate, says: Evidence) -> bool:
    """Return whether so much of a frame fits a change, all over the image, that it may show one."""
    lens = state.head.camera(state.cameras[0]).intrinsics
    enough = says.inliers >= max(_CHANGE_MATCHES, MOST * len(seen.weights))
    return enough and share_filled(says.blocks, lens.size) >= _CHANGE_SHARE


def _linearised_again(past: tuple[Past, ...], after: SelfCalibration) -> SelfCalibration:
    """Return the state after frames, which led to a state, linearised where this is.

    What was known before the first of them still stands where it stood. Frames that were linearised
    far from where the head is found to be would else seem to tell more than they do, and so would
    readings that are noisier than was expected.
    """
    before = past[0].state
    known = replace(before, joint_std_rad=after.joint_std_rad)
    again, likelihood = _estimated_again((replace(past[0], state=known), *past[1:]), at=after.head)
    if not np.isfinite(likelihood):
        return after
    return replace(again, past=(replace(again.past[0], state=before), *again.past[1:]))


def _stds_by_kind(state: SelfCalibration) -> tuple[float, ...]:
    """Return the noise of each kind of reading [rad]; one for all, where that is the same."""
    stds = state.reading_std_rad
    kinds = np.array(reading_kinds(state.head.kinematics))
    if np.ptp(stds) == 0:
        return (float(stds[0]),)
    return tuple(float(stds[kinds == kind].mean()) for kind in range(kinds.max() + 1))


def learned_head(state: SelfCalibration) -> HeadCalibration:
    """Return the learned head with its accuracy, to be saved and used as any calibration.

    The time offset is as certain as it was calibrated and, where the calibration does not state its
    covariance, so are the lenses of cameras that self-calibration does not use.
    """
    before = state.head.accuracy
    others, C = covariance_of_others(state.head, state.names)
    accuracy = Accuracy(
        method="self-calibration",
        parameters=(*state.names, *others),
        covariance=np.asarray(block_diag(state.covariance, C), float),
        pixel_std_px=before.pixel_std_px if before else None,
        camera_std_px=before.camera_std_px if before else {},
        joint_std=_stds_by_kind(state),
        findings=before.void if before else (),
        systematic_px=before.systematic_px if before else {},
    )
    return replace(state.head, accuracy=accuracy)
