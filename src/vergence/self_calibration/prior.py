"""Prior of self-calibration: the parameters to estimate, and their covariance.

It is the calibration's covariance or, without one, usual tolerances, conditioned on what the
paper's procedure measures well: relative pose and epipolar lines of the cameras at straight gaze,
and the ratio of the focal lengths. What may have moved since the calibration is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry import se3
from vergence.geometry.camera import (
    Camera,
    displaced_by_distortion,
    intrinsics_names,
    pixel_grid,
    project,
    unproject,
)
from vergence.geometry.head import (
    HeadCalibration,
    pair_names,
    parameter_names,
    reading_stds,
    stated_covariance,
    states_covariance,
)
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.lens import COEFFICIENTS, PINHOLE
from vergence.geometry.parameters import is_gain, parameter_values, redundant_offsets
from vergence.geometry.se3 import POSE
from vergence.self_calibration.match_noise import no_revisits
from vergence.self_calibration.residuals import epipolar_residuals, pair_coordinates
from vergence.self_calibration.state import FilterState

Changed = Literal["nothing", "little", "anything"]
"""What may have changed since a calibration: nothing right after it; little by transport,
temperature or a screw; anything by a repair, which voids the stated covariance."""


@dataclass(frozen=True)
class Tolerance:
    """Standard deviation of each kind of parameter; 0 is exact."""

    focal: float  # relative, common to fx and fy of a camera
    aspect: float  # relative, of fx and fy independently
    centre_px: float
    lens_px: float  # displacement by the distortion coefficients, rms over the image
    turn_rad: float  # of a mounting about each axis
    shift_m: float
    stereo_turn_rad: float  # of the cameras relative to each other at straight gaze, or the bases
    stereo_shift_m: float
    gain: float  # relative; of a joint with several readings, of the gear factor of each
    offset_rad: float  # of a joint between the first and the last of an eye
    axis_turn_rad: float  # direction of a joint's axis relative to the one before
    axis_shift_m: float


_TOLERANCES = (
    # usual, moved, drift, bump, uncalibrated
    (0.02, 0.002, 1e-4, 0.0, 0.02),  # focal
    (1e-4, 1e-4, 0.0, 0.0, 0.0),  # aspect
    (0.2, 0.3, 0.01, 0.0, 5.0),  # centre_px
    (0.1, 0.0, 0.0, 0.0, 0.0),  # lens_px
    np.radians([0.5, 0.1, 0.03, 1.5, 1.5]),  # turn_rad
    (3e-3, 1e-4, 1e-5, 1e-3, 3e-3),  # shift_m
    np.radians([0.3, 0.03, 0.003, 0.0, 1.0]),  # stereo_turn_rad
    (2e-4, 5e-5, 5e-6, 0.0, 1e-3),  # stereo_shift_m
    (0.03, 0.002, 1e-4, 0.0, 0.05),  # gain
    np.radians([0.5, 0.0, 0.0, 0.0, 0.5]),  # offset_rad
    np.radians([0.1, 0.0, 0.0, 0.0, 0.1]),  # axis_turn_rad
    (3e-4, 0.0, 0.0, 0.0, 3e-4),  # axis_shift_m
)
"""Usual errors of a calibration without a covariance, measured as docs/method.md describes. The
others are assumptions: change by transport, temperature and screws; random walk in a minute;
change of a camera that was hit; a head known from its drawing only."""
USUAL, MOVED, DRIFT, BUMP, UNCALIBRATED = (
    Tolerance(*map(float, c)) for c in zip(*_TOLERANCES, strict=True)
)
"""The columns of _TOLERANCES."""

_LENS_INFLATION = 2.0
"""Inflation of the stated errors of a lens fit; chosen with benchmarks/single_frames.py."""
_EPIPOLAR_PX = 0.3
"""Distance of points from their epipolar lines at straight gaze, root mean square over the image;
0.05 to 0.5 in six calibrations of the twin by the paper's method."""
JOINT_STD_RAD = np.radians(0.2)
"""Noise of readings for which the calibration states none, until it is estimated."""


