"""The eye-camera transform alone, of one camera of known intrinsics: with latent joint angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import bundle_adjust, covariance_of
from vergence.calibration.bundle.solver import OUTLIER
from vergence.calibration.observations import Observations
from vergence.calibration.sequential.hand_eye import robust_park_martin
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EyeAxes, T_base_eye
from vergence.geometry.parameters import parameter_names
from vergence.vision.board_pose import board_poses

_NAME = "camera"


@dataclass(frozen=True, eq=False)
class EyeCamera:
    """The result of refine_eye_camera."""

    T_eye_cam: Array
    """(4, 4)."""
    covariance: Array
    """(6, 6) of T_eye_cam in the increment of `se3.boxplus`: rotation [rad], then translation [m],
    along the axes of the eye."""
    T_base_target: Array
    """(4, 4) where the board stands."""
    T_base_eye: Array
    """(N, 4, 4) the true eye poses, as estimated."""
    residuals_px: Array
    """(N, K, 2) projected minus seen; NaN where not seen."""
    pixel_std_px: float
    """Of one coordinate of a corner."""
    joint_std: tuple[float, ...]
    """Of the readings: (angles [rad],), or (rotation [rad], translation [m]) for eye poses."""
    warnings: tuple[str, ...]
    """What the data cannot determine, and why."""


def refine_eye_camera(
    eye: Array,
    pixels: Array,
    points: Array,
    camera: Camera,
    *,
    start: Array | None = None,
    axes: EyeAxes | None = None,
    pixel_std_px: float | None = None,
    joint_std: float | tuple[float, float] | None = None,
    outlier: float = OUTLIER,
) -> EyeCamera:
    """Find where a camera of known intrinsics sits in its eye, from N views of a board at rest.

    Args:
        eye: (N, 2) readings of pan and tilt [rad], or (N, 4, 4) eye poses T_base_eye. Poses that
            are exactly those of a pan and a tilt are taken as such.
        pixels: (N, K, 2) corners; NaN where one was not seen.
        points: (K, 3) corners in frame target [m].
        camera: intrinsics.
        start: (4, 4) T_eye_cam to start from; None: Park and Martin's.
        axes: how readings become angles; None: perfectly. Of no use with poses.
        pixel_std_px: noise; as joint_std and outlier, see `bundle_adjust`.

    Raises:
        VergenceError: shapes do not fit, or Park and Martin's method has no answer.
    """
    axes = EyeAxes() if axes is None else axes
    _check(eye, pixels, points)
    N, K = pixels.shape[:2]
    angles = eye if eye.ndim == 2 else _pan_and_tilt(eye)
    T_read = eye if angles is None else T_base_eye(angles, axes)
    T_cam_target = board_poses(camera, pixels, points)
    if start is None:
        known = np.isfinite(T_cam_target).all(axis=(1, 2))
        start = robust_park_martin(T_read[known], T_cam_target[known])
    # The left eye of a head that has no other.
    observations = Observations(
        board=Chessboard(columns=K, rows=1, square_m=1.0),  # counts corners; `points` places them
        placement=np.zeros(N, dtype=int),
        eye_angles=np.full((N, 4), np.nan) if angles is None else np.tile(angles, (1, 2)),
        corners={_NAME: pixels},
        sizes={_NAME: (camera.width, camera.height)},
        T_base_eye=np.stack([eye, eye], axis=1) if angles is None else None,
    )
    head = HeadCalibration(
        cameras={_NAME: MountedCamera(eye="left", intrinsics=camera, T_eye_cam=start)},
        T_rbase_lbase=np.eye(4),
        axes={"left": axes, "right": axes},
    )
    found = bundle_adjust(
        head,
        observations,
        T_cam_target={_NAME: T_cam_target},
        points=points,
        fixed=[name for name in parameter_names(head) if ".T_eye_cam." not in name],
        pixel_std_px=pixel_std_px,
        joint_std=joint_std,
        own_levels_from=np.inf,
        outlier=outlier,
    )
    T_found = found.T_base_eye[:, 0]
    return EyeCamera(
        T_eye_cam=found.head.cameras[_NAME].T_eye_cam,
        covariance=covariance_of(found, f"{_NAME}.T_eye_cam"),
        T_base_target=found.T_lbase_target[0],
        T_base_eye=np.where(np.isnan(T_found), T_read, T_found),
        residuals_px=found.residuals_px[_NAME],
        pixel_std_px=found.pixel_std_px,
        joint_std=found.joint_std,
        warnings=found.warnings,
    )


def _pan_and_tilt(T: Array) -> Array | None:
    """Return the angles (N, 2) of eye poses (N, 4, 4), or None where these are more than that."""
    pan = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    tilt = np.arctan2(-T[:, 2, 0], T[:, 2, 2])
    angles = np.stack([pan, tilt], axis=-1)
    return angles if np.abs(T_base_eye(angles) - T).max() < 1e-9 else None


def _check(eye: Array, pixels: Array, points: Array) -> None:
    N, K = len(eye), len(points)
    if eye.shape not in ((N, 2), (N, 4, 4)) or not np.isfinite(eye).all():
        raise VergenceError(
            "refine_eye_camera needs finite readings of shape (N, 2) or poses of shape (N, 4, 4), "
            f"found {eye.shape}."
        )
    if pixels.shape != (N, K, 2) or points.shape != (K, 3):
        raise VergenceError(
            f"refine_eye_camera needs pixels of shape ({N}, {K}, 2) for {N} views of {K} points, "
            f"found {pixels.shape}."
        )
