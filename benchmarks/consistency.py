"""Check stated covariances and error budgets against rendered replays.

Replays the motions of the paper's figures on rendered images with several error profiles,
calibrated by the paper's method, and prints for each figure

- the mean squared Mahalanobis distance of points located with the true head, over its three degrees
  of freedom. The noise of the four pixel coordinates is measured in one half of the samples and
  used in the other, and the 95 % band holds what both halves leave uncertain;
- predicted / observed spread over the motion, x, y and z, by `accuracy.budget` with all errors of
  the calibration known; where readings are exact, also that in depth of these errors alone;
- predicted / observed spread in depth by the budget of a user, who knows the profile only.

Samples are taken at random times, one in each of as many equal parts of the motion: at regular
times postures recur, and errors of a detector with them. Measurements are kept in a folder, and a
second run continues a stopped one.

    python benchmarks/consistency.py [--samples 640] [--folder runs/consistency]
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tyro
from scipy.stats import kurtosis

from vergence.accuracy.budget import Source, budget
from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, load_head, save_head
from vergence.geometry.parameters import boxminus
from vergence.paper.figures import FIGURES, WIDE, Figure, default_duration_s
from vergence.paper.replay import describe, replay
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate
from vergence.twin.calibration_errors import inject_calibration_error, profile_sources
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile, load_profile
from vergence.twin.sensors import with_sensors

PROFILES = ("ideal", "noise-only", "paper")


def measure(folder: Path, profile: ErrorProfile, seed: int, samples: int) -> None:
    """Replay what is missing, and keep heads and measurements in a folder."""
    for lens in ("2.8mm", "4.0mm"):
        figures = [f for f in FIGURES.values() if f.lens == lens]
        missing = [f for f in figures if not (folder / f"fig{f.number}.npz").exists()]
        if not missing:
            continue
        with Twin(profile, seed=seed, lens=lens) as twin:
            used = folder / f"calibration-{lens}.json"
            if not used.exists():
                found = paper_calibration(twin, seed)
                save_head(twin.truth, folder / f"truth-{lens}.json")
                save_head(inject_calibration_error(found.head, profile.by_hand), used)
            for figure in missing:
                times = random_times(figure, samples, seed)
                true: list[tuple[Array, Array]] = []

                def look(*, truth: dict[str, Array], true: list = true, **_: object) -> None:
                    true.append((truth[WIDE[0]], truth[WIDE[1]]))

                done = replay(
                    twin, load_head(used), figure, times, observer=look, image_every=10**9
                ).measurements
                np.savez(
                    folder / f"fig{figure.number}.npz",
                    joints=done.eye_angles,
                    pixels=np.stack([done.pixels_l, done.pixels_r]),
                    true_pixels=np.array(true).swapaxes(0, 1),
                    time_s=times,
                )
                print(f"{profile.name}: figure {figure.number} replayed", flush=True)


def random_times(figure: Figure, samples: int, seed: int) -> Array:
    """Return times (N,) [s], one in each of N equal parts of the motion, in whole milliseconds."""
    rng = np.random.default_rng([seed, figure.number])
    part_s = default_duration_s(figure.motion) / samples
    return np.floor(1e3 * part_s * (np.arange(samples) + rng.uniform(0, 0.95, samples))) / 1e3


def mahalanobis(
    truth: HeadCalibration, profile: ErrorProfile, figure: Figure, seen: dict[str, Array]
) -> tuple[float, float, Array]:
    """Return the mean squared distance over its degrees of freedom, half the width of its 95 % band
    about 1, and the noise (4,) of the pixels.
    """
    off = seen["pixels"] - seen["true_pixels"]
    good = np.array(np.isfinite(off).all(axis=(0, 2)))
    half = np.random.default_rng(0).permutation(len(good)) < len(good) // 2
    fitted, tested = good & half, good & ~half
    bias = off[:, fitted].mean(axis=1)
    pixel_std = off[:, fitted].std(axis=1).ravel()
    given = {
        "left": seen["pixels"][0, tested] - bias[0],
        "right": seen["pixels"][1, tested] - bias[1],
        "joints": seen["joints"][tested],
        "cameras": WIDE,
        "reading_std": np.radians(profile.joints.noise_deg),
    }
    found = locate(truth, **given, pixel_std_px=pixel_std)
    there = np.array(figure.mean_m)
    if not profile.joints.noise_deg:  # the neck sags by some hundredths of a millimetre
        at = {"left": seen["true_pixels"][0, tested], "right": seen["true_pixels"][1, tested]}
        there, _ = triangulate_at(truth, **at, joints=seen["joints"][tested], cameras=WIDE)
    error = found.xyz - there

    def distances(std: Array) -> Array:
        information = np.linalg.inv(locate(truth, **given, pixel_std_px=std).covariance)
        return np.einsum("ni,nij,nj->n", error, information, error) / 3

    # The variances of n samples are uncertain by their size times the root of (kurtosis - 1) / n.
    whole, step = distances(pixel_std), 0.01
    larger = [distances(pixel_std * (1 + step * own)).mean() for own in np.eye(4)]
    by_variance = (np.array(larger) - whole.mean()) / (2 * step)
    tails = kurtosis(off[:, fitted], axis=1, fisher=False).ravel() - 1
    variance = whole.var() / len(whole) + (by_variance**2 @ tails) / fitted.sum()
    return float(whole.mean()), float(1.96 * np.sqrt(variance)), pixel_std


def main(
    samples: int = 640,
    folder: Path = Path("runs/consistency"),
    seeds: tuple[int, ...] = (0,),
    profiles: Sequence[str] = PROFILES,
) -> None:
    """Measure what is missing, and print the figures.

    Args:
        samples: of each replay.
        folder: of the measurements.
        seeds: of the heads.
        profiles: error profiles.
    """
    for name in profiles:
        profile = load_profile(name)
        for seed in seeds:
            kept = folder / f"{name}-{samples}-{seed}"
            kept.mkdir(parents=True, exist_ok=True)
            measure(kept, profile, seed, samples)
            for figure in FIGURES.values():
                print(f"{line_of(kept, profile, figure)} seed {seed}", flush=True)


def line_of(folder: Path, profile: ErrorProfile, figure: Figure) -> str:
    """Describe a figure in one line."""
    truth = with_sensors(load_head(folder / f"truth-{figure.lens}.json"), profile.joints)
    used = load_head(folder / f"calibration-{figure.lens}.json")
    with np.load(folder / f"fig{figure.number}.npz") as file:
        seen = dict(file)
    ratio, width, noise_px = mahalanobis(truth, profile, figure, seen)
    left, right = seen["pixels"]
    points, _ = triangulate_at(used, left=left, right=right, joints=seen["joints"], cameras=WIDE)
    observed = describe(points)
    white = Source("noise", pixel_std_px=noise_px, reading_std=np.radians(profile.joints.noise_deg))
    joints = eye_angles(figure.motion, seen["time_s"])
    motion = {"joints": joints, "rates": np.gradient(joints, seen["time_s"], axis=0)}
    at = observed.mean_m[None]
    errors = Source("calibration", errors=boxminus(used, truth))

    def spread_m(*sources: Source) -> Array:
        (found,) = budget(used, at, **motion, sources=sources)
        return found.total.spread_m

    with_truth = spread_m(errors, white) / observed.std_m
    depth = spread_m(*profile_sources(used, profile))[0] / observed.std_m[0]
    alone = ""
    if not profile.joints.noise_deg:  # depths err by the calibration alone where pixels are true
        exact, _ = triangulate_at(
            used,
            left=seen["true_pixels"][0],
            right=seen["true_pixels"][1],
            joints=seen["joints"],
            cameras=WIDE,
        )
        alone = f" (calibration {spread_m(errors)[0] / np.nanstd(exact[:, 0]):.2f})"
    return (
        f"{profile.name:<10} Fig. {figure.number:<2} d2/3 {ratio:.3f} (1 +- {width:.3f}), "
        f"pixels {' '.join(f'{each:.3f}' for each in noise_px)} px; "
        f"spread {' '.join(f'{1e3 * each:.2f}' for each in observed.std_m)} mm, "
        f"with the truth {' '.join(f'{each:.2f}' for each in with_truth)}{alone}, "
        f"by the profile {depth:.2f}"
    )


if __name__ == "__main__":
    tyro.cli(main)
