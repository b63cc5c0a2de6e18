"""Gaze shifts of eyes and neck: the objects that are shown, and the evaluation.

On the twin: test_track.py, and by many: benchmarks/gaze_shifts.py.
"""

import numpy as np
import pytest

from gaze_shifts import ANGLE_RAD, DISTANCE_M, EACH_S, judged, number_at, objects
from vergence.arrays import Array
from vergence.gaze.commands import JointLimits

TIME: Array = np.arange(0, 2 * EACH_S - 0.05, 0.1).astype(float)
STILL = np.zeros((len(TIME), 7))


def test_objects_follow_each_other_at_the_stated_angles():
    where = objects(200, 1)
    assert where.shape == (201, 3)
    rays = where / np.linalg.norm(where, axis=1, keepdims=True)
    angles = np.arccos(np.sum(rays[1:] * rays[:-1], axis=1))
    assert angles.min() > ANGLE_RAD[0]
    assert np.radians(55) < angles.max() < ANGLE_RAD[1]
    distances = np.linalg.norm(where, axis=1)
    assert distances.min() > DISTANCE_M[0]
    assert distances.max() < DISTANCE_M[1]
    np.testing.assert_array_equal(objects(200, 1), where)


def turning_until(time_s: float) -> np.ndarray:
    """Return angles (N, 7) of a neck that turns at 0.2 rad/s from the gaze shift until a time."""
    angles = STILL.copy()
    angles[:, 2] = 0.2 * np.clip(TIME - EACH_S, 0, time_s - EACH_S)
    return angles


def test_the_error_counts_once_the_object_is_reached_and_while_the_neck_turns():
    errors: Array = 1.0 + 399.0 * (TIME < EACH_S + 0.35)  # reached after four frames
    errors[np.isclose(TIME, EACH_S + 0.8)] = 12.0  # the neck is turning
    errors[np.isclose(TIME, EACH_S + 2.0)] = 30.0  # it is not
    found = judged(JointLimits(), TIME, errors, turning_until(EACH_S + 1.0), 1, 0.7)
    assert found.reached_s == pytest.approx(0.4)
    assert found.turning_px == 12.0
    assert found.turning_frames == 7
    assert found.final_px == 1.0
    assert found.neck_rad == pytest.approx(0.2)
    assert found.beyond_rad < 0


def test_an_object_that_is_never_reached_is_reported():
    found = judged(JointLimits(), TIME, np.full(len(TIME), 50.0), turning_until(4.0), 1, 0.7)
    assert found.reached_s == np.inf
    assert found.turning_frames == 0
    assert found.final_px == 50.0


def test_a_joint_beyond_its_range_is_found():
    angles = STILL.copy()
    angles[-3, 3] = JointLimits().range_rad[3, 1] + 0.01
    found = judged(JointLimits(), TIME, np.zeros(len(TIME)), angles, 1, 0.7)
    assert found.beyond_rad == pytest.approx(0.01)


def test_the_change_falls_into_one_frame_whatever_the_rounding():
    times = 21 * EACH_S + np.array([-1e-3, -1e-9, 0, 1e-9])
    assert number_at(times).tolist() == [20, 21, 21, 21]
