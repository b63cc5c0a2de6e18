"""What persists, learned from frame to frame: a recursive estimate with its covariance.

Each frame's joint angles are marginalised, but for those of one keyframe, from which features are
followed; what the frame says of the head is kept, with a slow random walk for drift. What is seen
again errs again: a frame counts by how far its posture is new. The noise of the readings is
estimated from what the images say of them. A camera that was bumped, or a head that is not as it
was calibrated, shows in a few frames together: when mountings that turned, or a head that is hardly
known, explain them far better than noise does, the head is estimated again from where these frames
began, with these free.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import Accuracy, HeadCalibration
from vergence.geometry.parameters import boxminus, change_named
from vergence.self_calibration.frame import from_matches, prior_of
from vergence.self_calibration.keyframe import (
    follow_keyframe,
    next_keyframe,
    with_motion,
)
from vergence.self_calibration.match_noise import recurrence_inflation, with_frame
from vergence.self_calibration.prior import BUMP, DRIFT, UNCALIBRATED, tolerance_covariance
from vergence.self_calibration.state import (
    Evidence,
    Followed,
    Keyframe,
    Past,
    SelfCalibrated,
    SelfCalibration,
)

_WINDOW = 3
"""Frames that are examined together for a change of the head; two at least."""
_LINEARISED_AGAIN = (4, 8, 16, 32, 64)
"""Numbers of first frames, after which all of them are linearised again; then they are dropped."""
_CHANGE_EVIDENCE = 2 * np.log(1e5)
"""Twice the logarithm of how much likelier a change must make the window: it is rare."""
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
    state = replace(state, bumped=False, uncalibrated=False)
    if seen.evidence is None:
        return replace(_drifted(state, elapsed_s), keyframe=None)
    frame = Past(_alone(state), replace(seen, images=None), followed, elapsed_s)
    past = (*state.past, frame)
    changed = _after_change(past[-_WINDOW:])
    if changed is not None:
        return changed
    past = past[-_WINDOW:] if state.settled else past
    if seen.status == "contradiction":
        return replace(_drifted(state, elapsed_s), past=past, keyframe=None)
    learned = replace(_updated(state, seen, seen.evidence, followed, elapsed_s), past=past)
    return learned if state.settled else _settling(learned)


def _alone(state: SelfCalibration) -> SelfCalibration:
    return replace(state, past=(), keyframe=None)


def _settling(state: SelfCalibration) -> SelfCalibration:
    """Return the state after one of the first frames, at times with all of them linearised anew."""
    believed = tuple(each for each in state.past if each.seen.status != "contradiction")
    if len(believed) in _LINEARISED_AGAIN:
        again = _linearised_again(believed, state)
        state = replace(again, keyframe=_same_keyframe(state.keyframe, again.keyframe))
    settled = len(state.past) >= _LINEARISED_AGAIN[-1]
    return replace(state, settled=settled, past=state.past[-_WINDOW:] if settled else state.past)


def _same_keyframe(before: Keyframe | None, again: Keyframe | None) -> Keyframe | None:
    """Return a keyframe with its joints as they were estimated again; None: they were not."""
    if before is None or again is None or not np.array_equal(before.readings, again.readings):
        return None
    return replace(
        before, joints=again.joints, covariance=again.covariance, with_head=again.with_head
    )


def _drifted(state: SelfCalibration, elapsed_s: float) -> SelfCalibration:
    drift = tolerance_covariance(state.head, state.names, DRIFT) * elapsed_s / 60
    return replace(state, covariance=state.covariance + drift)


def _updated(
    state: SelfCalibration,
    seen: SelfCalibrated,
    says: Evidence,
    followed: Followed | None,
    elapsed_s: float,
) -> SelfCalibration:
    """Return the state after a frame that is believed."""
    P = len(state.names)
    inflation = recurrence_inflation(state.recurrence, seen.readings, elapsed_s)
    evidence = _weakened(says, inflation)
    N, b = _normal_equations(state, evidence)
    if followed is not None:
        N, b = with_motion(state, seen, followed, inflation, N, b)
    C = np.asarray(np.linalg.inv(N), float)
    change = C @ b
    head = change_named(state.head, state.names, change[:P])
    variance, weight = _joint_variance(state, evidence)
    learned = replace(
        state,
        head=head,
        covariance=(C[:P, :P] + C[:P, :P].T) / 2,
        recurrence=with_frame(state.recurrence, seen.readings, says.blocks, elapsed_s),
        match_scale=state.match_scale + _PACE * (evidence.match_scale - state.match_scale),
        design_effect=state.design_effect + _PACE * (evidence.design_effect - state.design_effect),
        joint_std_rad=float(np.sqrt(variance)),
        joint_weight=weight,
        frames=state.frames + 1,
        keyframe=next_keyframe(state, seen, head, C, change),
    )
    return _drifted(learned, elapsed_s)


def _weakened(evidence: Evidence, inflation: float) -> Evidence:
    """Return what a frame says beyond the frames before, whose errors it shares."""
    return replace(
        evidence,
        information=evidence.information / inflation,
        vector=evidence.vector / inflation,
        misfit=evidence.misfit / inflation,
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


def _after_change(past: tuple[Past, ...]) -> SelfCalibration | None:
    """Return the state after a change of the head in the last frames; None: there was none.

    Either a camera was bumped, or the head is not as it was calibrated.
    """
    state = past[-1].state
    fixed = [_log_likelihood(each.state, each.seen, each.elapsed_s) for each in past]
    best, found = 0.0, None
    for tolerance in (BUMP, UNCALIBRATED):
        free = tolerance_covariance(state.head, state.names, tolerance)
        freed = [
            _log_likelihood(_freed(each, free).state, each.seen, each.elapsed_s) for each in past
        ]
        if not any(one > other for one, other in zip(freed, fixed, strict=True)):
            continue
        for first in range(len(past)):
            frames = (_freed(past[first], free), *past[first + 1 :])
            after, likelihood = _estimated_again(frames)
            gain = likelihood - sum(fixed[first:])
            if gain > best:
                best, found = gain, (frames, after, tolerance is BUMP)
    # One frame alone may be a wrong one: the next will tell.
    if found is None or len(found[0]) < 2 or 2 * best < _CHANGE_EVIDENCE:
        return None
    frames, after, bumped = found
    after = _linearised_again(frames, after)
    return replace(after, bumped=bumped, uncalibrated=not bumped, settled=False, keyframe=None)


def _freed(frame: Past, free: Array) -> Past:
    """Return a frame before which the head may have changed."""
    state = replace(frame.state, covariance=frame.state.covariance + free)
    return replace(frame, state=state)


def _estimated_again(
    past: tuple[Past, ...], *, at: HeadCalibration | None = None
) -> tuple[SelfCalibration, float]:
    """Return the state after frames, from the state before the first, and their log likelihood.

    Each is linearised anew, at a head, or else where the ones before it have led.
    """
    state, likelihood, again = past[0].state, 0.0, []
    for each in past:
        about = state if at is None else replace(state, head=at)
        seen = from_matches(about, each.seen.matches, each.seen.readings, at_head=at is not None)
        if seen.evidence is None or seen.status == "contradiction":
            return state, -np.inf
        likelihood += _log_likelihood(state, seen, each.elapsed_s)
        again.append(Past(_alone(state), seen, each.followed, each.elapsed_s))
        evidence = _about(state, seen.evidence, about.head)
        state = _updated(state, seen, evidence, each.followed, each.elapsed_s)
    return replace(state, past=tuple(again)), likelihood


def _about(state: SelfCalibration, says: Evidence, head: HeadCalibration) -> Evidence:
    """Return evidence about a state's head that was given about another one near it."""
    if head is state.head:
        return says
    apart = boxminus(state.head, head)
    change = np.array([apart[name] for name in state.names])
    vector = says.vector - says.information[:, : len(change)] @ change
    return replace(says, vector=vector)


