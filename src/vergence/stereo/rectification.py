"""Rectified image pairs at any posture of the eyes, with any lens model.

Two pinhole cameras share one orientation, with the x axis along the baseline: Fusiello, Trucco and
Verri, "A compact algorithm for rectification of stereo pairs" (2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats, single_blas_thread
from vergence.errors import VergenceError
from vergence.geometry.batches import batch_last, times, vector
from vergence.geometry.camera import (
    MAX_IMAGE_AREA_PX,
    MAX_IMAGE_PX,
    Camera,
    in_valid_field,
    is_image_size,
    project,
    unproject,
)
from vergence.geometry.eye_motion import check_joints
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.kinematics import checked_readings
from vergence.geometry.se3 import inverse, pose
from vergence.stereo.extrinsics import camera_poses, stereo_cameras

FOCAL_SHARE = 0.85
"""Focal length of the rectified cameras, relative to the mean of the real ones: eyes that diverge
need a wider view."""
_ROWS = 16
"""Rows of a map that are projected at a time, so that they stay in the cache."""
_OUTSIDE = -1e4
"""In a map: no pixel of the camera shows this direction."""


@dataclass(frozen=True, eq=False)
class RectifiedView:
    """How the image of one camera becomes its half of a rectified pair."""

    camera: Camera
    """The real camera."""
    R_rect_cam: Array
    """(3, 3) from the axes of the real camera to those of the rectified one."""
    map_x: np.ndarray
    """(H, W) float32: the column in the real image of each rectified pixel, for cv2.remap; far
    outside where the camera does not look."""
    map_y: np.ndarray
    """(H, W) float32: the row."""

    @property
    def seen(self) -> np.ndarray:
        """(H, W) of bool: whether the real image shows a rectified pixel."""
        right, bottom = self.camera.width - 1, self.camera.height - 1
        inside_x = (self.map_x >= 0) & (self.map_x <= right)
        return inside_x & (self.map_y >= 0) & (self.map_y <= bottom)


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """Two views by pinhole cameras that differ by a shift along their x axis alone."""

    head: HeadCalibration
    """By which images are rectified."""
    joints: Array
    """Readings (r,) [rad], or measured poses (2, 4, 4) of both eyes, at which they are."""
    cameras: tuple[str, str]
    """Names of the left and the right one."""
    left: RectifiedView
    right: RectifiedView
    matrix: Array
    """(3, 3) of both rectified cameras."""
    baseline_m: float
    """The right camera's shift along x."""
    T_lbase_rect: Array
    """(4, 4) pose of the left rectified camera in the left eye's base frame."""

    @property
    def Q(self) -> Array:
        """(4, 4) from (u, v, disparity, 1) to a point, homogeneous: as of cv2.stereoRectify."""
        (f, _, cx), (_, _, cy), _ = self.matrix
        return np.array(
            [[1, 0, 0, -cx], [0, 1, 0, -cy], [0, 0, 0, f], [0, 0, 1 / self.baseline_m, 0]]
        )


@single_blas_thread()
def rectify(
    head: HeadCalibration,
    joints: ArrayLike,
    *,
    cameras: tuple[str, str] | None = None,
    size: tuple[int, int] | None = None,
    focal_px: float | None = None,
) -> RectifiedPair:
    """Compute how to rectify the images of two cameras at one posture of the eyes.

    Args:
        head: with a camera in each eye.
        joints: readings of one posture [rad], or measured poses (2, 4, 4) of both eyes.
        cameras: names of a camera of the left eye and one of the right; None: the main ones.
        size: width and height [px] of the rectified images; None: those of the left camera, the one
            for the other where it stands on its side.
        focal_px: of the rectified cameras; None: FOCAL_SHARE of the real ones' mean.

    Raises:
        VergenceError: the head has no such pair, the joints are not known ones of one posture, size
            or focal length are not positive, or the two views do not overlap.
    """
    left, right = stereo_cameras(head, cameras)
    at = floats("joints", joints).copy()  # which the pair keeps
    if at.shape != (2, 4, 4):
        at = checked_readings(head.kinematics, at, one_posture=True)
    if not np.isfinite(at).all():
        raise VergenceError(f"A pair is rectified at known joints; found {at.ravel()}.")
    check_joints(head.kinematics, at)
    if focal_px is not None and not 0 < focal_px < np.inf:
        raise VergenceError(f"focal_px is above 0 pixels, found {focal_px:g}.")
    if size is not None and not is_image_size(size):
        raise VergenceError(
            "size is a width and a height in whole pixels, such as (640, 480), at most "
            f"{MAX_IMAGE_PX} each and {MAX_IMAGE_AREA_PX:,} together; found {size!r:.80}."
        )
    T_lbase_lcam, T_lbase_rcam = camera_poses(head, at, cameras=cameras)
    T_rcam_lcam = inverse(T_lbase_rcam) @ T_lbase_lcam
    R_lcam_rcam, baseline = T_rcam_lcam[:3, :3].T, inverse(T_rcam_lcam)[:3, 3]
    axes = np.array([[0, 0, 1], R_lcam_rcam[:, 2]])  # of both cameras, in the left one
    x = baseline / np.linalg.norm(baseline)
    y = np.cross(axes.mean(axis=0), x)
    y /= max(float(np.linalg.norm(y)), 1e-12)
    R_rect_lcam = np.stack([x, y, np.cross(x, y)])
    lenses = left.intrinsics, right.intrinsics
    own_px = FOCAL_SHARE * float(np.mean([lens.matrix[[0, 1], [0, 1]] for lens in lenses]))
    own_size = lenses[0].size
    if abs(R_rect_lcam[0, 1]) > abs(R_rect_lcam[0, 0]):  # its columns are along the baseline
        own_size = own_size[1], own_size[0]
    size = own_size if size is None else size
    looks = axes @ R_rect_lcam.T
    if (looks[:, 2] <= 0).any():
        raise _apart(cameras)
    # Both views look into the middle of their images.
    focal = focal_px or own_px
    cx, cy = (np.array(size) - 1) / 2 - focal * (looks[:, :2] / looks[:, 2:]).mean(axis=0)
    matrix = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    views = [
        RectifiedView(lens, R, *_map(lens, R, matrix, size))
        for lens, R in zip(lenses, (R_rect_lcam, R_rect_lcam @ R_lcam_rcam), strict=True)
    ]
    if _overlap(*views) < 0.05:
        raise _apart(cameras)
    return RectifiedPair(
        head=head,
        joints=at,
        cameras=pair_names(head, cameras),
        left=views[0],
        right=views[1],
        matrix=matrix,
        baseline_m=float(np.linalg.norm(baseline)),
        T_lbase_rect=T_lbase_lcam @ pose(R_rect_lcam.T),
    )


