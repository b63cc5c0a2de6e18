"""Accuracy of located points by the design of a head: baseline, lens, encoders, delay, calibration.

The head is symmetric. Its eyes pan about z, then tilt about y; pinhole cameras sit on the optical
axes a little ahead of the rotation centres. The mean square distance of a located point from the
true one is a sum over sources,

    E|dP|^2 = s^2 S_pixel + j^2 S_joint + (w t)^2 (S_joint + rho S_common) + S_calibration / V   (a)

for pixel noise s [px], joint noise j [rad], eyes that turn with rms speed w [rad/s] in each joint
and readings a time t late. rho is the correlation of the two eyes' speeds: 1 if they turn together,
-1 if one does the opposite of the other. V is the number of views that the head is calibrated with.

S_calibration is the covariance by bundle adjustment of a `standard_recording`: boards at eight
places at straight gaze, and one board at rest from 16 directions of gaze. Distortion is taken as
known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vergence.accuracy.plan_information import (
    point_by_parameters,
    total_information,
    view_information,
)
from vergence.accuracy.plan_views import MARGIN_PX, Views
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import fixed_by_default
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import pinhole
from vergence.geometry.head import R_EYE_CAM, HeadCalibration, MountedCamera, parameter_names
from vergence.geometry.kinematics import EYES, looking_along, pan_tilt_along
from vergence.geometry.parameters import named_columns
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import pose, rotation
from vergence.stereo.linearised import linearised
from vergence.stereo.triangulation import sightings

CAMERAS = "left_main", "right_main"
"""Names of the cameras of a designed head."""
STRAIGHT, GAZES = 8, 16
"""Views of the standard recording: boards at straight gaze, and gazes to a board at rest."""
VIEWS = STRAIGHT + GAZES
FILLS = (0.5, 0.75)
"""Shares of an image's height that the circle about a board fills, at any slant."""
LEAN_RAD = (0.6, 0.6, 0.4)
"""Maximum slants of a board about its axes, and turn in its plane [rad]."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Mean square error of N points per unit variance of each source; see Eq. a."""

    pixel: Array
    """(N,) [m^2 / px^2]."""
    joint: Array
    """(N,) [m^2 / rad^2] by independent errors of all four readings."""
    common: Array
    """(N,) [m^2 / rad^2] twice the covariance by errors of the same joint of both eyes."""
    calibration: Array
    """(J, N) [m^2] by one view of the standard recording, for each level of joint noise; infinite
    if the recording does not determine the head."""
    offset_px: Array
    """(N, 2) largest distance of the point from the middle of an image, sideways and upwards."""


def reading_std(counts_per_turn: ArrayLike, noise_deg: ArrayLike) -> Array:
    """Compute the standard deviation [rad] of readings with steps and noise; 0 counts: no steps."""
    counts = np.asarray(counts_per_turn, float)
    step = np.where(counts > 0, 2 * np.pi / np.maximum(counts, 1), 0.0)
    return np.hypot(step / np.sqrt(12), np.radians(noise_deg))  # errors of rounding are uniform


def designed_head(
    baseline_m: float, focal_px: float, camera_ahead_m: float, image_px: tuple[int, int]
) -> HeadCalibration:
    """Build the symmetric head: two pinhole cameras ahead of the rotation centres."""
    mounted = pose(R_EYE_CAM, [camera_ahead_m, 0.0, 0.0])
    return HeadCalibration(
        cameras={
            name: MountedCamera(eye, pinhole(*image_px, focal_px), mounted)
            for eye, name in zip(EYES, CAMERAS, strict=True)
        },
        T_rbase_lbase=pose(t=[0.0, baseline_m, 0.0]),
    )


def fixating_joints(baseline_m: float, points: Array) -> Array:
    """Compute the readings (..., 4) [rad] that fixate points (..., 3) from the left eye."""
    x, y, z = np.moveaxis(points, -1, 0)
    angles = [pan_tilt_along(x, y + shift, z) for shift in (0.0, baseline_m)]
    return np.stack([angle for pan_tilt in angles for angle in pan_tilt], axis=-1)


