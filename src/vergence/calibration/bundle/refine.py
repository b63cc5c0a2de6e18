"""One estimate of everything, with an accuracy that can be believed.

The paper solves step after step and takes joint readings as exact. Here the true joint angles of
every view are unknowns of their own, tied to their readings by the joint noise while the corners
are tied by the pixel noise; both levels of noise are estimated from the same data. The result is
the maximum a posteriori, its covariance, and words for what the data cannot determine.

See `problem` for the unknowns, `solver` for the steps, `noise` for the levels of noise,
`observability` for what is held, and `advice` for the words.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle import diagnostics
from vergence.calibration.bundle.adjustment import Adjusted, adjust
from vergence.calibration.bundle.initial_state import one_eye, whole_head
from vergence.calibration.bundle.problem import (
    AXES,
    INTRINSICS,
    PER_CAMERA,
    Problem,
    calibration_names,
    corner_errors,
    eye_poses,
    lens_vector,
)
from vergence.calibration.bundle.solver import OUTLIER
from vergence.calibration.sequential.intrinsics import target_poses
from vergence.calibration.sequential.robust_hand_eye import robust_park_martin
from vergence.calibration.sequential.sequential import Views
from vergence.data.timing import Timing
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES, EyeAxes, T_base_eye

EXACT = 1e-8
"""Joint noise [rad or m] that stands for exact readings."""
OWN_LEVELS = 40
"""Eyes times views from which pan and tilt have each a noise of their own: it is then known to
about a tenth."""


@dataclass(frozen=True, eq=False)
class EyeCamera:
    """The result of refine_eye_camera."""

    T_eye_cam: Array
    """(4, 4)."""
    covariance: Array
    """(6, 6) of T_eye_cam: rotation [rad], then translation [m], along the axes of the eye (see
    problem.pose_difference)."""
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
    """What the data cannot determine, and why, in words."""


@dataclass(frozen=True, eq=False)
class Refined:
    """The result of refine."""

    head: HeadCalibration
    time_offset_s: float
    """An image shows the joints this much later than its joint reading."""
    parameters: tuple[str, ...]
    """Names of the c unknowns of the calibration, such as left_wide.fx, left_wide.T_eye_cam.rx,
    T_rbase_lbase.tz, left.pan_gain, time_offset_s; px, rad, m, s. Poses change along the axes of
    the frame that they map into, rotation first (see problem.pose_difference)."""
    covariance: Array
    """(c, c) in the order of parameters; zero for what was held by choice."""
    pixel_std_px: float
    """Of one coordinate of a corner."""
    joint_std: tuple[float, ...]
    """Of the readings [rad]: all joints, or pan and tilt; for eye poses rotation and [m]
    translation."""
    T_lbase_target: Mapping[int, Array]
    """By number of the placement: where the board stood."""
    T_base_eye: Array
    """(V, 2, 4, 4) the true poses of the left and the right eye; NaN where it saw no board."""
    residuals_px: Mapping[str, Array]
    """By camera: (V, K, 2) projected minus seen; NaN where not seen."""
    warnings: tuple[str, ...]
    """What the data cannot determine, and why, in words."""


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
        pixel_std_px: noise of one coordinate of a corner; None: estimated.
        joint_std: noise of the readings, [rad] or, for poses, ([rad], [m]); None: estimated; 0:
            the readings are exact.
        outlier: standard deviations beyond which a corner or a reading loses weight.

    Raises:
        VergenceError: shapes do not fit, or Park and Martin's method has no answer.
    """
    axes = EyeAxes() if axes is None else axes
    _check_eye_camera(eye, pixels, points)
    angles = eye if eye.ndim == 2 else _pan_and_tilt(eye)
    T_read = eye if angles is None else T_base_eye(angles, axes)
    if start is None:
        T_cam_target = target_poses(camera, pixels, points)
        known = np.isfinite(T_cam_target).all(axis=(1, 2))
        start = robust_park_martin(T_read[known], T_cam_target[known])
    poses = T_read if angles is None else None
    problem, state = one_eye(camera, start, axes, angles, poses, pixels, points)
    group = np.array([0, 0] if poses is None else [0, 0, 0, 1, 1, 1])
    found = adjust(
        problem,
        state,
        group,
        pixel_std_px=pixel_std_px,
        joint_std=_levels(joint_std, group),
        outlier=outlier,
    )
    mount = slice(len(INTRINSICS), PER_CAMERA)
    true_poses, residuals = T_read.copy(), np.full(pixels.shape, np.nan)
    true_poses[problem.block_view] = eye_poses(problem, found.state)
    residuals[problem.block_view] = _residuals(problem, found)
    return EyeCamera(
        T_eye_cam=found.state.T_eye_cam[0],
        covariance=found.observability.covariance[mount, mount],
        T_base_target=found.state.T_lbase_target[0],
        T_base_eye=true_poses,
        residuals_px=residuals,
        pixel_std_px=found.components.noise.pixel_px,
        joint_std=tuple(map(float, found.components.noise.joint)),
        warnings=diagnostics.left_out(problem) + diagnostics.warnings(problem, found),
    )


