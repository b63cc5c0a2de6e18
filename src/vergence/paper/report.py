"""Write report.md, and the page inside each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.calibration.initial import SequentialCalibration
from vergence.files import markdown_table
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import straight_gaze
from vergence.paper.comparison import PAPER
from vergence.paper.figures import WIDE
from vergence.paper.replay import Replay, summaries
from vergence.stereo.extrinsics import camera_poses
from vergence.stereo.uncertainty import depth_error, disparity_error
from vergence.twin.profile import ErrorProfile
from vergence.twin.sensors import read
from vergence.twin.simulated_robot import LOOK_S


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Results of a run so far."""

    profile: ErrorProfile
    seed: int
    calibrations: dict[str, SequentialCalibration]
    """Estimated calibrations by lens."""
    heads: dict[str, HeadCalibration]
    """Heads that the replays use by lens, with the calibration errors of the profile."""
    replays: dict[int, Replay]
    """Replays by the number of the figure."""


def _depth_std_from_joints(result: Replay, profile: ErrorProfile, head: HeadCalibration) -> float:
    """Predict the standard deviation of depth [m] from the joint sensors by Eqs. 20-21.

    The error of the angle between the cameras is that of the difference of the two pan readings
    along the figure's motion: noise, quantisation, gain and delay, without backlash. Depth and
    baseline are those of the camera centres at straight gaze. The equations leave out errors of the
    calibration and of image matching.
    """
    times, joints = result.measurements.time_s, profile.joints
    sensed = eye_angles(result.figure.motion, times - joints.delay_ms * 1e-3)
    error = read(sensed, joints, np.random.default_rng(0)) - eye_angles(result.figure.motion, times)
    orientation_std = float((error[:, 0] - error[:, 2]).std())
    left, right = camera_poses(head, straight_gaze(head.kinematics), cameras=WIDE)[:, :3, 3]
    baseline = float(np.linalg.norm(right - left))
    depth = result.figure.mean_m[0] - left[0]
    focal = head.camera("left_wide").intrinsics.matrix[0, 0]
    return float(depth_error(depth, baseline, focal, disparity_error(focal, orientation_std)))


def figure_report(result: Replay, profile: ErrorProfile, head: HeadCalibration) -> str:
    """Write the markdown page for a figure's recording."""
    figure = result.figure
    parts = [
        f"# Fig. {figure.number}: {figure.motion} motion, {figure.lens} lens",
        "The eyes move, the object does not: a perfect head would draw three straight lines. "
        "Positions in metres from the left eye's rotation centre; x is depth.",
        _std_table([result], {figure.lens: head}, profile),
        _mean_table([result]),
        f"Error profile `{profile.name}`: {profile.description} {_fitted_line(profile)}",
    ]
    return "\n\n".join(parts) + "\n"


def report(done: Reproduction) -> str:
    """Write the text of report.md."""
    profile = done.profile
    replays = [done.replays[number] for number in sorted(done.replays)]
    parts = [
        f"# Figs. 6-11, error profile `{profile.name}`, seed {done.seed}",
        f"{profile.description} {_fitted_line(profile)}",
        "All numbers come from rendered images. Positions in metres from the left eye's rotation "
        "centre, x forward (depth), y left, z up; `paper` is what the paper's captions print.",
        "## Standard deviations",
        _std_table(replays, done.heads, profile),
        "The column of Eqs. 20-21 includes the joint sensors only (noise, quantisation, gain, "
        "delay), not what the calibration and the mechanics add.",
        _verdict(replays),
        "## Means",
        _mean_table(replays),
        *_comparison(replays),
        "## Calibrations",
        *_calibration_table(done.calibrations),
    ]
    if profile.fitted:
        rows = [(f"`{f.name}`", f"{f.value:g} {f.unit}", f.meaning, f.how) for f in profile.fitted]
        parts += ["## Fitted parameters", markdown_table("name | value | meaning | how", rows)]
    return "\n\n".join(parts) + "\n"


def _fitted_line(profile: ErrorProfile) -> str:
    count = len(profile.fitted)
    if not count:
        return "No parameter of it was fitted."
    return (
        f"{count} of its numbers were fitted to the paper's standard deviations: the agreement "
        "is a calibration, not a prediction."
    )


