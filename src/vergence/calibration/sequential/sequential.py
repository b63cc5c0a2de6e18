"""The paper's calibration, step by step (Sec. II): corners and joint readings to a head.

Cameras (Zhang), static stereo at straight gaze, T_eye_cam of each wide camera (Eqs. 5-9), the
pose between wide and narrow camera, T_rbase_lbase (Eq. 10). Each step takes the one before as
exact.

Beyond the paper: eyes may be given by poses instead of angles; without straight gaze T_rbase_lbase
comes from the cameras of both eyes before the same board; a head may have one eye only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.hand_eye import park_martin
from vergence.calibration.sequential.intrinsics import (
    Intrinsics,
    LensModel,
    calibrate_intrinsics,
    seen_corners,
    target_poses,
)
from vergence.calibration.sequential.static_stereo import calibrate_pair
from vergence.errors import VergenceError
from vergence.geometry.board import Board, corner_points
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera, main_camera
from vergence.geometry.kinematics import EYES, Neck, Side, T_base_eye
from vergence.geometry.se3 import angle, inverse, pose
from vergence.stereo.triangulation import fixed_transform

STRAIGHT_RAD = 0.05
"""Readings within this of zero count as straight gaze: noise and offsets stay below, and the
eyes' deliberate motions lie well above."""
LEAST_COMMON = 6
"""Corners that both eyes see of a board, to place one against the other."""


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
    eyes: Mapping[str, Side] = field(default_factory=dict)
    """By camera, which eye it sits in; left out: as its name begins."""
    shared_px: float = 0.0
    """Smooth errors over the image [px] that the corners of all images of a camera are taken to
    share at least: what is known of how they were found."""


def eyes_of(views: Views) -> dict[str, Side]:
    """Return by camera which eye it sits in.

    Raises:
        VergenceError: neither `eyes` nor a camera's name says it.
    """
    found: dict[str, Side] = {}
    for name in views.corners:
        stated = views.eyes.get(name)
        begins: list[Side] = [eye for eye in EYES if name.startswith(eye)]
        if stated is None and not begins:
            raise VergenceError(
                f"Which eye does {name} sit in? Views.eyes says it, or a name that begins with "
                "left or right."
            )
        found[name] = begins[0] if stated is None else stated
    return found


@dataclass(frozen=True, eq=False)
class PaperCalibration:
    """A head by the paper's method, and how well each step fitted its data."""

    head: HeadCalibration
    intrinsics: Mapping[str, Intrinsics]
    stereo_rms_px: float | None
    """None: no static stereo, for want of straight gaze or of another eye."""
    stereo_views: int
    eye_views: Mapping[str, int]


def lenses(views: Views, *, wide_lens: LensModel = "radial-tangential") -> dict[str, Intrinsics]:
    """Return the intrinsics of every camera by Zhang's method: the first step.

    Args:
        views: all views of the board; from which end a view is numbered is no matter here.
        wide_lens: distortion fitted to all cameras but the narrow ones, which have none
            (Sec. II-A) and names that end in "narrow".

    Raises:
        VergenceError: a camera has fewer than three views, or they do not tell its focal length.
    """
    points = corner_points(views.board)
    found = {}
    for name, corners in views.corners.items():
        model = "none" if name.endswith("narrow") else wide_lens
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
    eye_poses_read: Array | None = None,
) -> PaperCalibration:
    """Calibrate a head with a main camera, and perhaps others, in each eye.

    An eye's main camera is its wide one, or else its first.

    Args:
        views: all views of the board. Those with the gaze straight give the static stereo, those
            that share a placement while the eyes move give T_eye_cam.
        wide_lens: see lenses.
        neck: the neck's chain, from the design.
        intrinsics: what `lenses` gave, where it was called before.
        eye_poses_read: (V, 2, 4, 4) poses of the left and the right eye in their bases, for eyes
            that do not pan and tilt; they take the place of the readings.

    Raises:
        VergenceError: a step has not the views it needs.
    """
    points = corner_points(views.board)
    intrinsics = lenses(views, wide_lens=wide_lens) if intrinsics is None else intrinsics
    cameras = {name: found.camera for name, found in intrinsics.items()}
    eyes = eyes_of(views)
    mounted: dict[str, MountedCamera] = {}
    eye_views: dict[str, int] = {}
    for k, eye in enumerate(EYES):
        own = [name for name in cameras if eyes[name] == eye]
        if not own:
            continue
        T_read = _eye_poses(views, eye_poses_read, k)
        main = main_camera(own, eye)
        T_eye_main, eye_views[eye] = _eye_camera(views, main, cameras[main], T_read, points)
        mounted[main] = MountedCamera(eye=eye, intrinsics=cameras[main], T_eye_cam=T_eye_main)
        for name in own:
            if name != main:
                both = views.corners[main], views.corners[name]
                T_name_main, _ = calibrate_pair(*both, points, cameras[main], cameras[name])
                mounted[name] = MountedCamera(
                    eye=eye,
                    intrinsics=cameras[name],
                    T_eye_cam=T_eye_main @ inverse(T_name_main),
                )
    T_rbase_lbase, rms, count = _between_the_eyes(views, eye_poses_read, mounted, points)
    head = HeadCalibration(
        cameras=mounted, T_rbase_lbase=T_rbase_lbase, neck=Neck() if neck is None else neck
    )
    return PaperCalibration(head, intrinsics, rms, count, eye_views)


