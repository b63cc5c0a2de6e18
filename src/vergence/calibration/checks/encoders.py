"""Whether the joint readings are what the description says: the images know how the eyes turned.

Before a board at rest the turns of a camera are linear in the readings, as long as they are small:
turn = sum of w_r reading_r. By the description w_r is gain * R_cam_eye d_r, where d_r is the sum
over the joints of factor * axis. That shows wrong units, wrong signs, and exchanged readings and
eyes before any of them spoils a calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement

import numpy as np

from vergence.arrays import Array
from vergence.calibration.checks import board_flips
from vergence.calibration.checks.axes_and_eyes import ASIDE, not_beside
from vergence.calibration.checks.reading_fit import ReadingFit, fit_readings
from vergence.calibration.observations import Observations, camera_eyes, most_seen
from vergence.errors import VergenceError, listed
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Kinematics, Side
from vergence.geometry.se3 import angle, inverse, known_poses, rotvec

LEAST_VIEWS_AT_REST = 6
"""Fewest views of a board at rest that say something about readings or measured poses."""
LEAST_SPREAD_RAD = 0.02
"""Root mean square, about the second axis; less is too near to the noise of readings, and says
nothing of one of the joints. `excitation` and the bundle adjustment speak of such motion."""
EXPLAINED = 0.8
"""Part of the turns' variance that good readings explain at least: at the least turn, with noise
of half a degree."""
LOST = 0.5
"""Part below which readings are not of this eye, or not of these moments."""
MOST_NOISE_RAD = np.radians(3.0)
"""Root mean square of unexplained turns that no noise of readings makes."""
IDLE = 0.05
"""Part of the turns' variance below which a reading has no part in them."""
LEAST_BASELINE_M = 1e-3
"""Between the cameras of two eyes."""
GAINS = (0.6, 1.6)
"""Least and largest gain of a joint that is calibrated; others mean another unit or joint."""
DEGREES_PER_RAD = np.degrees(1.0)


@dataclass(frozen=True, eq=False)
class _Turns:
    """Turns of one camera before the board that it sees most often."""

    camera: str
    views: int
    own: ReadingFit
    """By the readings of the camera's own eye."""
    other: ReadingFit
    """By those of the other eye."""
    readings: Array
    """(N, r) of the head."""
    turn: Array
    """(N, 3) of the camera [rad]."""


def check_encoders(seen: Observations, T_cam_target: Mapping[str, Array]) -> None:
    """Refuse readings at rest that the images contradict: VergenceError says what they seem to be.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known. How far the
    cameras are apart is known where the boards of a placement are numbered alike.
    """
    if seen.T_base_eye is not None:
        return
    eyes = camera_eyes(seen)
    needed = sorted({r for eye in eyes.values() for r in seen.kinematics.used(eye)})
    read = np.asarray(np.isfinite(seen.eye_angles[:, needed]).all(axis=1))
    T_cam_target = {name: T[read] for name, T in T_cam_target.items()}
    seen = seen.take(read)
    # Readings of an eye without cameras explain nothing.
    seen = replace(seen, eye_angles=np.nan_to_num(seen.eye_angles))
    found: dict[int, _Turns] = {}
    for name, eye in eyes.items():
        e = EYES.index(eye)
        turns = _turns(seen, name, e, T_cam_target[name]) if name in T_cam_target else None
        if turns is not None and (e not in found or turns.views > found[e].views):
            found[e] = turns
    between = _between_the_eyes(found, T_cam_target)
    to_left = {e: t / np.linalg.norm(t) for e, t in between.items()}
    said = _exchanged(seen.kinematics, found, between)
    said = said or _exchanged_readings(seen.kinematics, found)
    if not said:
        said = [
            sentence
            for e in sorted(found)
            for sentence in _contradictions(seen.kinematics, found[e], EYES[e], to_left.get(e))
        ]
    if said:
        raise VergenceError(" ".join(said))


def _turns(seen: Observations, name: str, e: int, T_cam_target: Array) -> _Turns | None:
    """Return how a camera turns; None where it does so too little, or in too few views.

    None too of an eye without joints, since no readings are to explain its turns.
    """
    rows = most_seen(seen.placement, known_poses(T_cam_target))
    if len(rows) < LEAST_VIEWS_AT_REST or not seen.kinematics.used(EYES[e]):
        return None
    R = board_flips.nearest(T_cam_target[rows, :3, :3], seen.board)
    # From the view in the middle of all: the first one may be a wrong one.
    middle = R[angle(R[:, None] @ np.swapaxes(R, 1, 2)).sum(axis=1).argmin()]
    # A camera that turns by T sees a board at rest turn by its inverse.
    turn = rotvec(middle @ np.swapaxes(R, 1, 2))
    turn = turn - turn.mean(axis=0)
    if np.linalg.svd(turn, compute_uv=False)[1] < LEAST_SPREAD_RAD * np.sqrt(len(turn)):
        return None
    readings = seen.eye_angles[rows]
    own, other = (fit_readings(seen.kinematics, EYES[eye], readings, turn) for eye in (e, 1 - e))
    return _Turns(name, len(rows), own, other, readings, turn)


