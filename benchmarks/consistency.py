"""Whether the stated covariances and budgets are true of rendered replays.

Replays the motions of the paper's figures on rendered images with several error profiles,
calibrated by the paper's method, and prints for each figure

- the mean squared Mahalanobis distance of located points from the truth, as a multiple of its three
  degrees of freedom: with the true head, so that only the noise of pixels and readings is left. The
  noise of the readings is the profile's; that of the four pixel coordinates is measured in one half
  of the samples and used in the other, and the 95 % band holds what both halves leave uncertain;
- predicted / observed spread over the motion, x, y and z: by `accuracy.budget`, with all that is
  wrong with the calibration taken from the truth as known errors; where readings are exact, also
  that in depth of the calibration's errors alone and of the pixels' alone, and the correlation of
  these two over the motion, of which the budget assumes none;
- predicted / observed spread in depth by the budget as a user gets it, who knows the profile only;
- where there are several heads, the second of these with the squared spreads of all together: by
  chance the errors of one head and of the detector add up or cancel, and over heads they do not.

Samples are taken at random times, one in each of as many equal parts of the motion. At regular
times postures come again, and where pictures have no noise a detector errs in the same way each
time: of 320 samples of Fig. 8 only 80 would be distinct.

Measurements are kept in a folder, and a second run goes on where the first one was stopped.

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
from vergence.geometry.head import WIDE, HeadCalibration, load_head, save_head
from vergence.geometry.parameters import boxminus
from vergence.paper.figures import FIGURES, Figure, default_duration_s
from vergence.paper.replay import describe, replay
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate
from vergence.twin.budget_sources import profile_sources
from vergence.twin.calibration_errors import inject_calibration_error
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
                save_head(inject_calibration_error(found.head, profile.by_hand, lens), used)
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
        "joint_std_rad": np.radians(profile.joints.noise_deg),
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
        profile, spreads = load_profile(name), np.empty((2, len(seeds), len(FIGURES), 3))
        for k, seed in enumerate(seeds):
            own = folder / f"{name}-{samples}-{seed}"
            own.mkdir(parents=True, exist_ok=True)
            measure(own, profile, seed, samples)
            for n, figure in enumerate(FIGURES.values()):
                line, spreads[0, k, n], spreads[1, k, n] = found(own, profile, figure)
                print(f"{line} seed {seed}" if len(seeds) > 1 else line, flush=True)
        predicted, observed = np.sqrt((spreads**2).mean(axis=1))
        for figure, together in zip(FIGURES.values(), predicted / observed, strict=True):
            if len(seeds) > 1:
                ratios = " ".join(f"{each:.2f}" for each in together)
                print(f"{name:<10} Fig. {figure.number:<2} {len(seeds)} heads together: {ratios}")


def found(folder: Path, profile: ErrorProfile, figure: Figure) -> tuple[str, Array, Array]:
    """Return a line about a figure, and the predicted and the observed spread (3,) [m]."""
    truth = with_sensors(load_head(folder / f"truth-{figure.lens}.json"), profile.joints)
    used = load_head(folder / f"calibration-{figure.lens}.json")
    with np.load(folder / f"fig{figure.number}.npz") as file:
        seen = dict(file)
    ratio, width, noise_px = mahalanobis(truth, profile, figure, seen)
    left, right = seen["pixels"]
    points, _ = triangulate_at(used, left=left, right=right, joints=seen["joints"], cameras=WIDE)
    observed = describe(points)
    white = Source(
        "noise", pixel_std_px=noise_px, joint_std_rad=np.radians(profile.joints.noise_deg)
    )
    joints = eye_angles(figure.motion, seen["time_s"])
    motion = {"joints": joints, "rates": np.gradient(joints, seen["time_s"], axis=0)}
    at = observed.mean_m[None]
    errors = Source("calibration", errors=boxminus(used, truth))

    def spread_m(*sources: Source) -> Array:
        (found,) = budget(used, at, **motion, sources=sources, cameras=WIDE)
        return found.total.spread_m

    predicted_m = spread_m(errors, white)
    with_truth = predicted_m / observed.std_m
    depth = spread_m(*profile_sources(used, profile))[0] / observed.std_m[0]
    apart = ""
    if not profile.joints.noise_deg:
        by_calibration, by_pixels = depth_errors(used, seen)
        apart = (
            f" (calibration {spread_m(errors)[0] / by_calibration.std():.2f}, "
            f"pixels {spread_m(white)[0] / by_pixels.std():.2f}, "
            f"correlation {np.corrcoef(by_calibration, by_pixels)[0, 1]:.2f})"
        )
    pixels = " ".join(f"{each:.3f}" for each in noise_px)
    spread = " ".join(f"{1e3 * each:.2f}" for each in observed.std_m)
    line = (
        f"{profile.name:<10} Fig. {figure.number:<2} d2/3 {ratio:.3f} (1 +- {width:.3f}), "
        f"pixels {pixels} px; spread {spread} mm, "
        f"with the truth {' '.join(f'{each:.2f}' for each in with_truth)}{apart}, "
        f"by the profile {depth:.2f}"
    )
    return line, predicted_m, observed.std_m


def depth_errors(used: HeadCalibration, seen: dict[str, Array]) -> tuple[Array, Array]:
    """Return depths (n,) [m] as the calibration errs, and what pixels add to them, of the n samples
    that both images show, whose readings are exact.
    """
    found, exact = (
        triangulate_at(used, left=left, right=right, joints=seen["joints"], cameras=WIDE)[0][:, 0]
        for left, right in (seen["pixels"], seen["true_pixels"])
    )
    both = np.isfinite(found)
    return exact[both], (found - exact)[both]


if __name__ == "__main__":
    tyro.cli(main)
