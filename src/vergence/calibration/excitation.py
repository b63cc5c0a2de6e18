"""Whether the eyes and the board moved enough for a calibration.

A start that rests on noise leads bundle adjustment to a wrong optimum, whose stated accuracy is
wrong as well; motion that is too small is refused before. The images show how far an eye turned.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_findings import ADVISED
from vergence.calibration.observations import Observations, camera_eyes, most_seen
from vergence.errors import VergenceError, counted
from vergence.findings import Finding, warning
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, eye_joint_angles
from vergence.geometry.se3 import known_poses, rotvec

LEAST_MOTION_RAD = 0.01
"""Minimum root mean square turn of an eye about its second axis: with a joint noise of 0.3 degrees
and 20 views the paper's method is then wrong by 7 degrees."""
ONE_ANGLE_RAD = 0.1
"""Root mean square spread of the boards' normals below which they stand at one angle."""
FOCAL_PART, FOCAL_SURE = 0.004, 1e-4
"""Standard deviation of a focal length, relative to it, from which it is doubted, and below which
the eye's own turns have slanted the board."""
SLANT = "slant the board by 20 to 40 degrees, in different directions"


def check_excitation(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse eyes that turn too little, or about one axis only, before each board at rest.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known.
    """
    best: dict[int, tuple[float, float, str, np.ndarray]] = {}
    for name, eye in camera_eyes(seen).items():
        rows = most_seen(seen.placement, known_poses(T_cam_target[name]))
        R = T_cam_target[name][rows, :3, :3]
        spread = _spread(rotvec(R @ R[:1].swapaxes(1, 2)))
        found = (float(spread[1]), float(spread[0]), name, rows)
        e = EYES.index(eye)
        best[e] = max(best.get(e, found), found, key=lambda each: (each[0], len(each[3])))
    said = [_lacking(seen, e, *best[e]) for e in sorted(best) if best[e][0] < LEAST_MOTION_RAD]
    if said:
        raise VergenceError(" ".join(said))


def _lacking(
    seen: Observations, e: int, second: float, first: float, name: str, rows: np.ndarray
) -> str:
    """Say how an eye moved, and what to move instead."""
    eye, joints = EYES[e], seen.kinematics.eyes[EYES[e]]
    measured = seen.T_base_eye is not None
    advice = f"turn it {ADVISED} about two axes" if measured else f"move each joint {ADVISED}"
    how = ""
    if not measured and len(joints) < 2:
        how = f" (by `kinematics` it has {counted(len(joints), 'joint')})"
        advice = "describe the joints of what carries it, or leave the camera out"
    elif not measured and len(rows) > 2:
        moved = eye_joint_angles(seen.kinematics, eye, seen.eye_angles[rows]).std(axis=0)
        moves = zip(joints, moved, strict=True)
        how = f" ({', '.join(f'{joint.name} by {rad:.2g} rad' for joint, rad in moves)})"
    if len(np.unique(seen.placement)) == len(seen.placement):
        advice = "give the views of a board that stands still one number in `placement`"
    return (
        f"{name}.T_eye_cam is not observable: before a board at rest, in "
        f"{counted(len(rows), 'view')}, the {eye} eye turns by {first:.2g} rad about one axis and "
        f"by {second:.2g} rad about another{how}; {advice}, and record 20 views or more of one "
        "board."
    )


def _spread(vectors: Array) -> Array:
    """Compute the standard deviations (3,) of vectors (N, 3) along their principal axes."""
    if len(vectors) < 3:
        return np.zeros(3)
    away = vectors - vectors.mean(axis=0)
    return np.linalg.svd(away, compute_uv=False) / np.sqrt(len(vectors))


def doubtful_focal_lengths(
    seen: Observations,
    T_cam_target: Mapping[str, Array],
    head: HeadCalibration,
    focal_std_px: Mapping[str, tuple[float, float]],
) -> list[Finding]:
    """Warn of focal lengths that the boards do not determine.

    By camera T_cam_target are the board's poses (V, 4, 4), NaN where not known, and focal_std_px
    the standard deviations of fx and fy.
    """
    findings, eye_poses = [], seen.eye_poses()
    for name, mounted in head.cameras.items():
        part = float((focal_std_px[name] / np.diag(mounted.intrinsics.matrix)[:2]).max())
        if part > FOCAL_PART:
            sentence = (
                f"{name}.fx and fy: hardly observable, known to {100 * part:.1f} %; record more "
                f"views, and {SLANT}."
            )
            findings.append(warning("focal-length", sentence, name))
        if part < FOCAL_SURE:
            continue
        T_base_eye = eye_poses[:, EYES.index(mounted.eye)]
        normals = (T_base_eye @ mounted.T_eye_cam @ T_cam_target[name])[:, :3, 2]
        known = np.isfinite(normals).all(axis=1)
        numbers = np.unique(seen.placement[known])
        means = [normals[known & (seen.placement == p)].mean(axis=0) for p in numbers]
        if means and _spread(np.array(means))[0] < ONE_ANGLE_RAD:
            sentence = (
                f"{name}.fx and fy: hardly observable, all boards stand at one angle, and only the "
                f"turns of the eyes determine them; {SLANT}."
            )
            findings.append(warning("boards-at-one-angle", sentence, name))
    return findings