def initial_state(
    head: HeadCalibration,
    *,
    cameras: tuple[str, str] | None = None,
    changed: Changed = "little",
) -> FilterState:
    """Start the filter from a calibration.

    Args:
        head: with a camera in each eye.
        cameras: names of the left and the right camera; None: the main ones.
        changed: what may have changed since the calibration. With "anything" usual tolerances
            replace the stated covariance; the stated noise is kept.

    Raises:
        VergenceError: the head has one eye or no joint readings, was calibrated with measured eye
            poses, or `changed` is another word.
    """
    if changed not in get_args(Changed):
        raise VergenceError(f"changed is {' or '.join(get_args(Changed))}, found {changed!r}.")
    pair = pair_names(head, cameras)
    accuracy = head.accuracy
    measured = accuracy is not None and accuracy.eye_motion == "poses"
    if measured or not head.kinematics.readings:
        found = "was calibrated with measured eye poses" if measured else "has none"
        raise VergenceError(f"Self-calibration corrects joint readings; this head {found}.")
    if accuracy is not None and changed == "anything":
        unknown = replace(accuracy, parameters=(), covariance=np.empty((0, 0)), lenses={})
        head = replace(head, accuracy=unknown)
    names = estimated_names(head, pair)
    factors = head.kinematics.gear_ratios
    stds = reading_stds(head) * factors
    # A reading that is 1 ms late errs by 0.05 degrees at 50 degrees a second.
    stds = np.maximum(stds, np.radians(0.05)) if stds.any() else np.full_like(stds, JOINT_STD_RAD)
    rms = float(np.sqrt(np.mean(stds**2)))
    moved = tolerance_covariance(head, names, MOVED)
    C = moved * 1e-6 if changed == "nothing" else moved  # C is inverted, if parameters were fixed
    if states_covariance(head):
        rows, stated = stated_covariance(head, names)
        C[np.ix_(rows, rows)] += stated
    else:
        C = C + _procedure_covariance(head, names, pair)
    systematic = accuracy.systematic_px if accuracy else {}
    return FilterState(
        head=head,
        cameras=pair,
        names=names,
        covariance=C,
        prior_head=head,
        prior_covariance=C,
        reading_std=rms,
        noise_ratios=stds / rms / factors,
        revisits=no_revisits(len(factors)),
        systematic_px=(systematic.get(pair[0], 0.0), systematic.get(pair[1], 0.0)),
    )


def estimated_names(head: HeadCalibration, cameras: tuple[str, str]) -> tuple[str, ...]:
    """List the parameters to estimate: those that show in a pair of cameras or follow from them.

    Other cameras are mounted on the same eyes: their mountings follow those of the pair.
    """
    stated = head.accuracy.parameters if head.accuracy else ()
    visible = {
        f"{name}.{each}"
        for name in cameras
        for each in (PINHOLE if stated else intrinsics_names(head.camera(name).intrinsics))
    }

    def wanted(name: str) -> bool:
        owner, _, rest = name.partition(".")
        of_pose = rest.startswith("T_eye_cam") or owner == "T_rbase_lbase"
        of_joint = is_gain(name) or (not stated and owner in EYES)
        return of_pose or of_joint or name in visible or name in stated

    excluded = {"time_offset_s"} | redundant_offsets(head.kinematics).difference(stated)
    return tuple(n for n in parameter_names(head) if wanted(n) and n not in excluded)


def remaining_covariance(
    head: HeadCalibration, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Array]:
    """List the R parameters that may be wrong and are not among `names`, with their covariance.

    The covariance (R, R) is the calibration's or, without one, that of usual tolerances.
    """
    others = tuple(name for name in parameter_names(head) if name not in names)
    if states_covariance(head):
        rows, C = stated_covariance(head, others)
        return tuple(others[k] for k in rows), C
    others = tuple(name for name in others if name.partition(".")[0] in head.cameras)
    return others, _lens_fit_covariance(head, others)


