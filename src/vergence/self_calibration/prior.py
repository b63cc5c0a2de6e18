"""What may be wrong with a head before its eyes have looked: the prior of self-calibration.

A calibration that states its covariance brings it along. One that does not, such as that of the
paper's method, is given the errors that such procedures usually have, in the quantities that they
measure: lenses, mountings, gains, and the pose of the cameras to each other at straight gaze,
which is known far better than the mountings. The axes of the joints, which they take to be as
designed, may be off too. At straight gaze points lie near their epipolar lines, since both cameras
saw the same board, whatever each parameter may be wrong by; and a board that is bent makes both
focal lengths wrong alike, but not their ratio. What has moved since is added to both, unless the
head has just been calibrated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.camera import pixel_grid, project, unproject
from vergence.geometry.head import HeadCalibration, stated_covariance, states_covariance
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.parameter_names import PINHOLE, POSE, intrinsics_names
from vergence.geometry.parameters import (
    is_gain,
    parameter_names,
    parameter_values,
    redundant_offsets,
)
from vergence.self_calibration.residuals import epipolar_residuals, pair_coordinates
from vergence.self_calibration.tolerances import MOVED, USUAL, tolerance_covariance

Changed = Literal["nothing", "little", "anything"]
"""What may have changed since a calibration: nothing right after it; little by transport,
temperature or a screw; anything by a repair, and then its covariance no longer holds."""
_COMMON = 0.5
"""Share of the usual variance which both eyes have in common: their lenses and encoders are of one
make, and one board is shown to both. With a half, neither eyes that have nothing in common nor such
that are wrong alike are out of proportion."""
_LEFT = 1e-6
"""Share of the variance of MOVED that is left right after a calibration, whose covariance may state
none of what it held fixed."""
_BASELINES_AWAY = 5.0, 20.0
"""Depths at which boards are shown, in baselines."""
_BEYOND_FIT = 2.0
"""By how much more than its fit to a board states a lens is taken to err. The fits themselves are
right: it makes up for matches that tell less than is estimated. Fitted by
`benchmarks/single_frames.py`: of 12 rendered heads (2.8 mm lens) the squared Mahalanobis distance
of the cameras' turn is 1.76, 1.37, 1.16 and 0.96 per degree of freedom with factors of 1, 1.5, 2
and 3; of 6 heads with the 4.0 mm lens 0.93 with 2."""
_LEAST_LENS_PX = 1e-3
"""Standard deviation of a principal point, and of what coefficients displace, below which no board
determines them, however well it fits."""
_SHOWN_BY_LINES = 4
"""How many errors of a pair displace points from their epipolar lines at straight gaze, each with
another pattern over the image: pitch, roll, vergence, and the ratio of the focal lengths."""
JOINT_STD_RAD = np.radians(0.2)
"""Noise of readings that nobody states, until it is estimated."""
LEAST_JOINT_STD_RAD = np.radians(0.05)
"""Noise at first where a calibration states less: it was recorded with eyes at rest, and readings
that are a millisecond late are that wrong while eyes turn by 50 degrees a second. An assumption."""


def learned_names(head: HeadCalibration, cameras: tuple[str, str]) -> tuple[str, ...]:
    """Return which parameters of a head can be wrong, and show in its main cameras or follow them.

    Other cameras are screwed to the same eyes: if they stayed where the calibration has them, they
    would stand wrongly to those that are corrected.
    """
    stated = head.accuracy.parameters if head.accuracy else ()
    shown = {
        f"{name}.{each}"
        for name in cameras
        for each in (PINHOLE if stated else intrinsics_names(head.camera(name).intrinsics))
    }

    def wanted(name: str) -> bool:
        owner, _, rest = name.partition(".")
        pose = rest.startswith("T_eye_cam") or owner == "T_rbase_lbase"
        of_joint = is_gain(name) or (not stated and owner in EYES)
        return pose or of_joint or name in shown or name in stated

    never = {"time_offset_s"} | redundant_offsets(head.kinematics).difference(stated)
    return tuple(n for n in parameter_names(head) if wanted(n) and n not in never)


def prior_covariance(
    head: HeadCalibration,
    names: tuple[str, ...],
    cameras: tuple[str, str],
    *,
    moved: bool = True,
) -> Array:
    """Return the covariance (P, P) of the parameters before anything is seen.

    That which the head states or, if it states none, usual tolerances; and what may have moved
    since, unless nothing has.
    """
    since = tolerance_covariance(head, names, MOVED) * (1.0 if moved else _LEFT)
    if not states_covariance(head):
        return since + _of_procedure(head, names, cameras)
    stated, C = stated_covariance(head, names)
    since[np.ix_(stated, stated)] += C
    return since


def covariance_of_others(
    head: HeadCalibration, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Array]:
    """Return the parameters (R,) of a head that may be wrong besides those named, and (R, R).

    By the calibration's covariance or, where it states none, by what such procedures usually are
    wrong by.
    """
    others = tuple(name for name in parameter_names(head) if name not in names)
    if states_covariance(head):
        stated, C = stated_covariance(head, others)
        return tuple(others[k] for k in stated), C
    others = tuple(name for name in others if name.partition(".")[0] in head.cameras)
    return others, _with_fits(head, others)


def _with_fits(head: HeadCalibration, names: tuple[str, ...]) -> Array:
    """Return the covariance (P, P) by usual tolerances, of lenses by how well they were fitted.

    But for the focal length, which one board may make wrong in all of its views.
    """
    C = tolerance_covariance(head, names, USUAL)
    for camera, fit in (head.accuracy.lenses if head.accuracy else {}).items():
        tolerance = replace(
            USUAL,
            focal=max(fit.focal, USUAL.focal),
            centre_px=max(_BEYOND_FIT * fit.centre_px, _LEAST_LENS_PX),
            lens_px=max(_BEYOND_FIT * fit.distortion_px or USUAL.lens_px, _LEAST_LENS_PX),
        )
        own = [k for k, name in enumerate(names) if name.startswith(f"{camera}.")]
        C[np.ix_(own, own)] = tolerance_covariance(head, names, tolerance)[np.ix_(own, own)]
    return C


def _with_common(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str], C: Array
) -> Array:
    """Return the covariance of parameters of which those of both eyes err alike in part."""
    lenses = [head.camera(name).intrinsics for name in cameras]
    alike = lenses[0].model == lenses[1].model
    of_eyes = [
        [
            (f"{left}.{rest}", f"{right}.{rest}")
            for name in names
            for owner, _, rest in [name.partition(".")]
            if owner == left and (alike or rest not in COEFFICIENTS[lenses[0].model])
        ]
        for left, right in (cameras, EYES)
    ]
    both = [pair for pairs in of_eyes for pair in pairs if pair[1] in names]
    first, second = ([names.index(pair[k]) for pair in both] for k in (0, 1))
    # Errors of factors are relative to these, which may be of opposite sign in the two eyes.
    values = parameter_values(head)
    sign = np.array([-1.0 if is_gain(n) and (values[n] or 0.0) < 0 else 1.0 for n in names])
    left, right = (
        sign[each, None] * np.linalg.cholesky(C[np.ix_(each, each)]) for each in (first, second)
    )
    shared = C.copy()
    shared[np.ix_(first, second)] = _COMMON * left @ right.T
    shared[np.ix_(second, first)] = shared[np.ix_(first, second)].T
    return shared


def _with_followers(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str], C: Array
) -> Array:
    """Return the covariance in which other cameras err with the main one of their eye.

    They are screwed to the same eye, and saw the same board: to each other they turn as little as
    the cameras of the two eyes do. How far they are apart is known less well, since wrong focal
    lengths look like distances: their shift has the tolerance of a mounting.
    """
    follow, C = np.eye(len(names)), C.copy()
    for name in (each for each in head.cameras if each not in cameras):
        main = cameras[EYES.index(head.camera(name).eye)]
        own, its = ([names.index(f"{each}.T_eye_cam.{k}") for k in POSE] for each in (name, main))
        C[own[:3], own[:3]] = USUAL.stereo_turn_rad**2
        follow[own, its] = 1.0
        apart = head.camera(name).T_eye_cam[:3, 3] - head.camera(main).T_eye_cam[:3, 3]
        follow[np.ix_(own[3:], its[:3])] = -se3.hat(apart)
    return follow @ C @ follow.T


def _of_procedure(head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str]) -> Array:
    """Return the covariance of a head whose T_rbase_lbase follows from static stereo (Eq. 10).

    Its error is that of the static stereo, and what the mountings' errors do to it.
    """
    C = _with_common(head, names, cameras, _with_fits(head, names))
    C = _with_followers(head, names, cameras, C)
    base = [k for k, name in enumerate(names) if name.startswith("T_rbase_lbase")]
    zero = straight_gaze(head.kinematics)
    by = pair_coordinates(head, names, zero, cameras).by_unknowns[-len(POSE) :, : len(names)]
    # stereo = by_base base + by_rest rest, with a stereo that does not depend on the rest.
    back = np.linalg.inv(by[:, base])
    mixing = np.eye(len(names))
    mixing[base] = -back @ by
    mixing[np.ix_(base, base)] = back
    C = mixing @ C @ mixing.T
    J = _by_epipolar_lines(head, names, cameras)
    noise = USUAL.epipolar_px**2 * len(J) / _SHOWN_BY_LINES * np.eye(len(J))
    C = C - C @ J.T @ np.linalg.solve(J @ C @ J.T + noise, J @ C)
    return _with_focal_ratio(head, names, cameras, (C + C.T) / 2)


def _with_focal_ratio(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str], C: Array
) -> Array:
    """Return the covariance with the ratio of the focal lengths as certain as their fits are."""
    fits = head.accuracy.lenses if head.accuracy else {}
    if not all(name in fits and f"{name}.fx" in names for name in cameras):
        return C
    ratio = np.zeros(len(names))
    for name, sign in zip(cameras, (1, -1), strict=True):
        ratio[names.index(f"{name}.fx")] = sign / head.camera(name).intrinsics.matrix[0, 0]
    variance = _BEYOND_FIT**2 * sum(fits[name].focal ** 2 for name in cameras)
    by_ratio = C @ ratio
    return C - np.outer(by_ratio, by_ratio) / (ratio @ by_ratio + variance)


def _by_epipolar_lines(
    head: HeadCalibration, names: tuple[str, ...], cameras: tuple[str, str]
) -> Array:
    """Return how parameters (N, P) displace points from their epipolar lines at straight gaze [px].

    Of points all over the image that both cameras see; N is 0 if there are none.
    """
    straight = straight_gaze(head.kinematics)
    pair = pair_coordinates(head, names, straight, cameras)
    lenses = pair.lenses
    baseline = float(np.linalg.norm(pair.T_second_first[:3, 3]))
    left = np.tile(pixel_grid(lenses[0]), (len(_BASELINES_AWAY), 1))
    depths = np.repeat(_BASELINES_AWAY, len(left) // len(_BASELINES_AWAY)) * baseline
    points = unproject(lenses[0], left) * depths[:, None]
    right = project(lenses[1], se3.transform(pair.T_second_first, points))
    edge = np.array([lenses[1].width, lenses[1].height]) - 1
    both = ((right >= 0) & (right <= edge)).all(axis=1)  # NaN: not seen
    found = epipolar_residuals(lenses, pair.T_second_first, left[both], right[both])
    return found.by_coordinates @ pair.by_unknowns[:, : len(names)]
