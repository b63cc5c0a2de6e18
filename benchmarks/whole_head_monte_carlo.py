"""Whether the stated accuracy of a whole head is true, over many simulated heads, drawn at random.

    python benchmarks/whole_head_monte_carlo.py --trials 40

Each trial draws a head (baseline, lenses, mountings, gains, axes), a recording of 10 to 18 boards
at straight gaze, 8 to 12 for each narrow camera and 30 to 60 eye orientations before a board at
rest, pixel noise of 0.03 to 0.3 px and joint noise of 0, 0.02, 0.1 or 0.3 degrees. It is calibrated
as `vergence calibrate` does: the paper's method, then bundle adjustment, which is given no noise.
Then a point at rest is located while the eyes move.

Printed are the share of trials in which the stated 95 % region holds the truth, and how the errors
of the located point compare with the covariance that `locate` states. Errors are counted as
`vergence evaluate` counts them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import tyro
from rich.progress import track

from simulated_head import probability, random_head
from simulated_recording import Noise, inside_image, still_recording
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate

JOINT_DEG = (0.0, 0.02, 0.1, 0.3)
PIXEL_PX = (0.03, 0.3)
KINDS = ("T_eye_cam", "T_rbase_lbase", "intrinsics", "axes")
"""Of regions."""


@dataclass(frozen=True)
class Trial:
    """What came of one trial."""

    number: int
    joint_deg: float
    pixel_px: float
    failure: str = ""
    probability: dict[str, float] = field(default_factory=dict)
    """By region: the stated probability of a smaller error; uniform where the statement is true."""
    largest: float = 0.0
    """The largest error of a parameter in stated standard deviations."""
    point: float = 0.0
    """Mean square error of a located point in units of its predicted variance: 1 if true."""
    point_calibration: float = 0.0
    """The same for what the calibration alone does to a point; its samples share one error."""
    point_mm: float = 0.0
    """Root mean square error of a located point."""
    warnings: int = 0


def run(seed: int, number: int) -> Trial:
    """Simulate, calibrate and judge one head."""
    rng = np.random.default_rng([seed, number])
    joint_deg = float(rng.choice(JOINT_DEG))
    pixel_px = float(np.exp(rng.uniform(*np.log(PIXEL_PX))))
    noise = Noise(pixel_px, np.radians(joint_deg))
    truth = random_head(rng)
    observed = still_recording(
        truth,
        rng,
        noise,
        wide_views=int(rng.integers(10, 19)),
        narrow_views=int(rng.integers(8, 13)),
        orientations=int(rng.integers(30, 61)),
        spread_rad=rng.uniform(0.22, 0.3),
    )
    try:
        estimate = bundle_adjust(calibrate_sequentially(observed).head, observed)
    except VergenceError as error:
        return Trial(number, joint_deg, pixel_px, failure=str(error))
    accuracy = estimate.accuracy
    head = replace(estimate.head, accuracy=accuracy)
    off = boxminus(head, truth)
    names, covariance = accuracy.parameters, accuracy.covariance
    error = np.array([off[name] for name in names])
    return Trial(
        number,
        joint_deg,
        pixel_px,
        probability=probabilities(names, covariance, error),
        largest=float(np.abs(error / np.sqrt(np.diag(covariance))).max()),
        warnings=len(accuracy.findings),
        **judge_point(head, truth, noise, rng),
    )


def probabilities(names: tuple[str, ...], covariance: Array, error: Array) -> dict[str, float]:
    """Return by region the stated probability of an error smaller than this one (c,)."""
    found = {}
    region = np.array([name.rpartition(".")[0] for name in names])
    for each in dict.fromkeys(region.tolist()):
        rows = np.flatnonzero(region == each)
        found[each] = probability(error[rows], covariance[np.ix_(rows, rows)])
    return found


def judge_point(
    head: HeadCalibration, truth: HeadCalibration, noise: Noise, rng: np.random.Generator
) -> dict[str, Any]:
    """Return a trial's values of a point that is located 40 times."""
    plain = without_offsets(truth)
    for _ in range(1000):
        at = np.array([rng.uniform(0.4, 1.2), *rng.uniform(-0.1, 0.1, 2)])
        phase = np.linspace(0, 2 * np.pi, 40, endpoint=False)[:, None] * [1, 2, 1, 3]
        readings = rng.uniform(-0.1, 0.1, 4) + rng.uniform(0.05, 0.15, 4) * np.cos(phase)
        left, right = (project_point(plain, f"{eye}_wide", readings, at) for eye in EYES)
        if inside_image(left).all() and inside_image(right).all():
            break
    else:
        raise AssertionError("no motion keeps the point in view")
    found = locate(head, left=left, right=right, joints=readings)
    by_calibration, predicted = found.xyz - at, found.covariance
    left, right = (uv + rng.normal(0, noise.pixel_px, uv.shape) for uv in (left, right))
    readings = readings + rng.normal(0, noise.joint_rad, readings.shape)
    error = triangulate_at(head, left=left, right=right, joints=readings)[0] - at
    return {
        "point": _mean_square(error, predicted),
        "point_calibration": _mean_square(by_calibration, found.calibration_covariance),
        "point_mm": float(1e3 * np.sqrt((error**2).sum(axis=1).mean())),
    }


def _mean_square(errors: Array, covariance: Array) -> float:
    """Return the mean square of errors (N, 3) in units of the variance: 1 where it is true."""
    return float(np.mean(errors[:, None] @ np.linalg.solve(covariance, errors[..., None])) / 3)


def kind(region: str) -> str:
    """Return the kind of a region by its name."""
    name = region.rpartition(".")[2]
    if name.endswith(("wide", "narrow")):
        return "intrinsics"
    return "axes" if name in EYES else name


def shares(trials: list[Trial]) -> dict[str, float]:
    """Return by kind the share of regions that hold the truth."""
    found = [(kind(name), p < 0.95) for trial in trials for name, p in trial.probability.items()]
    return {each: float(np.mean([held for k, held in found if k == each])) for each in KINDS}


def ratio(squares: list[float]) -> float:
    """Return the ratio of observed to predicted standard deviation."""
    return float(np.sqrt(np.mean(squares)))


def main(trials: int = 500, seed: int = 0, first: int = 0) -> None:
    """Print the share of regions that hold the truth, by joint noise, and each failure.

    Args:
        trials: number of heads.
        seed: of everything random.
        first: number of the first trial.
    """
    done = [run(seed, number) for number in track(range(first, first + trials))]
    print(table(done) + "\n")
    for trial in done:
        if trial.failure or (trial.largest > 10 and not trial.warnings):
            print(f"trial {trial.number}: {trial.failure or f'{trial.largest:.0f} std, unwarned'}")


def table(trials: list[Trial]) -> str:
    """Return the results by joint noise, as Markdown."""
    lines = [
        "| joint noise | trials | " + " | ".join(KINDS) + " | point: observed / predicted "
        "| by the calibration alone | largest error [std] | warned |",
        "|---" * (len(KINDS) + 6) + "|",
    ]
    good = [trial for trial in trials if not trial.failure]
    rows = {f"{level:g}°": [t for t in good if t.joint_deg == level] for level in JOINT_DEG}
    for name, mine in {**rows, "all": good}.items():
        if mine:
            cells = [f"{100 * share:.1f} %" for share in shares(mine).values()]
            cells += [
                f"{ratio([t.point for t in mine]):.3f}",
                f"{ratio([t.point_calibration for t in mine]):.3f}",
                f"{max(t.largest for t in mine):.1f}",
                str(sum(t.warnings > 0 for t in mine)),
            ]
            lines.append(f"| {name} | {len(mine)} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