def _std_table(
    replays: Sequence[Replay], heads: Mapping[str, HeadCalibration], profile: ErrorProfile
) -> str:
    rows = []
    for result in replays:
        figure, ours = result.figure, result.statistics
        predicted = _depth_std_from_joints(result, profile, heads[figure.lens])
        ratio = _three(ours.std_m / np.array(figure.std_m), 2)
        stds = _three(figure.std_m, 3), _three(ours.std_m, 4), ratio, f"{predicted:.4f}"
        what = figure.number, figure.motion, figure.lens
        rows.append((*what, *stds, ours.samples, ours.dropped))
    heading = (
        "Fig. | motion | lens | paper x / y / z | ours x / y / z | ours / paper "
        "| x by Eqs. 20-21 | samples | dropped"
    )
    return markdown_table(heading, rows)


def _verdict(replays: Sequence[Replay]) -> str:
    ratios = np.array([r.statistics.std_m / np.array(r.figure.std_m) for r in replays])
    if not np.isfinite(ratios).all():
        return "Not every figure could be located."
    worst = float(np.exp(np.abs(np.log(ratios)).max()))
    close = int((np.abs(ratios - 1) <= 0.25).sum())
    depth = float(np.abs(ratios[:, 0] - 1).max())
    return (
        f"Of {ratios.size} standard deviations {close} are within 25 % of the paper's, all within "
        f"a factor {worst:.2f}; those of depth within {100 * depth:.0f} %. The paper rounds to "
        "1 mm, which alone makes a printed 2 mm uncertain by 25 %."
    )


def _mean_table(replays: Sequence[Replay]) -> str:
    rows = []
    for result in replays:
        paper, ours = result.figure.mean_m, result.statistics
        error = ours.mean_m - paper
        ratio = f"{abs(error[0]) / ours.std_m[0]:.2f}"
        across = f"{1e3 * float(np.hypot(error[1], error[2])):.1f} mm"
        rows.append((result.figure.number, _three(paper, 3), _three(ours.mean_m, 4), ratio, across))
    heading = "Fig. | object (the paper's mean) | our mean | depth error / our std | error across"
    return markdown_table(heading, rows)


def _comparison(replays: Sequence[Replay]) -> list[str]:
    """Compare the depth of all methods; empty if only one was used."""
    compared = {result.figure.number: summaries(result) for result in replays}
    methods = list(dict.fromkeys(method for each in compared.values() for method in each))
    if not methods:
        return []
    rows = []
    for number, each in compared.items():
        paper = each[PAPER]
        for method in methods:
            found = each[method]
            std, mean = (1e3 * found[key][0] for key in ("std_m", "mean_m"))
            off = mean - 1e3 * found["object_m"][0]
            times = paper["std_m"][0] / found["std_m"][0]
            rows.append((number, method, f"{std:.2f} mm", f"{times:.1f}", f"{off:+.2f} mm"))
    return [
        "## Methods compared",
        "All methods have the same images, readings and object pixels. `single-frame` corrects "
        "each pair of images by itself; `learned` also keeps what persists, and had "
        f"looked around for {LOOK_S:g} s before; `floor` is given the true head.",
        markdown_table("Fig. | method | depth std | times steadier | depth error", rows),
    ]


def _calibration_table(calibrations: Mapping[str, SequentialCalibration]) -> list[str]:
    rows, remarks = [], []
    for lens, found in calibrations.items():
        for name, made in found.intrinsics.items():
            focal = made.camera.matrix[0, 0]
            rows.append((lens, name, made.views, f"{made.rms_px:.3f} px", f"{focal:.2f} px"))
        eyes = ", ".join(f"{count} ({eye})" for eye, count in found.eye_views.items())
        remarks.append(
            f"Static stereo with the {lens} lens: {found.stereo_views} views, RMS "
            f"{found.stereo_rms_px:.3f} px. Eye orientations: {eyes}."
        )
    return [markdown_table("lens | camera | views | RMS residual | focal length", rows), *remarks]


def _three(values: Array | tuple[float, ...], digits: int) -> str:
    return " / ".join(f"{value:.{digits}f}" for value in values)