def _eye_poses(views: Views, given: Array | None, k: int) -> Array:
    """Return the poses (V, 4, 4) of the left (0) or the right eye (1) as read."""
    return T_base_eye(views.eye_angles[:, 2 * k : 2 * k + 2]) if given is None else given[:, k]


def _between_the_eyes(
    views: Views, given: Array | None, mounted: Mapping[str, MountedCamera], points: Array
) -> tuple[Array, float | None, int]:
    """Return T_rbase_lbase (4, 4), the RMS of the static stereo [px], and its number of views.

    The identity for a head with one eye.
    """
    own = [[name for name in mounted if mounted[name].eye == eye] for eye in EYES]
    if not all(own):
        return np.eye(4), None, 0
    left, right = (main_camera(names, eye) for names, eye in zip(own, EYES, strict=True))
    lens_l, lens_r = mounted[left].intrinsics, mounted[right].intrinsics
    corners_l, corners_r = views.corners[left], views.corners[right]
    both = (seen_corners(corners_l) & seen_corners(corners_r)).sum(axis=1) >= LEAST_COMMON
    if not both.any():
        raise VergenceError(
            f"T_rbase_lbase is not observable: no view shows the board to both {left} and {right}; "
            "hold it where both eyes see it."
        )
    T_l, T_r = (_eye_poses(views, given, k) for k in (0, 1))
    if given is None:
        straight = both & (np.abs(views.eye_angles) < STRAIGHT_RAD).all(axis=1)
    else:
        straight = both & (_turn(T_l) < STRAIGHT_RAD) & (_turn(T_r) < STRAIGHT_RAD)
    if straight.any():
        T_rcam_lcam, rms = calibrate_pair(
            corners_l[straight], corners_r[straight], points, lens_l, lens_r
        )
        # The eyes stand still at straight gaze: the mean of its readings is the better one.
        if given is None:
            theta_0 = views.eye_angles[straight].mean(axis=0)
            T_l0, T_r0 = T_base_eye(theta_0[:2]), T_base_eye(theta_0[2:])
        else:
            T_l0, T_r0 = _mean(T_l[straight]), _mean(T_r[straight])
        T = fixed_transform(
            T_r0, mounted[right].T_eye_cam, T_rcam_lcam, mounted[left].T_eye_cam, T_l0
        )
        return T, rms, int(straight.sum())
    T_lbase_target, T_rbase_target = (
        T_read[both] @ mounted[name].T_eye_cam @ target_poses(lens, corners[both], points)
        for T_read, name, lens, corners in (
            (T_l, left, lens_l, corners_l),
            (T_r, right, lens_r, corners_r),
        )
    )
    between = T_rbase_target @ inverse(T_lbase_target)
    known = np.isfinite(between).all(axis=(1, 2))
    return _mean(between[known]), None, 0


def _turn(T: Array) -> Array:
    """Return how far poses (N, 4, 4) are turned (N,) [rad]; infinite where they are not known."""
    known = np.isfinite(T).all(axis=(1, 2))
    turns = np.full(len(T), np.inf)
    turns[known] = angle(T[known, :3, :3])
    return turns


def _mean(T: Array) -> Array:
    """Return the mean (4, 4) of poses (N, 4, 4) that differ little."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3].sum(axis=0))
    return pose(U @ Vt, np.median(T[:, :3, 3], axis=0))


def _eye_camera(
    views: Views, name: str, camera: Camera, T_read: Array, points: Array
) -> tuple[Array, int]:
    """Return T_eye_cam (4, 4) from the placement seen at the most eye orientations."""
    seen = seen_corners(views.corners[name]).sum(axis=1) >= 6
    if not seen.any():
        raise VergenceError(f"The board was never found in the images of {name}.")
    numbers, counts = np.unique(views.placement[seen], return_counts=True)
    chosen = seen & (views.placement == numbers[counts.argmax()])
    poses = target_poses(camera, views.corners[name][chosen], points)
    known = np.isfinite(poses).all(axis=(1, 2))
    return park_martin(T_read[chosen][known], poses[known]), int(known.sum())