def refine(
    start: HeadCalibration,
    views: Views,
    *,
    timing: Timing | None = None,
    eye_poses_read: Array | None = None,
    hold: Collection[str] | None = None,
    pixel_std_px: float | None = None,
    joint_std: float | tuple[float, float] | None = None,
    outlier: float = OUTLIER,
) -> Refined:
    """Estimate a whole head at once: lenses, mountings, the pose between the eyes, axes, time.

    Args:
        start: the paper's calibration, or another that is about right.
        views: corners and joint readings.
        timing: when the readings were taken, where eyes moved; None: they stood still, and the
            time offset is not estimated.
        eye_poses_read: (V, 2, 4, 4) poses of the left and the right eye in their bases, for eyes
            that do not pan and tilt; they take the place of the readings.
        hold: names of parameters that keep their start; None: held_by_default.
        pixel_std_px: noise of one coordinate of a corner; None: estimated.
        joint_std: noise of the readings, [rad] or, for poses, ([rad], [m]); None: estimated; 0:
            the readings are exact.
        outlier: standard deviations beyond which a corner or a reading loses weight.

    Raises:
        VergenceError: shapes do not fit, a reading that is needed is not finite, or there are
            fewer data than unknowns.
    """
    hold = held_by_default(start, timed=timing is not None) if hold is None else hold
    _check_head(start, views, timing, eye_poses_read, hold)
    problem, state, numbers = whole_head(
        start, views, timing=timing, poses=eye_poses_read, hold=hold
    )
    one_level = joint_std is not None or len(problem.reading) < OWN_LEVELS
    group = np.array([0, 0] if one_level else [0, 1])
    if eye_poses_read is not None:
        group = np.array([0, 0, 0, 1, 1, 1])
    found = adjust(
        problem,
        state,
        group,
        pixel_std_px=pixel_std_px,
        joint_std=_levels(joint_std, group),
        outlier=outlier,
    )
    true_poses = np.full((len(views.placement), 2, 4, 4), np.nan)
    true_poses[problem.block_view, problem.block_eye] = eye_poses(problem, found.state)
    residuals = {name: np.full(views.corners[name].shape, np.nan) for name in problem.cameras}
    for c, name in enumerate(problem.cameras):
        mine = problem.camera == c
        residuals[name][problem.block_view[problem.block[mine]]] = _residuals(problem, found)[mine]
    unseen = tuple(
        f"{name} sees no board, and stays at its start."
        for name in start.cameras
        if name not in problem.cameras
    )
    seen = np.stack([np.isfinite(views.corners[name]) for name in problem.cameras])
    lost = np.setdiff1d(np.flatnonzero(seen.any(axis=(0, 2, 3))), problem.block_view)
    if len(lost):
        unseen += (
            f"Views {', '.join(map(str, lost))} were left out: no image of these boards shows "
            "enough corners.",
        )
    return Refined(
        head=_head(start, problem, found),
        time_offset_s=found.state.time_offset_s,
        parameters=calibration_names(problem.cameras),
        covariance=found.observability.covariance,
        pixel_std_px=found.components.noise.pixel_px,
        joint_std=tuple(map(float, found.components.noise.joint)),
        T_lbase_target=dict(zip(numbers.tolist(), found.state.T_lbase_target, strict=True)),
        T_base_eye=true_poses,
        residuals_px=residuals,
        warnings=unseen + diagnostics.left_out(problem) + diagnostics.warnings(problem, found),
    )


