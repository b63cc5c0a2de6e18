"""Whether the joint readings are what the description says: the images know how the eyes turned.

Before a board at rest the turns of a camera are linear in the readings, turn = u pan + v tilt, as
long as they are small; u and v are the joints' axes in frame cam, as long as the gains. That shows
wrong units, wrong signs, and exchanged joints and eyes before any of them spoils a calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.checks import board_flips
from vergence.calibration.observations import Observations, camera_eyes, most_seen_board
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYE_COLUMNS, EYES
from vergence.geometry.se3 import angle, inverse, rotvec

LEAST_VIEWS_AT_REST = 6
"""Of a board at rest, to say something about readings."""
LEAST_TURN_RAD = 0.02
"""Root mean square, about the second axis; less is too near to the noise of readings, and says
nothing of one of the joints. `excitation` and the bundle adjustment speak of such motion."""
EXPLAINED = 0.8
"""Part of the turns' variance that good readings explain at least: at the least turn, with noise
of half a degree."""
LOST = 0.5
"""Part below which readings are not of this eye, or not of these moments."""
DEAD = 0.03
"""Part of the other joint's motion, below which a reading does not change."""
GAINS = (0.6, 1.6)
"""Of a joint that is calibrated; others are another unit, or another joint."""
DEGREES_PER_RAD = np.degrees(1.0)
MOST_TURNED_DEG = 30.0
"""Between the bases of the eyes; their axes are the head's, as built."""
ASIDE = 0.7
"""Cosine of the angle between the line through the eyes and the head's y axis, at least."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """How the readings of an eye explain the turns of a camera before a board at rest."""

    axes: Array
    """(2, 3) u and v."""
    explained: float
    """Part of the turns' variance that the readings explain."""
    moved: Array
    """(2,) standard deviations of the readings [rad]."""


@dataclass(frozen=True, eq=False)
class _Turns:
    """Of one camera before the board that it sees most often."""

    camera: str
    views: int
    own: _Fit
    """By the readings of the camera's own eye."""
    other: _Fit
    """By those of the other eye."""