def _between_the_eyes(found: Mapping[int, _Turns], poses: Mapping[str, Array]) -> dict[int, Array]:
    """Return by eye the vector (3,) [m] from the right to the left camera, in its camera's frame.

    Empty where no view shows the board to both. VergenceError if the cameras are in one place.
    """
    if len(found) < 2:
        return {}
    T = poses[found[1].camera] @ inverse(poses[found[0].camera])
    T = T[known_poses(T)]
    if not len(T):
        return {}
    # A board that is still numbered from the wrong end moves the camera, but not in most views.
    in_left = np.median(-inverse(T)[:, :3, 3], axis=0)
    in_right = np.median(T[:, :3, 3], axis=0)
    if min(np.linalg.norm(in_left), np.linalg.norm(in_right)) < LEAST_BASELINE_M:
        raise VergenceError(
            f"By the images {found[0].camera} and {found[1].camera} stand in the same place: is "
            "one set of images there twice?"
        )
    return {0: in_left, 1: in_right}


def _exchanged(
    kinematics: Kinematics, found: Mapping[int, _Turns], between: Mapping[int, Array]
) -> list[str]:
    """Return a sentence if left and right are exchanged, and what of them."""
    if len(found) < 2:
        return []
    left, right = (found[e].camera for e in (0, 1))
    own, other = [found[e].own for e in (0, 1)], [found[e].other for e in (0, 1)]
    follows_own, follows_other = (
        all(f.explained > EXPLAINED for f in fits) for fits in (own, other)
    )
    if not follows_own and not follows_other:
        return []
    fits = own if follows_own else other
    if not all(fit.possible for fit in fits):
        shared = set(kinematics.used("left")) == set(kinematics.used("right"))
        if not shared or not between or not all(fit.possible for fit in other):
            return []  # one joint alone counts the other way: of that speaks _contradictions
        # The images are exchanged, or vergence counts the other way: then each camera stands on its
        # own side, and of that speaks _contradictions too.
        if (between[1] @ other[1].R_cam_eye)[1] > 0:
            return []
        follows_own, fits = False, other
    # From the right eye's camera to the left one's, and how far it stands to the left.
    shift = between[1] @ fits[1].R_cam_eye if between else None
    aside = None if shift is None else float(shift[1])
    if follows_own:
        if shift is None or shift[1] > 0:
            return []
        if shift[1] > -ASIDE * np.linalg.norm(shift):
            return [not_beside(f"By the images {left} stands", right, shift)]
        what = "images and joint readings"
        if follows_other:
            what = f"images, or in both {what}"
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


def _exchanged_readings(kinematics: Kinematics, found: Mapping[int, _Turns]) -> list[str]:
    """Return a sentence if the turns of an eye are explained only once two readings are exchanged.

    They may be of different eyes, and then explain the turns of both.
    """
    lost = [turns for turns in found.values() if turns.own.explained < EXPLAINED]
    for pair in combinations(range(len(kinematics.readings)), 2) if lost else ():
        fits = []
        for e, turns in found.items():
            readings = turns.readings.copy()
            readings[:, pair] = readings[:, pair[::-1]]
            fits.append(fit_readings(kinematics, EYES[e], readings, turns.turn))
        if all(map(_good, fits)):
            names = listed([kinematics.readings[r] for r in pair])
            return [_explain_little(lost[0], f"{names} are exchanged")]
    return []


def _explain_little(turns: _Turns, why: str) -> str:
    """Return the sentence on readings that explain little of a camera's turns, and why."""
    share = max(turns.own.explained, 0.0)
    return (
        f"The readings of {listed(turns.own.names)} explain {100 * share:.0f} % of the turns that "
        f"{turns.camera} makes before a board at rest: {why}."
    )


def _good(fit: ReadingFit) -> bool:
    """Return whether readings turn a camera as they should."""
    in_range = GAINS[0] < fit.gains.min() <= fit.gains.max() < GAINS[1]
    return bool(fit.possible and in_range and fit.explained > EXPLAINED)


