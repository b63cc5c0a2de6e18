"""Match features of a scene between two eyes, or over time in one.

The predicted geometry turns both images into one orientation. Features are tracked from the first
to the second image and back (Lucas and Kanade), refined by least squares, and returned as pixels of
the original images. The search covers predictions that are wrong by a few degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise
from vergence.vision.exposure import NEARBY_PX, of_equal_contrast
from vergence.vision.matching.feature_selection import best_of_cells, relief_around
from vergence.vision.matching.least_squares_matching import REACH, match_windows
from vergence.vision.matching.turned_views import TurnedViews, on_map, turned_views, whole_windows


@dataclass(frozen=True, eq=False)
class Matches:
    """The same N points of the scene in two images."""

    left: Array
    """(N, 2) pixels in the left image, or in the earlier one."""
    right: Array
    """(N, 2) pixels in the right image, or in the later one."""
    covariance: Array
    """(N, 2, 2) [px^2] of the right pixels, with the left ones taken as exact."""


def match_scene(
    left: np.ndarray,
    right: np.ndarray,
    *,
    left_camera: Camera,
    right_camera: Camera,
    T_rcam_lcam: Array,
) -> Matches:
    """Match features that both images show, by the predicted relative pose of the cameras.

    Images are (H, W) grey or (H, W, 3) RGB, uint8; T_rcam_lcam (4, 4) may be wrong by a few
    degrees.
    """
    views = turned_views((left, right), (left_camera, right_camera), T_rcam_lcam)
    return _matched(views, best_of_cells(views.first, views.inside), None)[0]


def track_features(
    before: np.ndarray,
    now: np.ndarray,
    *,
    camera: Camera,
    T_now_before: Array,
    pixels: Array,
    depths_m: Array,
) -> tuple[Matches, np.ndarray]:
    """Track features (M, 2) [px] of approximate depths (M,) into a later image of the same camera.

    The predicted motion T_now_before (4, 4) may be wrong by a few degrees. Returns N matches and
    the indices (N,) of their features; a match is up to a pixel away from its feature.
    """
    views = turned_views((before, now), (camera, camera), T_now_before)
    rays = np.column_stack([normalise(camera, pixels), np.ones(len(pixels))])
    rays = np.nan_to_num(rays @ views.R_view_first.T)
    ahead = rays[:, 2] > 0.1  # others leave any view
    at = views.focal * rays[:, :2] / np.where(ahead, rays[:, 2], 1.0)[:, None] + views.middle
    at, whole = np.round(at), whole_windows(views.inside)
    column, row = np.clip(at // 2, 0, np.array(whole.shape[::-1]) - 1).astype(int).T
    edge = np.array(views.first.shape[::-1]) - 1
    within = ((at >= REACH) & (at <= edge - REACH)).all(axis=1)
    usable = np.flatnonzero(ahead & within & whole[row, column])
    matches, kept = _matched(views, at[usable], depths_m[usable])
    return matches, usable[kept]


def _matched(views: TurnedViews, at: Array, depths_m: Array | None) -> tuple[Matches, np.ndarray]:
    """Match whole pixels (M, 2) of the first view; return their indices (N,), too.

    Depths (M,), if they are known, give the start of the search and the growth of the windows.
    """
    by_depth = views.focal * views.shift[:2] - (at - views.middle) * views.shift[2]
    # Without depths the search starts within a room.
    inverse_depth = 1 / (np.full(len(at), 1.5) if depths_m is None else depths_m)
    images = of_equal_contrast(views.first, views.second, views.inside)
    starts = at + by_depth * inverse_depth[:, None]
    if depths_m is None:
        found, sure = _track_far(views, images, at, starts, by_depth)
    else:
        found, sure = _track(*images, at, starts)
    # The displacement is by_depth / (depth + shift[2]), where shift[2] changes the scale.
    square = np.maximum((by_depth**2).sum(axis=1), 1e-12)
    # If the camera only turns, depth displaces nothing and any direction will do.
    along = np.where(square[:, None] > 1e-12, by_depth / np.sqrt(square)[:, None], [1.0, 0.0])
    kept = np.flatnonzero(sure)
    relief = relief_around(at[kept], ((found - at) * along)[kept].sum(axis=1))
    flat = relief < 0.4  # px
    kept, relief = kept[flat], relief[flat]
    at, found, along, inverse_depth = at[kept], found[kept], along[kept], inverse_depth[kept]
    if depths_m is None:
        inverse_depth = ((found - at) * by_depth[kept]).sum(axis=1) / square[kept]
    matched = match_windows(
        views.first,
        views.second_image,
        views.maps[1],
        at=at,
        found=found,
        direction=along,
        enlargement=-views.shift[2] * inverse_depth,
    )
    pixels, by_view = on_map(views.maps[1], matched.pixels)
    covariance = by_view @ matched.covariance @ np.swapaxes(by_view, 1, 2)
    # Matches with a deviation above 0.7 px carry little information for their time.
    good = matched.good & (np.linalg.eigvalsh(covariance)[:, 1] < 0.7**2)
    # Displacement across the epipolar line, as fitted to rendered images.
    covariance += ((0.2 * relief) ** 2)[:, None, None] * np.eye(2)
    column, row = at[good].astype(int).T
    left = np.stack([plane[row, column] for plane in views.maps[0]], axis=-1).astype(float)
    return Matches(left, pixels[good], covariance[good]), kept[good]


def _track_far(
    views: TurnedViews,
    images: tuple[np.ndarray, np.ndarray],
    at: Array,
    starts: Array,
    by_depth: Array,
) -> tuple[Array, np.ndarray]:
    """Track pixels (N, 2) into another view over small and large displacements.

    Those that a plane sweep predicts far from their start (N, 2) are tracked from there too, which
    takes precedence. Returns positions (N, 2), and which are sure.
    """
    nearby_px = 4 * step_px(views.first.shape[1]) - 1  # as for tracking in images of 640 px
    swept = images
    if nearby_px > NEARBY_PX:  # the sweep's small images of large ones need contrast, too
        swept = of_equal_contrast(views.first, views.second, views.inside, nearby_px)
    inverse_depth = inverse_depths(
        *swept, at, focal=views.focal, middle=views.middle, shift=views.shift
    )
    others = at + by_depth * inverse_depth[:, None]
    # At 20 px, trackers lose two fifths of the features.
    far = np.flatnonzero(np.linalg.norm(others - starts, axis=1) > 12)
    both = np.concatenate([np.arange(len(at)), far])
    found, sure = _track(*images, at[both], np.concatenate([starts, others[far]]))
    (found, found_far), (sure, sure_far) = (np.split(a, [len(at)]) for a in (found, sure))
    found[far[sure_far]], sure[far[sure_far]] = found_far[sure_far], True
    return found, sure


def _track(
    view: np.ndarray, other: np.ndarray, at: Array, start: Array
) -> tuple[Array, np.ndarray]:
    """Track pixels (N, 2) into another view; sure (N,) are those that are tracked back, too."""
    if not len(at):
        return at, np.zeros(0, bool)
    options = {
        "winSize": (9, 9),  # px; 11 take half as long again, for 4 % more matches
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        # Least squares needs no better start.
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 5, 0.1),
    }
    points = at.astype(np.float32)
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        view, other, points, start.astype(np.float32), maxLevel=3, **options
    )
    # The way back starts at its end and needs no pyramid.
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        other, view, found, points.copy(), maxLevel=0, **options
    )
    near = np.linalg.norm(back - points, axis=1) < 0.3  # px
    sure = (good[:, 0] == 1) & (again[:, 0] == 1) & near
    return found.astype(float), sure


def step_px(width: int) -> int:
    """Compute the displacement between neighbouring planes: a pixel of the small images."""
    return max(width // 80, 1)  # about 80 px wide, for speed


def inverse_depths(
    first: np.ndarray, second: np.ndarray, at: Array, *, focal: float, middle: Array, shift: Array
) -> Array:
    """Estimate inverse depths (N,) [1/m] in the second image; NaN where no plane is clearly best.

    A plane sweep in small images: each pixel (N, 2) of the first takes the plane at which its
    surroundings differ least (Collins, "A space-sweep approach to true multi-image matching",
    1996). It covers larger displacements than a tracker's pyramid. Both images (H, W) have one
    contrast, focal length and principal point `middle` (2,); a point shifts by (3,) [m] from the
    first camera to the second.
    """
    step = step_px(first.shape[1])
    by_inverse_depth = focal * float(np.hypot(*shift[:2]))  # displacement in the middle
    if by_inverse_depth < 1e-9 or not len(at):
        return np.full(len(at), np.nan)
    size = first.shape[1] // step, first.shape[0] // step
    a, b = (
        cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for image in (first, second)
    )
    # Up to a third of the width forwards and, by a wrong prediction, a 32nd backwards.
    planes = np.arange(-round(size[0] / 32), round(size[0] / 3) + 1)
    planes = planes * (step / by_inverse_depth)
    centre = (middle + 0.5) / step - 0.5  # the principal point in the small images
    difference = np.empty((len(planes), *a.shape), np.float32)
    for k, inverse_depth in enumerate(planes):
        scale = 1 - inverse_depth * shift[2]
        moved = inverse_depth * focal / step * shift[:2] + (1 - scale) * centre
        displaced = cv2.warpAffine(
            b,
            np.array([[scale, 0, moved[0]], [0, scale, moved[1]]]),
            size,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=1e4,  # more than any difference, also in the mean of a square
        )
        cv2.boxFilter(cv2.absdiff(a, displaced), -1, (5, 5), dst=difference[k])
    visible = difference < 256
    mean = np.einsum("kij,kij->ij", difference, visible) / np.maximum(visible.sum(axis=0), 1)
    least = difference.min(axis=0)
    clear = least < 0.5 * mean  # 0.7 gives the same matches
    # argmin takes five times as long along the first axis.
    numbers = np.arange(len(planes), dtype=np.uint8)[:, None, None]
    best = cv2.medianBlur((numbers * (difference == least)).max(axis=0), 5)
    column, row = np.clip(((at + 0.5) // step).astype(int), 0, np.array(size) - 1).T
    return np.where(clear[row, column], planes[best[row, column]], np.nan)
