"""Whether eyes and board moved enough for a calibration, and whether the board is stretched.

A start that rests on noise leads bundle adjustment to a wrong optimum, whose stated accuracy is
wrong as well; motion that is too small is refused before. The images show how far an eye turned.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import norm, t

from vergence.arrays import Array
from vergence.calibration.intrinsics import Intrinsics, jackknife_covariance, noise_covariance
from vergence.calibration.lenses import without_poses
from vergence.calibration.observations import Observations, camera_eyes, most_seen
from vergence.calibration.undetermined import little_turned
from vergence.errors import VergenceError
from vergence.findings import Finding, void, warning
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import known_poses
from vergence.vision.board_pose import board_errors, determines_pose, seen_corners

FOCAL_PART = 0.004
"""Relative standard deviation of a focal length from which a warning is given."""
STRETCH_VIEWS, STRETCH_SIGNIFICANT = 6, 4.0
"""Minimum number of views per camera needed to estimate scatter, and significance threshold [sigma]
of a stretched board, for many views."""
LEAST_STRETCH, LEAST_STRETCH_IN_MOTION = 5e-4, 1e-3
"""Stretch that makes focal lengths as wrong as good recordings leave them uncertain, and with which
rows of moving eyes must not be used: with 0.2 % and corners known to 0.01 px points were wrong by
12 % where rows at rest left 1 %, since the images of one motion share the error."""
SLANT = "slant the board by 20 to 40 degrees, in different directions"


def check_excitation(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse eyes that turn too little, or about one axis only, before each board at rest.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known.
    """
    if seen.eye_motion == "fixed":
        return
    turned = {
        name: T[most_seen(seen.placement, known_poses(T)), :3, :3]
        for name, T in T_cam_target.items()
    }
    if findings := list(little_turned(turned, camera_eyes(seen))):
        raise VergenceError(" ".join(each.sentence for each in findings))


def doubtful_focal_lengths(
    head: HeadCalibration,
    focal_std_px: Mapping[str, tuple[float, float]],
) -> list[Finding]:
    """Warn of focal lengths that the boards do not determine, by the std of fx and fy by camera."""
    findings = []
    for name, std_px in focal_std_px.items():
        part = float((std_px / np.diag(head.cameras[name].intrinsics.matrix)[:2]).max())
        if part > FOCAL_PART:
            sentence = (
                f"{name}.fx and fy are known to {100 * part:.1f} % only: record more views, and "
                f"{SLANT}."
            )
            findings.append(warning("focal-length", sentence, name))
    return findings


def stretch(
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    intrinsics: Mapping[str, Intrinsics],
) -> tuple[float, float]:
    """Estimate how much higher than wide squares are, relative to it, with its standard deviation.

    A board that a printer has stretched looks like pixels that are not square; where boards are
    rolled or slanted the stretch turns with the board, and that of the pixels does not. The
    deviation is infinite where no camera shows it. T_cam_target has by camera the poses (V, 4, 4)
    of the board by its intrinsics, NaN where not known.
    """
    points, found = corner_points(observations.board), []
    for name, each in intrinsics.items():
        corners, T = observations.corners[name], T_cam_target[name]
        usable = determines_pose(points, seen_corners(corners)) & known_poses(T)
        found.append(_stretch_of_camera(each, T[usable], corners[usable], points))
    values, stds = np.array(found).reshape(-1, 2).T
    information = (1 / stds**2).sum()
    if not information > 0:
        return 0.0, np.inf
    return float((values / stds**2).sum() / information), float(1 / np.sqrt(information))


def stretched_board(
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    intrinsics: Mapping[str, Intrinsics],
    *,
    moving: bool,
) -> list[Finding]:
    """Find squares that are not square; the arguments are stretch's.

    With rows of moving eyes, whose images share the error, the result must not be used.
    """
    value, std = stretch(observations, T_cam_target, intrinsics)
    # The deviation of few views is uncertain itself.
    redundancy = sum(known_poses(T_cam_target[name]).sum() - 1 for name in intrinsics)
    significant = t.isf(norm.sf(STRETCH_SIGNIFICANT), max(redundancy, 1))
    if not abs(value) > max(significant * std, LEAST_STRETCH):
        return []
    board = observations.board
    height_m = (1 + value) * (board.square_y_m or board.square_m)
    sentence = (
        f"The squares of the board are {100 * abs(value):.2f} % "
        f"{'higher' if value > 0 else 'lower'} than wide by the images (one standard deviation: "
        f"{100 * std:.2f} %), which makes focal lengths wrong by as much: measure the board along "
        "its rows and its columns, state both sides in dataset.json (by the images "
        f"board.square_y_m is {height_m:.6g} if board.square_m is right), and check that it is "
        "flat."
    )
    if moving and abs(value) > LEAST_STRETCH_IN_MOTION:
        sentence += " With rows of moving eyes it makes gains and axes wrong; leave them out."
        return [void("stretched-board", sentence)]
    return [warning("stretched-board", sentence)]


def _stretch_of_camera(
    lens: Intrinsics, T_cam_target: Array, corners: Array, points: Array
) -> tuple[float, float]:
    """Return the stretch and its standard deviation, by one step of least squares from a fit.

    The deviation is infinite where views or corners are too few.
    """
    camera, step_m = lens.camera, 1e-6
    errors, by_pose, by_lens = board_errors(camera, T_cam_target, corners, points)
    stretched, *_ = board_errors(camera, T_cam_target, corners, points * [1, 1 + step_m, 1])
    by_stretch = (stretched - errors)[..., None] / step_m
    by_all = np.concatenate([by_lens[..., lens.free], by_stretch], axis=2)
    # A view of few corners may have a pose that puts one of them behind the camera.
    before = np.isfinite(errors).all(axis=1) & np.isfinite(by_all).all(axis=(1, 2))
    if before.sum() < STRETCH_VIEWS:
        return 0.0, np.inf
    errors, corners = errors[before], corners[before]
    rest = without_poses(by_pose[before], by_all[before])
    information_inverse = noise_covariance(rest, 1.0)
    step = -information_inverse @ np.einsum("vin,vi->n", rest, errors)
    left = errors + rest @ step
    redundancy = 2 * seen_corners(corners).sum() - 6 * len(corners) - rest.shape[2]
    if redundancy < 1:
        return 0.0, np.inf
    variance = (left**2).sum() / redundancy
    by_noise, by_views = information_inverse * variance, jackknife_covariance(left, rest)
    return float(step[-1]), float(np.sqrt(max(by_noise[-1, -1], by_views[-1, -1])))
