"""Whether the eyes and the board moved enough for a calibration: what is refused, what is doubted.

A start that rests on noise would lead the bundle adjustment to a wrong optimum, whose stated
accuracy is then wrong as well. So motion too small for the paper's steps is refused before them.
How far an eye turned is taken from the images, which know it better than the joint readings do.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_findings import ADVISED
from vergence.calibration.observations import Observations, camera_eyes, most_seen
from vergence.errors import VergenceError, listed
from vergence.findings import Finding, warning
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, eye_joint_angles
from vergence.geometry.se3 import known_poses, rotvec

LEAST_MOTION_RAD = 0.01
"""Root mean square turn of an eye about its second axis, below which nothing is calibrated: with a
joint noise of 0.3 degrees and 20 views the paper's method is then wrong by 7 degrees."""
ONE_ANGLE_RAD = 0.1
"""Root mean square spread of the boards' normals, below which they stand at one angle."""
FOCAL_PART = 0.004
"""Standard deviation of a focal length, relative to it, that deserves a warning."""
FOCAL_SURE = 1e-4
"""Standard deviation of a focal length, relative to it, at which nothing is doubtful."""
SLANT = "slant the board by 20 to 40 degrees, in different directions"


def check_excitation(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse eyes that turn too little, or about one axis only, before each board at rest.

    T_cam_target has by camera the poses (V, 4, 4) of the board, all numbered from the same end, NaN
    where not known. VergenceError says what is not observable, and what to move by how much.
    """
    said, eyes = [], camera_eyes(seen)
    for e, eye in enumerate(EYES):
        found = {}
        for name, T in T_cam_target.items():
            if eyes[name] == eye:
                rows = most_seen(seen.placement, known_poses(T))
                R = T[rows, :3, :3]
                found[name] = (_spread(rotvec(R @ R[:1].swapaxes(1, 2)))[0], rows)
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
    whose, everything = f"the {EYES[e]} eye", "rotation and translation"
    only = f"by {spread[1]:.2g} rad only before a board at rest"
    joints = seen.kinematics.eyes[EYES[e]]
    all_joints = listed([joint.name for joint in joints])
    angles = eye_joint_angles(seen.kinematics, EYES[e], seen.eye_angles[rows])
    motion = angles.std(axis=0) if len(rows) else np.ones(len(joints))
    if seen.T_base_eye is None and not joints:
        what, why = everything, f"{whose} has no joint by `kinematics`"
        advice = "describe the joints of what carries it, or leave the camera out"
    elif len(rows) < 3:
        times = ("no view", "one view only", "two views only")[len(rows)]
        what, why = everything, f"{whose} sees a board at rest in {times}"
        advice = f"let it look at one from 20 angles or more, and move {all_joints} {ADVISED}"
        if len(np.unique(seen.placement)) == len(seen.placement):
            advice = "give the views of a board that stands still one number in `placement`"
    elif spread[1] >= LEAST_MOTION_RAD:
        return []
    elif spread[0] < LEAST_MOTION_RAD:
        what, advice = everything, f"move {all_joints} {ADVISED}"
        why = f"{whose} turns by {spread[0]:.2g} rad only before a board at rest"
    elif seen.T_base_eye is not None:
        axis = _spread(rotvec(seen.T_base_eye[rows, e, :3, :3]))[1][0]
        along = _axis_name(axis * np.sign(axis[np.abs(axis).argmax()]))
        what = f"rotation about and translation along {along}"
        why, advice = f"{whose} turns about another axis {only}", f"turn it about that {ADVISED}"
    elif len(joints) < 2:
        what = f"{everything} along its only axis"
        why, advice = f"{whose} has one joint", "a camera is placed by turns about two axes"
    elif motion.min() > motion.max() / 3:
        what = f"{everything} along one axis"
        why = f"{all_joints} of {whose} move together, and apart {only}"
        advice = f"move one without the other {ADVISED}"
    else:
        still = joints[int(motion.argmin())].name
        axis = _axis_name(joints[int(motion.argmax())].axis)
        what = f"rotation about {axis} and translation along {axis}"
        why, advice = f"{still} of {whose} moves {only}", f"move {still} {ADVISED}"
    return [f"{name}.T_eye_cam {what}: not observable; {why}; {advice}."]


def _axis_name(axis: Array) -> str:
    """Return what to call an axis (3,): x, y, z, or its direction."""
    k = int(np.abs(axis).argmax())
    if abs(axis[k]) > 1 - 1e-9:
        return "xyz"[k]
    return f"({', '.join(f'{x:.2f}' for x in axis)})"


def doubtful_focal_lengths(
    seen: Observations,
    T_cam_target: Mapping[str, Array],
    head: HeadCalibration,
    focal_std_px: Mapping[str, tuple[float, float]],
) -> list[Finding]:
    """Return warnings of focal lengths that the boards do not determine.

    By camera T_cam_target are the board's poses (V, 4, 4), NaN where not known, and focal_std_px
    the standard deviations of fx and fy.
    """
    said = []
    for name, (fx, fy) in focal_std_px.items():
        K = head.cameras[name].intrinsics.matrix
        part = max(fx / K[0, 0], fy / K[1, 1])
        if part > FOCAL_PART:
            sentence = (
                f"{name}.fx and fy: hardly observable, known to {100 * part:.1f} %; record more "
                f"views, and {SLANT}."
            )
            said.append(warning("focal-length", sentence, name))
    alike = []
    for name, mounted in head.cameras.items():
        K = mounted.intrinsics.matrix
        if max(focal_std_px[name]) < FOCAL_SURE * K[[0, 1], [0, 1]].min():
            continue  # the eye's own turns have slanted the board
        T_base_eye = seen.eye_poses()[:, EYES.index(mounted.eye)]
        # Of the boards, in the eye's base.
        normals = (T_base_eye @ mounted.T_eye_cam @ T_cam_target[name])[:, :3, 2]
        known = np.isfinite(normals).all(axis=1)
        numbers = np.unique(seen.placement[known])
        means = [normals[known & (seen.placement == p)].mean(axis=0) for p in numbers]
        if means and _spread(np.array(means))[0][0] < ONE_ANGLE_RAD:
            alike.append(name)
    if alike:
        focal_lengths = ", ".join(f"{name}.fx and fy" for name in alike)
        sentence = (
            f"{focal_lengths}: hardly observable, all boards stand at one angle, and only the "
            f"turns of the eyes determine them; {SLANT}."
        )
        said.append(warning("boards-at-one-angle", sentence, ", ".join(alike)))
    return said
