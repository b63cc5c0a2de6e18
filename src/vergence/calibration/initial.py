"""The paper's calibration, step by step (Sec. II): corners and joint readings to a head.

Each step takes the one before as exact. Beyond the paper eyes may be given by poses, a head may
have one eye only, and without straight gaze T_rbase_lbase comes from boards at rest that both eyes
see, at once or one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.hand_eye import robust_park_martin
from vergence.calibration.intrinsics import Intrinsics, calibrate_intrinsics
from vergence.calibration.lenses import LensModel
from vergence.calibration.observations import (
    Observations,
    base_by_boards,
    camera_eyes,
    mean_placed,
    missing_reading,
    most_seen,
    readable,
)
from vergence.calibration.priors import POSE_SCALE
from vergence.errors import VergenceError
from vergence.estimation.least_squares import least_squares
from vergence.estimation.variables import Block, Variables
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera
from vergence.geometry.head import (
    R_EYE_CAM,
    HeadCalibration,
    MountedCamera,
    main_camera,
    main_pair,
)
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import (
    agreeing_poses,
    angle,
    boxplus,
    inverse,
    known_poses,
    mean_pose,
    pose,
)
from vergence.stereo.extrinsics import base_extrinsics
from vergence.vision.board_pose import (
    LEAST_CORNERS,
    BoardViews,
    board_latent,
    board_poses,
    seen_corners,
)

STRAIGHT_RAD = 0.05
"""Readings turned by less than this from zero count as straight gaze: noise and offsets stay below,
and the eyes' deliberate motions lie well above."""

ONE_POSTURE_RAD = 0.02
"""Turn of an eye from the mean of its straight gaze up to which views count as one pose of the
cameras to each other. In simulations none of 20 estimates failed where readings were within 0.03
rad, and two of 20 where they were within 0.05."""


@dataclass(frozen=True, eq=False)
class SequentialCalibration:
    """A head by the paper's method, and how well each step fitted its data."""

    head: HeadCalibration
    intrinsics: Mapping[str, Intrinsics]
    stereo_rms_px: float | None
    """None: no static stereo, for want of straight gaze or of another eye."""
    stereo_views: int
    eye_views: Mapping[str, int]

    @property
    def accuracy(self) -> Accuracy:
        """The head's accuracy."""
        assert self.head.accuracy is not None
        return self.head.accuracy


def calibrate_sequentially(
    observations: Observations,
    *,
    lenses: Mapping[str, LensModel] | None = None,
    neck: Neck | None = None,
    intrinsics: Mapping[str, Intrinsics] | None = None,
    T_cam_target: Mapping[str, Array] | None = None,
) -> SequentialCalibration:
    """Calibrate a head with a main camera, and perhaps others, in each eye.

    An eye's main camera is its wide one, or else its first.

    Args:
        observations: views in which the eyes stood still. Those with the gaze straight give the
            static stereo, those that share a placement while the eyes turn give T_eye_cam.
        lenses: lens models by camera; where none is stated, it is the paper's.
        neck: from the design.
        intrinsics: by camera, where calibrate_intrinsics was called before.
        T_cam_target: by camera (V, 4, 4) poses of the board, where they were solved for before with
            these intrinsics.

    Raises:
        VergenceError: a step has not the views it needs.
    """
    points = corner_points(observations.board)
    if intrinsics is None:
        intrinsics = calibrate_intrinsics(observations, lenses=lenses)
    cameras = {name: found.camera for name, found in intrinsics.items()}
    if T_cam_target is None:
        T_cam_target = {
            name: board_poses(camera, observations.corners[name], points)
            for name, camera in cameras.items()
        }
    eyes = camera_eyes(observations)
    mounted: dict[str, MountedCamera] = {}
    eye_views: dict[str, int] = {}
    for eye in EYES:
        own = {name: camera for name, camera in cameras.items() if eyes[name] == eye}
        if own:
            found, eye_views[eye] = _mounted(observations, eye, own, T_cam_target, points)
            mounted |= found
    head = HeadCalibration(
        cameras=mounted,
        T_rbase_lbase=np.eye(4),
        kinematics=observations.kinematics,
        neck=neck or Neck(),
        accuracy=Accuracy(
            method="paper", lenses={name: each.accuracy for name, each in intrinsics.items()}
        ),
    )
    T_rbase_lbase, rms, count = _between_the_eyes(observations, head, T_cam_target, points)
    head = replace(head, T_rbase_lbase=T_rbase_lbase)
    return SequentialCalibration(head, intrinsics, rms, count, eye_views)


