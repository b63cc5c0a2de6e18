"""What planned views are worth beside random ones, and whether a plan's accuracy is reached.

    python benchmarks/next_views.py
    python benchmarks/next_views.py --straight 8 --orientations 10

For each of many simulated heads, drawn at random, a first recording (pixel noise 0.1 px, joint
noise 0.1 degrees) is calibrated. Then ten more views are recorded: planned ones as `vergence plan`
plans them; random admissible ones, each with the board elsewhere; and random admissible ones that
move the board as seldom as the plan does. In all three the board stands 5 mm and 1 degree off, in
each direction, where it should stand. Each is calibrated together with the first recording.

Printed are the largest standard deviations of a point in the workspace that the calibrations state,
by the calibration alone, what was predicted for the planned views, and how large the true errors of
the points are in units of the stated ones.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np
import tyro
from rich.progress import track

from simulated_head import random_head, rough_start
from simulated_recording import BOARD, Noise, Recording, joined, observe, record
from vergence.accuracy.plan import Plan, plan
from vergence.accuracy.plan_views import Views, admissible_views
from vergence.accuracy.plan_workspace import largest_std, point_by_parameters
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.observations import Observations
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.parameters import parameter_names, without_offsets
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import boxplus
from vergence.stereo.triangulation import triangulate_at

NOISE = Noise(pixel_px=0.1, joint_rad=float(np.radians(0.1)))
LIMITS_RAD = np.radians([25.0, 20.0, 25.0, 20.0])
OFF_RAD, OFF_M = np.radians(1.0), 0.005
BAR, AGREEMENT = 0.8, 0.1


@dataclass(frozen=True)
class Config:
    """How many heads, and what is recorded first."""

    heads: int = 20
    seed: int = 0
    views: int = 10
    straight: int = 12
    """Boards at straight gaze."""
    orientations: int = 24
    """Eye angles at which a board at rest is seen."""


@dataclass(frozen=True)
class Outcome:
    """Largest standard deviations [mm] of one head; errors in stated standard deviations, rms."""

    before: float
    predicted: float
    planned: float
    same_noise: float
    """Planned views, by the levels of noise that were known when they were planned."""
    random: float
    """Each view with the board elsewhere."""
    gathered: float
    """Random views with the board moved as seldom as in the plan."""
    planned_error: float
    random_error: float


def run(config: Config, number: int) -> Outcome:
    """Simulate one head."""
    rng = np.random.default_rng([config.seed, number])
    truth = without_offsets(random_head(rng))
    how = Recording(straight=config.straight, orientations=config.orientations, noise=NOISE)
    first = record(truth, rng, how)
    head = calibrated(rough_start(truth, rng), first)
    found = plan(head, BOARD, views=config.views, limits_rad=LIMITS_RAD, seed=number)
    places = len(np.unique(found.views.placement))
    apart = admissible_views(head, BOARD, LIMITS_RAD, rng, places=config.views, gazes=1)
    gazes = -(-config.views // places)
    gathered = admissible_views(head, BOARD, LIMITS_RAD, rng, places=places, gazes=gazes)
    order = np.argsort(np.arange(places * gazes) % gazes, kind="stable")
    gathered = gathered.take(order[: config.views])
    both = [joined([first, recorded(truth, each, rng)]) for each in (found.views, apart, gathered)]
    (planned, error), (random, random_error), (as_seldom, _) = (
        judged(calibrated(head, each), truth, found) for each in both
    )
    same_noise, _ = judged(calibrated(head, both[0], noise_of=head), truth, found)
    return Outcome(
        before=float(1e3 * found.before_m.max()),
        predicted=float(1e3 * found.after_m.max()),
        planned=planned,
        same_noise=same_noise,
        random=random,
        gathered=as_seldom,
        planned_error=error,
        random_error=random_error,
    )


def calibrated(
    start: HeadCalibration, observed: Observations, noise_of: HeadCalibration | None = None
) -> HeadCalibration:
    """Return a head with its stated accuracy; the noise is estimated, or that of another head."""
    known = {}
    if noise_of is not None and noise_of.accuracy is not None:
        known["pixel_std_px"] = noise_of.accuracy.pixel_std_px
        known["joint_std"] = float(np.sqrt(np.mean(np.square(noise_of.accuracy.joint_std))))
    estimate = bundle_adjust(start, observed, **known)
    return replace(estimate.head, accuracy=estimate.accuracy)


def recorded(truth: HeadCalibration, views: Views, rng: np.random.Generator) -> Observations:
    """Return what is recorded of views by someone who places the board by hand."""
    _, number = np.unique(views.placement, return_inverse=True)
    off = rng.normal(size=(number.max() + 1, 6)) * np.repeat([OFF_RAD, OFF_M], 3)
    return observe(
        truth,
        rng,
        NOISE,
        placement=number,
        T_lbase_target=boxplus(views.T_lbase_target, off[number]),
        joints=views.joints,
        whole=True,
    )


def judged(head: HeadCalibration, truth: HeadCalibration, found: Plan) -> tuple[float, float]:
    """Return the largest stated standard deviation [mm], and the rms of standardised errors."""
    assert head.accuracy is not None
    pair, points, joints = pair_names(head), found.workspace.points, found.workspace.joints
    columns = [parameter_names(head).index(name) for name in head.accuracy.parameters]
    J = point_by_parameters(head, pair, points, joints)[..., columns]
    left, right = (project_point(truth, name, joints, points) for name in pair)
    error = triangulate_at(head, left=left, right=right, joints=joints)[0] - points
    C = J @ head.accuracy.covariance @ np.swapaxes(J, 1, 2)
    squares = error[:, None] @ np.linalg.solve(C, error[..., None]) / 3
    largest = 1e3 * largest_std(J, head.accuracy.covariance).max()
    return float(largest), float(np.sqrt(squares.mean()))


def main(config: Config) -> int:
    """Print the table, and return 1 if a bar is missed."""
    done = [run(config, k) for k in track(range(config.heads), description="heads")]
    columns = ("before", "predicted", "planned", "same_noise", "random", "gathered")
    print("| head | " + " | ".join(columns) + " | planned / random | predicted / planned |")
    print("|---" * (len(columns) + 3) + "|")
    for k, each in enumerate(done):
        cells = [f"{getattr(each, name):.2f}" for name in columns]
        ratios = each.planned / each.random, each.predicted / each.planned
        print(f"| {k} | {' | '.join(cells)} | {ratios[0]:.2f} | {ratios[1]:.2f} |")
    table = {name: np.array([getattr(each, name) for each in done]) for name in vars(done[0])}
    agreement = table["predicted"] / table["planned"]
    gain = float(np.median(table["planned"] / table["random"]))
    gathered = float(np.median(table["planned"] / table["gathered"]))
    print(f"\nplanned / random: median {gain:.2f}; where boards move as seldom: {gathered:.2f}")
    for name in ("planned", "same_noise"):
        ratio = table["predicted"] / table[name]
        print(
            f"predicted / {name}: median {np.median(ratio):.3f}, {ratio.min():.2f} to "
            f"{ratio.max():.2f}, within 10 % for {np.mean(abs(ratio - 1) < AGREEMENT):.0%}"
        )
    for name in ("planned_error", "random_error"):
        rms = np.sqrt(np.mean(table[name] ** 2))
        print(f"{name}: rms {rms:.2f} stated standard deviations")
    return int(gain > BAR or abs(np.median(agreement) - 1) > AGREEMENT)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config, description=__doc__)))
