"""The eye-camera transform alone, of one camera of known intrinsics: with latent joint angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import (
    NoiseModel,
    bundle_adjust,
    check_noise,
    covariance_of,
)
from vergence.calibration.hand_eye import robust_park_martin
from vergence.calibration.observations import Observations
from vergence.calibration.priors import ParametersPrior
from vergence.errors import VergenceError
from vergence.estimation.residual import OUTLIER
from vergence.findings import Finding, warning
from vergence.geometry.board import Chessboard
from vergence.geometry.camera import Camera, intrinsics_names
from vergence.geometry.head import HeadCalibration, MountedCamera, parameter_names
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics, check_turns, eye_pose, pan_tilt
from vergence.geometry.se3 import known_poses, rigid_poses
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
    """Noise of one coordinate of a corner."""
    joint_std: tuple[float, ...]
    """Noise of each kind of readings [rad], or of eye poses (rotation [rad], translation [m])."""
    findings: tuple[Finding, ...]
    """What the data cannot determine, and why; the most severe first."""


def refine_eye_camera(
    eye: Array,
    pixels: Array,
    points: Array,
    camera: Camera,
    *,
    start: Array | None = None,
    joints: tuple[Joint, ...] | None = None,
    intrinsics_covariance: Array | None = None,
    pixel_std_px: float | None = None,
    joint_std: float | tuple[float, float] | None = None,
    outlier: float = OUTLIER,
) -> EyeCamera:
    """Find where a camera of known intrinsics sits in its eye, from N views of a board at rest.

    Args:
        eye: (N, r) readings [rad], or (N, 4, 4) measured eye poses T_base_eye.
        pixels: (N, K, 2) corners; NaN where one was not seen.
        points: (K, 3) corners in frame target [m].
        camera: intrinsics.
        start: (4, 4) T_eye_cam to start from; None: Park and Martin's.
        joints: of the eye, whose readings are named in the order of their columns; None: pan and
            tilt. Of no use with poses.
        intrinsics_covariance: (n, n) of the intrinsics in the order of
            `geometry.camera.intrinsics_names`, as their prior; None: they are taken as
            exact.
        pixel_std_px: noise of one coordinate of a corner; None: estimated.
        joint_std: noise of the readings, [rad] or, for poses, ([rad], [m]); None: estimated; 0:
            the readings are exact.
        outlier: standard deviations beyond which a corner or a reading loses weight.

    Raises:
        VergenceError: shapes do not fit, numbers are not finite, readings are not in radians, poses
            are not rigid, noise is not positive, or Park and Martin's method has no answer.
    """
    joints = pan_tilt("left") if joints is None else joints
    names = tuple(dict.fromkeys(name for joint in joints for name in joint.readings))
    # The left eye of a head that has no other.
    kinematics = Kinematics({"left": joints, "right": ()}, names)
    eye, pixels, points = (np.asarray(each, dtype=float) for each in (eye, pixels, points))
    start = None if start is None else np.asarray(start, dtype=float)
    _check(eye, pixels, points, kinematics, np.eye(4) if start is None else start)
    check_noise(joint_std, pixel_std_px=pixel_std_px, outlier=outlier)
    angles, rounded = (eye if eye.ndim == 2 else None), ()
    if angles is None:
        eye, rounded = rigid_poses("eye", eye)
    if start is not None:
        start, _ = rigid_poses("start", start)
    if angles is not None and isinstance(joint_std, tuple):
        raise VergenceError(
            f"joint_std of joint readings is one number [rad], found {joint_std}; two, of "
            "rotation [rad] and translation [m], are for measured eye poses."
        )
    T_read = eye if angles is None else eye_pose(kinematics, "left", angles)
    T_cam_target = board_poses(camera, pixels, points)
    if start is None:
        known = known_poses(T_cam_target)
        start = robust_park_martin(T_read[known], T_cam_target[known])
    head = HeadCalibration(
        cameras={_NAME: MountedCamera(eye="left", intrinsics=camera, T_eye_cam=start)},
        T_rbase_lbase=np.eye(4),
        kinematics=kinematics,
    )
    uncertain, priors = _intrinsics_prior(head, intrinsics_covariance)
    kept = [name for name in parameter_names(head) if ".T_eye_cam." not in name]
    found = bundle_adjust(
        head,
        _observations(pixels, camera, kinematics, angles, T_read),
        points=points,
        fixed=set(kept) - set(uncertain),
        T_cam_target={_NAME: T_cam_target},
        noise=NoiseModel(pixel_std_px, joint_std, outlier),
        priors=priors,
    )
    findings = (*found.findings, *rounded)
    if intrinsics_covariance is None:
        sentence = "The covariance leaves out that of the intrinsics, taken as exact."
        findings += (warning("exact-intrinsics", sentence),)
    T_found = found.T_base_eye[:, 0]
    return EyeCamera(
        T_eye_cam=found.head.cameras[_NAME].T_eye_cam,
        covariance=covariance_of(found, f"{_NAME}.T_eye_cam"),
        T_base_target=found.T_lbase_target[0],
        T_base_eye=np.where(np.isnan(T_found), T_read, T_found),
        residuals_px=found.residuals_px[_NAME],
        pixel_std_px=found.pixel_std_px,
        joint_std=found.joint_std,
        findings=findings,
    )


def _observations(
    pixels: Array, camera: Camera, kinematics: Kinematics, angles: Array | None, T_read: Array
) -> Observations:
    """Describe views (N, K, 2) of one board at rest by a camera called _NAME in the left eye.

    The eye's motion is given by angles (N, r) or, without them, by poses T_read (N, 4, 4).
    """
    N, K = pixels.shape[:2]
    unknown = np.full((N, len(kinematics.readings)), np.nan)
    return Observations(
        board=Chessboard(columns=K, rows=1, square_m=1.0),  # counts corners; `points` places them
        placement=np.zeros(N, dtype=int),
        eye_angles=unknown if angles is None else angles,
        corners={_NAME: pixels},
        sizes={_NAME: camera.size},
        kinematics=kinematics,
        T_base_eye=np.stack([T_read, T_read], axis=1) if angles is None else None,
    )


def _intrinsics_prior(
    head: HeadCalibration, covariance: Array | None
) -> tuple[list[str], list[ParametersPrior]]:
    """Find which intrinsics are uncertain, and their prior; VergenceError for a wrong one."""
    names = [f"{_NAME}.{name}" for name in intrinsics_names(head.cameras[_NAME].intrinsics)]
    if covariance is None:
        return [], []
    covariance = np.asarray(covariance, dtype=float)
    if covariance.shape != (len(names), len(names)) or not np.isfinite(covariance).all():
        raise VergenceError(
            f"The covariance of the intrinsics {', '.join(names)} is {len(names)} x {len(names)} "
            f"finite numbers, found {covariance.shape}."
        )
    free = np.flatnonzero(np.diag(covariance) > 0)
    if not len(free):
        return [], []
    uncertain, among = [names[k] for k in free], covariance[np.ix_(free, free)]
    return uncertain, [ParametersPrior(names=tuple(uncertain), head=head, covariance=among)]


def _check(eye: Array, pixels: Array, points: Array, kinematics: Kinematics, start: Array) -> None:
    """Raise VergenceError for arrays whose shapes do not fit, or that are not finite."""
    N, K = (len(each) if each.ndim else 0 for each in (eye, points))
    r = len(kinematics.readings)
    for what, array, shapes, finite in (
        ("readings, or poses,", eye, ((N, r), (N, 4, 4)), True),
        ("points", points, ((K, 3),), True),
        ("pixels", pixels, ((N, K, 2),), False),
        ("T_eye_cam to start from,", start, ((4, 4),), True),
    ):
        if array.shape not in shapes or (finite and not np.isfinite(array).all()):
            expected = " or ".join(map(str, shapes))
            raise VergenceError(
                f"refine_eye_camera needs {'finite ' * finite}{what} of shape {expected}, found "
                f"{array.shape}."
            )
    if eye.ndim == 2:
        check_turns(kinematics, eye)
