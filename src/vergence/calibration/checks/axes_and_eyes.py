"""Whether a calibration puts axes and eyes where a head can have them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from vergence.arrays import Array
from vergence.findings import Finding, void, warning
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import common_normal
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.se3 import angle
from vergence.stereo.extrinsics import stereo_cameras

MOST_TURNED_DEG = 30.0
"""Between the bases of the eyes; their axes are the head's, as built."""
SURE = 4.0
"""Standard deviations from which an axis stands on the wrong side beyond doubt."""
ASIDE = 0.7
"""Cosine of the angle between the line through the eyes and the head's y axis, at least."""
_ALIKE = 0.2
"""Largest difference of factors, relative to the largest of them, of eyes that turn as one."""
USUAL_BASELINE_M = 0.02, 0.5
"""Between which the baseline of a head is not doubted."""


def impossible_geometry(
    head: HeadCalibration, std: Mapping[str, float] | None = None
) -> list[Finding]:
    """Return findings on axes and eyes that a calibration puts where none can be.

    Args:
        head: the calibration.
        std: stated standard deviations of its parameters, by name; None: none are stated.
    """
    said = _exchanged_axes(head, std or {})
    if len({mounted.eye for mounted in head.cameras.values()}) < 2:
        return said
    across = np.degrees(angle(head.T_rbase_lbase[:3, :3]))
    if across > MOST_TURNED_DEG:
        sentence = (
            f"T_rbase_lbase: the bases of the eyes are turned by {across:.0f} degrees against each "
            "other, though the joints of both turn about the head's axes: check the signs of one "
            "eye's readings, which is of which joint, and that they are zero at straight gaze."
        )
        said.append(void("bases-turned", sentence, "T_rbase_lbase"))
    t = eye_shift(head)
    if t[1] < ASIDE * np.linalg.norm(t):
        sentence = not_beside("T_rbase_lbase puts the left eye", "the right one", t)
        said.append(void("eyes-not-beside", sentence, "T_rbase_lbase"))
    return said


def not_beside(left: str, right: str, shift: Array) -> str:
    """Return a sentence on a left eye that does not stand to the left of the right one.

    Args:
        left: what is said of the left one, up to where it stands.
        right: name of the other.
        shift: (3,) from the right to the left one [m], along the axes of the head.
    """
    ahead, aside, above = 1e3 * shift
    return (
        f"{left} {aside:.0f} mm to the left of {right}, {ahead:.0f} mm ahead of it and {above:.0f} "
        "mm above: check which images and readings are left and right, and the signs of the "
        "joints; if one eye does stand above the other, describe by `kinematics` a head that lies "
        "on its side (docs/other_joints.md)."
    )


def eye_shift(head: HeadCalibration) -> Array:
    """Return where the left eye stands from the right one (3,) [m], looking straight ahead.

    Along the axes of the right eye's base; the length is the baseline.
    """
    left, right = stereo_cameras(head, None)
    kinematics = head.kinematics
    T_lbase_leye, T_rbase_reye = eye_poses(head, straight_gaze(kinematics))
    mixing = [kinematics.chains[eye].mixing for eye in EYES]
    as_one = mixing[0].shape == mixing[1].shape and bool(
        (np.abs(mixing[0] - mixing[1]) <= _ALIKE * np.abs(mixing[0]).max(initial=0.0)).all()
    )
    left_end, right_end = (
        joints[-1].point_m if joints else np.zeros(3)
        for joints in (kinematics.eyes[eye] for eye in EYES)
    )
    if as_one or not np.array_equal(left_end, right_end):
        # A pair that turns as one, or joints elsewhere: the eyes are where their cameras are.
        T_lbase_leye, T_rbase_reye = T_lbase_leye @ left.T_eye_cam, T_rbase_reye @ right.T_eye_cam
    return (head.T_rbase_lbase @ T_lbase_leye)[:3, 3] - T_rbase_reye[:3, 3]


def odd_baseline(head: HeadCalibration) -> list[Finding]:
    """Return a warning if the eyes are nearer to each other, or farther, than those of a head."""
    if len({mounted.eye for mounted in head.cameras.values()}) < 2:
        return []
    baseline, (least, most) = float(np.linalg.norm(eye_shift(head))), USUAL_BASELINE_M
    if least <= baseline <= most:
        return []
    sentence = (
        f"The eyes came out {1e3 * baseline:.1f} mm apart: if they are not, the board's squares "
        "have another size than the dataset says."
    )
    return [warning("odd-baseline", sentence)]


def _exchanged_axes(head: HeadCalibration, std: Mapping[str, float]) -> list[Finding]:
    """Return findings on parallel axes that stand on the other side of the axis before."""
    said, used = [], {mounted.eye for mounted in head.cameras.values()}
    for eye in EYES:
        for before, joint in pairwise(head.kinematics.eyes[eye] if eye in used else ()):
            apart = common_normal(before, joint).parallel_m
            if apart is None:
                continue
            beyond = -(apart + joint.axis_distance_m)
            if beyond > max(apart / 2, SURE * std.get(f"{eye}.{joint.name}_axis_distance_m", 0.0)):
                sentence = (
                    f"The {joint.name} axis of the {eye} eye stands {1e3 * beyond:.0f} mm on the "
                    f"other side of its {before.name} axis than `kinematics` says "
                    f"({1e3 * apart:.0f} mm): check whether their readings are exchanged, and "
                    "`point_m`."
                )
                said.append(void("axes-exchanged", sentence, f"{eye} eye"))
    return said
