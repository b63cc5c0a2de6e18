"""Whether the eyes and the board moved enough for a calibration: what is refused, what is doubted.

A start that rests on noise would lead the bundle adjustment to a wrong optimum, whose stated
accuracy is then wrong as well. So motion too small for the paper's steps is refused before them.
How far an eye turned is taken from the images, which know it better than the joint readings do.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.diagnostics import ADVISED
from vergence.calibration.observations import Observations, camera_eyes, most_seen_board
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYE_COLUMNS, EYES
from vergence.geometry.se3 import rotvec

LEAST_MOTION_RAD = 0.01
"""Root mean square turn of an eye about its second axis, below which nothing is calibrated: with a
joint noise of 0.3 degrees and 20 views the paper's method is then wrong by 7 degrees."""
ONE_ANGLE_RAD = 0.1
"""Root mean square spread of the boards' normals, below which they stand at one angle."""
FOCAL_PART = 0.004
"""Standard deviation of a focal length, relative to it, that deserves a warning."""
SLANT = "slant the board by 20 to 40 degrees, in different directions"


def check_excitation(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse eyes that turn too little, or about one axis only, before each board at rest.

    Args:
        seen: views at rest, all numbered from the same end.
        T_cam_target: by camera (V, 4, 4) poses of the board, NaN where not known.

    Raises:
        VergenceError: names what is not observable, and what to move by how much.
    """
    said, eyes = [], camera_eyes(seen)
    for e, eye in enumerate(EYES):
        found = {}
        for name, T in T_cam_target.items():
            if eyes[name] == eye:
                rows = most_seen_board(seen, T)
                R = T[rows, :3, :3]
                turns = rotvec(R @ R[0].T) if len(rows) else np.zeros((0, 3))
                found[name] = (_spread(turns)[0], rows)
        if found:
            name = max(found, key=lambda each: (found[each][0][1], len(found[each][1])))
            said += _lacking(seen, name, e, *found[name])
    if said:
        raise VergenceError(" ".join(said))


def _spread(vectors: Array) -> tuple[Array, Array]:
    """Return how much vectors (N, 3) spread along their principal axes (3,), and these (3, 3)."""
    if len(vectors) < 3:
        return np.zeros(3), np.eye(3)
    _, s, Vt = np.linalg.svd(vectors - vectors.mean(axis=0), full_matrices=False)
    return s / np.sqrt(len(vectors)), Vt


def _lacking(seen: Observations, name: str, e: int, spread: Array, rows: np.ndarray) -> list[str]:
    """Return a sentence if the motion of an eye is too poor to place its camera."""
    whose = f"the {EYES[e]} eye"
    subject = f"{name}.T_eye_cam"
    advice = f"move pan and tilt {ADVISED}"
    if len(rows) < 3:
        times = ("no view", "one view only", "two views only")[len(rows)]
        return [
            f"{subject} rotation and translation: not observable; {whose} sees a board at rest in "
            f"{times}; let it look at one from 20 angles or more, and {advice}."
        ]
    if spread[1] >= LEAST_MOTION_RAD:
        return []
    if spread[0] < LEAST_MOTION_RAD:
        return [
            f"{subject} rotation and translation: not observable; {whose} turns by "
            f"{spread[0]:.2g} rad only before a board at rest; {advice}."
        ]
    only = f"by {spread[1]:.2g} rad only before a board at rest"
    if seen.T_base_eye is not None:
        axis = _spread(rotvec(seen.T_base_eye[rows, e, :3, :3]))[1][0]
        along = ", ".join(f"{x:.2f}" for x in axis * np.sign(axis[np.abs(axis).argmax()]))
        return [
            f"{subject} rotation about and translation along ({along}): not observable; {whose} "
            f"turns about another axis {only}; turn it about that {ADVISED}."
        ]
    motion = seen.eye_angles[rows, EYE_COLUMNS[EYES[e]]].std(axis=0)
    if motion.min() > motion.max() / 3:
        return [
            f"{subject} rotation and translation along one axis: not observable; pan and tilt of "
            f"{whose} move together, and apart {only}; move one without the other {ADVISED}."
        ]
    k = int(motion.argmin())
    still, open_ = (("pan", "y"), ("tilt", "z"))[k]
    return [
        f"{subject} rotation about {open_} and translation along {open_}: not observable; {still} "
        f"of {whose} moves {only}; move {still} {ADVISED}."
    ]


def doubts(
    seen: Observations,
    T_cam_target: Mapping[str, Array],
    head: HeadCalibration,
    focal_std_px: Mapping[str, tuple[float, float]],
) -> list[str]:
    """Return sentences for focal lengths that the boards do not determine.

    Args:
        seen: all views.
        T_cam_target: by camera (V, 4, 4) poses of the board, NaN where not known.
        head: the calibration.
        focal_std_px: by camera, the standard deviations of fx and fy.
    """
    said = []
    for name, (fx, fy) in focal_std_px.items():
        K = head.cameras[name].intrinsics.matrix
        part = max(fx / K[0, 0], fy / K[1, 1])
        if part > FOCAL_PART:
            said.append(
                f"{name}.fx and fy: hardly observable, known to {100 * part:.2g} %; record more "
                f"views, and {SLANT}."
            )
    alike = [
        name
        for name, mounted in head.cameras.items()
        if _at_one_angle(seen, T_cam_target[name], mounted)
    ]
    if alike:
        said.append(
            f"{', '.join(f'{name}.fx and fy' for name in alike)}: hardly observable, all boards "
            f"stand at one angle, and only the turns of the eyes determine them; {SLANT}."
        )
    return said


def _at_one_angle(seen: Observations, T_cam_target: Array, mounted: MountedCamera) -> bool:
    """Return whether all boards before a camera have nearly the same normal, in the eye's base."""
    T_base_eye = seen.eye_poses()[:, EYES.index(mounted.eye)]
    normals = (T_base_eye @ mounted.T_eye_cam @ T_cam_target)[:, :3, 2]
    known = np.isfinite(normals).all(axis=1)
    if not known.any():
        return False
    numbers = np.unique(seen.placement[known])
    means = [normals[known & (seen.placement == p)].mean(axis=0) for p in numbers]
    return bool(_spread(np.array(means))[0][0] < ONE_ANGLE_RAD)
