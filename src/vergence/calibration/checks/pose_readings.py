"""Whether eyes move as they are described: the images know how they did.

This is about eyes whose poses are measured, and about the order of the joints of others. Between
two views of a board at rest the eye moves by A, as it was measured, and its camera by B, as the
images show; A X = X B with X = T_eye_cam. Poses that are inverted, in another unit or of other rows
do not fit, and what they seem to be is found by trying.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.checks import board_flips
from vergence.calibration.checks.encoders import LEAST_VIEWS_AT_REST
from vergence.calibration.checks.reading_fit import OUTLIER, OUTLIER_RAD, OUTLIERS
from vergence.calibration.hand_eye import robust_park_martin
from vergence.calibration.observations import Observations, camera_eyes, most_seen
from vergence.errors import VergenceError
from vergence.findings import Finding, warning
from vergence.geometry.kinematics import EYES, Side, eye_joint_angles
from vergence.geometry.se3 import angle, inverse, known_poses, pose, rotation

LEAST_TURN_RAD = 0.03
"""Median turn between views, below which noise says as much as the poses."""
MISFIT_SHARE = 0.15
"""Part of the median turn by which poses and images may differ in the median."""
LEAST_MISFIT_RAD = np.radians(0.3)
"""Misfit, in the median, below which no other explanation is looked for."""
BETTER = 1 / 3
"""Largest misfit of an explanation, as a part of the misfit of the poses as they are."""
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "kilometres": 1e3}
UNIT_WITHIN = 0.1
"""Relative difference up to which a ratio of lengths is taken for one of these units."""
LENGTH = (0.8, 1.25)
"""Lengths of the poses relative to those of the images; others are no error of a board's size."""
FARTHEST_M = 10.0
"""Distance of an eye from its base that no head is assumed to have; millimetres look farther."""
LEAST_SHIFT_M = 0.01
"""Median motion, by the images, from which lengths can be compared."""


@dataclass(frozen=True, eq=False)
class CheckedPoses:
    """Observations whose poses fit the images."""

    observations: Observations
    """Without the corners of views whose pose contradicts the others."""
    findings: tuple[Finding, ...]
    """Which these are, and how far they are off."""


def check_pose_readings(seen: Observations, T_cam_target: Mapping[str, Array]) -> CheckedPoses:
    """Compare measured eye poses with the images; single views that contradict them are left out.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known. VergenceError
    says what the poses seem to be, if they are not what they should be. Without measured poses
    nothing is done. Views of moving eyes are not compared: a time offset looks like another row.
    """
    if seen.T_base_eye is None:
        return CheckedPoses(seen, ())
    eyes, findings = camera_eyes(seen), []
    left_out: set[tuple[Side, int]] = set()
    for name, eye in eyes.items():
        at_rest = np.where(seen.at_rest[:, None, None], T_cam_target[name], np.nan)
        rows = most_seen(seen.placement, known_poses(at_rest))
        T_eye, T_cam = seen.T_base_eye[rows, EYES.index(eye)], at_rest[rows]
        known = known_poses(T_eye)
        rows, T_eye, T_cam = rows[known], T_eye[known], T_cam[known]
        if len(rows) < LEAST_VIEWS_AT_REST:
            continue
        T_cam[:, :3, :3] = board_flips.nearest(T_cam[:, :3, :3], seen.board)
        turn = float(
            np.median(angle(_motions(T_eye)[:, :, :3, :3])[*np.triu_indices(len(rows), 1)])
        )
        if turn < LEAST_TURN_RAD:
            continue
        by_view = _misfits(T_eye, T_cam)
        misfit = float(np.median(by_view))
        cause = _what_they_are(T_eye, T_cam, misfit)
        if misfit > MISFIT_SHARE * turn or (cause and misfit > LEAST_MISFIT_RAD):
            cause = cause or "they are not of this eye or not of these moments, or the board moved"
            raise VergenceError(
                f"The poses of the {eye} eye differ by {np.degrees(misfit):.1f} degrees in the "
                f"median from the turns that {name} shows before a board at rest: {cause}."
            )
        bad = by_view > max(OUTLIER * misfit, OUTLIER_RAD)
        bad &= bad.mean() <= OUTLIERS
        said = _wrong_unit(name, eye, T_eye[~bad], T_cam[~bad])
        if said:
            raise VergenceError(said)
        for row, off in zip(rows[bad].tolist(), by_view[bad], strict=True):
            sentence = (
                f"View {row}: the pose of the {eye} eye differs by {np.degrees(off):.1f} degrees "
                f"from what {name} shows beside the other views; it was left out: are two rows "
                "exchanged?"
            )
            findings.append(warning("odd-pose", sentence, f"view {row}, {eye} eye"))
            left_out.add((eye, row))
    corners = {name: c.copy() for name, c in seen.corners.items()} if left_out else seen.corners
    for eye, row in left_out:
        for name, own in eyes.items():
            if own == eye:
                corners[name][row] = np.nan
    return CheckedPoses(replace(seen, corners=corners), tuple(findings))


