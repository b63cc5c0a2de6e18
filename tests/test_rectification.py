"""Rectified pairs from exact projections, at random postures and through every lens model."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_head import four_cameras
from vergence.errors import VergenceError
from vergence.geometry.camera import pinhole, project
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.lens import reach
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, pose, rotation, transform
from vergence.stereo.rectification import (
    rectified_image,
    rectified_pixels,
    rectified_points,
    rectify,
)

LENSES = {
    "radial-tangential": pinhole(640, 480, 280.0, (-0.12, 0.02, 0.001, -0.0005, 0.0)),
    "rational": pinhole(
        640, 480, 280.0, (0.2, 0.02, 0.001, 0.0, 0.0, 0.35, 0.06, 0.0), model="rational"
    ),
    "fisheye": pinhole(640, 480, 280.0, (-0.02, 0.003, 0.0, 0.0), model="fisheye"),
}
WIDE = ("left_wide", "right_wide")


def head(model: str) -> HeadCalibration:
    """Return a head with wide lenses of a model, the right one of another focal length."""
    made = four_cameras()
    cameras = dict(made.cameras)
    for name, scale in zip(WIDE, (1.0, 1.03), strict=True):
        camera = LENSES[model]
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= scale
        matrix[0, 1] = 0.7
        cameras[name] = replace(cameras[name], intrinsics=replace(camera, matrix=matrix))
    tilted = pose(rotation([0.01, -0.02, 0.015]), [0.003, 0.092, -0.002])
    return replace(made, cameras=cameras, T_rbase_lbase=tilted)


@pytest.mark.parametrize("model", list(LENSES))
@given(seed=st.integers(0, 10_000))
def test_a_point_lies_in_one_row_and_its_disparity_gives_it_back(model: str, seed: int):
    rng = np.random.default_rng(seed)
    made, joints = head(model), rng.uniform(-0.25, 0.25, 4)
    pair = rectify(made, joints, size=(16, 12))
    points = rng.uniform([0.3, -0.3, -0.3], [3.0, 0.3, 0.3], (30, 3))
    at = [
        rectified_pixels(pair, view, project_point(made, name, joints, points))
        for view, name in zip((pair.left, pair.right), WIDE, strict=True)
    ]
    seen = np.isfinite(at).all(axis=(0, 2))
    assert seen.sum() > 5
    left, right = (each[seen] for each in at)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    disparity = left[:, 0] - right[:, 0]
    found = transform(pair.T_lbase_rect, rectified_points(pair, left, disparity))
    np.testing.assert_allclose(found, points[seen], atol=1e-9)
    homogeneous = np.column_stack([left, disparity, np.ones(len(left))]) @ pair.Q.T
    by_Q = transform(pair.T_lbase_rect, homogeneous[:, :3] / homogeneous[:, 3:])
    np.testing.assert_allclose(by_Q, points[seen], atol=1e-9)


@pytest.mark.parametrize("model", list(LENSES))
def test_the_map_leads_to_the_pixel_that_shows_the_same_direction(model: str):
    made, joints = head(model), np.array([0.1, -0.05, -0.1, 0.1])
    pair = rectify(made, joints)
    for view in (pair.left, pair.right):
        v, u = np.nonzero(view.seen)
        raw = np.stack([view.map_x[v, u], view.map_y[v, u]], axis=-1).astype(float)
        some = slice(None, None, 97)
        back = rectified_pixels(pair, view, raw[some])
        np.testing.assert_allclose(back, np.stack([u, v], axis=-1)[some], atol=1e-3)
        assert view.seen.mean() > 0.5
        assert not view.seen.all()


@pytest.mark.parametrize("model", [*LENSES, "folding"])
@pytest.mark.parametrize("joints", [(0.0, 0.0, 0.0, 0.0), (0.2, 0.1, -0.2, 0.1)])
def test_the_map_is_exact_everywhere(model: str, joints):
    """Also where the view ends, and where a lens folds over within it."""
    made = head("radial-tangential" if model == "folding" else model)
    if model == "folding":
        strong = np.array([-0.4, 0.15, 1e-3, 2e-3, -0.03])
        cameras = {
            name: replace(each, intrinsics=replace(each.intrinsics, distortion=strong))
            for name, each in made.cameras.items()
        }
        made = replace(made, cameras=cameras)
    size = (333, 250)
    pair = rectify(made, np.array(joints), size=size, focal_px=120.0)
    v, u = np.mgrid[: size[1], : size[0]]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(pair.matrix).T
    for view in (pair.left, pair.right):
        in_camera = rays @ view.R_rect_cam
        exact = project(view.camera, in_camera)
        x, y, z = np.moveaxis(in_camera, -1, 0)
        within = reach(view.camera.model, tuple(view.camera.distortion))
        seen = (z > 0) & (x**2 + y**2 < within * z**2)
        maps = np.stack([view.map_x, view.map_y], axis=-1)
        near = seen & (np.abs(exact) < 2000).all(axis=-1)
        assert near.mean() > 0.3
        assert np.abs(maps - exact)[near].max() < 1e-3
        assert (maps[~seen] < -9e3).all()


def test_a_rectified_image_is_dark_where_the_camera_does_not_look():
    pair = rectify(head("fisheye"), np.array([0.25, 0.2, -0.1, 0.0]))
    image = rectified_image(pair.left, np.full((480, 640, 3), 200, np.uint8))
    inner = cv2.erode(pair.left.seen.astype(np.uint8), np.ones((3, 3))) > 0
    outer = cv2.dilate(pair.left.seen.astype(np.uint8), np.ones((7, 7))) == 0
    assert (image[inner] == 200).all()
    assert (image[outer] == 0).all()


def test_measured_poses_rectify_as_the_angles_that_they_come_from():
    made, joints = head("rational"), np.array([0.1, 0.05, -0.1, 0.0])
    by_angles, by_poses = (
        rectify(made, j, size=(16, 12)) for j in (joints, eye_poses(made, joints))
    )
    np.testing.assert_allclose(by_poses.T_lbase_rect, by_angles.T_lbase_rect, atol=1e-12)
    assert by_angles.baseline_m == pytest.approx(0.092, abs=0.03)


@pytest.mark.parametrize("joints", [(1.2, 0.0, -1.2, 0.0), (0.0, 1.1, 0.0, -1.1)])
def test_views_that_do_not_overlap_are_refused(joints):
    with pytest.raises(VergenceError, match="do not overlap"):
        rectify(head("radial-tangential"), np.array(joints))


@pytest.mark.parametrize("pan", [0.0, 0.9])
def test_fisheye_lenses_may_have_the_epipole_at_their_rim(pan):
    lens = pinhole(640, 480, 215.0, (0.0,) * 4, model="fisheye")
    made = four_cameras()
    cameras = {name: replace(each, intrinsics=lens) for name, each in made.cameras.items()}
    pair = rectify(replace(made, cameras=cameras), np.array([pan, 0.0, pan, 0.0]))
    assert (pair.left.seen & pair.right.seen).mean() > 0.1


@pytest.mark.parametrize("shape", [(3, 4), (7,), (), (5, 2, 4, 4), (4, 4)])
def test_a_pair_is_rectified_at_one_posture(shape):
    with pytest.raises(VergenceError, match=r"readings left_pan.*found .* one posture"):
        rectify(four_cameras(), np.zeros(shape))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"focal_px": 0.0}, "focal_px is above 0 pixels, found 0"),
        ({"focal_px": np.nan}, "focal_px is above 0 pixels, found nan"),
        ({"size": (0, 480)}, r"in whole pixels, such as \(640, 480\).*; found \(0, 480\)"),
        ({"size": (640.5, 480)}, r"in whole pixels.*; found \(640.5, 480\)"),
        ({"size": (640,)}, r"in whole pixels.*; found \(640,\)"),
        ({"size": 640}, "in whole pixels.*; found 640"),
        ({"size": (100_000, 100_000)}, "at most 20000 each and 50,000,000 together"),
        ({"joints": [0.0, np.nan, 0.0, 0.0]}, "rectified at known joints; found .*nan"),
    ],
    ids=str,
)
def test_what_no_camera_can_have_is_refused(wrong, said):
    with pytest.raises(VergenceError, match=said):
        rectify(four_cameras(), **{"joints": np.zeros(4)} | wrong)


@pytest.mark.parametrize("shape", [(240, 320, 3), (480, 640, 3, 1), (640,)])
def test_an_image_of_another_size_is_refused_with_both_sizes(shape):
    pair = rectify(four_cameras(), [0.0, 0.0, 0.0, 0.0], size=(16, 12))
    with pytest.raises(VergenceError, match=rf"of 640 x 480 px.*found .*{shape[0]}"):
        rectified_image(pair.left, np.zeros(shape, np.uint8))


def test_cameras_that_stand_on_their_side_give_a_pair_that_stands_upright():
    made = head("radial-tangential")
    on_its_side = pose(rotation([0, 0, np.pi / 2]))
    cameras = {
        name: replace(mounted, T_eye_cam=mounted.T_eye_cam @ on_its_side)
        for name, mounted in made.cameras.items()
    }
    pair = rectify(replace(made, cameras=cameras), np.zeros(4))
    assert pair.left.map_x.shape == (640, 480)
    assert pair.left.seen.mean() > 0.95
    assert rectify(made, np.zeros(4)).left.map_x.shape == (480, 640)


def test_narrow_cameras_can_be_asked_for():
    pair = rectify(four_cameras(), np.zeros(4), cameras=("left_narrow", "right_narrow"))
    assert pair.matrix[0, 0] == pytest.approx(0.85 * 1200)
    assert np.linalg.norm(inverse(pair.T_lbase_rect)[:3, 3]) < 0.05