def tolerance_covariance(
    head: HeadCalibration, names: tuple[str, ...], tolerance: Tolerance
) -> Array:
    """Compute the covariance (P, P) of parameters that err by tolerances."""
    C = np.diag(_relative_variances(names, tolerance))
    rows = {name: k for k, name in enumerate(names)}
    for camera, mounted in head.cameras.items():
        lens = mounted.intrinsics
        focal = [
            (rows[n], lens.matrix[k, k]) for k in (0, 1) if (n := f"{camera}.f{'xy'[k]}") in rows
        ]
        if focal:
            own, f = [k for k, _ in focal], np.array([value for _, value in focal])
            relative = tolerance.focal**2 + tolerance.aspect**2 * np.eye(len(f))
            C[np.ix_(own, own)] = relative * np.outer(f, f)
        coefficients = [f"{camera}.{each}" for each in COEFFICIENTS[lens.model]]
        free = [k for k, name in enumerate(coefficients) if name in rows]
        if tolerance.lens_px and free:
            own = [rows[coefficients[k]] for k in free]
            C[np.ix_(own, own)] = _coefficient_covariance(lens, free, tolerance.lens_px)
    if factors := [name for name in names if is_gain(name) and not name.endswith("_gain")]:
        values = parameter_values(head)
        for name in factors:
            C[rows[name], rows[name]] *= (values[name] or 1.0) ** 2
    return C


def _coefficient_covariance(lens: Camera, free: Sequence[int], lens_px: float) -> Array:
    """Compute the covariance (n, n) of the free distortion coefficients of a lens.

    Together they displace the image by lens_px, root mean square; each alone is less certain. Some
    combinations of a rational lens displace nothing; their deviation of 0.01 keeps them linear.
    """
    shown = len(free) * displaced_by_distortion(lens)[np.ix_(free, free)] / lens_px**2
    return np.asarray(np.linalg.inv(shown + np.eye(len(free)) / 0.01**2), float)


@lru_cache(maxsize=64)
def _relative_variances(names: tuple[str, ...], t: Tolerance) -> Array:
    """List variances (P,), without those of focal lengths and distortion coefficients."""
    by_end = {
        ".cx": t.centre_px,
        ".cy": t.centre_px,
        "_offset_rad": t.offset_rad,
        "_nonorthogonality_rad": t.axis_turn_rad,
        "_inclination_rad": t.axis_turn_rad,
        "_axis_distance_m": t.axis_shift_m,
        "_slide_m": t.axis_shift_m,
    }

    def std(name: str) -> float:
        turns = name.rpartition(".")[2].startswith("r")
        if ".T_eye_cam." in name:
            return t.turn_rad if turns else t.shift_m
        if name.startswith("T_rbase_lbase."):
            return t.stereo_turn_rad if turns else t.stereo_shift_m
        if is_gain(name):
            return t.gain
        return next((value for end, value in by_end.items() if name.endswith(end)), 0.0)

    return np.square([std(name) for name in names])


def _procedure_covariance(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str]
) -> Array:
    """Compute the covariance of a head that the paper's procedure calibrated."""
    C = _lens_fit_covariance(head, names)
    C = _correlate_eyes(head, names, cameras, C)
    C = _follow_main_cameras(head, names, cameras, C)
    pair = pair_coordinates(head, names, straight_gaze(head.kinematics), cameras)
    # T_rbase_lbase follows from static stereo (Eq. 10): its errors are those of the relative pose
    # at straight gaze, and what the other parameters' errors add to it.
    base = [k for k, name in enumerate(names) if name.startswith("T_rbase_lbase")]
    by_names = pair.by_unknowns[-len(POSE) :, : len(names)]
    to_base = np.linalg.inv(by_names[:, base])
    mixing = np.eye(len(names))
    mixing[base] = -to_base @ by_names
    mixing[np.ix_(base, base)] = to_base
    C = mixing @ C @ mixing.T
    J = _epipolar_jacobian(pair.lenses, pair.T_second_first) @ pair.by_unknowns[:, : len(names)]
    # They have four degrees of freedom: pitch, roll, vergence and the ratio of focal lengths.
    C = _condition(C, J, _EPIPOLAR_PX**2 * len(J) / 4)
    fits = head.accuracy.lenses if head.accuracy else {}
    if all(name in fits and f"{name}.fx" in names for name in cameras):
        ratio = np.zeros((1, len(names)))
        for name, sign in zip(cameras, (1, -1), strict=True):
            ratio[0, names.index(f"{name}.fx")] = sign / head.camera(name).intrinsics.matrix[0, 0]
        C = _condition(C, ratio, _LENS_INFLATION**2 * sum(fits[n].focal ** 2 for n in cameras))
    return C


