"""Results of the command depth: a recording, JSON and a report, pair by pair."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vergence.cli.report import Part, Report, Table
from vergence.demos.depth_errors import RANGE_M, DepthErrors
from vergence.errors import counted
from vergence.files import REPORT, write_whole
from vergence.findings import Finding, warning
from vergence.progress import Progress
from vergence.self_calibration.dense_pairs import (
    DepthSequence,
    misaligned,
    row_difference_rad,
    row_noise_rad,
)
from vergence.viewer.depth import depth_recording, log_depth
from vergence.viewer.recording import log_report

TITLE = "Dense depth"
RESULTS = ("depth.rrd", "depth.json", REPORT)
"""Files in the folder of the results."""
HEADING = (
    "geometry", "median error [%]", "wrong by a fifth [%]", "others within two std [%]",
    "rows, rms [px]",
)  # fmt: skip
DOUBT = (
    "Features are {:.2g} degrees beside their rows: the calibration is of another head, a camera "
    "has turned since, or images and readings are not of the same moments. The depths are wrong by "
    "far more than is stated."
)


@dataclass(frozen=True)
class Summary:
    """Statistics of dense depth over all pairs; written as JSON."""

    pairs: int
    left_out: int
    """Further rows at whose postures the views cannot be rectified."""
    matched: float
    """Share of the rectified pixels that have a depth."""
    textured: float
    """Share of them that texture determines well."""
    median_relative_std: float
    """Stated standard deviation over depth, of textured pixels at RANGE_M."""
    row_difference_deg: float
    """Angle between the rows of a feature in the two rectified images, median over features and
    pairs; NaN: too few features were matched."""
    findings: tuple[Finding, ...] = ()
    joints: DepthErrors | None = None
    """By the calibration and the joint readings; None: the truth is not known."""
    seen: DepthErrors | None = None
    """By the geometry that both eyes see; None: not asked for, or the truth is not known."""
    true_geometry: DepthErrors | None = None
    """By the true head and angles: the error of the matching itself."""


def write_depth(out: Path, sequence: DepthSequence, progress: Progress) -> Report:
    """Write depth.rrd, depth.json and report.md of a sequence into a `results_folder`."""
    head, count = sequence.head, sequence.count
    progress("dense depth, pairs", 0, count)
    relative_stds, shares, rows_rad, noises_rad = [], [], [], []
    with depth_recording(out / "depth.rrd", head) as rec:
        for k, (moment, (pair, dense)) in enumerate(sequence.found):
            near = dense.textured & (dense.depth_m > RANGE_M[0]) & (dense.depth_m < RANGE_M[1])
            relative_stds.append(dense.std_m[near] / dense.depth_m[near])
            shares.append((np.isfinite(dense.depth_m).mean(), dense.textured.mean()))
            rows_rad.append(row_difference_rad(moment, pair))
            noises_rad.append(row_noise_rad(pair))
            seen = moment.seen
            log_depth(
                rec,
                head if seen is None else seen.head,
                time_s=moment.time_s,
                index=k,
                joints=moment.joints if seen is None else seen.joints,
                pair=pair,
                right=moment.right,
                found=dense,
            )
            progress("dense depth, pairs", k + 1, count)
        matched, textured = np.mean(shares, axis=0)
        stds, known = np.concatenate(relative_stds), np.isfinite(rows_rad)
        angle_rad = float(np.median(np.array(rows_rad)[known])) if known.any() else np.nan
        doubtful = misaligned(angle_rad, float(np.median(noises_rad)))
        doubt = warning("misaligned-rows", DOUBT.format(np.degrees(angle_rad)))
        findings = (doubt,) if doubtful else ()
        report = depth_report(
            Summary(
                pairs=count,
                left_out=sequence.left_out,
                matched=float(matched),
                textured=float(textured),
                median_relative_std=float(np.median(stds)) if stds.size else np.nan,
                row_difference_deg=float(np.degrees(angle_rad)),
                findings=findings,
                **sequence.errors(),
            )
        )
        log_report(rec, report.markdown())
    report.write_json(out / "depth.json")
    write_whole(out / REPORT, report.markdown())
    return report


def depth_report(done: Summary) -> Report:
    """Report the statistics of dense depth and, where the truth is known, its errors."""
    where = f"{RANGE_M[0]} to {RANGE_M[1]} m"
    stated = f"None of these is at {where}."
    if np.isfinite(done.median_relative_std):
        percent = 100 * done.median_relative_std
        stated = f"At {where} their stated standard deviation is {percent:.1f} % in the median."
    parts: list[Part] = [
        f"{counted(done.pairs, 'pair')}: {100 * done.matched:.0f} % of the rectified pixels have a "
        f"depth, {100 * done.textured:.0f} % one that texture determines well. {stated}",
        f"A feature is {done.row_difference_deg:.2g} degrees beside its row in the median."
        if np.isfinite(done.row_difference_deg)
        else "Too few features are matched to compare the rows of the two images.",
    ]
    if done.left_out:
        parts.append(
            f"{done.left_out} more cannot be rectified: the two views do not overlap, or an eye "
            "looks along the line from one camera to the other."
        )
    parts += [f"Warning: {each}" for each in done.findings]
    rows = [
        (
            name,
            f"{100 * e.median_relative:.2f}",
            f"{100 * e.wrong:.1f}",
            f"{100 * e.within_two_std:.0f}",
            f"{e.vertical_rms_px:.2f}",
        )
        for name, e in (
            ("calibration and joints", done.joints),
            ("seen by both eyes", done.seen),
            ("true geometry", done.true_geometry),
        )
        if e is not None
    ]
    if rows:
        parts += [f"Errors at {where} where there is texture:", Table(HEADING, rows)]
    return Report(TITLE, parts, done)
