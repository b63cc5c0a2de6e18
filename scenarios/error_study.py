"""What the paper's eighteen standard deviations can support, and what they cannot.

A point model of the experiment with stated sources of errors: how far each spreads the points,
which kinds of errors cannot explain the paper, and how well fitted models predict figures that they
were not fitted to. Prints its tables in Markdown, those of
docs/error_study.md, and writes them and a figure into a folder.

    python scenarios/error_study.py [--out runs/error_study] [--seed 0] [--check FILE]
"""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from scipy.optimize import least_squares

from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import Array
from vergence.cli.terminal import plain_ending
from vergence.errors import check_seed
from vergence.files import markdown_table, read_parsed, results_folder, write_whole
from vergence.geometry.camera import pinhole
from vergence.geometry.head import R_EYE_CAM, HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import pose, rotation
from vergence.paper.figures import FIGURES, WIDE, Figure, Lens
from vergence.progress import Progress, silent
from vergence.stereo.extrinsics import rebase, relative_camera_pose
from vergence.stereo.triangulation import Status
from vergence.stereo.uncertainty import locate
from vergence.viewer.plots.canvas import BLUE, GREEN, RED, panels, save

# The point model: without images and calibration, the believed head differs from the true one by
# stated errors. Errors that follow the motion are computed exactly, white noise by the covariance
# of the located points.

FOCAL_PX: dict[Lens, float] = {"2.8mm": 280.0, "4.0mm": 400.0}
PIXEL_UM = 10.0
"""Pitch of the pixels [um]: a sensor 6.4 mm wide with 640 columns."""
_UP = np.array([1.0, -1.0, 1.0, -1.0])
"""Signs of the joints: in this study's version of Eqs. 22-23 positive tilt looks up."""


@dataclass(frozen=True)
class Errors:
    """Sources of errors; pairs are for the left and the right eye."""

    baseline_mm: float = 92.0
    """Baseline of the true head, which the paper does not state."""
    joint_noise_deg: float = 0.0
    """White, of each reading."""
    pixel_noise_um: float = 0.0
    """White, of each coordinate on the sensor."""
    delay_ms: float = 0.0
    """Time by which readings are older than images."""
    pan_gain_percent: tuple[float, float] = (0.0, 0.0)
    tilt_gain_percent: tuple[float, float] = (0.0, 0.0)
    roll_deg: tuple[float, float] = (0.0, 0.0)
    """Error of the believed mounting about the optical axis."""
    pitch_deg: tuple[float, float] = (0.0, 0.0)
    axial_mm: tuple[float, float] = (0.0, 0.0)
    """Error of the believed mounting along the optical axis."""
    focal_28_percent: tuple[float, float] = (0.0, 0.0)
    """Error of the believed focal length of the 2.8 mm lenses."""
    focal_40_percent: tuple[float, float] = (0.0, 0.0)


def true_head(
    lens: Lens,
    baseline_mm: float,
    camera_mm: tuple[tuple[float, ...], ...] = ((20.0, 0.0, 0.0),) * 2,
    mounting_deg: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 0.0),) * 2,
) -> HeadCalibration:
    """Build a head of two wide cameras; by default they look ahead, 20 mm before the axes."""
    cameras = {
        f"{eye}_wide": MountedCamera(
            eye=eye,
            intrinsics=pinhole(640, 480, FOCAL_PX[lens]),
            T_eye_cam=pose(
                rotation(np.radians(mounting_deg[k])) @ R_EYE_CAM, 1e-3 * np.array(camera_mm[k])
            ),
        )
        for k, eye in enumerate(EYES)
    }
    return HeadCalibration(cameras=cameras, T_rbase_lbase=pose(t=[0, baseline_mm * 1e-3, 0]))


