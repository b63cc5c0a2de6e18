"""Where cameras sit in their eyes, from measured poses of a target instead of corners.

For devices that measure poses of a body directly. As with corners, the true joint readings of every
view are unknowns tied to what was read, and all else is estimated at once: T_eye_cam of each
camera, T_rbase_lbase, the errors of the joints, the target's places, and the levels of noise.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array, single_blas_thread
from vergence.calibration.bundle_adjustment import (
    NoiseModel,
    bundle_adjust,
    check_noise,
    fixed_by_default,
)
from vergence.calibration.hand_eye import median_turn, robust_park_martin
from vergence.calibration.observations import (
    PoseObservations,
    base_by_boards,
    mean_placed,
    most_seen,
)
from vergence.calibration.plausibility import implausible_geometry
from vergence.calibration.residuals import TARGET_SHIFTS, TARGET_TURNS
from vergence.errors import VergenceError, counted
from vergence.findings import Finding, by_severity
from vergence.geometry.camera import intrinsics_names, pinhole
from vergence.geometry.head import HeadCalibration, MountedCamera, main_pair
from vergence.geometry.kinematics import (
    EYES,
    Kinematics,
    Side,
    check_turns,
    eye_pose,
    same_design,
)
from vergence.geometry.se3 import known_poses, rigid_poses

LEAST_POSES = 3
"""Fewest poses of a target at rest, from which a camera's place in its eye follows."""
_STUCK = 0.1
"""Least turn of a target at rest, relative to the turn of the eye: of true poses it is about one,
and this small only where the measurement does not follow."""
_AT_REST_RAD = 1e-6
"""Turn of an eye at rest [rad]: rounding of stored numbers."""


@dataclass(frozen=True, eq=False)
class TargetPoseEstimate:
    """The result of adjust_target_poses."""

    head: HeadCalibration
    """Its lenses are those of the start, or none."""
    parameters: tuple[str, ...]
    """Names of the c parameters of the head; see BundleEstimate.parameters."""
    covariance: Array
    """(c, c); zero for what was fixed by choice."""
    pose_std: tuple[float, float] | None
    """Estimated noise of measured poses, rotation [rad] and translation [m] along each axis; None:
    their covariance was given."""
    noise_factor: float
    """By which the given standard deviations have to be multiplied to explain the errors; 1 where
    none were given."""
    joint_std: tuple[float, ...]
    """Noise of the readings, see Accuracy.joint_std."""
    T_lbase_target: Mapping[int, Array]
    """By number of the placement: where the target stood."""
    T_base_eye: Array
    """(V, 2, 4, 4) the true poses of the left and the right eye; NaN where it saw no target."""
    errors: Mapping[str, Array]
    """By camera (V, 6): expected minus measured poses, in stated or estimated standard deviations,
    whitened; NaN where none was measured."""
    findings: tuple[Finding, ...]
    """What the data cannot determine, and why; the most severe first."""


