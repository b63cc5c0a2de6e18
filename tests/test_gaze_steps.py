"""Steps of the gaze controller without images: limits of the joints, and what follows a loss."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drawn_head import PERIOD_S, DrawnHead, four_cameras, point_at
from postures import EYE_READINGS, LIMITS, NECK
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import setpoint
from vergence.gaze.controller import step_gaze
from vergence.gaze.state import GazePhase, GazeSettings, GazeState, initial_gaze_state, look_at
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYE_JOINTS

SETTINGS = GazeSettings(calibration=four_cameras(), limits=LIMITS)
WITH_NECK = replace(SETTINGS, use_neck=True)
STEP_S = 0.08


def at_rest(settings: GazeSettings = SETTINGS) -> GazeState:
    return initial_gaze_state(settings, np.zeros(7), 0.0)


def frame_at(state: GazeState, time_s: float) -> Frame:
    """Return a frame without images, of joints that are where they were commanded."""
    at = setpoint(state.command, time_s)
    return Frame(time_s, time_s, at[EYE_READINGS], at[NECK], {})


def looking(
    settings: GazeSettings, state: GazeState, point: Array, seconds: float
) -> list[GazeState]:
    """Return the states in which a point (3,) is looked at, frame by frame."""
    states = [look_at(settings, state, point)]
    for time_s in state.command.time_s + np.arange(STEP_S, seconds, STEP_S):
        states.append(step_gaze(settings, states[-1], frame_at(states[-1], time_s), time_s))
    return states


def seen(settings: GazeSettings, point: Array, seconds: float) -> tuple[DrawnHead, GazeState]:
    """Return a drawn head that shows an object at a point, and the state that has followed it."""
    head, state = DrawnHead(lambda _: point), at_rest(settings)
    while head.time_s < seconds:
        state = step_gaze(settings, state, head.read(settings.cameras), head.now_s())
        head.command(state.command)
    return head, state


# Limits


@pytest.mark.parametrize("pan_deg", [-60.0, 60.0])
def test_eyes_stay_at_the_end_of_their_range_and_no_fixation_is_claimed(pan_deg: float):
    state = looking(SETTINGS, at_rest(), point_at(pan_deg, 0, 1.0), 1.0)[-1]
    assert state.phase is GazePhase.SACCADE
    pans = setpoint(state.command, 1.0)[EYE_READINGS][[0, 2]]
    np.testing.assert_allclose(pans, np.sign(pan_deg) * np.radians(35 - 0.25), rtol=1e-9)
    # Once the eyes are there, images count again.
    assert state.landing_s < state.frame_s - 0.5


def test_images_on_the_way_of_a_saccade_are_not_used():
    """It ends when the slowest joint has arrived at its speed, and 20 ms later the eye rests."""
    head, state = seen(SETTINGS, point_at(25, 0, 0.8), PERIOD_S / 2)
    while state.track is None:  # the first frame that shows the object
        state = step_gaze(SETTINGS, state, head.read(SETTINGS.cameras), head.now_s())
        head.command(state.command)
    begin = state.command
    away = np.abs(begin.goal - begin.start) / LIMITS.speed_rad_s
    assert state.landing_s == pytest.approx(begin.time_s + away.max() + 0.02)
    assert state.landing_s > begin.time_s + PERIOD_S
    during = step_gaze(SETTINGS, state, head.read(SETTINGS.cameras), head.now_s())
    assert during.command is state.command
    assert during.track is state.track


@pytest.mark.parametrize(("turn_deg", "phase"), [(6, GazePhase.FIXATION), (8, GazePhase.SACCADE)])
def test_a_correction_by_more_than_half_a_fovea_is_a_saccade(turn_deg, phase):
    """From 0.12 rad, which is 6.9 degrees, on."""
    settled = looking(SETTINGS, at_rest(), point_at(0, 0, 5.0), 0.5)[-1]
    assert settled.phase is GazePhase.FIXATION
    assert settled.since_s < 0.3
    moved = looking(SETTINGS, settled, point_at(turn_deg, 0, 5.0), 1.5 * STEP_S)[-1]
    assert moved.phase is phase
    assert (moved.since_s == settled.since_s) == (phase is GazePhase.FIXATION)


@pytest.mark.parametrize(
    ("turn_deg", "width_deg", "follows"),
    [(0.2, 0.6, False), (0.5, 0.6, True), (0.2, -0.6, True), (0.2, 0.0, True)],
)
def test_a_fixating_eye_that_lags_is_not_moved_within_its_backlash(turn_deg, width_deg, follows):
    """An eye before which its sensor lags, a negative width, follows every command."""
    widths = dict.fromkeys(EYE_JOINTS, (np.radians(width_deg), np.radians(0.02)))
    accuracy = Accuracy(method="bundle", backlash_rad=widths)
    settings = replace(SETTINGS, calibration=replace(four_cameras(), accuracy=accuracy))
    settled = looking(settings, at_rest(settings), point_at(0, 0, 5.0), 0.5)[-1]
    moved = looking(settings, settled, point_at(turn_deg, 0, 5.0), 1.5 * STEP_S)[-1]
    assert moved.phase is GazePhase.FIXATION
    assert (np.abs(moved.command.goal - settled.command.goal).max() > 1e-4) == follows


@pytest.mark.parametrize("pan_deg", [40.0, 84.0])
def test_a_neck_keeps_its_greatest_speed_and_acceleration(pan_deg: float):
    """It brakes before the end of its range, which is at 50 degrees."""
    settings = replace(WITH_NECK, neck_speed_rad_s=0.5, neck_acceleration_rad_s2=2.0)
    states = looking(settings, at_rest(settings), point_at(pan_deg, 0, 1.0), 3.0)
    rates = np.array([state.neck_rate for state in states])
    times = np.array([state.command.time_s for state in states])
    later = np.diff(times) > 0  # no command is sent during a saccade
    change = np.abs(np.diff(rates, axis=0))[later] / np.diff(times)[later, None]
    assert change.max() == pytest.approx(2.0)
    assert np.abs(rates).max() == pytest.approx(0.5)
    # The set points move as fast as is said, between the frames too.
    for state in states[5:15]:
        ends = [setpoint(state.command, state.frame_s + t)[NECK] for t in (0.0, 0.01)]
        np.testing.assert_allclose((ends[1] - ends[0]) / 0.01, state.neck_rate, atol=1e-9)


def test_a_neck_follows_until_the_eyes_are_near_their_middle():
    """It begins at 0.2 rad and ends at 0.04."""
    state = looking(WITH_NECK, at_rest(WITH_NECK), point_at(20, 0, 1.0), 2.0)[-1]
    np.testing.assert_array_equal(state.neck_rate, 0)
    assert np.abs(state.command.goal[EYE_READINGS][[0, 2]].mean()) < 0.045
    aside = looking(WITH_NECK, state, point_at(29, 0, 1.0), 0.4)
    assert not any(each.neck_rate.any() for each in aside)


def test_a_neck_stops_at_the_end_of_its_range_and_comes_back():
    there = looking(WITH_NECK, at_rest(WITH_NECK), point_at(84, 0, 1.0), 1.4)[-1]
    end = np.radians(50 - 0.25)
    assert setpoint(there.command, 1.4)[NECK][2] == pytest.approx(end)
    assert there.neck_rate[2] == 0
    back = looking(WITH_NECK, there, point_at(-20, 0, 1.0), 1.8)[-1]
    assert back.command.start[2] == pytest.approx(np.radians(-20), abs=0.08)


# What is not seen


def test_a_given_point_is_never_lost():
    state = looking(SETTINGS, at_rest(), point_at(10, 5, 1.0), 0.3)[-1]
    for time_s in (0.4, 1.0, 5.0):
        assert step_gaze(SETTINGS, state, None, time_s) is state


def test_an_object_is_lost_after_a_time_and_all_stops_and_is_forgotten():
    """Here while the neck turns to it."""
    _, state = seen(WITH_NECK, point_at(28, 0, 0.8), 0.5)
    assert state.neck_rate[2] > 0.1
    assert state.searched == 0
    since_s = max(state.seen_s, state.landing_s)
    waiting = step_gaze(WITH_NECK, state, None, since_s + 0.19)
    assert waiting.phase is state.phase
    assert waiting.command is state.command
    assert waiting.cameras == WITH_NECK.cameras
    lost_s = since_s + 0.21
    lost = step_gaze(WITH_NECK, replace(waiting, searched=3), None, lost_s)
    assert lost.phase is GazePhase.LOST
    assert lost.since_s == lost_s
    for time_s in (lost_s, lost_s + 0.3):
        np.testing.assert_array_equal(
            setpoint(lost.command, time_s), setpoint(state.command, lost_s)
        )
    assert (lost.track, lost.aim, lost.measured) == (None, None, None)
    assert lost.searched == 0
    np.testing.assert_array_equal(lost.neck_rate, 0)


@pytest.mark.parametrize("settings", [SETTINGS, WITH_NECK], ids=["eyes", "neck"])
def test_a_search_looks_ahead_and_to_all_sides_and_begins_again(settings: GazeSettings):
    """After 0.6 s, and 0.3 s at each place."""
    state, turns = at_rest(settings), []
    for time_s in np.arange(0, 8, 1e-2):
        after = step_gaze(settings, state, None, float(time_s))
        if after.command is not state.command:
            turns.append(after)
        state = after
    commands = [each.command for each in turns]
    assert commands[0].time_s == pytest.approx(0.6, abs=0.011)
    pans, tilts = np.array([command.goal[EYE_READINGS][:2] for command in commands]).T
    for command, pan, tilt in zip(commands, pans, tilts, strict=True):
        np.testing.assert_allclose(command.goal[EYE_READINGS], [pan, tilt, pan, tilt])
        np.testing.assert_allclose(command.goal[NECK], [0, 0, pan if settings.use_neck else 0])
    assert len(set(zip(pans[:7], tilts[:7], strict=True))) == 7
    np.testing.assert_array_equal((pans[0], tilts[0]), 0)
    for sides in (np.sign(pans[:7]), np.sign(tilts[:7])):
        assert (sides == 1).sum() == (sides == -1).sum() >= 2
    np.testing.assert_array_equal((pans[7], tilts[7]), (pans[0], tilts[0]))
    for before, after in pairwise(commands):
        way_s = (np.abs(before.goal - before.start) / LIMITS.speed_rad_s).max()
        assert after.time_s - before.time_s == pytest.approx(way_s + 0.02 + 0.3, abs=0.011)
