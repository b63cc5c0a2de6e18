"""Where a board stands before a camera, by its corners in one image."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.estimation.least_squares import least_squares
from vergence.estimation.residual import Residual, Rows
from vergence.estimation.variables import Block, Latent, Variables
from vergence.geometry.camera import Camera, normalise, project, project_jacobians
from vergence.geometry.projection import by_pose_of_points
from vergence.geometry.se3 import boxplus, known_poses, pose, rotation

LEAST_CORNERS = 6
"""Fewest corners that determine a board's pose reliably."""


def seen_corners(corners: Array) -> np.ndarray:
    """Find which corners (..., K, 2) [px] were seen: (..., K) of bool."""
    return np.asarray(np.isfinite(corners).all(axis=-1))


def determines_pose(points: Array, seen: np.ndarray) -> np.ndarray:
    """Check whether corners determine the board's pose: enough are seen, not on one line.

    The board's corners are points (K, 3) in frame target, seen is (..., K) of bool.
    """
    count = seen.sum(axis=-1)
    weight = seen / np.maximum(count, 1)[..., None]
    mean = weight @ points
    second = np.einsum("...k,ki,kj->...ij", weight, points, points, optimize=True)
    spread = np.linalg.eigvalsh(second - mean[..., :, None] * mean[..., None, :])
    return (count >= LEAST_CORNERS) & (spread[..., 1] > 1e-3 * np.maximum(spread[..., 2], 1e-30))


@dataclass(frozen=True, eq=False, kw_only=True)
class BoardViews(Residual):
    """Corners of a board in V views of one camera; the board's poses T_cam_target are latent.

    The camera is given, or else it is the shared block "lens". With the shared block
    "T_cam_reference" the latent poses are those in another, rigidly connected camera.
    """

    corners: Array
    """(V, K, 2) pixels; NaN where not seen."""
    points: Array
    """(K, 3) the corners in frame target [m]."""
    camera: Camera | None = None
    relative: bool = False
    """Whether the camera is placed by the block "T_cam_reference"."""
    level: str = "corners"
    together: int = 2
    seen: np.ndarray = field(init=False)
    element: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        vars(self).update(seen=seen_corners(self.corners), element=np.arange(len(self.corners)))

    def in_camera(self, x: Variables) -> tuple[Array, Array, Array]:
        """Place corners (V, K, 3): turned and shifted in the reference, and in the camera."""
        T = x.latent.value
        turned = self.points @ np.swapaxes(T[:, :3, :3], 1, 2)
        placed = turned + T[:, None, :3, 3]
        if not self.relative:
            return turned, placed, placed
        T_cam_reference = x["T_cam_reference"]
        in_camera = placed @ T_cam_reference[:3, :3].T + T_cam_reference[:3, 3]
        return turned, placed, in_camera

    def lens(self, x: Variables) -> Camera:
        """Take the camera at the unknowns."""
        return x["lens"] if self.camera is None else self.camera

    def error(self, x: Variables) -> Array:
        """Compute projected minus seen pixels (V, 2 K); NaN for corners behind the camera."""
        with np.errstate(over="ignore", invalid="ignore"):
            off = project(self.lens(x), self.in_camera(x)[2]) - self.corners
        return np.where(self.seen[..., None], off, 0.0).reshape(len(off), -1)

    def rows(self, x: Variables) -> Rows:
        """Compute the derivatives by the lens or the camera's place, and by the boards' poses."""
        (turned, placed, in_camera), V = self.in_camera(x), len(self.corners)
        with np.errstate(over="ignore", invalid="ignore"):
            _, by_point, by_lens = project_jacobians(self.lens(x), in_camera)
        by_shared, columns = np.zeros((V, len(self.points), 2, 0)), np.zeros(0, dtype=np.intp)
        if self.camera is None:
            by_shared, columns = by_lens, x.columns("lens")
        if self.relative:
            R = x["T_cam_reference"][:3, :3]
            by_shared, columns = by_pose_of_points(by_point, placed @ R.T), x.columns(_RELATIVE)
            by_point = by_point @ R
        seen = self.seen[..., None, None]
        by_shared, by_pose = (
            np.where(seen, J, 0.0).reshape(V, 2 * len(self.points), J.shape[-1])
            for J in (by_shared, by_pose_of_points(by_point, turned))
        )
        return Rows(by_shared, np.tile(columns, (V, 1)), by_pose)


