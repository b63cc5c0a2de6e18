"""What two images show of the same scene: features matched between two eyes, or over time in one.

The predicted geometry brings both images into one orientation, in which a point of the scene
differs by little more than its disparity. Features are tracked from the first to the second image
and back (Lucas and Kanade), then matched by least squares, and returned as pixels of the images as
they are. Between two eyes they are the places of the part that both see, one in each cell, that a
window determines best; over time they are given. The search covers predictions that are wrong by a
few degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, half_size, normalise
from vergence.vision.exposure import NEARBY_PX, grey_levels, of_equal_contrast
from vergence.vision.matching.feature_selection import best_of_cells
from vergence.vision.matching.least_squares_matching import REACH, WINDOW_PX, match_windows
from vergence.vision.matching.plane_sweep import inverse_depths, step_px
from vergence.vision.matching.relief import relief_around
from vergence.vision.matching.turned_views import TurnedViews, on_map, turned_views, whole_windows

_FEW = 150
"""Matches below which images of half the size are tried. Rooms give 370 and more, also with plain
walls."""
_WINDOW_PX = 9
"""OpenCV's tracker takes eight columns at a time: 11 px take half as long again, for 4 % more."""
_LEVELS = 3
_EXPECTED_DEPTH_M = 1.5
"""Where tracking starts to search; from there its pyramid reaches 50 px at best."""
_FAR_PX = 12.0
"""Distance from this start to what the plane sweep predicts, from which that is tried too. Of
features that are 20 px from the start, trackers without it lose two fifths."""
_SWEPT_MEAN = 4
"""Side of the square of which the mean is taken for the sweep, in pixels of its small images: as in
images of 640 px, where it is the same as for tracking."""
_ROUND_TRIP_PX = 0.3
_LEAST_FORWARD = 0.1
"""Least component of a ray along the optical axis: others are beside any view."""
_LARGEST_STD_PX = 0.7
"""Largest standard deviation of a match that is kept: others are not worth their time."""
_LARGEST_RELIEF_PX = 0.4
_ACROSS = 0.2
"""Share of the relief that windows take for a displacement across the epipolar line; fitted by eye
to rendered images of one head at known postures, where 0.1 to 0.3 tell about as much; with relief
that was judged after least squares, by twelve neighbours."""


@dataclass(frozen=True, eq=False)
class Matches:
    """The same N points of the scene in two images."""

    left: Array
    """(N, 2) pixels in the left image, or in the earlier one."""
    right: Array
    """(N, 2) pixels in the right image, or in the later one."""
    covariance: Array
    """(N, 2, 2) [px^2] of the right pixels, the left ones taken as exact: by the contrast of the
    window, and by how far the two windows differ."""


def match_scene(
    left: np.ndarray,
    right: np.ndarray,
    *,
    left_camera: Camera,
    right_camera: Camera,
    T_rcam_lcam: Array,
) -> Matches:
    """Return features that both images show, by about where the cameras stand to each other.

    Where noise leaves few, images of half the size are matched too, whose windows show more of the
    scene; the matches with more information are returned.

    Images are (H, W) grey or (H, W, 3) RGB, uint8; T_rcam_lcam (4, 4) may be wrong by a few
    degrees.
    """
    by_left, by_right = (left, left_camera), (right, right_camera)
    matches = _between_eyes(by_left, by_right, T_rcam_lcam)
    if len(matches.left) >= _FEW or min(left.shape[:2]) < 4 * WINDOW_PX:
        return matches
    small = _between_eyes(_half_size(*by_left), _half_size(*by_right), T_rcam_lcam)
    small = Matches(2 * small.left + 0.5, 2 * small.right + 0.5, 4 * small.covariance)
    return max(matches, small, key=_information)


def _between_eyes(
    left: tuple[np.ndarray, Camera], right: tuple[np.ndarray, Camera], T_rcam_lcam: Array
) -> Matches:
    """Return what images with their cameras show alike, at their own scale."""
    views = turned_views((left[0], right[0]), (left[1], right[1]), T_rcam_lcam)
    return _matched(views, best_of_cells(views.first, views.inside), None)[0]


def _half_size(image: np.ndarray, camera: Camera) -> tuple[np.ndarray, Camera]:
    """Return an image whose pixels are the means of 2 x 2, and its camera."""
    small = half_size(camera)
    whole = grey_levels(image)[: 2 * small.height, : 2 * small.width]
    return cv2.resize(whole, small.size, interpolation=cv2.INTER_AREA), small


def _information(matches: Matches) -> float:
    """Return the information of matches: the sum of their inverse variances [1/px^2]."""
    return float((1 / np.trace(matches.covariance, axis1=1, axis2=2)).sum())


