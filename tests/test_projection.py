"""A point before the head becomes a pixel, for any batch, with the derivatives of every step."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated_head import plain_head, point_in_camera, skewed_head
from vergence.arrays import Array
from vergence.geometry.camera import pinhole, project
from vergence.geometry.head import MountedCamera
from vergence.geometry.kinematics import eye_pose
from vergence.geometry.parameters import lens_of_vector, lens_vector
from vergence.geometry.projection import project_at, project_point, project_with_jacobians
from vergence.geometry.se3 import boxplus, transform
from vergence.stereo.extrinsics import camera_poses

CAMERAS = ("left_wide", "right_wide", "left_narrow", "right_narrow")
seeds = st.integers(0, 2**32 - 1)


def before_the_head(rng: np.random.Generator, *shape: int) -> Array:
    return rng.uniform([0.3, -0.1, -0.1], [1.5, 0.1, 0.1], (*shape, 3))


@given(seeds, st.sampled_from(CAMERAS))
def test_a_pixel_is_the_lens_of_the_point_in_the_camera(seed: int, name: str):
    rng = np.random.default_rng(seed)
    head, points = skewed_head(rng), before_the_head(rng, 5)
    joints = rng.uniform(-0.25, 0.25, (5, 4))
    in_camera = point_in_camera(head, name, joints, points)
    expected = project(head.cameras[name].intrinsics, in_camera)
    np.testing.assert_allclose(project_point(head, name, joints, points), expected, atol=1e-9)


@pytest.mark.parametrize("name", CAMERAS)
def test_one_point_many_points_and_boards_have_the_same_pixels(name: str):
    rng = np.random.default_rng(2)
    head, boards = skewed_head(rng), before_the_head(rng, 7, 54)
    joints = rng.uniform(-0.25, 0.25, (7, 4))
    pixels = project_point(head, name, joints[:, None], boards)
    assert pixels.shape == (7, 54, 2)
    for found, expected in (
        (project_point(head, name, joints[3], boards[3, 8]), pixels[3, 8]),
        (project_point(head, name, joints, boards[:, 8]), pixels[:, 8]),
        (project_point(head, name, joints[3], boards[3]), pixels[3]),
        (project_point(head, name, joints[3], boards)[3], pixels[3]),
        (project_point(head, name, joints, boards[3, 8])[3], pixels[3, 8]),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-11)


def test_a_point_beyond_the_reach_of_a_lens_has_no_pixel():
    lens = pinhole(640, 480, 280.0, (-0.3, 0.0, 0.0, 0.0, 0.0))  # folds over at 46 degrees
    head = skewed_head(np.random.default_rng(0))
    cameras = {n: replace(c, intrinsics=lens) for n, c in head.cameras.items()}
    head, angles = replace(head, cameras=cameras), np.radians([[30.0], [60.0]])
    in_camera = np.concatenate([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    poses, _ = camera_poses(head, np.zeros(4), cameras=("left_wide", "right_wide"))
    pixels = project_point(head, "left_wide", np.zeros(4), transform(poses, in_camera))
    np.testing.assert_array_equal(np.isnan(pixels).all(axis=1), [False, True])


def test_points_in_the_plane_of_a_camera_have_no_pixel_without_a_warning():
    head, points = plain_head(0.09, 300.0), np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.0]])
    pixels = project_point(head, "left_wide", np.zeros(4), points)
    np.testing.assert_array_equal(np.isnan(pixels).all(axis=1), [True, False])


def slope(function, n: int, step: float) -> Array:
    """Return derivatives (..., n) at zero by central differences."""
    rows = step * np.eye(n)
    return np.stack([(function(d) - function(-d)) / (2 * step) for d in rows], axis=-1)


@given(seeds, st.sampled_from(CAMERAS))
@settings(max_examples=20)
def test_every_derivative_of_the_projection_agrees_with_differences(seed: int, name: str):
    rng = np.random.default_rng(seed)
    head, points = skewed_head(rng), before_the_head(rng, 3, 4)
    mounted, between = head.cameras[name], head.T_rbase_lbase
    T = eye_pose(head.kinematics, mounted.eye, rng.uniform(-0.25, 0.25, (3, 4)))
    found = project_with_jacobians(mounted, between, T[:, None], points)

    def with_lens(change: Array) -> MountedCamera:
        lens = mounted.intrinsics
        return replace(mounted, intrinsics=lens_of_vector(lens, lens_vector(lens) + change))

    def with_mounting(change: Array) -> MountedCamera:
        return replace(mounted, T_eye_cam=boxplus(mounted.T_eye_cam, change))

    pose_slope = partial(slope, n=6, step=1e-6)
    expected = dict(
        pixels=project_at(mounted, between, T, points),
        by_lens=slope(lambda d: project_at(with_lens(d), between, T, points), 9, 1e-4),
        by_T_eye_cam=pose_slope(lambda d: project_at(with_mounting(d), between, T, points)),
        by_T_base_eye=pose_slope(lambda d: project_at(mounted, between, boxplus(T, d), points)),
        by_T_rbase_lbase=pose_slope(lambda d: project_at(mounted, boxplus(between, d), T, points)),
        by_point=slope(lambda d: project_at(mounted, between, T, points + d), 3, 1e-6),
    )
    for what, exact in expected.items():
        np.testing.assert_allclose(getattr(found, what), exact, rtol=1e-6, atol=2e-5, err_msg=what)