@single_blas_thread()
def adjust_target_poses(
    T_cam_target: Mapping[str, Array],
    eye: Array,
    *,
    eyes: Mapping[str, Side],
    kinematics: Kinematics | None = None,
    placement: np.ndarray | None = None,
    covariance: Mapping[str, Array] | None = None,
    noise_factor: float | None = None,
    start: HeadCalibration | None = None,
    fixed: Collection[str] = (),
    joint_std: float | tuple[float, float] | None = None,
) -> TargetPoseEstimate:
    """Estimate a head from poses of a target that its cameras measured in V views.

    Args:
        T_cam_target: by camera (V, 4, 4); NaN where none was measured.
        eye: (V, r) joint readings [rad], or (V, 2, 4, 4) measured poses of both eyes.
        eyes: by camera, in which eye it sits.
        kinematics: how readings turn the eyes; None: as in the start or, without one, pan and tilt.
        placement: (V,) numbers of the target's places in the head; None: it stayed at one.
        covariance: by camera (6, 6) or (V, 6, 6) of the poses, in the increment of `se3.boxplus`;
            None: noise of one level for rotations and of one for translations, both estimated.
        noise_factor: of the standard deviations in `covariance`; None: estimated.
        start: a head that is about right, with these cameras; None: by Park and Martin's method.
        fixed: names of more parameters that keep their start, such as left.pan_gain.
        joint_std: noise of the readings, [rad] or, for poses, ([rad], [m]); None: estimated; 0:
            the readings are exact.

    Raises:
        VergenceError: shapes do not fit, readings are not in radians, poses are not rigid, noise is
            not positive, a reading that is needed is not finite, the start is another head, poses
            stay the same while the eye turns, or the motion does not determine a start.
    """
    T_cam_target = {name: np.asarray(T, dtype=float) for name, T in T_cam_target.items()}
    eye = np.asarray(eye, dtype=float)
    check_noise(joint_std, noise_factor=noise_factor)
    if start is not None:
        _check_start(start, T_cam_target, eyes, kinematics)
        kinematics = start.kinematics
    kinematics = Kinematics() if kinematics is None else kinematics
    views = len(eye) if eye.ndim else 0
    placement = np.zeros(views, dtype=int) if placement is None else np.asarray(placement)
    _check_target_poses(T_cam_target, eye, eyes, kinematics, placement)
    measured_eyes, rounded = eye.ndim == 4, []
    for name, T in T_cam_target.items():
        T_cam_target[name], found = rigid_poses(f"T_cam_target of {name}", T)
        rounded += found
    if measured_eyes:
        eye, found = rigid_poses("eye", eye)
        rounded += found
    read = eye
    if not measured_eyes:
        read = np.stack([eye_pose(kinematics, side, eye) for side in EYES], axis=1)
    _check_not_stuck(T_cam_target, read, eyes)
    if start is None:
        start = _start(T_cam_target, read, placement, eyes, kinematics)
    fixed = {
        *fixed,
        *fixed_by_default(start, timed=False),
        *(
            f"{name}.{each}"
            for name, mounted in start.cameras.items()
            for each in intrinsics_names(mounted.intrinsics)
        ),
    }
    whitening = None
    if covariance is not None:
        whitening = {name: _whitening(covariance, name, T) for name, T in T_cam_target.items()}
    found = bundle_adjust(
        start,
        PoseObservations(T_cam_target, whitening, placement, eye, eye if measured_eyes else None),
        fixed=fixed,
        noise=NoiseModel(noise_factor, joint_std),
    )
    pose_std, factor = None, found.pixel_std_px
    if covariance is None:
        pose_std, factor = (found.levels[TARGET_TURNS], found.levels[TARGET_SHIFTS]), 1.0
    errors = {
        name: each if pose_std is None else each / np.repeat(pose_std, 3)
        for name, each in found.residuals_px.items()
    }
    # Bases of measured poses may stand anywhere, as those of two cameras on one body do.
    implausible = [] if measured_eyes else implausible_geometry(found.head)
    return TargetPoseEstimate(
        head=found.head,
        parameters=found.parameters,
        covariance=found.covariance,
        pose_std=pose_std,
        noise_factor=factor,
        joint_std=found.joint_std,
        T_lbase_target=found.T_lbase_target,
        T_base_eye=found.T_base_eye,
        errors=errors,
        findings=by_severity((*found.findings, *rounded, *implausible)),
    )


def _whitening(covariance: Mapping[str, Array], name: str, T_cam_target: Array) -> Array:
    """Compute matrices (V, 6, 6) that whiten the errors of poses by one camera."""
    V = len(T_cam_target)
    stated = np.asarray(covariance.get(name, np.nan), dtype=float)
    if stated.shape not in ((6, 6), (V, 6, 6)):
        raise VergenceError(
            f"The covariance of poses of {name} is (6, 6) or ({V}, 6, 6), found {stated.shape}."
        )
    stated = np.where(known_poses(T_cam_target)[:, None, None], stated, np.eye(6))
    with suppress(np.linalg.LinAlgError):
        if np.isfinite(stated).all():
            return np.asarray(np.linalg.inv(np.linalg.cholesky(stated)), dtype=float)
    raise VergenceError(
        "The covariance of a measured pose is symmetric and positive definite, rotation [rad] "
        "first and then translation [m]; found one that is not."
    )