def track_features(
    before: np.ndarray,
    now: np.ndarray,
    *,
    camera: Camera,
    T_now_before: Array,
    pixels: Array,
    depths_m: Array,
) -> tuple[Matches, np.ndarray]:
    """Return where features of an earlier image are in a later one of the same camera.

    Args:
        before: (H, W) grey or (H, W, 3) RGB, uint8.
        now: the later one.
        camera: that took both.
        T_now_before: (4, 4) about how it moved; its turn may be wrong by a few degrees.
        pixels: (M, 2) of the features in the earlier image.
        depths_m: (M,) about how far they were along its optical axis.

    Returns:
        N matches, and which (N,) of the features they are. Windows lie on whole pixels of a turned
        image, so that a match is up to a pixel beside its feature.
    """
    views = turned_views((before, now), (camera, camera), T_now_before)
    rays = np.column_stack([normalise(camera, pixels), np.ones(len(pixels))])
    rays = np.nan_to_num(rays @ views.R_view_first.T)
    ahead = rays[:, 2] > _LEAST_FORWARD
    at = views.focal * rays[:, :2] / np.where(ahead, rays[:, 2], 1.0)[:, None] + views.middle
    at, whole = np.round(at), whole_windows(views.inside)
    column, row = np.clip(at // 2, 0, np.array(whole.shape[::-1]) - 1).astype(int).T
    edge = np.array(views.first.shape[::-1]) - 1
    within = ((at >= REACH) & (at <= edge - REACH)).all(axis=1)
    usable = np.flatnonzero(ahead & within & whole[row, column])
    matches, kept = _matched(views, at[usable], depths_m[usable])
    return matches, usable[kept]


def _matched(views: TurnedViews, at: Array, depths_m: Array | None) -> tuple[Matches, np.ndarray]:
    """Return matches of whole pixels (M, 2) of the first view, and which of these they are (N,).

    Depths (M,) tell where to search, and how much larger a window became; None: unknown.
    """
    by_depth = views.focal * views.shift[:2] - (at - views.middle) * views.shift[2]
    nearness = 1 / (np.full(len(at), _EXPECTED_DEPTH_M) if depths_m is None else depths_m)
    alike = of_equal_contrast(views.first, views.second, views.inside)
    starts = at + by_depth * nearness[:, None]
    if depths_m is None:
        found, sure = _track_far(views, alike, at, starts, by_depth)
    else:
        found, sure = _track(*alike, at, starts)
    # Displaced by by_depth / (depth + shift[2]), of which the last is due to the change of scale.
    square = np.maximum((by_depth**2).sum(axis=1), 1e-12)
    # A camera that only turns displaces nothing by depth: any direction will do.
    along = np.where(square[:, None] > 1e-12, by_depth / np.sqrt(square)[:, None], [1.0, 0.0])
    kept = np.flatnonzero(sure)
    relief = relief_around(at[kept], ((found - at) * along)[kept].sum(axis=1))
    flat = relief < _LARGEST_RELIEF_PX
    kept, relief = kept[flat], relief[flat]
    at, found, along, nearness = at[kept], found[kept], along[kept], nearness[kept]
    if depths_m is None:
        nearness = ((found - at) * by_depth[kept]).sum(axis=1) / square[kept]
    matched = match_windows(
        views.first,
        views.second_image,
        views.maps[1],
        at=at,
        found=found,
        direction=along,
        enlargement=-views.shift[2] * nearness,
    )
    # In the second image itself, whose scale is another.
    pixels, by_view = on_map(views.maps[1], matched.pixels)
    covariance = by_view @ matched.covariance @ np.swapaxes(by_view, 1, 2)
    good = matched.good & (np.linalg.eigvalsh(covariance)[:, 1] < _LARGEST_STD_PX**2)
    covariance += ((_ACROSS * relief) ** 2)[:, None, None] * np.eye(2)
    column, row = at[good].astype(int).T
    left = np.stack([each[row, column] for each in views.maps[0]], axis=-1).astype(float)
    matches = Matches(left, pixels[good], covariance[good])
    return matches, kept[good]


def _track_far(
    views: TurnedViews,
    alike: tuple[np.ndarray, np.ndarray],
    at: Array,
    starts: Array,
    by_depth: Array,
) -> tuple[Array, np.ndarray]:
    """Return where pixels (N, 2) are found in another view, and which are sure, near and far.

    Each is tracked from its start (N, 2). Those that a plane sweep has far from there are tracked
    from where it has them too, which counts if they are found: repeated patterns look the same
    some periods away.
    """
    swept = inverse_depths(
        *_of_wide_contrast(views, alike),
        at,
        focal=views.focal,
        middle=views.middle,
        shift=views.shift,
    )
    others = at + by_depth * swept[:, None]
    far = np.flatnonzero(np.linalg.norm(others - starts, axis=1) > _FAR_PX)
    both = np.concatenate([np.arange(len(at)), far])
    found, sure = _track(*alike, at[both], np.concatenate([starts, others[far]]))
    (found, there), (sure, again) = (np.split(each, [len(at)]) for each in (found, sure))
    found[far[again]], sure[far[again]] = there[again], True
    return found, sure


def _of_wide_contrast(
    views: TurnedViews, alike: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return views for the plane sweep, which makes large ones small: less means over more pixels.

    Without those over a few pixels of its small images, nothing of many scenes is left in these.
    """
    nearby_px = _SWEPT_MEAN * step_px(views.first.shape[1]) - 1
    if nearby_px <= NEARBY_PX:
        return alike
    return of_equal_contrast(views.first, views.second, views.inside, nearby_px)


def _track(
    view: np.ndarray, other: np.ndarray, at: Array, start: Array
) -> tuple[Array, np.ndarray]:
    """Return where pixels (N, 2) are found in another view, and which are sure.

    Sure are those that are found again where they came from.
    """
    if not len(at):
        return at, np.zeros(0, bool)
    options = {
        "winSize": (_WINDOW_PX, _WINDOW_PX),
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        # Near enough for least squares.
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 5, 0.1),
    }
    points = at.astype(np.float32)
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        view, other, points, start.astype(np.float32), maxLevel=_LEVELS, **options
    )
    # The way back begins at its end: no pyramid is needed.
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        other, view, found, points.copy(), maxLevel=0, **options
    )
    near = np.linalg.norm(back - points, axis=1) < _ROUND_TRIP_PX
    sure = (good[:, 0] == 1) & (again[:, 0] == 1) & near
    return found.astype(float), sure