def believed_head(truth: HeadCalibration, lens: Lens, errors: Errors) -> HeadCalibration:
    """Apply errors to a head, and recompute T_rbase_lbase by Eq. 10.

    Straight gaze stays exact, where the static stereo of a robot is calibrated.
    """
    focal = errors.focal_28_percent if lens == "2.8mm" else errors.focal_40_percent
    cameras = {}
    for k, (name, mounted) in enumerate(truth.cameras.items()):
        turn = rotation(np.radians([errors.pitch_deg[k], 0.0, errors.roll_deg[k]]))
        shift = [0.0, 0.0, 1e-3 * errors.axial_mm[k]]
        matrix = mounted.intrinsics.matrix * [[1 + focal[k] / 100], [1 + focal[k] / 100], [1]]
        matrix[:2, 2] = mounted.intrinsics.matrix[:2, 2]
        cameras[name] = replace(
            mounted,
            intrinsics=replace(mounted.intrinsics, matrix=matrix),
            T_eye_cam=mounted.T_eye_cam @ pose(turn, shift),
        )
    straight = straight_gaze(truth.kinematics)
    return rebase(
        replace(truth, cameras=cameras), relative_camera_pose(truth, straight), joints=straight
    )


def spread_mm(
    figure: Figure, errors: Errors, *, samples: int = 240, truth: HeadCalibration | None = None
) -> Array:
    """Predict the standard deviations (3,) [mm] of a figure's estimates over its combined period.

    NaN if a sample cannot be located. The truth is by default that of `true_head`.
    """
    believed, seen = _measured(figure, errors, samples, truth)
    found = locate(
        believed,
        **seen,
        pixel_std_px=errors.pixel_noise_um / PIXEL_UM,
        reading_std=np.radians(errors.joint_noise_deg),
    )
    if (found.status != Status.OK).any():
        return np.full(3, np.nan)
    noise = np.diagonal(found.covariance, axis1=1, axis2=2).mean(axis=0)
    return 1e3 * np.sqrt(found.xyz.var(axis=0) + noise)


def sampled_mm(figure: Figure, errors: Errors, seed: int, *, samples: int = 6000) -> Array:
    """Simulate what `spread_mm` predicts, with the noise drawn in each sample."""
    rng = np.random.default_rng([seed, figure.number])
    believed, seen = _measured(figure, errors, samples, None)
    for name, std in (
        ("left", errors.pixel_noise_um / PIXEL_UM),
        ("right", errors.pixel_noise_um / PIXEL_UM),
        ("joints", np.radians(errors.joint_noise_deg)),
    ):
        seen[name] = seen[name] + rng.normal(0, std, seen[name].shape)
    return 1e3 * locate(believed, **seen).xyz.std(axis=0)


def _measured(
    figure: Figure, errors: Errors, samples: int, truth: HeadCalibration | None
) -> tuple[HeadCalibration, dict[str, Any]]:
    """Simulate the believed head, and exact pixels and readings as arguments of `locate`."""
    truth = truth or true_head(figure.lens, errors.baseline_mm)
    time_s = np.arange(samples) * PERIOD_S[figure.motion] / samples
    angles = eye_angles(figure.motion, time_s) * _UP
    gains = np.array([errors.pan_gain_percent, errors.tilt_gain_percent]).T.ravel()
    sensed = eye_angles(figure.motion, time_s - 1e-3 * errors.delay_ms) * _UP
    left, right = (project_point(truth, name, angles, np.array(figure.mean_m)) for name in WIDE)
    seen = {"left": left, "right": right, "joints": (1 + gains / 100) * sensed}
    return believed_head(truth, figure.lens, errors), seen


def spreads_mm(errors: Errors) -> Array:
    """Predict the standard deviations (6, 3) [mm] of all figures."""
    return np.array([spread_mm(figure, errors) for figure in FIGURES.values()])


PAPER_MM = 1e3 * np.array([figure.std_m for figure in FIGURES.values()])
"""Standard deviations (6, 3) [mm] of the paper's captions."""


# What each source does