def check_encoders(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse readings at rest that the images contradict: VergenceError says what they seem to be.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known.
    """
    if seen.T_base_eye is not None or not np.isfinite(seen.eye_angles).all():
        return
    found: dict[int, _Turns] = {}
    for name, eye in camera_eyes(seen).items():
        e = EYES.index(eye)
        turns = _turns(seen, name, e, T_cam_target[name]) if name in T_cam_target else None
        if turns is not None and (e not in found or turns.views > found[e].views):
            found[e] = turns
    to_left = _direction_to_the_left(found, T_cam_target)
    said = _exchanged(found, to_left)
    if not said:
        said = [
            sentence
            for e in sorted(found)
            for sentence in _contradictions(found[e], EYES[e], to_left.get(e))
        ]
    if said:
        raise VergenceError(" ".join(said))


def doubts(head: HeadCalibration) -> list[str]:
    """Return sentences on eyes that a calibration puts where none can be."""
    if len({mounted.eye for mounted in head.cameras.values()}) < 2:
        return []
    said = []
    across = np.degrees(angle(head.T_rbase_lbase[:3, :3]))
    if across > MOST_TURNED_DEG:
        said.append(
            f"T_rbase_lbase: the bases of the eyes are turned by {across:.0f} degrees against each "
            "other, though pan and tilt of both turn about the head's axes: check the signs of one "
            "eye's readings, and which is pan and which tilt."
        )
    t = head.T_rbase_lbase[:3, 3]  # of the left eye in the right one's base
    if t[1] < ASIDE * np.linalg.norm(t):
        ahead, left, above = 1e3 * t
        said.append(
            f"T_rbase_lbase puts the left eye {left:.0f} mm to the left of the right one, "
            f"{ahead:.0f} mm ahead of it and {above:.0f} mm above: check which images and readings "
            "are left and right, and the signs of pan and tilt."
        )
    return said


def _turns(seen: Observations, name: str, e: int, T_cam_target: Array) -> _Turns | None:
    """Return how a camera turns; None where it does so too little, or in too few views."""
    rows = most_seen_board(seen, T_cam_target)
    if len(rows) < LEAST_VIEWS_AT_REST:
        return None
    R = board_flips.nearest(T_cam_target[rows, :3, :3], seen.board)
    # A camera that turns by T sees a board at rest turn by its inverse.
    turn = rotvec(R[:1] @ np.swapaxes(R, 1, 2))
    turn = turn - turn.mean(axis=0)
    if np.linalg.svd(turn, compute_uv=False)[1] < LEAST_TURN_RAD * np.sqrt(len(turn)):
        return None
    fits = []
    for eye in (e, 1 - e):
        read = seen.eye_angles[rows, EYE_COLUMNS[EYES[eye]]]
        read = read - read.mean(axis=0)
        axes = np.linalg.lstsq(read, turn, rcond=None)[0]
        left = ((turn - read @ axes) ** 2).sum() / (turn**2).sum()
        fits.append(_Fit(axes, 1 - float(left), read.std(axis=0)))
    return _Turns(name, len(rows), *fits)


def _direction_to_the_left(
    found: Mapping[int, _Turns], poses: Mapping[str, Array]
) -> dict[int, Array]:
    """Return by eye the unit vector (3,) from the right to the left camera, in its camera's frame.

    Empty where no view shows the board to both.
    """
    if len(found) < 2:
        return {}
    T = poses[found[1].camera] @ inverse(poses[found[0].camera])
    T = T[np.isfinite(T).all(axis=(1, 2))]
    if not len(T):
        return {}
    # Boards numbered from the wrong end move the camera, but not in most views.
    in_left = np.median(-inverse(T)[:, :3, 3], axis=0)
    in_right = np.median(T[:, :3, 3], axis=0)
    return {e: t / np.linalg.norm(t) for e, t in enumerate((in_left, in_right))}


def _exchanged(found: Mapping[int, _Turns], to_left: Mapping[int, Array]) -> list[str]:
    """Return a sentence if left and right are exchanged, and what of them."""
    if len(found) < 2:
        return []
    follows_own = all(turns.own.explained > EXPLAINED for turns in found.values())
    follows_other = all(turns.other.explained > EXPLAINED for turns in found.values())
    if not follows_own and not follows_other:
        return []
    left, right = (found[e].camera for e in (0, 1))
    axes = [(turns.own if follows_own else turns.other).axes for turns in found.values()]
    if any(np.cross(tilt, pan)[2] <= 0 for pan, tilt in axes):
        return []  # one joint alone counts the other way: of that speaks _contradictions
    aside = None  # how far the left eye's camera stands to the left of the right one's
    if to_left:
        up = (found[1].own if follows_own else found[1].other).axes[0]
        aside = float(np.cross(up / np.linalg.norm(up), [0.0, 0.0, 1.0]) @ to_left[1])
    if follows_own:
        if aside is None or aside > 0:
            return []
        what = "images and joint readings"
        if follows_other:
            what = f"images, or {what},"
        return [
            f"{left} stands to the right of {right} by the images: left and right are exchanged in "
            f"the {what} (or pan and tilt both count the other way)."
        ]
    follow = "The images of each eye follow the joint readings of the other"
    if aside is None:
        return [
            f"{follow}: left and right are exchanged, in the images or in the columns of joint "
            "readings."
        ]
    side, what = ("left", "columns of the joint readings") if aside > 0 else ("right", "images")
    return [
        f"{follow}, and the left camera stands to the {side} of the right one: left and right are "
        f"exchanged in the {what}."
    ]


def _contradictions(turns: _Turns, eye: str, to_left: Array | None) -> list[str]:
    """Return sentences on readings of an eye that contradict their description.

    `to_left` is the direction (3,) from the right to the left camera, in frame cam; None: not
    known, and the camera is taken to stand upright.
    """
    fit = turns.own
    if fit.explained < EXPLAINED and fit.moved.min() < DEAD * fit.moved.max():
        joint = ("pan", "tilt")[int(fit.moved.argmin())]
        return [
            f"The readings of {eye}_{joint} hardly change ({fit.moved.min():.2g} rad), though "
            f"{turns.camera} turns about that axis too before a board at rest: check their column "
            "and the sensor."
        ]
    if fit.explained < LOST:
        return [
            f"The readings of {eye}_pan and {eye}_tilt explain {100 * max(fit.explained, 0):.0f} % "
            f"of the turns that {turns.camera} makes before a board at rest: they are not of this "
            "eye, not of these moments, or the board moved."
        ]
    if fit.explained < EXPLAINED:
        return []  # too noisy to say more; the noise is estimated, and warned of
    gains = np.linalg.norm(fit.axes, axis=1)
    said = []
    for joint, gain in zip(("pan", "tilt"), gains, strict=True):
        why = "check its unit, its gear and its column"
        for factor, unit, key in (
            (DEGREES_PER_RAD, "degrees", "deg"),
            (1 / DEGREES_PER_RAD, "radians", "rad"),
        ):
            if GAINS[0] < gain * factor < GAINS[1]:
                why = f"they are {unit}; set joints.{eye}_{joint}.unit to {key}"
        if not GAINS[0] < gain < GAINS[1]:
            said.append(
                f"{turns.camera} turns by {gain:.3g} times the readings of {eye}_{joint}: {why}."
            )
    if said:
        return said
    up, left = (axis / np.linalg.norm(axis) for axis in fit.axes)
    if np.cross(left, up)[2] > 0:
        return []
    # By their description, the camera would look out of the back of the eye. The tilt axis of both
    # eyes points to the left; of a camera that stands upright that is along -x, and up along -y.
    y = np.array([-1.0, 0.0, 0.0]) if to_left is None else to_left
    z = np.cross([0.0, 0.0, 1.0], y)
    pan_up, tilt_left, pan_left, tilt_up = up @ z, left @ y, up @ y, left @ z
    if min(abs(pan_left), abs(tilt_up)) > max(abs(pan_up), abs(tilt_left)):
        what = f"{eye}_pan and {eye}_tilt are exchanged"
    else:
        joint = f"{eye}_pan" if pan_up <= tilt_left else f"{eye}_tilt"
        what = f"{joint} counts the other way; set joints.{joint}.sign to its opposite"
    sure = ", if the camera stands upright" if to_left is None else ""
    return [f"By the readings, {turns.camera} would look backwards out of its eye: {what}{sure}."]