def _mounted(
    observations: Observations,
    eye: Side,
    cameras: Mapping[str, Camera],
    T_cam_target: Mapping[str, Array],
    points: Array,
) -> tuple[dict[str, MountedCamera], int]:
    """Place an eye's cameras in it; also return in how many views the main one was placed.

    The main camera is placed by hand-eye calibration, the others relative to it. Where eyes stand
    still, it looks straight ahead from the eye's origin, by definition.
    """
    main = main_camera(cameras)
    rows = most_seen(observations.placement, known_poses(T_cam_target[main]))
    if not len(rows):
        raise VergenceError(f"The board was never found in the images of {main}.")
    lost = rows[~readable(observations, eye)[rows]]
    if len(lost):
        raise missing_reading(eye, observations.name_of_view(lost[0]))
    if observations.eye_motion == "fixed":
        T_eye_main = pose(R_EYE_CAM)
    else:
        T_base_eye = observations.eye_poses()[rows, EYES.index(eye)]
        T_eye_main = robust_park_martin(T_base_eye, T_cam_target[main][rows])
    T_eye_cam = {main: T_eye_main}
    for name in cameras:
        if name != main:
            both = observations.corners[main], observations.corners[name]
            T_name_main, _ = calibrate_pair(
                *both, points, cameras[main], cameras[name], names=(main, name)
            )
            T_eye_cam[name] = T_eye_main @ inverse(T_name_main)
    mounted = {
        name: MountedCamera(eye=eye, intrinsics=cameras[name], T_eye_cam=T)
        for name, T in T_eye_cam.items()
    }
    return mounted, len(rows)


def _between_the_eyes(
    observations: Observations,
    head: HeadCalibration,
    T_cam_target: Mapping[str, Array],
    points: Array,
) -> tuple[Array, float | None, int]:
    """Compute T_rbase_lbase, static stereo's RMS [px] and view count.

    T_rbase_lbase of the given head does not matter; it stays for one eye.
    """
    pair, mounted = main_pair(head), head.cameras
    if pair is None:
        return head.T_rbase_lbase, None, 0
    left, right = pair
    corners_l, corners_r = observations.corners[left], observations.corners[right]
    both = (seen_corners(corners_l) & seen_corners(corners_r)).sum(axis=1) >= LEAST_CORNERS
    T_l, T_r = np.moveaxis(observations.eye_poses(), 1, 0)
    straight = both & known_poses(T_l) & known_poses(T_r)
    straight &= observations.T_base_eye is None  # measured eyes may shift as well
    for T in (T_l, T_r):
        straight[straight] &= angle(T[straight, :3, :3]) < STRAIGHT_RAD
    if straight.any():
        at_one = straight.copy()
        for T in (T_l[straight], T_r[straight]):
            at_one[straight] &= angle((inverse(mean_pose(T)) @ T)[:, :3, :3]) < ONE_POSTURE_RAD
        # Where most of them are not, each view's own readings tell more.
        straight = at_one & (2 * at_one.sum() > straight.sum())
    if straight.any():
        T_rcam_lcam, rms = calibrate_pair(
            corners_l[straight],
            corners_r[straight],
            points,
            mounted[left].intrinsics,
            mounted[right].intrinsics,
            names=pair,
        )
        T = base_extrinsics(
            # The eyes stand still at straight gaze: the mean of what was read is the better one.
            T_rbase_reye=mean_pose(T_r[straight]),
            T_reye_rcam=mounted[right].T_eye_cam,
            T_rcam_lcam=T_rcam_lcam,
            T_leye_lcam=mounted[left].T_eye_cam,
            T_lbase_leye=mean_pose(T_l[straight]),
        )
        return T, rms, int(straight.sum())
    T_lbase_target, T_rbase_target = (
        mean_placed(T_read @ mounted[name].T_eye_cam @ T_cam_target[name], observations.placement)
        for T_read, name in ((T_l, left), (T_r, right))
    )
    between = base_by_boards(T_lbase_target, T_rbase_target)
    if between is None:
        raise VergenceError(
            "T_rbase_lbase is not observable: no placement of the board is seen by both "
            f"{left} and {right}, in one view or in several, with {LEAST_CORNERS} corners that are "
            "not all on one line; hold it where both eyes see it."
        )
    return between, None, 0


def calibrate_pair(
    corners_a: Array,
    corners_b: Array,
    points: Array,
    a: Camera,
    b: Camera,
    *,
    names: tuple[str, str] = ("camera a", "camera b"),
) -> tuple[Array, float]:
    """Find T_b_a (4, 4) of two rigidly connected cameras with known intrinsics.

    Also returns the root mean square distance [px] of corners (V, K, 2), NaN where not seen, from
    their reprojections. VergenceError if no view shows six common corners that are not on one line.
    """
    both = seen_corners(corners_a) & seen_corners(corners_b)
    corners_a, corners_b = (
        np.where(both[..., None], each, np.nan) for each in (corners_a, corners_b)
    )
    T_a, T_b = (
        board_poses(camera, corners, points) for camera, corners in ((a, corners_a), (b, corners_b))
    )
    between = T_b @ inverse(T_a)
    known = np.flatnonzero(known_poses(between))
    if not len(known):
        raise VergenceError(
            f"The pose between {' and '.join(names)} needs views in which both see "
            f"{LEAST_CORNERS} corners of the board, not all on one line and not far from the "
            "images' middles; found none."
        )
    # A few corners in one part of the image may put a board where it is not, and images may be of
    # different moments.
    known = known[agreeing_poses(between[known])]
    start = Block(mean_pose(between[known]), np.array(POSE_SCALE), boxplus)
    views = (
        BoardViews(corners=corners_a[known], points=points, camera=a),
        BoardViews(corners=corners_b[known], points=points, camera=b, relative=True),
    )
    x = Variables({"T_cam_reference": start}, board_latent(T_a[known]))
    found = least_squares(views, x)
    squares = sum(float((errors**2).sum()) for errors in found.errors)
    return found.x["T_cam_reference"], float(np.sqrt(squares / (2 * both[known].sum())))