SOURCES = {
    "white noise 0.1° on all joints": Errors(joint_noise_deg=0.1),
    "white noise 5.6 µm on the sensor": Errors(pixel_noise_um=5.6),
    "joint readings 10 ms old": Errors(delay_ms=10),
    "pan gain 1 %, both eyes": Errors(pan_gain_percent=(1, 1)),
    "mounting roll ±1°, opposite": Errors(roll_deg=(1, -1)),
    "mounting 5 mm along the axis, both": Errors(axial_mm=(5, 5)),
    "focal length of the 2.8 mm lens 1 %": Errors(focal_28_percent=(1, 1)),
}


def sensitivities() -> dict[str, Array]:
    """Return by source the spreads (6, 3) [mm] that one unit of it makes."""
    cameras_mm = ((4.0, 1.0, 10.0), (3.0, -1.5, 10.5))
    mountings_deg = ((0.8, -0.5, 0.7), (-0.6, 0.9, -0.5))
    heads = {lens: true_head(lens, 75.0, cameras_mm, mountings_deg) for lens in ("2.8mm", "4.0mm")}
    return {
        name: np.array(
            [
                spread_mm(figure, errors, samples=3000, truth=heads[figure.lens])
                for figure in FIGURES.values()
            ]
        )
        for name, errors in SOURCES.items()
    }


def sensitivity() -> str:
    """Return the table of what one unit of each source does."""
    rows = [(name, *map(_cell, found)) for name, found in sensitivities().items()]
    return markdown_table("source | " + " | ".join(f"Fig. {n}" for n in FIGURES), rows)


def _cell(spread: Array) -> str:
    return "/".join(f"{value + 0.0:.1f}" if value < 9.95 else f"{value:.0f}" for value in spread)


# Models, and how they are fitted


@dataclass(frozen=True)
class Unknown:
    """One fitted number."""

    name: str
    unit: str
    start: float
    plausible: float
    """Standard deviation of what one would expect before looking at the figures."""


@dataclass(frozen=True)
class Model:
    """A family of errors with fitted numbers."""

    name: str
    unknowns: tuple[Unknown, ...]
    build: Callable[[Array], Errors]


BASELINE = Unknown("baseline", "mm", 85.0, 12.0)
NOISE = Unknown("joint noise", "deg", 0.15, 0.2)
SMALL = Model(
    "small",
    (BASELINE, NOISE, Unknown("focal length, 2.8 mm", "%", 2.0, 2.0)),
    lambda v: Errors(v[0], abs(v[1]), focal_28_percent=(v[2], v[2])),
)
LARGE = Model(
    "large",
    (
        BASELINE,
        Unknown("joint noise", "deg", 0.05, 0.05),
        Unknown("pixel noise", "µm", 2.0, 2.0),
        Unknown("delay", "ms", 10.0, 20.0),
        *(Unknown(f"{j} gain, {e}", "%", 0.5, 1.0) for j in ("pan", "tilt") for e in ("l", "r")),
        Unknown("roll, left", "deg", 0.2, 0.5),
        Unknown("roll, right", "deg", -0.2, 0.5),
        Unknown("pitch, left", "deg", 0.2, 0.7),
        Unknown("pitch, right", "deg", -0.2, 0.7),
        Unknown("along the axis, both", "mm", 1.0, 3.0),
        Unknown("focal length, 2.8 mm, left", "%", 1.0, 2.0),
        Unknown("focal length, 2.8 mm, right", "%", 1.0, 2.0),
        Unknown("focal length, 4.0 mm, left", "%", 0.5, 2.0),
        Unknown("focal length, 4.0 mm, right", "%", 0.5, 2.0),
    ),
    lambda v: Errors(
        baseline_mm=v[0],
        joint_noise_deg=abs(v[1]),
        pixel_noise_um=abs(v[2]),
        delay_ms=v[3],
        pan_gain_percent=(v[4], v[5]),
        tilt_gain_percent=(v[6], v[7]),
        roll_deg=(v[8], v[9]),
        pitch_deg=(v[10], v[11]),
        axial_mm=(v[12], v[12]),
        focal_28_percent=(v[13], v[14]),
        focal_40_percent=(v[15], v[16]),
    ),
)
NOISE_ALONE = Model(
    "noise alone",
    (BASELINE, NOISE, Unknown("pixel noise", "µm", 3.0, 5.0)),
    lambda v: Errors(v[0], abs(v[1]), abs(v[2])),
)
ORIENTATION = Model(
    "orientation alone",
    (
        BASELINE,
        NOISE,
        Unknown("delay", "ms", 10.0, 20.0),
        Unknown("pan gain", "%", 0.5, 2.0),
        Unknown("tilt gain", "%", 0.5, 2.0),
        Unknown("roll, opposite", "deg", 0.2, 0.7),
        Unknown("pitch, opposite", "deg", 0.2, 1.0),
    ),
    lambda v: Errors(
        v[0],
        abs(v[1]),
        delay_ms=v[2],
        pan_gain_percent=(v[3], v[3]),
        tilt_gain_percent=(v[4], v[4]),
        roll_deg=(v[5], -v[5]),
        pitch_deg=(v[6], -v[6]),
    ),
)
FORMS: dict[str, tuple[Unknown, Callable[[Errors, float], Errors]]] = {
    "delay": (Unknown("delay", "ms", 10, 20), lambda e, v: replace(e, delay_ms=v)),
    "pan gain": (Unknown("gain", "%", 1, 2), lambda e, v: replace(e, pan_gain_percent=(v, v))),
    "focal length, 2.8 mm": (
        Unknown("focal length", "%", 2, 2),
        lambda e, v: replace(e, focal_28_percent=(v, v)),
    ),
    "along the axis": (Unknown("shift", "mm", 5, 5), lambda e, v: replace(e, axial_mm=(v, v))),
    "pixel noise": (Unknown("noise", "µm", 3, 5), lambda e, v: replace(e, pixel_noise_um=abs(v))),
    "roll, opposite": (Unknown("roll", "deg", 0.5, 1), lambda e, v: replace(e, roll_deg=(v, -v))),
}
"""Sources that could stand beside baseline and joint noise in a model of three numbers."""
ALL = tuple(range(6))


