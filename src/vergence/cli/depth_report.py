"""Results of the command depth: a recording, JSON and a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vergence.cli.report import Report
from vergence.errors import counted
from vergence.files import REPORT, markdown_table, write_whole
from vergence.findings import warning
from vergence.progress import Progress
from vergence.self_calibration.dense_pairs import (
    RANGE_M,
    DepthSequence,
    largest_row_difference_rad,
    row_difference_rad,
)
from vergence.viewer.depth import depth_blueprint, log_depth
from vergence.viewer.live import Viewer, open_feed
from vergence.viewer.recording import log_report

RESULTS = ("depth.rrd", "depth.json", REPORT)
"""Files in the folder of the results."""
GEOMETRIES = {
    "joints": "calibration and joints",
    "seen": "seen by both eyes",
    "true_geometry": "true geometry",
}
"""Geometries whose errors are stated where the truth is known, as the table names them."""
DOUBT = (
    "Features are {:.2g} degrees beside their rows: the calibration is of another head, a camera "
    "has turned since, or images and readings are not of the same moments. The depths are wrong by "
    "far more than is stated."
)


def write_depth(
    out: Path, sequence: DepthSequence, progress: Progress, viewer: Viewer | None = None
) -> Report:
    """Write depth.rrd, depth.json and report.md of a sequence into a `results_folder`."""
    head, count = sequence.head, sequence.count
    progress("dense depth, pairs", 0, count)
    relative_stds, shares, rows_rad, limits_rad = [], [], [], []
    file = out / "depth.rrd"
    with open_feed("depth", depth_blueprint(), head, file=file, viewer=viewer) as feed:
        for k, (frame, (pair, dense)) in enumerate(sequence.found):
            near = dense.textured & (dense.depth_m > RANGE_M[0]) & (dense.depth_m < RANGE_M[1])
            relative_stds.append(dense.std_m[near] / dense.depth_m[near])
            shares.append((np.isfinite(dense.depth_m).mean(), dense.textured.mean()))
            rows_rad.append(row_difference_rad(frame, pair))
            limits_rad.append(largest_row_difference_rad(pair))
            feed(log_depth, index=k, frame=frame, pair=pair, found=dense)
            progress("dense depth, pairs", k + 1, count)
        matched, textured = np.mean(shares, axis=0)
        stds, known = np.concatenate(relative_stds), np.isfinite(rows_rad)
        angle_rad = float(np.median(np.array(rows_rad)[known])) if known.any() else np.nan
        doubtful = angle_rad > np.median(limits_rad)
        doubt = warning("misaligned-rows", DOUBT.format(np.degrees(angle_rad)))
        report = depth_report(
            {
                "pairs": count,
                "left_out": sequence.left_out,
                "matched": float(matched),
                "textured": float(textured),
                "median_relative_std": float(np.median(stds)) if stds.size else np.nan,
                "row_difference_deg": float(np.degrees(angle_rad)),
                "findings": (doubt,) if doubtful else (),
                **dict.fromkeys(GEOMETRIES),
                **sequence.errors(),
            }
        )
        feed.always(log_report, report.markdown())
    report.write_json(out / "depth.json")
    write_whole(out / REPORT, report.markdown())
    return report


def depth_report(data: Mapping[str, Any]) -> Report:
    """Report the statistics of dense depth and, where the truth is known, its errors."""
    where = f"{RANGE_M[0]} to {RANGE_M[1]} m"
    parts: list[str] = [
        f"{counted(data['pairs'], 'pair')}: {100 * data['matched']:.0f} % of the rectified pixels "
        f"have a depth, {100 * data['textured']:.0f} % one that texture determines well."
    ]
    if np.isfinite(std := data["median_relative_std"]):
        parts.append(f"Their median standard deviation at {where} is {100 * std:.1f} %.")
    if np.isfinite(angle_deg := data["row_difference_deg"]):
        parts.append(f"A feature is {angle_deg:.2g} degrees beside its row in the median.")
    else:
        parts.append("Too few features are matched to compare the rows of the two images.")
    if data["left_out"]:
        parts.append(
            f"{data['left_out']} more cannot be rectified: the two views do not overlap, or an eye "
            "looks along the line from one camera to the other."
        )
    parts += [f"Warning: {each}" for each in data["findings"]]
    rows = [
        (
            name,
            f"{100 * errors.median_relative:.2f}",
            f"{100 * errors.wrong:.1f}",
            f"{100 * errors.within_two_std:.0f}",
            f"{errors.vertical_rms_px:.2f}",
        )
        for key, name in GEOMETRIES.items()
        if (errors := data[key]) is not None
    ]
    heading = (
        "geometry | median error [%] | wrong by a fifth [%] | others within two std [%] | "
        "rows, rms [px]"
    )
    if rows:
        parts += [f"Errors at {where} where there is texture:", markdown_table(heading, rows)]
    return Report("Dense depth", parts, data)
