"""Self-calibration filter: update with one frame after another, and the learned head.

The initial frames are kept and relinearised when more is known. Each update tests hypotheses about
a change of the head on the last frames, and some updates also test the sum of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import reading_kinds
from vergence.self_calibration.changes import (
    CHANGES,
    WINDOW,
    detect_change,
    record_frame,
    release,
    relinearise,
)
from vergence.self_calibration.kalman import contradicts_prior, kalman_update
from vergence.self_calibration.keyframe import track_keyframe, worth_tracking
from vergence.self_calibration.prior import remaining_covariance
from vergence.self_calibration.state import (
    FilterState,
    FrameEstimate,
    FrameRecord,
    Keyframe,
    TrackedFeatures,
)

_RELINEARISED = (4, 8, 16, 32, 64)
"""Numbers of initial frames after which all of them are relinearised; the last takes 0.6 s."""
_TESTED = 8
"""Updates between tests of their sum, which takes 0.9 ms and shows a change in many frames."""


def update(state: FilterState, estimate: FrameEstimate) -> FilterState:
    """Update the filter with a frame that was estimated from its predicted state.

    Args:
        state: predicted for the frame; see `kalman.predict`.
        estimate: the frame, from `frame.estimate_frame`.
    """
    tracked = None
    if estimate.evidence is not None and worth_tracking(state, estimate):
        tracked = track_keyframe(state, estimate)
    return update_with_tracked(state, estimate, tracked)


def update_with_tracked(
    state: FilterState, estimate: FrameEstimate, tracked: TrackedFeatures | None
) -> FilterState:
    """Update the filter with a frame, and with features of the keyframe in it, if any."""
    state = replace(state, change=None)
    if estimate.evidence is None:
        return state
    records = (*state.records, record_frame(state, estimate, tracked))
    changed = detect_change(records[-WINDOW:])
    if changed is not None:
        return changed
    records = records[-WINDOW:] if state.settled else records[-_RELINEARISED[-1] :]
    if estimate.status == "contradiction":
        return replace(state, records=records, keyframe=None)
    updated = replace(kalman_update(state, estimate, tracked), records=records)
    if state.settled:
        tested = updated.frames % _TESTED == 0
    else:
        tested = len(_consistent(records)) in _RELINEARISED
        updated = _settle(updated)
    return _restart(updated) if tested and contradicts_prior(updated) else updated


def _restart(state: FilterState) -> FilterState:
    """Start again with the uncertainty of a head that is known from its drawing only."""
    return replace(
        release(state, CHANGES["head uncalibrated"]),
        revisits=None,
        joint_weight=FilterState.joint_weight,
        records=(),
        keyframe=None,
        change="head uncalibrated",
    )


def _settle(state: FilterState) -> FilterState:
    """Relinearise the initial frames when their number has doubled; then drop them."""
    records = state.records
    settled = len(records) >= _RELINEARISED[-1]
    consistent = _consistent(records)
    if settled or len(consistent) in _RELINEARISED:
        again = relinearise(consistent, state)
        state = replace(again, keyframe=_with_joints_of(state.keyframe, again.keyframe))
        records = state.records
    return replace(state, settled=settled, records=records[-WINDOW:] if settled else records)


def _consistent(records: tuple[FrameRecord, ...]) -> tuple[FrameRecord, ...]:
    return tuple(each for each in records if each.estimate.status != "contradiction")


def _with_joints_of(keyframe: Keyframe | None, again: Keyframe | None) -> Keyframe | None:
    """Return a keyframe with its joints as they were estimated again; None: they were not."""
    if keyframe is None or again is None or not np.array_equal(keyframe.readings, again.readings):
        return None
    return replace(
        keyframe,
        joints=again.joints,
        covariance=again.covariance,
        cross_covariance=again.cross_covariance,
    )


def learned_head(state: FilterState) -> HeadCalibration:
    """Return the current mean as a calibration, with its covariance.

    Parameters that are not estimated keep the calibration's covariance or, without one, the usual
    tolerances of lenses.
    """
    before = state.head.accuracy
    others, C = remaining_covariance(state.head, state.names)
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


def _stds_by_kind(state: FilterState) -> tuple[float, ...]:
    """Return the noise of each kind of reading [rad], or one for all where that is the same."""
    stds: Array = state.reading_std_rad
    kinds = np.array(reading_kinds(state.head.kinematics))
    if np.ptp(stds) == 0:
        return (float(stds[0]),)
    return tuple(float(stds[kinds == kind].mean()) for kind in range(kinds.max() + 1))