def fit(model: Model, figures: Sequence[int] = ALL) -> Array:
    """Return the numbers of a model that suit some figures, given by their places among the six.

    Least squares of log(ours / paper's), whose standard deviation is taken for 0.15 and the
    rounding of the captions, and of the distance from what is plausible.
    """
    start = np.array([u.start for u in model.unknowns])
    expected = np.array([u.start if u is BASELINE else 0.0 for u in model.unknowns])
    scale = np.array([u.plausible for u in model.unknowns])
    paper = PAPER_MM[list(figures)]
    weight = 1 / np.hypot(0.15, 0.29 / paper)
    chosen = [list(FIGURES.values())[k] for k in figures]

    def residuals(values: Array) -> Array:
        errors = model.build(values)
        ours = np.array([spread_mm(figure, errors) for figure in chosen])
        off = np.nan_to_num(np.log(ours / paper), nan=5.0) * weight
        return np.concatenate([off.ravel(), 0.5 * (values - expected) / scale])

    return least_squares(residuals, start, x_scale=scale, diff_step=1e-3, max_nfev=40).x


def judged(ours: Array, figures: Sequence[int] = ALL) -> tuple[str, str, str]:
    """Return the largest factor, how many are within 25 %, and the largest error in depth."""
    ratio = ours[list(figures)] / PAPER_MM[list(figures)]
    factor = np.exp(np.abs(np.log(ratio)).max())
    within = int((np.abs(ratio - 1) <= 0.25).sum())
    depth = 100 * np.abs(ratio[:, 0] - 1).max()
    return f"{factor:.2f}", f"{within} of {ratio.size}", f"{depth:.0f} %"


JUDGED = "largest factor | within 25 % | largest error in depth"


def noise_alone() -> str:
    """Return the table of divergent over parallel spread in depth."""
    ours = spreads_mm(NOISE_ALONE.build(fit(NOISE_ALONE)))
    rows = [
        (f"Figs. {6 + k} and {7 + k}", *(f"{s[k + 1, 0] / s[k, 0]:.2f}" for s in (PAPER_MM, ours)))
        for k in (0, 2, 4)
    ]
    return markdown_table("divergent / parallel | paper | noise alone", rows)


