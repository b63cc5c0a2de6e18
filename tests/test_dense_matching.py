"""What dense depth matches, what it refuses, and how far off it says to be, on drawn surfaces.

Surfaces face a head of two pinhole cameras, or turn away from it sideways; by how much their right
image is displaced is known everywhere.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from simulated_head import HEIGHT, WIDTH, plain_head
from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head_accuracy import Accuracy
from vergence.stereo.dense_depth import DenseDepth, dense_depth, point_cloud
from vergence.stereo.rectification import rectify
from vergence.stereo.uncertainty import locate

BASELINE_M, FOCAL_PX = 0.09, 280.0
HEAD = plain_head(BASELINE_M, FOCAL_PX)
PAIR = rectify(HEAD, np.zeros(4))
ZOOM = float(PAIR.matrix[0, 0]) / FOCAL_PX
"""Of the rectified images, whose axes are those of the cameras."""
INSIDE = slice(70, 410), slice(130, 560)
"""Of the rectified images, what both cameras see of a thing at 0.6 m and beyond."""
Images = tuple[np.ndarray, np.ndarray]


def texture(seed: int, contrast: float = 40.0, smooth_px: float = 1.5) -> Array:
    """Return grey levels (H, W + 260), of which an image shows the columns from 100 on."""
    noise = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH + 260))
    grey = cv2.GaussianBlur(noise, (0, 0), smooth_px)
    return 128 + contrast * grey / grey.std()


def surface(displaced_px: float, slope: float = 0.0, grey: Array | None = None) -> Images:
    """Return images of a surface that is displaced by so much in its middle, with noise.

    The displacement changes by the slope per column of the left image.
    """
    rng, grey = np.random.default_rng(9), texture(0) if grey is None else grey
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    in_left = (x + displaced_px - WIDTH / 2 * slope) / (1 - slope)
    right = cv2.remap(
        grey.astype(np.float32),
        *(a.astype(np.float32) for a in (in_left + 100, y)),
        cv2.INTER_CUBIC,
    )
    left, right = (
        each + rng.normal(0, 2, right.shape) for each in (grey[:, 100 : 100 + WIDTH], right)
    )
    return as_image(left), as_image(right)


def as_image(grey: Array) -> np.ndarray:
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def before(images: Images, displaced_px: int, rows: slice, columns: slice) -> Images:
    """Return images with a thing before the surface: where it is in the left one."""
    left, right = (each.copy() for each in images)
    grey = as_image(texture(1))[rows, columns]
    left[rows, columns] = grey
    right[rows, columns.start - displaced_px : columns.stop - displaced_px] = grey
    return left, right


def rectified(rows: slice, columns: slice) -> tuple[slice, slice]:
    """Return where rows and columns of the left image are in the rectified one."""
    ends = [
        [round((at - middle) * ZOOM + middle) for at in (part.start, part.stop)]
        for part, middle in ((rows, HEIGHT / 2 - 0.5), (columns, WIDTH / 2 - 0.5))
    ]
    return slice(*ends[0]), slice(*ends[1])


def displaced(found: DenseDepth) -> Array:
    """Return by how much things are displaced between the images that are not rectified [px]."""
    return BASELINE_M * FOCAL_PX / found.depth_m


def std_px(found: DenseDepth) -> Array:
    """Return the standard deviation of the disparity in the rectified images (Eq. 20)."""
    return found.std_m * PAIR.matrix[0, 0] * BASELINE_M / found.depth_m**2


def share(where: np.ndarray) -> float:
    return float(where.mean())


# What is matched


def test_images_of_different_things_are_seldom_matched():
    """By chance, though all of the right image is searched."""
    found = dense_depth(PAIR, surface(20)[0], as_image(texture(11))[:, :WIDTH])
    assert share(np.isfinite(found.depth_m[INSIDE])) < 0.15


def test_what_only_the_left_eye_sees_is_not_matched():
    """The right eye sees a nearer thing there, and beyond the edge of its image nothing."""
    thing = slice(150, 330), slice(300, 420)
    found = dense_depth(PAIR, *before(surface(10), 40, *thing))
    hidden = rectified(thing[0], slice(270, 300))
    assert share(np.isfinite(found.depth_m[hidden])) < 0.1
    np.testing.assert_allclose(np.nanmedian(displaced(found)[rectified(*thing)]), 40, atol=0.1)
    for apart in (10, 40):
        matched = np.isfinite(dense_depth(PAIR, *surface(apart)).depth_m)
        start = rectified(slice(0, 0), slice(apart, 0))[1].start
        assert share(matched[70:410, start + 10 : 560]) > 0.98
        assert share(matched[70:410, start - 6 : start]) < 0.15


@pytest.mark.parametrize(("side_px", "found_there"), [(10, 0.0), (12, 0.0), (18, 0.7)])
def test_a_patch_of_less_than_a_hundred_pixels_is_a_speckle(side_px: int, found_there: float):
    """In the rectified image, where edges of two or three pixels belong to the surroundings."""
    patch = slice(200, 200 + side_px), slice(300, 300 + side_px)
    found = dense_depth(PAIR, *before(surface(10), 20, *patch))
    there = share(np.abs(displaced(found) - 20)[rectified(*patch)] < 1)
    assert found_there <= there <= max(2 * found_there, 0.02)


@pytest.mark.parametrize(
    ("displaced_px", "nearest_m", "expected"),
    [(82, None, 1.0), (126, None, 0.0), (126, 0.18, 1.0)],
)
def test_depth_is_sought_from_the_nearest_on(displaced_px, nearest_m, expected):
    """From 0.3 m on by default: things at 0.31 and 0.2 m."""
    found = dense_depth(PAIR, *surface(displaced_px), nearest_m=nearest_m)
    right = np.abs(displaced(found)[70:410, 250:560] - displaced_px) < 1
    assert share(right) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("nearest_m", [0.0, -1.0, np.inf, np.nan])
def test_a_nearest_depth_that_is_no_distance_is_refused(nearest_m: float):
    with pytest.raises(VergenceError, match=f"nearest depth is from .* found {nearest_m:g} m"):
        dense_depth(PAIR, *surface(10), nearest_m=nearest_m)


@pytest.mark.parametrize("turned", [(0.14, 0.1, 0.04, 0.1), (-0.04, -0.1, -0.14, -0.1)])
def test_blocks_that_are_matched_lie_in_both_images(turned: tuple[float, ...]):
    """Rectified images show what lies beyond those of turned eyes, too."""
    pair = rectify(HEAD, np.array(turned))
    grey = as_image(texture(0)[:, :WIDTH])
    found = dense_depth(pair, grey, np.roll(grey, -30, axis=1))
    v, u = np.nonzero(np.isfinite(found.disparity_px))
    assert len(v) > 20_000
    opposite = np.round(u - found.disparity_px[v, u]).astype(int)
    for view, columns in ((pair.left, u), (pair.right, opposite)):
        for down, across in ((-2, -2), (-2, 2), (2, -2), (2, 2)):
            at = np.clip(v + down, 0, HEIGHT - 1), np.clip(columns + across, 0, WIDTH - 1)
            assert (columns >= 0).all()
            assert ((view.map_x[at] > -1) & (view.map_x[at] < WIDTH)).all()
            assert ((view.map_y[at] > -1) & (view.map_y[at] < HEIGHT)).all()


# How far off it says to be


@pytest.mark.parametrize(
    ("contrast", "lower", "upper", "textured"), [(40.0, 0.15, 0.2, 1.0), (8.0, 0.35, 0.5, 0.45)]
)
def test_the_deviation_of_a_facing_surface_follows_its_contrast(contrast, lower, upper, textured):
    grey = texture(0, contrast, smooth_px=1.5 if contrast > 10 else 2.5)
    found = dense_depth(PAIR, *surface(20.6, grey=grey))
    stated, inside = std_px(found)[INSIDE], found.textured[INSIDE]
    assert lower < np.nanmedian(stated) < upper
    assert share(inside) == pytest.approx(textured, abs=0.1)
    assert np.quantile(stated[inside], 0.99) < 0.42
    errors = ZOOM * (displaced(found)[INSIDE] - 20.6) / stated
    assert 0.5 < 1.48 * np.nanmedian(np.abs(errors)) < 1.7  # more by the matcher's own steps


@pytest.mark.parametrize("slope", [-0.1, 0.1])
def test_the_deviation_grows_with_the_slant_to_either_side(slope: float):
    facing, slanted = (dense_depth(PAIR, *surface(40, each)) for each in (0.0, slope))
    stated = std_px(slanted)[INSIDE]
    assert np.nanmedian(stated) > 1.5 * np.nanmedian(std_px(facing)[INSIDE])
    u = (np.arange(WIDTH) - (WIDTH / 2 - 0.5)) / ZOOM + WIDTH / 2 - 0.5
    truth = 40 + slope * (u - WIDTH / 2)
    errors = (ZOOM * (displaced(slanted) - truth))[INSIDE] / stated
    assert np.nanmean(np.abs(errors) < 2) > 0.95
    assert 1.48 * np.nanmedian(np.abs(errors)) > 0.3  # and not much more than needed


def test_the_edge_of_a_nearer_thing_is_uncertain_by_half_a_block():
    """However much nearer it is: where it ends to its right, the left eye sees what is behind."""
    thing = slice(150, 330), slice(300, 420)
    for apart in (30, 60):
        found = dense_depth(PAIR, *before(surface(10), apart, *thing))
        rows, columns = rectified(*thing)
        inside, end, outside = (
            np.nanmedian(std_px(found)[rows, part], axis=0).max()
            for part in (
                slice(columns.start + 15, columns.stop - 15),
                slice(columns.stop - 3, columns.stop + 3),
                slice(columns.stop + 15, 560),
            )
        )
        assert 2.4 < end < 2.6
        assert max(inside, outside) < 0.25


def test_the_deviation_beside_what_is_not_matched_is_that_of_the_surface():
    left, right = surface(20)
    right[200:260, 300:360] = as_image(texture(5))[200:260, 300:360]
    found = dense_depth(PAIR, left, right)
    rows, columns = rectified(slice(205, 255), slice(320, 380))
    assert share(np.isfinite(found.depth_m[rows, columns])) < 0.3
    beside = std_px(found)[rows, columns.start - 6 : columns.start]
    assert np.nanmedian(beside, axis=0).max() < 0.25


def test_what_readings_leave_open_is_that_of_a_located_point():
    """Whether their noise is given, or stated by the calibration."""
    images, reading_std = surface(60), 5e-3
    exact, given = (dense_depth(PAIR, *images, reading_std=std) for std in (None, reading_std))
    v, u = (each.ravel() for each in np.mgrid[100:400:50, 200:500:50])
    opposite = np.round(u - given.disparity_px[v, u]).astype(int)
    left, right = (
        np.stack([view.map_x[v, at], view.map_y[v, at]], axis=-1)
        for view, at in ((PAIR.left, u), (PAIR.right, opposite))
    )
    point = locate(
        HEAD,
        left=left,
        right=right,
        joints=np.zeros(4),
        pixel_std_px=0,
        reading_std=reading_std,
    )
    by_readings = np.sqrt(given.std_m**2 - exact.std_m**2)[v, u]
    np.testing.assert_allclose(by_readings, np.sqrt(point.covariance[:, 0, 0]), rtol=0.05)
    accuracy = Accuracy("bundle", joint_std=(reading_std,))
    stated = dense_depth(rectify(replace(HEAD, accuracy=accuracy), np.zeros(4)), *images)
    np.testing.assert_allclose(stated.std_m, given.std_m, rtol=1e-6)


def test_points_have_the_colour_of_their_pixel():
    """Of a facing wall that is red to the left and blue to the right."""
    left, right = (cv2.cvtColor(each, cv2.COLOR_GRAY2RGB) for each in surface(20))
    left[:, : WIDTH // 2, 2] //= 4
    left[:, WIDTH // 2 :, 0] //= 4
    points, colours = point_cloud(PAIR, dense_depth(PAIR, left, right))
    np.testing.assert_allclose(np.median(points[:, 0]), BASELINE_M * FOCAL_PX / 20, rtol=1e-3)
    aside = np.abs(points[:, 1]) > 0.02
    redder = colours[:, 0].astype(int) > colours[:, 2]
    assert share(redder[aside] == (points[aside, 1] > 0)) > 0.999  # others are black


def test_another_matcher_states_disparities_and_their_deviation():
    """What it does not match stays so, and its deviation joins that of the readings alone."""
    seen: list[np.ndarray] = []

    def matcher(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.extend([left, right])
        disparity = np.full(left.shape[:2], 30.0)
        disparity[200:210], disparity[220:230] = -1.0, np.nan
        return disparity, np.full(left.shape[:2], 0.2)

    found = dense_depth(PAIR, *surface(20), matcher=matcher)
    assert [each.shape for each in seen] == [(*PAIR.left.map_x.shape, 3)] * 2
    matched = np.isfinite(found.depth_m[INSIDE])
    assert share(matched) == 1 - 20 / (INSIDE[0].stop - INSIDE[0].start)
    np.testing.assert_allclose(found.disparity_px[INSIDE][matched], 30.0)
    np.testing.assert_allclose(std_px(found)[INSIDE][matched], 0.2)
    noisy = dense_depth(PAIR, *surface(20), matcher=matcher, reading_std=1e-3)
    by_readings = dense_depth(
        PAIR, *surface(20), matcher=lambda *pair: (matcher(*pair)[0], 1e-9 + 0 * matcher(*pair)[1]),
        reading_std=1e-3,
    )  # fmt: skip
    both = np.hypot(0.2, std_px(by_readings)[INSIDE][matched])
    np.testing.assert_allclose(std_px(noisy)[INSIDE][matched], both, rtol=1e-6)
    for wrong in ([1.0], np.zeros(PAIR.left.map_x.shape)):
        with pytest.raises(VergenceError, match="A matcher returns a disparity and its standard"):
            dense_depth(PAIR, *surface(20), matcher=lambda *pair, w=wrong: (matcher(*pair)[0], w))