def _contradictions(
    kinematics: Kinematics, turns: _Turns, eye: Side, to_left: Array | None
) -> list[str]:
    """Return sentences on readings of an eye that contradict their description.

    `to_left` is the direction (3,) from the right to the left camera, in frame cam; None: not
    known, and the camera is taken to stand upright.
    """
    fit = turns.own
    if fit.explained < EXPLAINED and fit.at_rest.any():
        return [
            f"The readings of {fit.names[int(fit.moved.argmin())]} hardly change "
            f"({fit.moved.min():.2g} rad), though {turns.camera} turns about that axis too before "
            "a board at rest: check their column and the sensor."
        ]
    if fit.explained < LOST or (fit.explained < EXPLAINED and fit.left_rad > MOST_NOISE_RAD):
        why = "they are not of this eye, not of these moments, or the board moved"
        if fit.explained > LOST:
            why = "the eye has a joint that is not described, or a column is of another joint"
        if idle := _without_part(kinematics, turns, eye):
            why = (
                f"those of {idle} have no part in it; check its column, and that the board stood "
                "still in the views of each placement"
            )
        if of_row := _of_another_row(kinematics, turns, eye):
            why = f"they stand one row too {of_row}"
        return [_explain_little(turns, why)]
    if fit.explained < EXPLAINED:
        return []  # too noisy to say more; the noise is estimated, and warned of
    if not fit.possible:
        cause = _what_explains(kinematics, turns, eye, to_left)
        look = f"By the readings, {turns.camera} would look backwards or aside out of its eye"
        return [f"{look}: {cause or 'check the axes of its joints and the signs of readings'}."]
    said = []
    # Of three axes one that counts the other way may look as if it hardly turned the eye.
    cause = None if _good(fit) else _what_explains(kinematics, turns, eye, to_left)
    if cause:
        return [f"The readings do not turn {turns.camera} as its images do: {cause}."]
    table = "joints" if set(kinematics.readings) <= set(EYE_JOINTS) else "readings"
    for name, gain in zip(fit.names, fit.gains, strict=True):
        why = "check its unit, its gear or factor, and its column"
        for factor, unit, value in (
            (DEGREES_PER_RAD, "degrees", "deg"),
            (1 / DEGREES_PER_RAD, "radians", "rad"),
        ):
            if GAINS[0] < gain * factor < GAINS[1]:
                why = f"they are {unit}; set {table}.{name}.unit to {value}"
        if not GAINS[0] < gain < GAINS[1]:
            said.append(f"{turns.camera} turns by {gain:.3g} times the readings of {name}: {why}.")
    return said


def _without_part(kinematics: Kinematics, turns: _Turns, eye: Side) -> str | None:
    """Return the one reading that explains nothing, though it moves and the others explain much.

    None: there is no such.
    """
    idle, used = [], kinematics.used(eye)
    if turns.own.explained < IDLE * len(used):
        return None
    for r in used:
        readings = turns.readings.copy()
        readings[:, r] = 0.0
        without = fit_readings(kinematics, eye, readings, turns.turn)
        if turns.own.explained - without.explained < IDLE:
            idle.append(kinematics.readings[r])
    return idle[0] if len(idle) == 1 else None


def _of_another_row(kinematics: Kinematics, turns: _Turns, eye: Side) -> str | None:
    """Return whether readings stand one row too late or early; None: they do not."""
    readings, turn = turns.readings, turns.turn
    for when, read, turned in (
        ("late", readings[1:], turn[:-1]),
        ("early", readings[:-1], turn[1:]),
    ):
        if _good(fit_readings(kinematics, eye, read, turned)):
            return when
    return None


def _what_explains(
    kinematics: Kinematics, turns: _Turns, eye: Side, to_left: Array | None
) -> str | None:
    """Return which one mistake in the readings would explain the turns; None: no single one.

    A sign, or two readings that are exchanged. Of several the one is named with which the eye's y
    axis points to the left.
    """
    # Of a camera that stands upright left is along -x.
    y = np.array([-1.0, 0.0, 0.0]) if to_left is None else to_left
    found: list[tuple[float, str]] = []
    for a, b in combinations_with_replacement(kinematics.used(eye), 2):
        readings = turns.readings.copy()
        names = [kinematics.readings[a], kinematics.readings[b]]
        if a == b:
            readings[:, a] *= -1
            table = "joints" if set(kinematics.readings) <= set(EYE_JOINTS) else "readings"
            what = (
                f"{names[0]} counts the other way; set {table}.{names[0]}.sign to its opposite "
                "(unless the images are mirrored)"
            )
        else:
            readings[:, [a, b]] = readings[:, [b, a]]
            what = f"{names[0]} and {names[1]} are exchanged"
        fit = fit_readings(kinematics, eye, readings, turns.turn)
        if _good(fit):
            found.append((float(fit.R_cam_eye[:, 1] @ y), what))
    if not found:
        return None
    return max(found)[1] + (", if the camera stands upright" if to_left is None else "")
