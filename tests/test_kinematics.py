"""Joint angles to poses: signs, order, imperfect axes, the neck."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vergence.geometry.kinematics import EyeAxes, Neck, T_base_eye, T_body_head
from vergence.geometry.se3 import rotation, transform

FORWARD, LEFT, UP = np.eye(3)
angle_pairs = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)).map(np.array)


def test_positive_pan_looks_left_and_positive_tilt_looks_down():
    assert (T_base_eye(np.array([0.1, 0.0]))[:3, :3] @ FORWARD) @ LEFT > 0.09
    assert (T_base_eye(np.array([0.0, 0.1]))[:3, :3] @ FORWARD) @ UP < -0.09


@given(angle_pairs)
def test_pan_comes_first(angles: np.ndarray):
    expected = rotation(angles[0] * UP) @ rotation(angles[1] * LEFT)
    np.testing.assert_allclose(T_base_eye(angles)[:3, :3], expected, atol=1e-14)


@given(angle_pairs)
def test_perfect_axes_intersect(angles: np.ndarray):
    np.testing.assert_array_equal(T_base_eye(angles)[:3, 3], 0)


@given(angle_pairs)
def test_true_angles_are_gain_times_reading_plus_offset(reading: np.ndarray):
    axes = EyeAxes(pan_gain=1.02, tilt_gain=0.97, pan_offset_rad=0.01, tilt_offset_rad=-0.02)
    true = np.array([1.02 * reading[0] + 0.01, 0.97 * reading[1] - 0.02])
    np.testing.assert_allclose(T_base_eye(reading, axes), T_base_eye(true), atol=1e-14)


@given(angle_pairs)
def test_a_tilt_axis_out_of_square_turns_about_x(angles: np.ndarray):
    axes = EyeAxes(nonorthogonality_rad=0.03)
    tilt_axis = rotation(angles[0] * UP) @ rotation(0.03 * FORWARD) @ LEFT
    R = T_base_eye(angles, axes)[:3, :3]
    np.testing.assert_allclose(
        R, rotation(angles[1] * tilt_axis) @ rotation(angles[0] * UP), atol=1e-14
    )


@given(angle_pairs)
def test_a_tilt_axis_ahead_of_the_pan_axis_moves_with_pan_only(angles: np.ndarray):
    axes = EyeAxes(axis_distance_m=0.002)
    expected = 0.002 * (rotation(angles[0] * UP) @ FORWARD)
    np.testing.assert_allclose(T_base_eye(angles, axes)[:3, 3], expected, atol=1e-17)


def test_eye_angles_may_have_any_leading_dimensions():
    angles = np.random.default_rng(0).normal(size=(3, 5, 2))
    T = T_base_eye(angles)
    assert T.shape == (3, 5, 4, 4)
    np.testing.assert_allclose(T[2, 4], T_base_eye(angles[2, 4]), atol=1e-15)


def test_each_neck_joint_carries_those_after_it():
    neck = Neck(
        axes=np.array([LEFT, FORWARD, UP]),
        points_m=np.array([[0.0, 0, 0.1], [0, 0, 0.2], [0, 0, 0.3]]),
        head_m=np.array([0.05, 0, 0.35]),
    )
    angles = np.array([0.3, -0.2, 0.5])
    point = np.array([0.1, 0.2, 0.3])  # in frame head
    expected = point + neck.head_m
    for axis, centre, turn in reversed(list(zip(neck.axes, neck.points_m, angles, strict=True))):
        expected = rotation(turn * axis) @ (expected - centre) + centre
    np.testing.assert_allclose(transform(T_body_head(neck, angles), point), expected, atol=1e-15)


def test_the_neck_at_zero_only_shifts():
    neck = Neck(axes=np.eye(3), points_m=np.ones((3, 3)), head_m=np.array([1.0, 2, 3]))
    T = T_body_head(neck, np.zeros((4, 3)))
    np.testing.assert_array_equal(T[2, :3, 3], [1, 2, 3])
    np.testing.assert_array_equal(T[2, :3, :3], np.eye(3))


def test_without_a_neck_the_head_is_the_body():
    np.testing.assert_array_equal(
        T_body_head(Neck(), np.zeros((2, 0))), np.tile(np.eye(4), (2, 1, 1))
    )