def orientation_alone() -> str:
    """Return the table of Fig. 10 as scaled from Fig. 8, whose lens is another one."""
    rows = []
    for name, errors in (
        ("joint noise alone", Errors(joint_noise_deg=0.1)),
        ("pixel noise alone", Errors(pixel_noise_um=5.6)),
    ):
        ours = spreads_mm(errors)
        scaled = ours[4, 0] * PAPER_MM[2, 0] / ours[2, 0]
        rows.append((name, f"{scaled:.1f} mm", f"{PAPER_MM[4, 0]:.0f} mm"))
    return markdown_table("scaled to Fig. 8 | gives Fig. 10 | paper", rows)


def models(fitted: dict[str, Array]) -> str:
    """Return the table of all models that were fitted to all figures."""
    rows = [
        (model.name, len(model.unknowns), *judged(spreads_mm(model.build(fitted[model.name]))))
        for model in (NOISE_ALONE, ORIENTATION, SMALL, LARGE)
    ]
    return markdown_table(f"model | fitted numbers | {JUDGED}", rows)


def numbers(model: Model, values: Array) -> str:
    """Return the table of fitted numbers."""
    rows = [
        (u.name, f"{abs(v) if 'noise' in u.name else v + 0.0:.2f} {u.unit}", f"{u.plausible:g}")
        for u, v in zip(model.unknowns, values, strict=True)
    ]
    return markdown_table("fitted number | value | plausible size", rows)


def spreads(fitted: dict[str, Array], seed: int) -> str:
    """Return the table of spreads, and a check of the noise by sampling."""
    rows = []
    for k, figure in enumerate(FIGURES.values()):
        cells = [_cell(PAPER_MM[k])]
        for model in (SMALL, LARGE):
            errors = model.build(fitted[model.name])
            cells += [_cell(spread_mm(figure, errors)), _cell(sampled_mm(figure, errors, seed))]
        rows.append((figure.number, *cells))
    return markdown_table("Fig. | paper | small | small, sampled | large | large, sampled", rows)


HOLD_OUTS = {
    "Figs. 6-7 to 8-11": (0, 1),
    "parallel to divergent": (0, 2, 4),
    "2.8 mm lens to 4.0 mm": (0, 1, 2, 3),
    "4.0 mm lens to 2.8 mm": (4, 5),
    **{f"all except Fig. {6 + k}": tuple(i for i in ALL if i != k) for k in ALL},
}


def hold_outs(progress: Progress = silent) -> str:
    """Return the table of figures that are predicted from others."""
    rows = []
    progress("hold-outs", 0, len(HOLD_OUTS))
    for done, (name, used) in enumerate(HOLD_OUTS.items()):
        rest = [k for k in ALL if k not in used]
        cells = []
        for model in (SMALL, LARGE):
            cells += judged(spreads_mm(model.build(fit(model, used))), rest)[:2]
        rows.append((name, *cells))
        progress("hold-outs", done + 1, len(HOLD_OUTS))
    heading = "fitted to, predicted | small: largest factor | within 25 % | large: largest factor"
    return markdown_table(f"{heading} | within 25 %", rows)


def forms(progress: Progress = silent) -> str:
    """Return the table of models of three numbers, each fitted to Figs. 6 and 7 alone."""
    rows = []
    progress("forms", 0, len(FORMS))
    for done, (name, (unknown, add)) in enumerate(FORMS.items()):
        model = Model(
            name,
            (BASELINE, NOISE, unknown),
            lambda v, add=add: add(Errors(v[0], abs(v[1])), v[2]),
        )
        ours = spreads_mm(model.build(fit(model, (0, 1))))
        rows.append((name, judged(ours, (0, 1))[0], *judged(ours, (2, 3, 4, 5))))
        progress("forms", done + 1, len(FORMS))
    return markdown_table(f"third number | factor in Figs. 6-7 | Figs. 8-11: {JUDGED}", rows)


