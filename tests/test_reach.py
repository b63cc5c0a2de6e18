"""The reach controller on drawn images, without and with faults."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drawn_hand import MARKER_HAND, DrawnHeadWithHand
from drawn_head import four_cameras, point_at
from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.gaze.hand import HandReading
from vergence.gaze.reaching import (
    ReachPhase,
    ReachSettings,
    ReachState,
    initial_reach_state,
    run_reach,
    step_reach,
    target_std_m,
)
from vergence.gaze.state import GazeSettings
from vergence.geometry.se3 import pose, rotation
from vergence.vision.sphere import sphere_detector

SETTINGS = ReachSettings(gaze=GazeSettings(calibration=four_cameras()), marker_hand=MARKER_HAND)
OBJECT = point_at(5, 6, 0.45)
ROUGHLY = pose(rotation([0.02, -0.02, 0.02]), [0.012, -0.015, 0.01])  # the arm's mounting error

pytestmark = pytest.mark.slow  # closed loops, of many seconds each


def run(
    head: DrawnHeadWithHand,
    seconds: float,
    *,
    settings: ReachSettings = SETTINGS,
    watch: Callable[[ReachState], None] = lambda state: None,
) -> tuple[ReachState, list[ReachPhase]]:
    """Return the last state and the phases in their order."""
    phases: list[ReachPhase] = []

    def keep(state: ReachState, *_: object) -> None:
        watch(state)
        if not phases or phases[-1] is not state.phase:
            phases.append(state.phase)

    begin = initial_reach_state(settings, np.zeros(7), head.hand.read(), head.now_s())
    return run_reach(head, head.hand, settings, begin, seconds, watch=keep), phases


def miss_m(head: DrawnHeadWithHand) -> float:
    """Return the true distance [m] of the hand from the object, now."""
    where = head.path(head.time_s)
    assert where is not None
    return float(np.linalg.norm(head.hand.true(head.hand.position) - where))


def still(_: float) -> Array:
    return OBJECT


def test_the_hand_reaches_is_servoed_and_closes_as_the_uncertainty_falls():
    stds: list[tuple[float, float]] = []

    def keep(state: ReachState) -> None:
        if state.target is not None and state.target.time_s == state.gaze.frame_s:
            stds.append((state.separation_m, target_std_m(SETTINGS, state, state.target)))

    head = DrawnHeadWithHand(still, home=SETTINGS.home)
    _, phases = run(head, 4.0, watch=keep)
    assert phases[-4:] == [ReachPhase.REACH, ReachPhase.SERVO, ReachPhase.CLOSE, ReachPhase.HELD]
    assert miss_m(head) < 2.5e-3
    (far_m, unsure_m), (near_m, sure_m) = stds[0], stds[-1]
    assert far_m > 2 * near_m
    assert unsure_m > 2 * sure_m


def test_the_grasp_tolerates_errors_of_the_mounting_and_of_the_calibration():
    """The baseline is wrong by 4 %, as by a gain of the joints, and the arm by 20 mm."""
    head = four_cameras()
    wrong = replace(head, T_rbase_lbase=pose(t=1.04 * head.T_rbase_lbase[:3, 3]))
    settings = replace(SETTINGS, gaze=GazeSettings(calibration=wrong))
    sway = np.array([0.008, 0.01, 0.006])
    drawn = DrawnHeadWithHand(
        lambda t: OBJECT + sway * np.sin(2.2 * t), home=settings.home, T_body_arm=ROUGHLY
    )
    state, _ = run(drawn, 5.0, settings=settings)
    assert state.phase is ReachPhase.HELD
    assert state.object is not None
    where = drawn.path(drawn.time_s)
    assert where is not None
    assert np.linalg.norm(drawn.hand.true(state.object) - where) > 20e-3
    assert miss_m(drawn) < 5e-3


def test_a_hand_waits_until_its_marker_is_seen():
    apart_m: list[float] = []

    def keep(state: ReachState) -> None:
        if head.now_s() < 1.2:
            assert state.phase is not ReachPhase.CLOSE
            apart_m.append(float(np.linalg.norm(head.hand.position - OBJECT)))

    head = DrawnHeadWithHand(still, home=SETTINGS.home, shown=lambda t: t > 1.2)
    state, _ = run(head, 5.0, watch=keep)
    assert min(apart_m) > 0.1
    assert state.phase is ReachPhase.HELD


@pytest.mark.parametrize(
    ("path", "ends"),
    [
        (lambda t: OBJECT + np.array([0.6 * np.clip(t - 0.7, 0, 1), 0.0, 0.0]), ReachPhase.TRACK),
        (lambda t: OBJECT if t < 0.7 else None, ReachPhase.SEEK),
    ],
    ids=["moves away", "hidden"],
)
def test_the_hand_goes_home_when_the_object_is_gone(path, ends: ReachPhase):
    head = DrawnHeadWithHand(path, home=SETTINGS.home)
    state, phases = run(head, 2.5)
    assert ReachPhase.REACH in phases
    assert ReachPhase.CLOSE not in phases
    assert state.phase is ends
    np.testing.assert_allclose(head.hand.position, SETTINGS.home, atol=2e-3)


def test_the_hand_does_not_close_on_an_uncertain_position():
    """Pixels with a standard deviation of 3 px leave more uncertainty than the tolerance."""
    gaze = replace(SETTINGS.gaze, objects={"sphere": sphere_detector(std_px=3.0)})
    unsure = replace(SETTINGS, gaze=gaze)
    head = DrawnHeadWithHand(still, home=SETTINGS.home)
    state, phases = run(head, 1.5, settings=unsure)
    assert state.phase is ReachPhase.SERVO
    assert ReachPhase.CLOSE not in phases


def test_a_hand_that_closed_on_nothing_opens_again():
    head = DrawnHeadWithHand(
        lambda t: OBJECT + np.array([0.0, 0.1 * (t > closed_s + 0.3), 0.0]), home=SETTINGS.home
    )
    closed_s = np.inf
    state, _ = run(head, 4.0)
    assert state.phase is ReachPhase.HELD
    closed_s = head.time_s
    phases = []
    while head.now_s() < closed_s + 0.9:
        frame = head.read(state.cameras)
        state = step_reach(SETTINGS, state, frame, head.hand.read(), head.now_s())
        head.command(state.gaze.command)
        head.hand.command(state.command)
        phases.append(state.phase)
    assert phases[0] is ReachPhase.HELD
    assert ReachPhase.SERVO in phases


def test_a_pose_of_the_hand_that_is_not_finite_is_left_out_and_the_others_are_kept():
    head = DrawnHeadWithHand(still, home=SETTINGS.home)
    state, _ = run(head, 0.5)
    T = np.eye(4)
    moments = head.now_s() + np.array([0.1, 0.2])
    for time_s, x in zip(moments, (0.3, 0.4), strict=True):
        T[0, 3] = x  # a driver that uses one array again
        state = step_reach(SETTINGS, state, None, HandReading(time_s, T), time_s)
    lost = HandReading(moments[1] + 0.1, np.full((4, 4), np.nan), closed=True)
    after = step_reach(SETTINGS, state, None, lost, moments[1] + 0.1)
    assert after.readings[-1].closed
    assert np.isfinite(after.command.goal).all()
    assert [each.T_body_hand[0, 3] for each in after.readings[-2:]] == [0.3, 0.4]
    with pytest.raises(VergenceError, match=r"pose \(4, 4\).* found \[0. 0. 0.\]"):
        step_reach(SETTINGS, state, None, HandReading(1e3, np.zeros(3)), 1e3)
    with pytest.raises(VergenceError, match="the first one a finite one"):
        initial_reach_state(SETTINGS, np.zeros(7), lost, 0.0)