def standard_recording(head: HeadCalibration, board: Chessboard) -> Views:
    """Make the VIEWS views of a board by a designed head, the same for all heads to their scale."""
    rng = np.random.default_rng(0)
    draw, around = rng.uniform(-1, 1, (STRAIGHT + 1, 6)), rng.uniform(-1, 1, (GAZES, 2))
    draw[-1, 1:3] = 0  # the board at rest stands ahead
    lens, baseline = head.cameras[CAMERAS[0]].intrinsics, head.T_rbase_lbase[1, 3]
    size_px, f = np.array(lens.size), lens.matrix[0, 0]
    corners = corner_points(board)
    radius = np.linalg.norm(np.ptp(corners, axis=0)) / 2
    radius_px = (np.mean(FILLS) + draw[:, 0] * np.ptp(FILLS) / 2) * lens.height / 2
    distance = radius * (f / radius_px + np.sin(np.linalg.norm(LEAN_RAD[:2])))
    # The board stands wherever both images hold it whole; angles add up.
    edge = np.arctan((size_px / 2 - MARGIN_PX) / f)
    room = 0.85 * np.maximum(edge - np.arctan(radius_px / f)[:, None], 0.0)
    apart = np.arctan(baseline / 2 / distance)
    pan = draw[:, 1] * np.maximum(room[:, 0] - apart, 0.0)
    tilt = draw[:, 2] * room[:, 1]
    centre = distance[:, None] * looking_along(pan, tilt) - [0.0, baseline / 2, 0.0]
    R = R_EYE_CAM @ rotation(draw[:, 3:] * LEAN_RAD)
    T = pose(R, centre - R @ corners.mean(axis=0))
    moving = fixating_joints(baseline, centre[-1]) + np.tile(around * room[-1], 2)
    place = np.append(np.arange(STRAIGHT), np.full(GAZES, STRAIGHT))
    return Views(T[place], np.concatenate([np.zeros((STRAIGHT, 4)), moving]), place)


def sensitivity(
    head: HeadCalibration,
    board: Chessboard,
    *,
    points: Array,
    joints: Array,
    corner_std_px: float,
    reading_std: Array,
) -> Sensitivity:
    """Compute what each source adds to the errors of points that a designed head locates.

    Points (N, 3) [m] are in the left eye's base frame, and are located at joints (N, 4) [rad].
    `reading_std` (J,) are levels of the noise of readings in the calibration.
    """
    left, right = (project_point(head, name, joints, points) for name in CAMERAS)
    seen = linearised(
        sightings(head, left=left, right=right, joints=joints, cameras=CAMERAS, pixel_std_px=1.0)
    )
    by_readings = seen.by_readings
    fixed = fixed_by_default(head, timed=False)
    names = tuple(name for name in parameter_names(head) if name not in fixed)
    by_names = point_by_parameters(head, CAMERAS, points, joints)[..., named_columns(head, names)]
    views = standard_recording(head, board)
    information = view_information(
        head,
        board,
        views,
        names,
        scale=np.ones(len(names)),
        pixel_std_px=corner_std_px,
        joint_stds=np.repeat(reading_std[:, None], 4, axis=1),
    )
    calibration = []
    for of_views in information:
        try:
            total = total_information(of_views, views.placement)
            scale = 1 / np.sqrt(np.maximum(np.diag(total), np.finfo(float).tiny))
            L = np.linalg.cholesky(np.linalg.inv(total * np.outer(scale, scale)))
        except np.linalg.LinAlgError:  # the views show too little of the board
            calibration.append(np.full(len(points), np.inf))
            continue
        calibration.append(VIEWS * ((by_names @ (scale[:, None] * L)) ** 2).sum(axis=(1, 2)))
    middle = head.cameras[CAMERAS[0]].intrinsics.matrix[:2, 2]
    return Sensitivity(
        pixel=(seen.by_pixels**2).sum(axis=(1, 2)),
        joint=(by_readings**2).sum(axis=(1, 2)),
        common=2 * (by_readings[..., :2] * by_readings[..., 2:]).sum(axis=(1, 2)),
        calibration=np.array(calibration),
        offset_px=np.maximum(np.abs(left - middle), np.abs(right - middle)),
    )


def noise_mean_square(
    seen: Sensitivity,
    *,
    pixel_std_px: ArrayLike,
    reading_std: ArrayLike,
    late_rad: ArrayLike = 0.0,
    correlation: float = 0.0,
) -> Array:
    """Compute Eq. a [m^2] without the calibration; all arguments broadcast.

    late_rad is the rms turn of a joint while its reading is late.
    """
    late = np.asarray(late_rad, float) ** 2
    joint = np.asarray(reading_std, float) ** 2 + late
    by_pixels = np.asarray(pixel_std_px, float) ** 2 * seen.pixel
    return by_pixels + joint * seen.joint + correlation * late * seen.common