def _condition(C: Array, J: Array, variance: float) -> Array:
    """Condition a covariance (P, P) on measurements of J (m, P) times the error."""
    by_measurements = C @ J.T
    C = C - by_measurements @ np.linalg.solve(
        J @ by_measurements + variance * np.eye(len(J)), by_measurements.T
    )
    return (C + C.T) / 2


def _lens_fit_covariance(head: HeadCalibration, names: tuple[str, ...]) -> Array:
    """Compute the covariance (P, P) by usual tolerances, and by the stated errors of lens fits.

    Focal lengths keep the usual tolerance: one bent board makes all of its views wrong alike.
    """
    C = tolerance_covariance(head, names, USUAL)
    for camera, fit in (head.accuracy.lenses if head.accuracy else {}).items():
        fitted = replace(
            USUAL,
            focal=max(fit.focal, USUAL.focal),
            # Exact data would make the covariance singular.
            centre_px=max(_LENS_INFLATION * fit.centre_px, 1e-3),
            lens_px=max(_LENS_INFLATION * fit.distortion_px or USUAL.lens_px, 1e-3),
        )
        own = [k for k, name in enumerate(names) if name.startswith(f"{camera}.")]
        C[np.ix_(own, own)] = tolerance_covariance(head, names, fitted)[np.ix_(own, own)]
    return C


def _correlate_eyes(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str], C: Array
) -> Array:
    """Correlate the errors of both eyes by one half, as lenses and encoders are of one make."""
    lenses = [head.camera(name).intrinsics for name in cameras]
    alike = lenses[0].model == lenses[1].model
    excluded = () if alike else COEFFICIENTS[lenses[0].model]
    pairs = [
        (k, names.index(other))
        for first, second in (cameras, EYES)
        for k, name in enumerate(names)
        for owner, _, rest in [name.partition(".")]
        if owner == first and rest not in excluded and (other := f"{second}.{rest}") in names
    ]
    # Gear factors err relative to their values, which may differ in sign between the eyes.
    values = parameter_values(head)
    sign = np.array([-1.0 if is_gain(n) and (values[n] or 0.0) < 0 else 1.0 for n in names])
    one, other = ([pair[k] for pair in pairs] for k in (0, 1))
    roots = [sign[own, None] * np.linalg.cholesky(C[np.ix_(own, own)]) for own in (one, other)]
    C = C.copy()
    C[np.ix_(one, other)] = 0.5 * roots[0] @ roots[1].T
    C[np.ix_(other, one)] = C[np.ix_(one, other)].T
    return C


def _follow_main_cameras(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str], C: Array
) -> Array:
    """Let other cameras of an eye move with its main one, to which they are rigidly mounted.

    Their relative rotation is known as well as that between the eyes, since they saw one board.
    Their relative position is known as a mounting is: wrong focal lengths look like distances.
    """
    follow, C = np.eye(len(names)), C.copy()
    for name in (each for each in head.cameras if each not in cameras):
        main = cameras[EYES.index(head.camera(name).eye)]
        own, its = ([names.index(f"{each}.T_eye_cam.{k}") for k in POSE] for each in (name, main))
        C[own[:3], own[:3]] = USUAL.stereo_turn_rad**2
        follow[own, its] = 1.0
        offset = head.camera(name).T_eye_cam[:3, 3] - head.camera(main).T_eye_cam[:3, 3]
        follow[np.ix_(own[3:], its[:3])] = -se3.hat(offset)
    return follow @ C @ follow.T


def _epipolar_jacobian(lenses: Sequence[Camera], T_rcam_lcam: Array) -> Array:
    """Differentiate epipolar distances (N,) [px] all over the common view, by pair coordinates."""
    baseline = float(np.linalg.norm(T_rcam_lcam[:3, 3]))
    pixels = pixel_grid(lenses[0])
    left = np.tile(pixels, (2, 1))
    distances_m = baseline * np.repeat([5.0, 20.0], len(pixels))  # typical ones of boards
    points = unproject(lenses[0], left) * distances_m[:, None]
    right = project(lenses[1], se3.transform(T_rcam_lcam, points))
    inside = ((right >= 0) & (right <= np.array(lenses[1].size) - 1)).all(axis=1)  # NaN: unseen
    return epipolar_residuals(lenses, T_rcam_lcam, left[inside], right[inside]).by_coordinates