def _linearised_again(past: tuple[Past, ...], after: SelfCalibration) -> SelfCalibration:
    """Return the state after frames, which led to a state, linearised where this is.

    What was known before the first of them still stands where it stood. Frames that were linearised
    far from where the head is found to be would else seem to tell more than they do.
    """
    before, names = past[0].state, after.names
    recentred = replace(past[0], state=replace(before, head=after.head))
    again, likelihood = _estimated_again((recentred, *past[1:]), at=after.head)
    if not np.isfinite(likelihood):
        return after
    apart = boxminus(before.head, after.head)
    pull = np.linalg.solve(before.covariance, [apart[name] for name in names])
    return replace(
        again,
        head=change_named(again.head, names, again.covariance @ pull),
        past=(replace(again.past[0], state=before), *again.past[1:]),
    )


def _log_likelihood(state: SelfCalibration, seen: SelfCalibrated, elapsed_s: float) -> float:
    """Return the log likelihood of a frame given what is known before, up to a constant."""
    assert seen.evidence is not None
    inflation = recurrence_inflation(state.recurrence, seen.readings, elapsed_s)
    says = _weakened(seen.evidence, inflation)
    C = prior_of(state, len(seen.readings))
    posterior = np.linalg.inv(np.linalg.inv(C) + says.information)
    _, log_det = np.linalg.slogdet(np.eye(len(C)) + C @ says.information)
    pull = float(says.vector @ posterior @ says.vector)
    return (pull - float(log_det) - says.misfit) / 2


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