def _map(
    camera: Camera, R_rect_cam: Array, matrix: Array, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute column and row (H, W) float32 in the real image of each rectified pixel."""
    (width, height), R_cam_rays = size, R_rect_cam.T @ np.linalg.inv(matrix)
    maps = np.empty((2, height, width), np.float32)
    for top in range(0, height, _ROWS):
        rows = slice(top, top + _ROWS)
        u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)[rows])
        rays = times(R_cam_rays, vector(u, v, 1.0))
        good = in_valid_field(camera, *batch_last(rays))[..., None]
        pixels = np.where(good, project(camera, rays), _OUTSIDE)
        maps[:, rows] = batch_last(pixels.clip(_OUTSIDE, -_OUTSIDE))
    return maps[0], maps[1]


def _overlap(left: RectifiedView, right: RectifiedView) -> float:
    """Compute the share of the rows in which a point at some distance is seen by both."""
    columns = np.arange(left.map_x.shape[1])
    last = np.where(left.seen, columns, -1).max(axis=1)
    first = np.where(right.seen, columns, len(columns)).min(axis=1)
    return float((last > first).mean())


def _apart(cameras: tuple[str, str] | None) -> VergenceError:
    names = "the two cameras" if cameras is None else " and ".join(cameras)
    return VergenceError(
        f"The views of {names} do not overlap at this posture; rectify where both eyes look the "
        "same way, across the line between the cameras."
    )


def rectified_image(view: RectifiedView, image: np.ndarray) -> np.ndarray:
    """Rectify an image to (H, W, ...), of its type; 0: it shows nothing.

    VergenceError if the image is not (height, width) or (height, width, channels) of the view's
    camera.
    """
    image, size = np.asarray(image), (view.camera.height, view.camera.width)
    if image.ndim not in (2, 3) or image.shape[:2] != size:
        raise VergenceError(
            f"This view rectifies images of {size[1]} x {size[0]} px, whose arrays are {size} or "
            f"{(*size, 3)}; found an array of shape {image.shape}."
        )
    return cv2.remap(image, view.map_x, view.map_y, cv2.INTER_LINEAR)


def rectified_pixels(pair: RectifiedPair, view: RectifiedView, pixels: Array) -> Array:
    """Compute where pixels (..., 2) of a view's real image are in its rectified one; NaN: nowhere.

    The difference of a point's columns, left minus right, is its disparity; its rows are the same.
    """
    rays = unproject(view.camera, pixels) @ view.R_rect_cam.T
    z = np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan)
    return (rays / z @ pair.matrix.T)[..., :2]


def rectified_points(pair: RectifiedPair, pixels: Array, disparity: Array) -> Array:
    """Compute points (..., 3) [m] in the left rectified camera, by its pixels and disparities [px].

    NaN where a disparity is not positive.
    """
    depth = pair.matrix[0, 0] * pair.baseline_m / np.where(disparity > 0, disparity, np.nan)
    xy = (pixels - pair.matrix[:2, 2]) / pair.matrix[0, 0]
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1) * depth[..., None]
