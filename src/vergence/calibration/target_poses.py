"""Where cameras sit in their eyes, from measured poses of a target instead of corners.

For devices that measure poses of a body directly. As with corners, the true joint readings of every
view are unknowns tied to what was read, and all else is estimated at once: T_eye_cam of each
camera, T_rbase_lbase, the errors of the joints, the target's places, and the levels of noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from vergence.arrays import Array, single_blas_thread
from vergence.calibration.bundle_adjustment import (
    BundleEstimate,
    NoiseModel,
    bundle_adjust,
    fixed_by_default,
)
from vergence.calibration.hand_eye import robust_park_martin
from vergence.calibration.observations import (
    PoseObservations,
    base_by_boards,
    check_shapes,
    mean_placed,
    most_seen,
)
from vergence.calibration.plausibility import implausible_geometry
from vergence.errors import VergenceError
from vergence.findings import by_severity
from vergence.geometry.camera import intrinsics_names, pinhole
from vergence.geometry.head import HeadCalibration, MountedCamera, main_pair
from vergence.geometry.kinematics import EYES, Kinematics, Side, check_turns, eye_pose
from vergence.geometry.se3 import known_poses, rigid_poses

LEAST_POSES = 3
"""Fewest poses of a target at rest, from which a camera's place in its eye follows."""


@single_blas_thread()
def adjust_target_poses(
    T_cam_target: Mapping[str, Array],
    eye: Array,
    *,
    eyes: Mapping[str, Side],
    kinematics: Kinematics | None = None,
    placement: np.ndarray | None = None,
    covariance: Mapping[str, Array] | None = None,
    noise: NoiseModel | None = None,
) -> BundleEstimate:
    """Estimate a head from poses of a target that its cameras measured in V views.

    Args:
        T_cam_target: by camera (V, 4, 4); NaN where none was measured.
        eye: (V, r) joint readings [rad], or (V, 2, 4, 4) measured poses of both eyes.
        eyes: by camera, in which eye it sits.
        kinematics: how readings turn the eyes; None: pan and tilt.
        placement: (V,) numbers of the target's places in the head; None: it stayed at one.
        covariance: by camera (6, 6) or (V, 6, 6) of the poses, in the increment of `se3.boxplus`,
            up to a factor that is estimated; None: noise of one level for rotations and of one for
            translations, both estimated: see `levels` of the result.
        noise: what is known of it; its `pixel_std_px` is the factor on the deviations.

    Raises:
        VergenceError: shapes do not fit, readings are not in radians, poses are not rigid, a
            reading that is needed is not finite, or the motion does not determine a start.
    """
    T_cam_target = {name: np.asarray(T, dtype=float) for name, T in T_cam_target.items()}
    eye, kinematics = np.asarray(eye, dtype=float), kinematics or Kinematics()
    V, measured_eyes = len(np.atleast_1d(eye)), eye.ndim == 4
    placement = np.zeros(V, dtype=int) if placement is None else np.asarray(placement)
    wanted = {"eye": (eye, (V, 2, 4, 4) if measured_eyes else (V, len(kinematics.readings)))}
    wanted |= {f"poses by {name}": (T, (V, 4, 4)) for name, T in T_cam_target.items()}
    check_shapes("Poses of a target", V, {**wanted, "placement": (placement, (V,))})
    if not T_cam_target:
        raise VergenceError("There are no poses of a target: T_cam_target names no camera.")
    for name in T_cam_target:
        if eyes.get(name) not in EYES:
            raise VergenceError(f"eyes does not say in which eye {name} sits, left or right.")
    rounded = []
    for name, T in T_cam_target.items():
        T_cam_target[name], found = rigid_poses(f"T_cam_target of {name}", T)
        rounded += found
    if measured_eyes:
        read, found = rigid_poses("eye", eye)
        rounded += found
    else:
        check_turns(kinematics, eye)
        read = np.stack([eye_pose(kinematics, side, eye) for side in EYES], axis=1)
    start = _start(T_cam_target, read, placement, eyes, kinematics)
    whitening = None
    if covariance is not None:
        whitening = {name: _whitening(covariance, name, T) for name, T in T_cam_target.items()}
    found = bundle_adjust(
        start,
        PoseObservations(T_cam_target, whitening, placement, eye, read if measured_eyes else None),
        fixed=fixed_by_default(start, timed=False).union(
            f"{name}.{each}"
            for name, mounted in start.cameras.items()
            for each in intrinsics_names(mounted.intrinsics)
        ),
        noise=noise or NoiseModel(),
    )
    # Bases of measured poses may stand anywhere, as those of two cameras on one body do.
    implausible = [] if measured_eyes else implausible_geometry(found.head)
    return replace(found, findings=by_severity((*found.findings, *rounded, *implausible)))


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
    """Start with Park and Martin's mountings, and T_rbase_lbase from what both eyes see.

    Poses have no pixels: a lens of one stands where a head needs one.
    """
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
