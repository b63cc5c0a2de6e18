"""Matches between two drawn pictures of a textured wall, whose true geometry is known."""

import cv2
import numpy as np
import pytest

from vergence.arrays import Array
from vergence.geometry.camera import normalise, pinhole, project
from vergence.geometry.se3 import pose, rotation
from vergence.vision.matching.feature_selection import relief_around
from vergence.vision.matching.scene_features import Matches, match_scene, track_features

CAMERA = pinhole(640, 480, 280.0, (-0.12, 0.01, 0.0, 0.0, 0.0))
T_RCAM_LCAM = pose(rotation([0.01, -0.15, 0.02]), [-0.075, 0.002, 0.01])
WALL_M = 1.5
ALIKE = 1.0, 0.0


def picture(
    T_cam_lcam: Array,
    contrast: float,
    rng: np.random.Generator,
    *,
    plain: float = 0.0,
    wall_m: float = WALL_M,
) -> np.ndarray:
    """Return (H, W) what a camera sees of the wall, which stands at wall_m before the left one.

    The lower share `plain` of the wall is without texture.
    """
    texture = cv2.GaussianBlur(np.random.default_rng(7).normal(0, 1, (1200, 1600)), (0, 0), 2.0)
    texture = (contrast * 60 / texture.std() * texture).astype(np.float32)
    top, seen_rows = 150, 900  # of the wall, that the left camera sees
    texture[top + round((1 - plain) * seen_rows) :] *= plain == 0
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    xy = normalise(CAMERA, np.stack([u, v], axis=-1))
    R, t = T_cam_lcam[:3, :3], T_cam_lcam[:3, 3]
    rays = np.concatenate([xy, np.ones((480, 640, 1))], axis=-1) @ R
    start = -R.T @ t
    on_wall = start + (wall_m - start[2]) / rays[..., 2:] * rays
    at = (on_wall[..., :2] / wall_m * 375 + [800, 600]).astype(np.float32)
    u, v = (np.ascontiguousarray(at[..., k]) for k in (0, 1))
    seen = cv2.remap(texture, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.clip(np.round(128 + seen + rng.normal(0, 1.5, seen.shape)), 0, 255).astype(np.uint8)


def found(
    contrast: float,
    guess: Array = T_RCAM_LCAM,
    exposure: tuple[float, float] = ALIKE,
    wall_m: float = WALL_M,
) -> tuple[Matches, Array]:
    """Return matches, and how far each right pixel is from where it belongs, in deviations."""
    rng = np.random.default_rng(0)
    left, right = (picture(T, contrast, rng, wall_m=wall_m) for T in (np.eye(4), T_RCAM_LCAM))
    right = np.clip(np.round(exposure[0] * right + exposure[1]), 0, 255).astype(np.uint8)
    matches = match_scene(left, right, left_camera=CAMERA, right_camera=CAMERA, T_rcam_lcam=guess)
    xy = normalise(CAMERA, matches.left)
    points = wall_m * np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    in_right = points @ T_RCAM_LCAM[:3, :3].T + T_RCAM_LCAM[:3, 3]
    errors = matches.right - project(CAMERA, in_right)
    root = np.linalg.cholesky(matches.covariance)
    return matches, np.linalg.solve(root, errors[..., None])[..., 0]


@pytest.mark.slow
def test_matches_are_right_to_their_stated_deviation():
    matches, errors = found(1.0)
    assert len(matches.left) > 200
    good = (np.abs(errors) < 5).all(axis=1)
    assert good.mean() > 0.9
    assert 0.5 < errors[good].std() < 2


@pytest.mark.parametrize("baselines", [3.0, 5.0, 100.0])
def test_near_and_far_scenes_are_matched_alike(baselines: float):
    """Displaced by 90, 55 and 3 px."""
    matches, errors = found(1.0, wall_m=0.075 * baselines)
    assert len(matches.left) > 120
    assert (np.abs(errors) < 5).all(axis=1).mean() > 0.8


@pytest.mark.slow
def test_a_prediction_that_is_wrong_by_a_degree_is_good_enough():
    turned = pose(rotation([0, 0, np.radians(1)]) @ rotation([0, np.radians(1), 0]))
    _, errors = found(1.0, turned @ T_RCAM_LCAM)
    assert (np.abs(errors) < 5).all(axis=1).sum() > 150


@pytest.mark.parametrize("exposure", [(0.5, 0.0), (0.8, 40.0), (1.2, -30.0)])
def test_eyes_that_expose_differently_see_the_same(exposure):
    alike, _ = found(1.0)
    matches, errors = found(1.0, exposure=exposure)
    assert len(matches.left) > 0.95 * len(alike.left)
    good = (np.abs(errors) < 5).all(axis=1)
    assert good.mean() > 0.9
    assert 0.5 < errors[good].std() < 2


def test_plain_walls_leave_their_features_to_what_has_texture():
    """Of what nine tenths show, and what a third shows, nearly as many features are matched."""
    counts = {}
    for plain in (0.1, 0.65):
        rng = np.random.default_rng(0)
        left, right = (picture(T, 1.0, rng, plain=plain) for T in (np.eye(4), T_RCAM_LCAM))
        matches = match_scene(
            left, right, left_camera=CAMERA, right_camera=CAMERA, T_rcam_lcam=T_RCAM_LCAM
        )
        counts[plain] = len(matches.left)
    assert counts[0.65] > 0.7 * counts[0.1]


@pytest.mark.parametrize("noise_grey", [0.0, 1.5, 4.0])
def test_a_covered_eye_gives_no_matches(noise_grey):
    rng = np.random.default_rng(0)
    left = picture(np.eye(4), 1.0, rng)
    dark = np.clip(np.round(rng.normal(15, noise_grey, left.shape)), 0, 255).astype(np.uint8)
    matches = match_scene(
        left, dark, left_camera=CAMERA, right_camera=CAMERA, T_rcam_lcam=T_RCAM_LCAM
    )
    assert len(matches.left) < 5


GRID = np.stack(np.meshgrid(np.arange(0.0, 300, 15), np.arange(0.0, 300, 15)), axis=-1)
GRID = GRID.reshape(-1, 2)


def test_neighbours_show_relief_at_a_depth_discontinuity():
    behind = GRID[:, 1] < 150
    found = relief_around(GRID, np.where(behind, 12.0, 20.0) + 0.1 * GRID[:, 0])
    assert (found[np.isin(GRID[:, 1], [135, 150])] > 1).all()
    assert (found[np.abs(GRID[:, 1] - 142.5) > 25] < 0.01).all()


T_NOW_BEFORE = pose(rotation([0.06, 0.2, 0.02]), [0.004, 0.001, 0.002])


def test_features_are_tracked_in_a_turning_camera():
    rng = np.random.default_rng(0)
    before, now = (picture(T, 1.0, rng) for T in (np.eye(4), T_NOW_BEFORE))
    u, v = np.meshgrid(np.arange(10.5, 640, 25), np.arange(10.25, 480, 25))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    predicted = pose(rotation([0, np.radians(0.7), 0])) @ T_NOW_BEFORE
    matches, which = track_features(
        before,
        now,
        camera=CAMERA,
        T_now_before=predicted,
        pixels=pixels,
        depths_m=np.full(len(pixels), 1.1 * WALL_M),
    )
    np.testing.assert_allclose(matches.left, pixels[which], atol=0.6)
    points = WALL_M * np.column_stack([normalise(CAMERA, matches.left), np.ones(len(which))])
    there = project(CAMERA, points @ T_NOW_BEFORE[:3, :3].T + T_NOW_BEFORE[:3, 3])
    errors = matches.right - there
    root = np.linalg.cholesky(matches.covariance)
    errors = np.linalg.solve(root, errors[..., None])[..., 0]
    good = (np.abs(errors) < 5).all(axis=1)
    assert len(which) > 150
    assert good.mean() > 0.9
    assert 0.3 < errors[good].std() < 2


def test_features_that_left_the_image_are_not_tracked():
    rng = np.random.default_rng(0)
    image = picture(np.eye(4), 1.0, rng)
    whole, cut_off = [[320.0, 240.0], [100.0, 240.0]], [[320.0, 7.4], [632.4, 240.0]]
    pixels = np.array([*whole, *cut_off, [np.nan, 3.0]])
    away = pose(rotation([0, np.radians(120), 0]))
    for T, expected in ((np.eye(4), [0, 1]), (away, [])):
        _, which = track_features(
            image, image, camera=CAMERA, T_now_before=T, pixels=pixels, depths_m=np.ones(5)
        )
        np.testing.assert_array_equal(which, expected)


@pytest.mark.parametrize("distance_m", [0.7, 3.0, 20.0])
def test_large_images_of_smooth_things_are_matched_at_any_distance(distance_m):
    """A facing wall whose contrast falls with its detail, as that of most things does."""
    width, height, focal, baseline = 1920, 1080, 840.0, 0.092
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(2 * width))
    noise = np.random.default_rng(3).normal(size=(height, 2 * width))
    wall = np.fft.irfft2(np.fft.rfft2(noise) / np.maximum(frequency, 1e-3), noise.shape)
    shift = round(focal * baseline / distance_m)
    images = [
        np.clip(120 + 45 * each / wall.std(), 0, 255).astype(np.uint8)
        for each in (wall[:, 200 : 200 + width], wall[:, 200 + shift : 200 + shift + width])
    ]
    camera = pinhole(width, height, focal)
    T = pose(np.eye(3), [-baseline, 0.0, 0.0])
    found = match_scene(*images, left_camera=camera, right_camera=camera, T_rcam_lcam=T)
    assert len(found.left) > 1000
    apart = found.left - found.right - [shift, 0]
    assert np.median(np.linalg.norm(apart, axis=1)) < 0.1