def draw(path: Path, fitted: dict[str, Array]) -> None:
    """Draw the spreads of the paper and of the models."""
    canvas, axes = panels(3, "Spreads of Figs. 6-11: paper, small and large model", columns=3)
    ours = {model.name: spreads_mm(model.build(fitted[model.name])) for model in (SMALL, LARGE)}
    for k, (panel, colour) in enumerate(zip(axes, (BLUE, GREEN, RED), strict=True)):
        places = np.arange(6)
        panel.bar(places, PAPER_MM[:, k], color=colour, alpha=0.35, label="paper")
        panel.plot(places, ours["small"][:, k], "o", color="0.2", label="small, 3 fitted")
        panel.plot(places, ours["large"][:, k], "x", color="0.2", label="large, 17 fitted")
        panel.set_xticks(places, [f"Fig. {n}" for n in FIGURES], fontsize=9)
        panel.set_ylabel("standard deviation [mm]")
        panel.set_title(("x = depth", "y", "z")[k], fontsize=11, loc="left")
        panel.legend(fontsize=9, frameon=False)
    save(canvas, path)


def study(seed: int, progress: Progress = silent) -> tuple[dict[str, str], dict[str, Array]]:
    """Return all tables by their names, and the fitted numbers by model."""
    fitted = {}
    together = (NOISE_ALONE, ORIENTATION, SMALL, LARGE)
    progress("fits", 0, len(together))
    for done, model in enumerate(together):
        fitted[model.name] = fit(model)
        progress("fits", done + 1, len(together))
    tables = {
        "Spread per unit of each source [mm, x/y/z]": sensitivity(),
        "Noise alone": noise_alone(),
        "Orientation alone": orientation_alone(),
        "Fitted models": models(fitted),
        "Spreads [mm, x/y/z]": spreads(fitted, seed),
        "The small model": numbers(SMALL, fitted["small"]),
        "The large model": numbers(LARGE, fitted["large"]),
        "Hold-outs": hold_outs(progress),
        "Models of three numbers, fitted to Figs. 6 and 7 alone": forms(progress),
    }
    return tables, fitted


def absent(tables: dict[str, str], document: str) -> list[str]:
    """Return the names of the tables that a document does not have, to 1 % and a unit of 0.01."""
    lines = document.split("\n")

    def words(text: str) -> str:
        return re.sub("[ -]+", " ", NUMBER.sub("", text))  # columns may be aligned

    def same(table: str, start: int) -> bool:
        found = "\n".join(lines[start : start + len(table.split("\n"))])
        if words(found) != words(table):
            return False
        ours, theirs = (np.array(NUMBER.findall(text), dtype=float) for text in (table, found))
        return np.allclose(ours, theirs, rtol=0.01, atol=0.011)

    return [
        name
        for name, table in tables.items()
        if not any(same(table, start) for start in range(len(lines)))
    ]


NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def main(out: Path = Path("runs/error_study"), seed: int = 0, check: Path | None = None) -> None:
    """Print what the paper's eighteen standard deviations can support, as tables in Markdown.

    Args:
        out: Folder for tables.md and spreads.png.
        seed: Seed of the sampled noise.
        check: A document that must have all of the tables; exit code 1 if it has not.
    """
    check_seed(seed)
    document = read_parsed(check, "a document", str, str) if check else None

    def show(task: str, done: int, total: int) -> None:
        print(f"{task}: {done} of {total}", flush=True)

    with results_folder(out):
        tables, fitted = study(seed, show)
        text = "\n\n".join(f"## {name}\n\n{table}" for name, table in tables.items())
        write_whole(out / "tables.md", text + "\n")
        draw(out / "spreads.png", fitted)
    print(text)
    if document is not None and (missing := absent(tables, document)):
        sys.exit(f"{check} does not have these tables as they are here: {'; '.join(missing)}.")


if __name__ == "__main__":
    with plain_ending("error_study"):
        tyro.cli(main, config=(tyro.conf.DisallowNone,))
