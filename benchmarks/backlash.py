"""Check that gains, time offset and backlash lie in their stated regions on heads with backlash.

Simulated heads look at boards from postures at rest, each reached from the one before, and at one
board in 5 s of motion at 30 Hz. The readings are noisy, and older than the images. Either the eye
lags behind its reading, as behind a servo's gear, or the sensor behind the eye.

    python benchmarks/backlash.py --heads 20 --widths-deg 0 0.2 0.6 1.0
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import numpy as np
import tyro

from simulated_head import random_head
from simulated_recording import Noise, facing, observe
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.data.timing import Timing
from vergence.findings import select
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.twin.sensors import play

STRAIGHT, TURNED = 12, 28
STEP_S = 1e-3


@dataclass(frozen=True)
class Tried:
    """Errors of one head in stated standard deviations, and backlash in degrees."""

    gains: list[float]
    time: float
    backlash: list[float]
    width_deg: list[float]
    void: bool


def _moved(path: Array, width: float, of_sensor: bool) -> tuple[Array, Array]:
    """Return angles of the eyes and noise-free readings (N, 4) along a path of commands."""
    lagging = play(path, width) if width else path
    return (path, lagging) if of_sensor else (lagging, path)


def _gaze(t: Array) -> Array:
    pan, tilt = 0.24 * np.sin(2 * np.pi * 0.4 * t), 0.2 * np.sin(2 * np.pi * 0.31 * t + 1)
    return np.stack([pan, tilt, pan, tilt], axis=-1)


def one_head(
    seed: int, width: float, *, noise_rad: float, late_s: float, moving: bool, of_sensor: bool
) -> Tried:
    """Calibrate a head whose backlash has a width [rad]."""
    rng = np.random.default_rng([62, seed])
    truth = without_offsets(random_head(rng, lenses=("wide",)))
    turned = rng.uniform(-1, 1, (TURNED, 4)) * [0.25, 0.21, 0.25, 0.21]
    wanted = np.concatenate([np.zeros((STRAIGHT, 4)), turned])
    before = np.concatenate([wanted[:1], wanted[:-1]])
    path = np.linspace(before, wanted, 20, axis=1).reshape(-1, 4)
    joints, readings = (each[19::20] for each in _moved(path, width, of_sensor))
    time_s, run = np.zeros(len(wanted)), np.zeros(len(wanted), int)
    if moving:
        fine_s, own_s = np.arange(-2, 6, STEP_S), np.arange(0, 5, 1 / 30)
        eye, read = _moved(_gaze(fine_s), width, of_sensor)
        eye, read = (
            np.array([np.interp(t, fine_s, each) for each in angles.T]).T
            for t, angles in ((own_s + late_s, eye), (own_s, read))
        )
        joints, readings = np.concatenate([joints, eye]), np.concatenate([readings, read])
        time_s, run = np.append(time_s, own_s), np.append(run, np.ones(len(own_s), int))
    placement = np.minimum(np.arange(len(joints)), STRAIGHT)
    centre = np.array([0.45, -0.04, 0.0]) + rng.uniform(-0.08, 0.08, (STRAIGHT + 1, 3))
    boards = facing(centre, rng.uniform(-0.6, 0.6, (STRAIGHT + 1, 3)))[placement]
    seen = observe(
        truth, rng, Noise(pixel_px=0.1), placement=placement, T_lbase_target=boards, joints=joints
    )
    noisy = readings + rng.normal(0, noise_rad, readings.shape)
    timing = Timing(time_s, run) if moving else None
    seen = replace(seen, eye_angles=noisy, timing=timing)
    found = bundle_adjust(calibrate_sequentially(seen.take(seen.at_rest)).head, seen)
    off = boxminus(found.head, replace(truth, time_offset_s=late_s * moving))
    std = dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)), strict=True))
    signed = -width if of_sensor else width
    return Tried(
        gains=[off[name] / std[name] for name in std if name.endswith("_gain")],
        time=off["time_offset_s"] / std["time_offset_s"] if moving else 0.0,
        backlash=[(value - signed) / each for value, each in found.backlash_rad.values()],
        width_deg=[np.degrees(value) for value, _ in found.backlash_rad.values()],
        void=bool(select(found.findings, "void")),
    )


def main(
    heads: int = 20,
    widths_deg: tuple[float, ...] = (0.0, 0.2, 0.6, 1.0),
    noise_deg: float = 0.4,
    late_ms: float = 45.0,
    moving: bool = True,
    of_sensor: bool = False,
    seed: int = 0,
) -> None:
    """Print for each width the share of 95 % regions that hold the truth."""
    for width_deg in widths_deg:
        tried = [
            one_head(
                seed + k,
                np.radians(width_deg),
                noise_rad=np.radians(noise_deg),
                late_s=1e-3 * late_ms,
                moving=moving,
                of_sensor=of_sensor,
            )
            for k in range(heads)
        ]
        gains, time, backlash = (
            np.abs(np.array([getattr(each, name) for each in tried]))
            for name in ("gains", "time", "backlash")
        )
        good = np.array([not each.void for each in tried])
        found = np.array([each.width_deg for each in tried])
        print(
            f"{width_deg:g} deg: inside gains {(gains < 1.96).mean():.2f}, time "
            f"{(time < 1.96).mean():.2f}, backlash {(backlash < 1.96).mean():.2f}; worst gain "
            f"{gains[good].max(initial=0):.1f} std; backlash {found.mean():+.3f} +- "
            f"{found.std():.3f} deg; void {len(good) - good.sum()} of {heads}",
            flush=True,
        )


if __name__ == "__main__":
    tyro.cli(main)
