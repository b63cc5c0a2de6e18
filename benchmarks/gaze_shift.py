"""Look from one object to the next, with eyes and neck, and keep the image still meanwhile.

Objects stand where another appears when the last one goes, up to 60 degrees apart. The eyes go
first; when the neck follows they turn back, and the object must stay where it is in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.foveate import SETTLED_PX
from vergence.gaze.commands import HEAD_JOINTS, NECK, Limits
from vergence.gaze.controller import Settings, State, look, start
from vergence.geometry.head import T_head_base
from vergence.geometry.se3 import inverse, transform
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import TwinHead, foveal_errors

PAN_RAD, TILT_RAD = np.radians([45.0, 18.0])
"""Farthest from straight ahead: what the neck reaches, with the eyes near their middle."""
ANGLE_RAD = np.radians([20.0, 60.0])
"""Least and greatest angle between an object and the next, as the head sees it."""
DISTANCE_M = (0.5, 1.5)
EACH_S = 3.0
"""How long an object stays."""
TURNING_RAD_S = 0.05
"""Speed from which the neck counts as turning."""


@dataclass(frozen=True, eq=False)
class Shift:
    """What one change of objects came to."""

    angle_rad: float
    """Between the two objects."""
    reached_s: float
    """From the appearance until both narrow images have it within SETTLED_PX; infinity: never."""
    turning_px: float
    """Farthest from either centre after that, while the neck was still turning; 0: it was not."""
    turning_frames: int
    """In which that was so."""
    final_px: float
    """The worse eye's distance at the end."""
    neck_rad: float
    """How far the neck turned, its largest joint."""
    beyond_rad: float
    """How far a joint went beyond its range; negative: none did."""


def objects(shifts: int, seed: int) -> Array:
    """Return where objects stand (shifts + 1, 3) [m] in frame head, one after the other."""
    rng = np.random.default_rng([seed, 8])
    found: list[Array] = []
    while len(found) < shifts + 1:
        pan, tilt = rng.uniform(-1, 1, 2) * [PAN_RAD, TILT_RAD]
        ray = np.array([np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), -np.sin(tilt)])
        if not found or ANGLE_RAD[0] < _angle(ray, found[-1]) < ANGLE_RAD[1]:
            found.append(rng.uniform(*DISTANCE_M) * ray)
    return np.array(found)


def _angle(a: Array, b: Array) -> float:
    return float(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))


def number_at(time_s: float | Array) -> Array:
    """Return which object stands there at times (...), by one rule however times are rounded."""
    return np.floor(np.round(np.asarray(time_s, float) / EACH_S, 6))


def shift_gaze(twin: Twin, settings: Settings, run: int, places_head: Array) -> list[Shift]:
    """Show objects one after the other; return what each change but the first came to.

    Args:
        twin: the head.
        settings: of the controller, whose `use_neck` is set.
        run: number of the run, for the noise.
        places_head: (N, 3) where objects stand [m], in frame head at rest.
    """
    places = transform(inverse(T_head_base(twin.truth, "left")), places_head)

    def path(time_s: float) -> Array:
        return places[min(int(number_at(time_s)), len(places) - 1)]

    head = TwinHead(twin, run, path, limits=settings.limits)
    times: list[float] = []
    errors: list[float] = []
    angles: list[Array] = []

    def keep(state: State, frame: Frame | None) -> None:
        if frame is not None:
            times.append(frame.time_s)
            errors.append(float(foveal_errors(twin, settings.calibration).max()))
            angles.append(twin.true_angles())

    state = start(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
    look(head, settings, state, EACH_S * len(places) - 0.05, watch=keep)
    time, error, angle = np.array(times), np.array(errors), np.array(angles)
    return [
        _judged(settings.limits, time, error, angle, k, _angle(places_head[k - 1], places_head[k]))
        for k in range(1, len(places))
    ]


def _judged(
    limits: Limits, time: Array, error: Array, angle: Array, number: int, angle_rad: float
) -> Shift:
    """Return what became of the object of a number, from the course of the whole run."""
    turning = np.abs(np.gradient(angle[:, NECK], time, axis=0)).max(axis=1) > TURNING_RAD_S
    here = number_at(time) == number
    reached = np.flatnonzero(here & (error < SETTLED_PX))
    after = here & (time >= (time[reached[0]] if len(reached) else np.inf))
    lower, upper = limits.range_rad.T
    return Shift(
        angle_rad=angle_rad,
        reached_s=float(time[reached[0]] - number * EACH_S) if len(reached) else np.inf,
        turning_px=float(error[turning & after].max(initial=0.0)),
        turning_frames=int((turning & after).sum()),
        final_px=float(error[here][-1]),
        neck_rad=float(np.ptp(angle[here][:, NECK], axis=0).max()),
        beyond_rad=float(np.maximum(lower - angle[here], angle[here] - upper).max()),
    )
