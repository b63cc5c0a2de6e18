"""Commands to the joints, their limits, and recordings as a head."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from postures import HEAD_JOINTS, LIMITS
from recordings import small_dataset
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.gaze.commands import (
    HeadCommand,
    JointLimits,
    RecordedHead,
    hold,
    joint_limits,
    setpoint,
    setpoints_at,
)

SEVEN = st.lists(st.floats(-2, 2), min_size=7, max_size=7).map(np.array)


def command(start=0.0, goal=0.0, rate=0.0, time_s=1.0) -> HeadCommand:
    return HeadCommand(time_s, *(np.full(7, x) for x in (start, goal, rate)), LIMITS)


@given(start=SEVEN, goal=SEVEN, rate=SEVEN, time_s=st.floats(1, 3))
def test_set_points_keep_ranges_and_speeds(start, goal, rate, time_s):
    """One that starts beyond a range does not go farther, and is back once there was time."""
    lower, upper = LIMITS.setpoint_range_rad.T
    now = setpoint(HeadCommand(1.0, start, goal, rate, LIMITS), time_s)
    reach = LIMITS.speed_rad_s * (time_s - 1)
    assert (np.abs(now - start) <= reach + 1e-12).all()
    assert (now >= np.minimum(lower, start + reach) - 1e-12).all()
    assert (now <= np.maximum(upper, start - reach) + 1e-12).all()


@pytest.mark.parametrize(
    ("end_rad", "speed_rad_s"),
    [((-np.inf, 1.0), 1.0), ((-1.0, np.inf), 1.0), ((-1.0, 1.0), np.inf), ((-1.0, 1.0), np.nan)],
)
def test_ranges_and_speeds_are_finite(end_rad: tuple[float, float], speed_rad_s: float):
    with pytest.raises(VergenceError, match="The range of left_pan goes from"):
        joint_limits({"left_pan": end_rad}, {"left_pan": speed_rad_s}, joints=HEAD_JOINTS)


@pytest.mark.parametrize("posture", [[0, 0, 0, np.nan, 0, 0, 0], np.zeros(4)])
def test_what_is_no_posture_is_not_held(posture):
    with pytest.raises(VergenceError, match=r"7 angles neck_pitch.* all finite; found an array"):
        hold(posture, LIMITS, 0.0)


def test_every_joint_has_a_speed():
    with pytest.raises(VergenceError, match=r"found \(7, 2\) and \(4,\)"):
        JointLimits(LIMITS.range_rad, np.ones(4), HEAD_JOINTS)


def test_a_goal_is_reached_and_followed_until_no_further_command_comes():
    moving = command(goal=0.1, rate=0.5)
    np.testing.assert_allclose(setpoint(moving, 1.05), 0.125)
    np.testing.assert_array_equal(setpoint(moving, 0.5), 0)  # not before its time
    np.testing.assert_allclose(setpoint(moving, 1.1), setpoint(moving, 9.0))


def test_earlier_set_points_can_be_recovered():
    commands = [hold(np.zeros(7), LIMITS, 0.0), command(goal=0.2), hold(np.ones(7), LIMITS, 2.0)]
    np.testing.assert_array_equal(setpoints_at(commands, -1.0), 0)
    np.testing.assert_array_equal(setpoints_at(commands, 0.9), 0)
    np.testing.assert_allclose(setpoints_at(commands, 1.5), 0.2)
    np.testing.assert_array_equal(setpoints_at(commands, 2.0), 1)


def test_a_recording_is_a_head_that_goes_where_it_went(tmp_path: Path):
    small_dataset(tmp_path / "set", 3)
    dataset = load_dataset(tmp_path / "set")
    head = RecordedHead(dataset)
    seen = [head.read(()) for _ in range(4)]
    assert seen.pop() is None
    head.command(command(goal=0.3))
    assert head.now_s() == pytest.approx(dataset.time_s[-1] + 0.1)
    angles = np.array([frame.eye_angles for frame in seen if frame is not None])
    np.testing.assert_array_equal(angles, dataset.eye_angles)
