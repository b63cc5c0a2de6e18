"""Gaze shifts of eyes and neck from one object to the next, and the stability of the image.

One object disappears as the next appears, up to 60 degrees away. The eyes move first; while the
neck follows they turn back, and the object must stay where it is in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.foveate import SETTLED_PX
from vergence.gaze.commands import HEAD_JOINTS, NECK, JointLimits
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import SimulatedHead, foveal_errors

PAN_RAD, TILT_RAD = np.radians([45.0, 18.0])
"""Greatest angles from straight ahead, which the neck reaches with the eyes near their middle."""
ANGLE_RAD = np.radians([20.0, 60.0])
"""Least and greatest angle between an object and the next, as the head sees it."""
DISTANCE_M = (0.5, 1.5)
EACH_S = 3.0
"""Time for which an object stays."""
TURNING_RAD_S = 0.05
"""Speed from which the neck counts as turning."""


@dataclass(frozen=True, eq=False)
class Shift:
    """Result of one gaze shift."""

    angle_rad: float
    """Angle between the two objects."""
    reached_s: float
    """Time from the appearance until both errors are within SETTLED_PX; infinity: never."""
    turning_px: float
    """Greatest error of either eye after that while the neck turned; 0: the neck did not turn."""
    turning_frames: int
    """Number of these frames."""
    final_px: float
    """Error of the worse eye at the end."""
    neck_rad: float
    """Greatest turn of a neck joint."""
    beyond_rad: float
    """Greatest excess of a joint over its range; negative: all stayed within."""


def objects(shifts: int, seed: int) -> Array:
    """Return the positions (shifts + 1, 3) [m] of successive objects in frame head."""
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
    """Return the number of the object at times (...) [s], independently of rounding errors."""
    return np.floor(np.round(np.asarray(time_s, float) / EACH_S, 6))


def shift_gaze(twin: Twin, settings: GazeSettings, run: int, places_head: Array) -> list[Shift]:
    """Show objects one after the other; return the result of each gaze shift but the first.

    Args:
        twin: the head.
        settings: of the controller, whose `use_neck` is set.
        run: number of the run, for the noise.
        places_head: (N, 3) positions of the objects [m], in frame head at rest.
    """

    def path(time_s: float) -> Array:
        return places_head[min(int(number_at(time_s)), len(places_head) - 1)]

    head = SimulatedHead(twin, run, path)
    times: list[float] = []
    errors: list[float] = []
    angles: list[Array] = []

    def keep(state: GazeState, frame: Frame | None) -> None:
        if frame is not None:
            times.append(frame.time_s)
            errors.append(float(foveal_errors(twin, settings.calibration).max()))
            angles.append(twin.true_angles())

    state = initial_gaze_state(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
    run_gaze(head, settings, state, EACH_S * len(places_head) - 0.05, watch=keep)
    time, error, angle = np.array(times), np.array(errors), np.array(angles)
    return [
        _judged(settings.limits, time, error, angle, k, _angle(places_head[k - 1], places_head[k]))
        for k in range(1, len(places_head))
    ]


def _judged(
    limits: JointLimits, time: Array, error: Array, angle: Array, number: int, angle_rad: float
) -> Shift:
    """Return the result for one object, from the time series of the whole run."""
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