_RELATIVE = "T_cam_reference"


def board_poses(camera: Camera, corners: Array, points: Array) -> Array:
    """Fit T_cam_target (V, 4, 4) to each view; NaN where it is not determined.

    Corners are pixels (V, K, 2), NaN where not seen, of points (K, 3) in frame target [m]. The fit
    to undistorted corners is refined by pixels, all views at once.
    """
    xy = normalise(camera, corners)
    poses = np.full((len(corners), 4, 4), np.nan)
    seen = seen_corners(xy)
    for v in np.flatnonzero(determines_pose(points, seen)):
        view = points[seen[v]], xy[v, seen[v]], np.eye(3), np.zeros(4)
        found, rvec, tvec = cv2.solvePnP(*view, flags=cv2.SOLVEPNP_ITERATIVE)
        if found and (points[seen[v]] @ rotation(rvec.ravel())[2] + tvec[2] <= 0).any():
            # With few corners it may end behind the camera, from where this leads out again.
            rvec, tvec = cv2.solvePnPRefineLM(*view, rvec, tvec)
        if found:
            poses[v] = pose(rotation(rvec.ravel()), tvec.ravel())
    return refined_poses(camera, np.where(seen[..., None], corners, np.nan), points, poses)[0]


def board_latent(T_cam_target: Array) -> Latent:
    """Make latent unknowns of poses (V, 4, 4) of boards."""
    return Latent(T_cam_target, 6, boxplus)


def seen_from_the_other_side(T_cam_target: Array, points: Array) -> Array:
    """Find the poses (V, 4, 4), slanted the other way, with which small boards look the same."""
    middle = points.mean(axis=0)
    R, centre = T_cam_target[:, :3, :3], T_cam_target[:, :3, :3] @ middle + T_cam_target[:, :3, 3]
    sight = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
    half_turn = 2 * sight[:, :, None] * sight[:, None] - np.eye(3)
    R_other = half_turn @ R @ np.diag([-1.0, -1.0, 1.0])
    return pose(R_other, centre - R_other @ middle)


def board_errors(
    camera: Camera, T_cam_target: Array, corners: Array, points: Array
) -> tuple[Array, Array, Array]:
    """Compute projected minus seen pixels (V, 2 K) of boards at poses (V, 4, 4).

    Returns also their derivatives by increments of the poses (V, 2 K, 6) and by the n intrinsics
    (V, 2 K, n). Rows of corners that were not seen are zero.
    """
    views = BoardViews(corners=corners, points=points)
    n = len(camera.distortion) + 4
    x = Variables({"lens": Block(camera, np.ones(n))}, board_latent(T_cam_target))
    rows = views.rows(x)
    assert rows.by_latent is not None
    return views.error(x), rows.by_latent, rows.by_shared


def refined_poses(camera: Camera, corners: Array, points: Array, T: Array) -> tuple[Array, Array]:
    """Refine poses (V, 4, 4) of boards by least squares, all views at once.

    Each view has four corners or more. Also returns the sums of squares (V,) [px^2], infinite where
    a pose is NaN or has a corner behind the camera.
    """
    T, squares = T.copy(), np.full(len(T), np.inf)
    views = BoardViews(corners=corners, points=points, camera=camera)
    at = Variables({}, board_latent(np.where(known_poses(T)[:, None, None], T, np.eye(4))))
    known = known_poses(T) & np.isfinite(views.error(at)).all(axis=1)
    if known.any():
        views = BoardViews(corners=corners[known], points=points, camera=camera)
        start = Variables({}, board_latent(T[known]))
        # Far below any corner's noise [px], so that fits converge to 1e-9 rad.
        found = least_squares([views], start, levels={"corners": 1e-2})
        T[known], squares[known] = found.x.latent.value, (found.errors[0] ** 2).sum(axis=1)
    return T, squares