def _start(
    T_cam_target: Mapping[str, Array],
    eye_poses: Array,
    placement: np.ndarray,
    eyes: Mapping[str, Side],
    kinematics: Kinematics,
) -> HeadCalibration:
    """Start with Park and Martin's mountings, and T_rbase_lbase from what both eyes see."""
    mounted, seen = {}, {}
    for name, T in T_cam_target.items():
        eye = eyes[name]
        own = eye_poses[:, EYES.index(eye)]
        known = known_poses(T) & known_poses(own)
        rows = most_seen(placement, known)
        if len(rows) < LEAST_POSES:
            raise VergenceError(
                f"{name} needs at least {LEAST_POSES} poses of a target at rest, at different "
                "readings."
            )
        T_eye_cam = robust_park_martin(own[rows], T[rows])
        # Poses have no pixels: a lens of one stands where a head needs one.
        mounted[name] = MountedCamera(eye=eye, intrinsics=pinhole(1, 1, 1.0), T_eye_cam=T_eye_cam)
        seen[name] = mean_placed(own @ T_eye_cam @ T, placement)
    head = HeadCalibration(cameras=mounted, T_rbase_lbase=np.eye(4), kinematics=kinematics)
    pair = main_pair(head)
    if pair is None:
        return head
    left, right = pair
    T_rbase_lbase = base_by_boards(seen[left], seen[right])
    if T_rbase_lbase is None:
        raise VergenceError(
            f"T_rbase_lbase is not observable: no placement has poses by both {left} and {right}."
        )
    return replace(head, T_rbase_lbase=T_rbase_lbase)


def _check_target_poses(
    T_cam_target: Mapping[str, Array],
    eye: Array,
    eyes: Mapping[str, Side],
    kinematics: Kinematics,
    placement: np.ndarray,
) -> None:
    views, r = len(eye) if eye.ndim else 0, len(kinematics.readings)
    if not T_cam_target:
        raise VergenceError("There are no poses of a target: T_cam_target names no camera.")
    if eye.shape not in ((views, r), (views, 2, 4, 4)):
        raise VergenceError(
            f"eye is ({views}, {r}) readings, or ({views}, 2, 4, 4) poses of both eyes, found "
            f"{eye.shape}."
        )
    if placement.shape != (views,):
        raise VergenceError(
            f"placement has a number for each of {counted(views, 'view')}, found shape "
            f"{placement.shape}."
        )
    if eye.ndim == 2:
        check_turns(kinematics, eye)
    for name, T in T_cam_target.items():
        if T.shape != (views, 4, 4):
            raise VergenceError(
                f"Poses of a target in {counted(views, 'view')} are ({views}, 4, 4) for each "
                f"camera, found {T.shape} for {name}."
            )
        if eyes.get(name) not in EYES:
            raise VergenceError(f"eyes does not say in which eye {name} sits, left or right.")


def _check_not_stuck(
    T_cam_target: Mapping[str, Array], eye_poses: Array, eyes: Mapping[str, Side]
) -> None:
    """Raise a VergenceError if the poses of a target stay the same while the eye turns."""
    for name, T in T_cam_target.items():
        own = eye_poses[:, EYES.index(eyes[name])]
        known = known_poses(T) & known_poses(own)
        if not known.any():
            continue
        turned, by_eye = (median_turn(each[known]) for each in (T, own))
        if by_eye > _AT_REST_RAD and turned < _STUCK * by_eye:
            raise VergenceError(
                f"The poses of the target by {name} turn by {np.degrees(turned):.2g} degrees in "
                f"the median, its eye by {np.degrees(by_eye):.2g}: is the measurement stuck, or "
                "does the target move with the eye?"
            )


def _check_start(
    start: HeadCalibration,
    T_cam_target: Mapping[str, Array],
    eyes: Mapping[str, Side],
    kinematics: Kinematics | None,
) -> None:
    """Raise a VergenceError if a start is of another head than what was measured."""
    for name in T_cam_target:
        if name not in start.cameras:
            raise VergenceError(
                f"There are poses of a target by {name}; start has the cameras "
                f"{', '.join(start.cameras)}."
            )
        own = start.cameras[name].eye
        if eyes.get(name, own) != own:
            raise VergenceError(f"{name} sits in the {own} eye of start, not in the {eyes[name]}.")
    if kinematics is not None and not (
        kinematics.readings == start.kinematics.readings
        and same_design(kinematics, start.kinematics)
    ):
        raise VergenceError(
            "kinematics and start.kinematics describe different joints or readings; leave "
            "kinematics out."
        )
