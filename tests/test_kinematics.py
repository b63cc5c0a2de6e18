"""Joint angles to poses: signs, order, imperfect axes, the neck."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vergence.geometry.kinematics import (
    Chain,
    EyeAxes,
    Neck,
    T_base_eye,
    T_body_head,
    axes_row,
    chain_linearised,
    chain_pose,
    eye_chain,
    eye_jacobians,
)
from vergence.geometry.se3 import boxminus, pose, rotation, transform

FORWARD, LEFT, UP = np.eye(3)
angle_pairs = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)).map(np.array)


def test_positive_pan_looks_left_and_positive_tilt_looks_down():
    assert (T_base_eye(np.array([0.1, 0.0]))[:3, :3] @ FORWARD) @ LEFT > 0.09
    assert (T_base_eye(np.array([0.0, 0.1]))[:3, :3] @ FORWARD) @ UP < -0.09


@given(angle_pairs)
def test_pan_comes_first_about_axes_that_intersect(angles: np.ndarray):
    expected = rotation(angles[0] * UP) @ rotation(angles[1] * LEFT)
    np.testing.assert_allclose(T_base_eye(angles), pose(expected), atol=1e-14)


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


def random_chain(rng: np.random.Generator, joints: int, readings: int) -> Chain:
    """Return a chain whose angles are any linear combinations of readings."""
    axes = rng.normal(size=(joints, 3))
    return Chain(
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        points_m=rng.normal(size=(joints, 3)),
        end_m=rng.normal(size=3),
        mixing=rng.normal(size=(joints, readings)),
        offset_rad=rng.normal(0, 0.1, joints),
    )


def turned_one_after_the_other(chain: Chain, angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return where a point of the end's frame is in the base: the last joint turns it first."""
    at = point + chain.end_m
    for axis, centre, turn in reversed(list(zip(chain.axes, chain.points_m, angles, strict=True))):
        at = rotation(turn * axis) @ (at - centre) + centre
    return at


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 3))
def test_joints_may_share_readings(seed: int, joints: int, readings: int):
    rng = np.random.default_rng(seed)
    chain, read = random_chain(rng, joints, readings), rng.normal(size=readings)
    point = rng.normal(size=3)
    expected = turned_one_after_the_other(chain, chain.mixing @ read + chain.offset_rad, point)
    np.testing.assert_allclose(transform(chain_pose(chain, read), point), expected, atol=1e-13)


def slopes(function, at: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Return how poses (..., 4, 4) change with (..., n) by central differences (..., 6, n)."""
    columns = [
        (boxminus(function(at + d), function(at)) - boxminus(function(at - d), function(at)))
        / (2 * step)
        for d in step * np.eye(at.shape[-1])
    ]
    return np.stack(columns, axis=-1)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_the_jacobian_of_a_chain_agrees_with_differences(seed: int, joints: int):
    rng = np.random.default_rng(seed)
    chain, readings = random_chain(rng, joints, 2), rng.normal(size=(5, 2))
    _, found = chain_linearised(chain, readings)
    expected = slopes(lambda each: chain_pose(chain, each), readings)
    np.testing.assert_allclose(found, expected, atol=1e-7)


@given(st.integers(0, 2**32 - 1))
def test_the_jacobians_of_an_eye_agree_with_differences(seed: int):
    rng = np.random.default_rng(seed)
    readings = rng.uniform(-0.5, 0.5, (5, 2))
    axes = axes_row(EyeAxes()) + rng.normal(0, 0.05, (5, 6))
    by_axes = slopes(lambda each: T_base_eye(readings, each), axes)
    by_readings = slopes(lambda each: T_base_eye(each, axes), readings)
    for found, expected in zip(eye_jacobians(readings, axes), (by_axes, by_readings), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-8)
    one_posture = eye_jacobians(readings[1], axes[1])
    for found, many in zip(one_posture, eye_jacobians(readings, axes), strict=True):
        np.testing.assert_allclose(found, many[1], atol=1e-15)


def test_a_chain_serves_many_postures_and_many_chains_one():
    rng = np.random.default_rng(1)
    angles = rng.normal(size=(3, 5, 2))
    T = T_base_eye(angles)
    assert T.shape == (3, 5, 4, 4)
    np.testing.assert_allclose(T[2, 4], T_base_eye(angles[2, 4]), atol=1e-15)
    readings, rows = rng.normal(0, 0.2, (7, 2)), axes_row(EyeAxes()) + rng.normal(0, 0.05, (7, 6))
    many = chain_pose(eye_chain(rows), readings)
    np.testing.assert_allclose(many[3], chain_pose(eye_chain(rows[3]), readings[3]), atol=1e-15)
    one = chain_pose(eye_chain(rows), readings[0])
    np.testing.assert_allclose(one[3], chain_pose(eye_chain(rows[3]), readings[0]), atol=1e-15)
    fixed = Chain(np.empty((0, 3)), np.empty((0, 3)), np.ones(3), np.empty((0, 0)), np.empty(0))
    np.testing.assert_array_equal(chain_pose(fixed, np.empty((7, 0)))[6], pose(t=np.ones(3)))


def test_each_neck_joint_carries_those_after_it():
    neck = Neck(
        axes=np.array([LEFT, FORWARD, UP]),
        points_m=np.array([[0.0, 0, 0.1], [0, 0, 0.2], [0, 0, 0.3]]),
        head_m=np.array([0.05, 0, 0.35]),
    )
    angles, point = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, 0.3])
    chain = Chain(neck.axes, neck.points_m, neck.head_m, np.eye(3), np.zeros(3))
    expected = turned_one_after_the_other(chain, angles, point)
    np.testing.assert_allclose(transform(T_body_head(neck, angles), point), expected, atol=1e-15)


def test_the_neck_at_zero_only_shifts_and_without_a_neck_the_head_is_the_body():
    neck = Neck(axes=np.eye(3), points_m=np.ones((3, 3)), head_m=np.array([1.0, 2, 3]))
    np.testing.assert_array_equal(T_body_head(neck, np.zeros((4, 3)))[2], pose(t=[1, 2, 3]))
    np.testing.assert_array_equal(T_body_head(Neck(), np.zeros((2, 0)))[1], np.eye(4))
