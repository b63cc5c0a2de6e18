"""Rigid transforms: the axioms of SE(3), and its increment where the logarithm is delicate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vergence.arrays import nearest_rotation
from vergence.errors import VergenceError
from vergence.geometry.se3 import (
    agreeing_poses,
    angle,
    boxminus,
    boxplus,
    hat,
    inverse,
    mean_pose,
    pose,
    rigid_poses,
    rotation,
    rotvec,
    transform,
)

coordinates = st.floats(-2, 2)
vectors = arrays(float, 3, elements=coordinates)
# Angles on all scales down to denormal ones, and up to pi.
angles = st.one_of(
    st.floats(0, np.pi), st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 1e-4, np.pi - 1e-9])
)


@st.composite
def increments(draw: st.DrawFn, angles: st.SearchStrategy[float] = angles) -> np.ndarray:
    """Increments (6,): an axis times an angle, and a translation."""
    axis = draw(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3))
    turn = axis / np.linalg.norm(axis) * draw(angles)
    return np.concatenate([turn, draw(vectors)])


poses = increments().map(lambda xi: boxplus(np.eye(4), xi))


def assert_same(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


@given(poses, poses)
def test_the_product_of_poses_is_a_pose(A: np.ndarray, B: np.ndarray):
    R = (A @ B)[:3, :3]
    assert_same(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1)
    assert_same((A @ B)[3], [0, 0, 0, 1])


@given(poses)
def test_identity_and_inverse_are_what_they_are_called(T: np.ndarray):
    assert_same(T @ pose(), T)
    assert_same(T @ inverse(T), np.eye(4))
    assert_same(inverse(T) @ T, np.eye(4))


@given(poses, poses, vectors)
def test_poses_act_on_points_one_after_the_other(A: np.ndarray, B: np.ndarray, p: np.ndarray):
    assert_same(transform(A @ B, p), transform(A, transform(B, p)))
    assert_same((A @ [*p, 1])[:3], transform(A, p))


@given(poses, poses)
def test_boxminus_leads_from_one_pose_to_the_other(A: np.ndarray, B: np.ndarray):
    assert_same(boxplus(B, boxminus(A, B)), A)


@given(poses, increments(st.floats(0, np.pi - 1e-3)))
def test_boxminus_undoes_boxplus_below_pi(T: np.ndarray, xi: np.ndarray):
    assert_same(boxminus(boxplus(T, xi), T), xi, 1e-11)


@given(poses, poses, increments())
def test_an_increment_is_along_the_axes_that_a_pose_maps_into(T_a_b, T_b_c, xi):
    only_turn = np.concatenate([xi[:3], np.zeros(3)])
    fixed = pose(T_a_b[:3, :3])  # without translation, which a turn leaves where it is
    assert_same(boxplus(fixed @ T_b_c, xi)[:3, :3], (boxplus(fixed, only_turn) @ T_b_c)[:3, :3])
    assert_same(boxplus(T_a_b, xi)[:3, 3], T_a_b[:3, 3] + xi[3:])


@pytest.mark.parametrize("small", [0.0, 1e-300, 1e-16, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3])
def test_boxminus_undoes_boxplus_near_the_identity(small: float):
    xi = np.array([0.6 * small, -0.8 * small, 0, 0.3, -0.2, 1.5])
    found = boxminus(boxplus(np.eye(4), xi), np.eye(4))
    assert_same(found, xi, 1e-15)
    assert_same(rotation(xi[:3]), np.eye(3) + hat(xi[:3]), small**2)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-8, 1e-5, 1e-3])
def test_boxplus_undoes_boxminus_at_pi(gap: float):
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(200, 3))
    axes[:3] = np.eye(3)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    T = pose(rotation(axes * (np.pi - gap)), rng.normal(size=(200, 3)))
    xi = boxminus(T, np.eye(4))
    assert_same(boxplus(np.eye(4), xi), T, 1e-9)
    assert_same(np.linalg.norm(xi[:, :3], axis=1), np.pi - gap, 1e-9)


@given(increments(st.floats(0, np.pi)))
def test_rotvec_undoes_rotation_and_angle_is_its_length(xi: np.ndarray):
    R = rotation(xi[:3])
    assert_same(rotation(rotvec(R)), R)
    assert angle(R) == pytest.approx(np.linalg.norm(xi[:3]), abs=1e-8)


@given(vectors, vectors)
def test_hat_is_the_matrix_of_the_cross_product(v: np.ndarray, w: np.ndarray):
    assert_same(hat(v) @ w, np.cross(v, w))
    assert_same(hat(v), -hat(v).T)


def test_a_turn_is_right_handed():
    assert_same(rotation([0, 0, np.pi / 2]) @ [1, 0, 0], [0, 1, 0])
    assert_same(rotation([0, np.pi / 2, 0]) @ [1, 0, 0], [0, 0, -1])


def test_leading_dimensions_are_batches():
    rng = np.random.default_rng(1)
    xi = rng.normal(size=(4, 5, 6))
    T, p = boxplus(np.eye(4), xi), rng.normal(size=(5, 3))
    assert T.shape == (4, 5, 4, 4)
    assert_same(transform(T, p)[2, 3], transform(T[2, 3], p[3]))
    assert_same(inverse(T)[1, 4], inverse(T[1, 4]))
    assert_same(boxminus(T, np.eye(4))[3, 0], boxminus(T[3, 0], np.eye(4)))
    assert pose(t=p).shape == (5, 4, 4)


@given(poses, st.floats(-1e-3, 1e-3))
def test_the_nearest_rotation_is_no_mirror_image(T: np.ndarray, third: float):
    """As of a sum of rotations that is nearly of rank two, whose determinant may be negative."""
    R = nearest_rotation(T[:3, :3] @ np.diag([2.0, 1.0, third]))
    assert_same(R, T[:3, :3], 1e-9)
    batch = nearest_rotation(np.stack([np.diag([1.0, 1, -0.1]), T[:3, :3]])[None])
    assert_same(batch, np.stack([np.eye(3), T[:3, :3]])[None], 1e-9)


def test_the_mean_of_poses_that_differ_much_is_a_pose():
    half_turns = pose(rotation(np.pi * np.eye(3)[[0, 1]]))
    quarter = pose(rotation([0.0, 0.0, np.pi - 0.1]))
    assert np.linalg.det(mean_pose(np.stack([*half_turns, quarter]))[:3, :3]) > 0


@given(T=poses, digits=st.integers(3, 5))
def test_rounded_poses_become_the_nearest_rigid_ones_and_others_are_refused(T, digits: int):
    read = T.copy()
    read[:3, :3] = np.round(T[:3, :3], digits)
    found, said = rigid_poses("eye", read)
    assert [each.code for each in said] in ([], ["rounded-poses"])
    assert np.abs(found[:3, :3] @ found[:3, :3].T - np.eye(3)).max() < 2e-6
    assert np.abs(found - T).max() < 2 * 10.0**-digits
    assert np.array_equal(rigid_poses("eye", found)[0], found)
    read[:3, :3] *= 1.003
    with pytest.raises(VergenceError, match="eye: expected a rigid transform"):
        rigid_poses("eye", read)


def test_the_mean_of_poses_is_that_of_the_majority():
    rng = np.random.default_rng(0)
    true = pose(rotation([0.1, -0.4, 0.2]), [0.3, 0.1, 0.6])
    T = boxplus(np.tile(true, (11, 1, 1)), rng.normal(0, 2e-3, (11, 6)))
    T[2] = T[2] @ pose(rotation([0.0, 0.0, np.pi]))  # turned
    T[5, :3, 3] += [0.14, 0.0, 0.0]  # shifted
    T[7] = pose(rotation([1.0, 0.0, 0.0]), [0.0, 0.5, 0.5])
    assert np.flatnonzero(~agreeing_poses(T)).tolist() == [2, 5, 7]
    assert np.abs(boxminus(mean_pose(T), true)).max() < 2e-3
    assert agreeing_poses(T[[0, 5]]).all()