def check_axis_order(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse eyes whose joints follow one another in another order than described.

    T_cam_target is that of `check_pose_readings`. VergenceError says which order the images show.
    Nothing is done where poses are measured, or the readings are too few or too noisy to tell.
    """
    if seen.T_base_eye is not None:
        return
    for name, eye in camera_eyes(seen).items():
        rows = most_seen(seen.placement, known_poses(T_cam_target[name]))
        joints, chain = seen.kinematics.eyes[eye], seen.kinematics.chains[eye]
        angles = eye_joint_angles(seen.kinematics, eye, seen.eye_angles[rows])
        if len(rows) < LEAST_VIEWS_AT_REST or not np.isfinite(angles).all():
            continue
        T_cam = T_cam_target[name][rows]
        T_cam[:, :3, :3] = board_flips.nearest(T_cam[:, :3, :3], seen.board)
        turns = np.moveaxis(rotation(angles[:, :, None] * chain.axes), 1, 0)
        described = _misfit_of_order(turns, T_cam)
        if described < LEAST_MISFIT_RAD:
            continue
        orders = list(permutations(range(len(joints))))[1:] if len(joints) < 4 else []
        misfits = [_misfit_of_order(turns[list(order)], T_cam) for order in orders]
        if orders and min(misfits) < BETTER * described:
            best = [joints[k].name for k in orders[int(np.argmin(misfits))]]
            given = [joint.name for joint in joints]
            raise VergenceError(
                f"The turns of {name} fit {' before '.join(best)} (to "
                f"{np.degrees(min(misfits)):.2f} degrees in the median), not "
                f"{' before '.join(given)} ({np.degrees(described):.2f} degrees): the {best[-1]} "
                f"axis of the {eye} eye moves with its {best[0]}. Describe its joints in this "
                "order by `kinematics` in dataset.json (docs/other_joints.md)."
            )


def _misfit_of_order(turns: Array, T_cam: Array) -> float:
    """Return the median misfit [rad] of turns (n, N, 3, 3) of joints, one behind the other."""
    R = np.broadcast_to(np.eye(3), T_cam[:, :3, :3].shape)
    for turn in turns:
        R = R @ turn
    return float(np.median(_misfits(pose(R), T_cam)))


def _motions(T: Array) -> Array:
    """Return the motions (N, N, 4, 4) between poses (N, 4, 4)."""
    return inverse(T)[:, None] @ T[None]


def _misfits(T_eye: Array, T_cam_target: Array) -> Array:
    """Return by view (N,) the median difference [rad] of its turns by poses and by images."""
    try:
        R = robust_park_martin(T_eye, T_cam_target)[:3, :3]
    except VergenceError:  # turns about one axis, which other checks speak of
        return np.zeros(len(T_eye))
    A, B = _motions(T_eye)[..., :3, :3], _motions(inverse(T_cam_target))[..., :3, :3]
    off = angle(np.swapaxes(A, -1, -2) @ R @ B @ R.T)
    np.fill_diagonal(off, np.nan)
    return np.nanmedian(off, axis=1)


def _what_they_are(T_eye: Array, T_cam: Array, misfit: float) -> str:
    """Return the likeliest mistake in poses that misfit [rad]; empty: none explains it."""
    tried = {
        # Of quaternions whose numbers are read in the other order come inverse turns of other axes.
        "they are inverted (T_eye_base instead of T_base_eye), or their rotations transposed, or "
        "made of quaternions in another order (x, y, z, w or w, x, y, z)": (
            inverse(T_eye),
            T_cam,
        ),
        "they stand one row too late": (T_eye[1:], T_cam[:-1]),
        "they stand one row too early": (T_eye[:-1], T_cam[1:]),
    }
    off = {what: float(np.median(_misfits(*pair))) for what, pair in tried.items()}
    best = min(off, key=lambda what: off[what])
    if off[best] > BETTER * misfit:
        return ""
    return f"{best}; they then fit to {np.degrees(off[best]):.2f} degrees"


def _wrong_unit(name: str, eye: str, T_eye: Array, T_cam: Array) -> str:
    """Return a sentence on poses whose lengths are in another unit; empty: they are not."""
    X = robust_park_martin(T_eye, T_cam)
    i, j = np.triu_indices(len(T_eye), 1)
    A, B = _motions(T_eye)[i, j], _motions(inverse(T_cam))[i, j]
    # (R_A - 1) t_X + scale t_A = R_X t_B, linear in t_X and in the length of a pose's metre.
    rows = np.concatenate([A[:, :3, :3] - np.eye(3), A[:, :3, 3:]], axis=2).reshape(-1, 4)
    lengths = np.maximum(np.linalg.norm(rows, axis=0), 1e-6)  # shorter is rounding alone
    if np.linalg.cond(rows / lengths) > 1e4:
        # The eye turns about a point: its poses say nothing of lengths, but where the point is.
        far = float(np.median(np.linalg.norm(T_eye[:, :3, 3], axis=1)))
        if far < FARTHEST_M:
            return ""
        return (
            f"By its poses the {eye} eye turns about a point {far:.4g} m from its base: give poses "
            "in metres, from a base in the head."
        )
    if np.median(np.linalg.norm(B[:, :3, 3], axis=1)) < LEAST_SHIFT_M:
        return ""
    scale = np.linalg.lstsq(rows, (B[:, :3, 3] @ X[:3, :3].T).ravel(), rcond=None)[0][3]
    if LENGTH[0] < scale < LENGTH[1]:
        return ""
    unit = next(
        (unit for unit, metres in UNITS.items() if abs(scale / metres - 1) < UNIT_WITHIN), None
    )
    cause = f"they are in {unit}; give metres" if unit else "check their unit, and board.square_m"
    if scale < 0:
        cause = "their coordinates are left-handed, or their translations point the other way"
    return (
        f"By the images of {name}, a length of 1 in the poses of the {eye} eye measures "
        f"{scale:.4g} m: {cause}."
    )
