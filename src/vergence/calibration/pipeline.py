"""The paper's calibration, step by step (Sec. II): corners and joint readings to a head.

Cameras (Zhang), static stereo at straight gaze, T_eye_cam of each wide camera (Eqs. 5-9), the
pose between wide and narrow camera, T_rbase_lbase (Eq. 10). Each step takes the one before as
exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vergence.active_stereo import fixed_transform
from vergence.arrays import Array
from vergence.calibration.eye_camera import park_martin
from vergence.calibration.intrinsics import (
    Intrinsics,
    LensModel,
    calibrate_intrinsics,
    seen_corners,
    target_poses,
)
from vergence.calibration.static_stereo import calibrate_pair
from vergence.calibration.target import Board, corner_points
from vergence.camera import Camera
from vergence.errors import VergenceError
from vergence.geometry import inverse
from vergence.head import HeadCalibration, MountedCamera
from vergence.kinematics import EYES, Neck, T_base_eye

STRAIGHT_RAD = 0.05
"""Readings within this of zero count as straight gaze: noise and offsets stay below, and the
eyes' deliberate motions lie well above."""


@dataclass(frozen=True, eq=False)
class Views:
    """What the cameras saw of the board: V moments, K corners."""

    board: Board
    placement: np.ndarray
    """(V,) of int: views with the same number show the board at the same place."""
    eye_angles: Array
    """(V, 4) joint readings [rad] in the order of kinematics.EYE_JOINTS."""
    corners: Mapping[str, Array]
    """By camera: (V, K, 2) pixels, NaN where the board was not looked for or not found."""
    sizes: Mapping[str, tuple[int, int]]
    """By camera: width and height [px]."""


@dataclass(frozen=True, eq=False)
class PaperCalibration:
    """A head by the paper's method, and how well each step fitted its data."""

    head: HeadCalibration
    intrinsics: Mapping[str, Intrinsics]
    stereo_rms_px: float
    stereo_views: int
    eye_views: Mapping[str, int]


def lenses(views: Views, *, wide_lens: LensModel = "radial-tangential") -> dict[str, Intrinsics]:
    """Return the intrinsics of every camera by Zhang's method: the first step.

    Args:
        views: all views of the board; from which end a view is numbered is no matter here.
        wide_lens: distortion fitted to the wide cameras; the narrow ones have none (Sec. II-A).

    Raises:
        VergenceError: a camera has fewer than three views, or they do not tell its focal length.
    """
    points = corner_points(views.board)
    found = {}
    for name, corners in views.corners.items():
        model = wide_lens if name.endswith("wide") else "none"
        try:
            found[name] = calibrate_intrinsics(
                corners, points, size=views.sizes[name], lens_model=model
            )
        except VergenceError as error:
            raise VergenceError(f"{name}: {error}") from None
    return found


def calibrate(
    views: Views,
    *,
    wide_lens: LensModel = "radial-tangential",
    neck: Neck | None = None,
    intrinsics: Mapping[str, Intrinsics] | None = None,
) -> PaperCalibration:
    """Calibrate a head with a wide camera, and perhaps a narrow one, in each eye.

    Args:
        views: all views of the board. Those with the gaze straight give the static stereo, those
            that share a placement while the eyes move give T_eye_cam.
        wide_lens: distortion fitted to the wide cameras; the narrow ones have none (Sec. II-A).
        neck: the neck's chain, from the design.
        intrinsics: what `lenses` gave, where it was called before.

    Raises:
        VergenceError: a step has not the views it needs.
    """
    points = corner_points(views.board)
    intrinsics = lenses(views, wide_lens=wide_lens) if intrinsics is None else intrinsics
    straight = (np.abs(views.eye_angles) < STRAIGHT_RAD).all(axis=1)
    if not straight.any():
        raise VergenceError(
            f"Static stereo needs views with all eye angles within {STRAIGHT_RAD} rad of zero, "
            "found none."
        )
    cameras = {name: found.camera for name, found in intrinsics.items()}
    T_rcam_lcam, stereo_rms = calibrate_pair(
        views.corners["left_wide"][straight],
        views.corners["right_wide"][straight],
        points,
        cameras["left_wide"],
        cameras["right_wide"],
    )
    both = seen_corners(views.corners["left_wide"]).all(axis=1)
    both &= seen_corners(views.corners["right_wide"]).all(axis=1)
    mounted: dict[str, MountedCamera] = {}
    eye_views = {}
    for k, eye in enumerate(EYES):
        angles = views.eye_angles[:, 2 * k : 2 * k + 2]
        wide = f"{eye}_wide"
        T_eye_wide, eye_views[eye] = _eye_camera(views, wide, cameras[wide], angles, points)
        mounted[wide] = MountedCamera(eye=eye, intrinsics=cameras[wide], T_eye_cam=T_eye_wide)
        narrow = f"{eye}_narrow"
        if narrow in cameras:
            T_narrow_wide, _ = calibrate_pair(
                views.corners[wide],
                views.corners[narrow],
                points,
                cameras[wide],
                cameras[narrow],
            )
            mounted[narrow] = MountedCamera(
                eye=eye,
                intrinsics=cameras[narrow],
                T_eye_cam=T_eye_wide @ inverse(T_narrow_wide),
            )
    # The eyes stand still at straight gaze: the mean of its readings is the better one.
    theta_0 = views.eye_angles[straight & both].mean(axis=0)
    T_rbase_lbase = fixed_transform(
        T_base_eye(theta_0[2:]),
        mounted["right_wide"].T_eye_cam,
        T_rcam_lcam,
        mounted["left_wide"].T_eye_cam,
        T_base_eye(theta_0[:2]),
    )
    head = HeadCalibration(
        cameras=mounted, T_rbase_lbase=T_rbase_lbase, neck=Neck() if neck is None else neck
    )
    return PaperCalibration(head, intrinsics, stereo_rms, int((straight & both).sum()), eye_views)


def _eye_camera(
    views: Views, name: str, camera: Camera, angles: Array, points: Array
) -> tuple[Array, int]:
    """Return T_eye_cam (4, 4) from the placement seen at the most eye orientations."""
    seen = seen_corners(views.corners[name]).sum(axis=1) >= 6
    if not seen.any():
        raise VergenceError(f"The board was never found in the images of {name}.")
    numbers, counts = np.unique(views.placement[seen], return_counts=True)
    chosen = seen & (views.placement == numbers[counts.argmax()])
    poses = target_poses(camera, views.corners[name][chosen], points)
    return park_martin(T_base_eye(angles[chosen]), poses), int(chosen.sum())