def held_by_default(start: HeadCalibration, *, timed: bool) -> set[str]:
    """Return the names of the parameters that refine does not touch unless told.

    - Offsets of the joints: an offset of tilt is a turn of T_eye_cam, one of pan a turn of the
      base frame, and no image tells them apart.
    - Distortion coefficients that are zero at the start: they are not in the lens model.
    - The time offset, where the eyes stood still.
    """
    held = {f"{eye}.{joint}_offset_rad" for eye in EYES for joint in ("pan", "tilt")}
    for camera, mounted in start.cameras.items():
        values = zip(INTRINSICS[4:], lens_vector(mounted.intrinsics)[4:], strict=True)
        held |= {f"{camera}.{name}" for name, value in values if value == 0}
    return held if timed else held | {"time_offset_s"}


def covariance_of(refined: Refined, name: str) -> Array:
    """Return the covariance of one parameter, or of all that have the name before their last dot.

    For example (6, 6) of "left_wide.T_eye_cam" and "T_rbase_lbase", (9, 9) of "left_wide".
    """
    chosen = [
        i
        for i, parameter in enumerate(refined.parameters)
        if name in (parameter, parameter.rpartition(".")[0])
    ]
    if not chosen:
        raise VergenceError(f"No parameter is called {name!r}; see Refined.parameters.")
    return refined.covariance[np.ix_(chosen, chosen)]


def _head(start: HeadCalibration, problem: Problem, found: Adjusted) -> HeadCalibration:
    state = found.state
    cameras = dict(start.cameras)
    for c, name in enumerate(problem.cameras):
        cameras[name] = MountedCamera(
            eye=cameras[name].eye, intrinsics=state.lenses[c], T_eye_cam=state.T_eye_cam[c]
        )
    rows = [EyeAxes(**dict(zip(AXES, map(float, row), strict=True))) for row in state.axes]
    return replace(
        start,
        cameras=cameras,
        T_rbase_lbase=state.T_rbase_lbase,
        axes={"left": rows[0], "right": rows[1]},
    )


def _residuals(problem: Problem, found: Adjusted) -> Array:
    """Return (M, K, 2), NaN where not seen."""
    return np.where(problem.seen[..., None], corner_errors(problem, found.state), np.nan)


def _levels(joint_std: float | tuple[float, float] | None, group: np.ndarray) -> Array | None:
    if joint_std is None:
        return None
    levels = np.broadcast_to(np.asarray(joint_std, dtype=float), (group.max() + 1,))
    return np.maximum(levels, EXACT)


def _pan_and_tilt(T: Array) -> Array | None:
    """Return the angles (N, 2) of eye poses (N, 4, 4), or None where these are more than that."""
    pan = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    tilt = np.arctan2(-T[:, 2, 0], T[:, 2, 2])
    angles = np.stack([pan, tilt], axis=-1)
    return angles if np.abs(T_base_eye(angles) - T).max() < 1e-9 else None


def _check_eye_camera(eye: Array, pixels: Array, points: Array) -> None:
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


def _check_head(
    start: HeadCalibration,
    views: Views,
    timing: Timing | None,
    poses: Array | None,
    hold: Collection[str],
) -> None:
    V = len(views.placement)
    wanted: dict[str, tuple[Array, tuple[int, ...]]] = {"eye_angles": (views.eye_angles, (V, 4))}
    if timing is not None:
        wanted["time_s"], wanted["run"] = (timing.time_s, (V,)), (timing.run, (V,))
    if poses is not None:
        wanted["eye_poses_read"] = (poses, (V, 2, 4, 4))
    for name, (array, shape) in wanted.items():
        if array.shape != shape:
            raise VergenceError(f"refine needs {name} of shape {shape}, found {array.shape}.")
    unknown = set(hold) - set(calibration_names(tuple(start.cameras)))
    if unknown:
        raise VergenceError(
            f"There is no parameter {min(unknown)!r} to hold; there are, for example, "
            "left_wide.fx, left_wide.T_eye_cam.rx, left.pan_gain and time_offset_s."
        )
