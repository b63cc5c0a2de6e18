"""Stability of the image while eyes and neck share gaze shifts of 20 to 60 degrees.

    python benchmarks/gaze_shifts.py [--profile ideal] [--shifts 40] [--seed 0]

The twin is calibrated. One object disappears as the next appears. The eyes move first; while the
neck follows they turn back, and the object must stay where it is in the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import tyro

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.foveate import SETTLED_PX
from vergence.gaze.commands import HEAD_JOINTS, NECK, JointLimits
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import SimulatedHead, calibrate_twin, foveal_errors

PAN_RAD, TILT_RAD = np.radians([45.0, 18.0])
"""Greatest angles from straight ahead, which the neck reaches with the eyes near their middle."""
ANGLE_RAD = np.radians([20.0, 60.0])
"""Least and greatest angle between an object and the next, as the head sees it."""
DISTANCE_M = (0.5, 1.5)
EACH_S = 3.0
"""Time for which an object stays."""
TURNING_RAD_S = 0.05
"""Speed from which the neck counts as turning."""
BAR_PX = 20.0
"""Greatest error allowed for a foveated object while the neck turns."""
ARRIVED_PX = 8.0


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

    Places (N, 3) of objects [m] are in frame head at rest; the number of the run seeds the noise.
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
            errors.append(float(foveal_errors(twin, settings).max()))
            angles.append(twin.true_angles())

    state = initial_gaze_state(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
    run_gaze(head, settings, state, EACH_S * len(places_head) - 0.05, watch=keep)
    time, error, angle = np.array(times), np.array(errors), np.array(angles)
    return [
        judged(settings.limits, time, error, angle, k, _angle(places_head[k - 1], places_head[k]))
        for k in range(1, len(places_head))
    ]


def judged(
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


def main(profile: str = "ideal", shifts: int = 40, seed: int = 0) -> None:
    """Print statistics of the gaze shifts.

    Args:
        profile: error profile.
        shifts: number of gaze shifts.
        seed: of everything random.
    """
    with Twin(load_profile(profile), seed=seed) as twin:
        settings = replace(calibrate_twin(twin, seed), use_neck=True)
        done = shift_gaze(twin, settings, 1, objects(shifts, seed))
    table = np.array([[*vars(shift).values()] for shift in done])
    angle, reached, moved, frames, final, neck, beyond = table.T
    angle = np.degrees(angle)
    print(f"{shifts} shifts of {angle.min():.0f} to {angle.max():.0f} degrees, {profile}")
    print(f"ended within {ARRIVED_PX:.0f} px of both centres: {(final < ARRIVED_PX).sum()}")
    print(f"reached after: median {np.median(reached):.2f} s, last {reached.max():.2f} s")
    print(f"the neck turned by: median {np.degrees(np.median(neck)):.0f} degrees")
    print(
        f"object from the centres while the neck still turned ({frames.sum():.0f} frames): "
        f"median {np.median(moved):.1f} px, worst {moved.max():.1f} px, "
        f"below {BAR_PX:.0f} px in {(moved < BAR_PX).sum()}"
    )
    print(f"a joint beyond its range by at most {np.degrees(max(beyond.max(), 0)):.3f} degrees")
    for k in np.argsort(moved)[-3:]:
        print(f"  shift {k}: {angle[k]:.0f} deg, {reached[k]:.2f} s, {moved[k]:.1f} px")


if __name__ == "__main__":
    tyro.cli(main)
