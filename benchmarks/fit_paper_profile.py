"""How the profile `paper` was fitted: six numbers to the paper's eighteen standard deviations.

The whole chain - calibration sequence, paper's calibration, replay - runs at point level for
several heads, drawn from seeds of their own. Gauss-Newton then moves the six numbers until
log(our std / paper's std) is small: its sixth power is summed, so that the largest deviations
count most, and depth counts half as much again. A mean depth error beyond 1.1 of our standard
deviations costs too. The form - which six sources - was chosen beforehand among sets of four out of
nineteen sources, besides baseline and noise, with all six figures in view.

    python benchmarks/fit_paper_profile.py [--steps 8]

It starts from plain values (START) and prints what belongs into profiles/paper.toml.
"""

from collections.abc import Sequence

import numpy as np
import tyro
from scipy.optimize import least_squares

from simulated_twin import observe_points, simulate_views
from vergence.arrays import Array
from vergence.calibration.initial import calibrate_sequentially
from vergence.geometry.head import HeadCalibration
from vergence.paper.figures import FIGURES, Lens, default_duration_s
from vergence.paper.replay import SAMPLES, estimate, sample_times
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import Shot, plan
from vergence.twin.head_model import nominal_head
from vergence.twin.model import as_built_head
from vergence.twin.profile import ByHand, ErrorProfile, Joints, load_profile

NAMES = (
    "mounting.baseline_mm",
    "joints.noise_deg",
    "joints.gain_percent (pan)",
    "joints.gain_percent (tilt)",
    "by_hand.focal_percent_40",
    "by_hand.axial_mm",
)
START = np.array([75.0, 0.15, -2.5, -4.0, 3.0, -4.0])
SCALE = np.array([10.0, 0.1, 1.0, 1.0, 1.0, 2.0])
SEEDS = (100, 101, 102, 103, 104, 105)
DEPTH_WEIGHT = 1.5
# Of corners and objects in images, when the profile was fitted. Both are found several times better
# since, which moves none of the six numbers by more than 1 %.
CORNER_NOISE_PX = 0.035
OBJECT_NOISE_PX = 0.03
PAPER_STD = np.array([figure.std_m for figure in FIGURES.values()])

Plans = dict[Lens, tuple[HeadCalibration, list[Shot]]]


def profile_of(values: Array) -> ErrorProfile:
    """Return the profile `ideal` with the six numbers put in."""
    baseline, noise, pan, tilt, focal, axial = (float(v) for v in values)
    ideal = load_profile("ideal")
    return ideal.model_copy(
        update={
            "mounting": ideal.mounting.model_copy(update={"baseline_mm": baseline}),
            "joints": Joints(noise_deg=abs(noise), gain_percent=(pan, tilt, pan, tilt)),
            "by_hand": ByHand(focal_percent_40=focal, axial_mm=axial),
        }
    )


def run(profile: ErrorProfile, plans: Plans, seed: int) -> tuple[Array, Array]:
    """Return the standard deviations (6, 3) [m] and the depth errors of the means (6,) in them."""
    std, bias = np.empty((6, 3)), np.empty(6)
    for lens, (nominal, shots) in plans.items():
        rng = np.random.default_rng([seed, 9])
        truth = as_built_head(nominal, profile, seed)
        views = simulate_views(truth, profile, shots, pixel_noise=CORNER_NOISE_PX, rng=rng)
        head = inject_calibration_error(calibrate_sequentially(views).head, profile.by_hand)
        for row, figure in enumerate(FIGURES.values()):
            if figure.lens != lens:
                continue
            times = sample_times(figure, None, SAMPLES / default_duration_s(figure.motion))
            seen = observe_points(
                truth, profile, figure, times, pixel_noise=OBJECT_NOISE_PX, rng=rng
            )
            ours = estimate(head, figure, seen).statistics
            std[row] = ours.std_m
            bias[row] = abs(ours.mean_m[0] - figure.mean_m[0]) / ours.std_m[0]
    return std, bias


def residuals(values: Array, plans: Plans, seeds: Sequence[int]) -> Array:
    """Return what is squared and summed."""
    parts = []
    for seed in seeds:
        std, bias = run(profile_of(values), plans, seed)
        ratio = np.log(std / PAPER_STD) * [DEPTH_WEIGHT, 1.0, 1.0] / 0.25
        parts += [(ratio**3).ravel(), 2 * np.clip(bias - 1.1, 0, None)]
    return np.concatenate(parts)


def main(steps: int = 6) -> None:
    """Fit, then judge the result on other seeds.

    Args:
        steps: of Gauss-Newton at most.
    """
    lenses = "2.8mm", "4.0mm"
    plans: Plans = {lens: (head := nominal_head(lens), plan(head, 0)) for lens in lenses}
    found = least_squares(
        residuals, START, x_scale=SCALE, diff_step=0.03, max_nfev=steps, args=(plans, SEEDS)
    )
    for name, value in zip(NAMES, found.x, strict=True):
        print(f"{name:<28} {value:8.3f}")
    print("other seeds: largest factor, number within 25 %, largest depth error, largest bias")
    for seed in range(10):
        std, bias = run(profile_of(found.x), plans, seed)
        ratio = std / PAPER_STD
        print(
            f"{seed:3d}  {np.exp(np.abs(np.log(ratio)).max()):.2f}  "
            f"{(np.abs(ratio - 1) <= 0.25).sum():2d}  {np.abs(ratio[:, 0] - 1).max():.2f}  "
            f"{bias.max():.2f}"
        )


if __name__ == "__main__":
    tyro.cli(main)
