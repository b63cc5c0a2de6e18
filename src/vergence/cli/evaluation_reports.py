"""Reports of the commands evaluate and self-calibrate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vergence.cli.report import Report
from vergence.files import markdown_table
from vergence.self_calibration.recorded import OBSERVED, SelfCalibrationResult

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to self-calibrate a real head
    from vergence.twin.evaluation import Evaluation


def evaluation_report(found: Evaluation) -> Report:
    """Report errors of a calibration, and how many confidence regions contain the truth."""
    rows = [
        (name, f"{e.rotation_deg:.4f}", f"{e.translation_mm:.3f}", f"{e.focal_percent:.3f}")
        for name, e in found.cameras.items()
    ]
    base = f"{found.base_rotation_deg:.4f}", f"{found.base_translation_mm:.3f}"
    heading = "error | rotation [deg] | translation [mm] | focal [%]"
    parts: list[str] = [markdown_table(heading, [*rows, ("T_rbase_lbase", *base, "")])]
    if found.regions:
        outside = [name for name, region in found.regions.items() if not region.holds_truth]
        inside = len(found.regions) - len(outside)
        parts.append(f"95 % regions that hold the truth: {inside} of {len(found.regions)}")
        if outside:
            parts.append(f"outside: {', '.join(outside)}")
        parts.append(f"error of the time offset: {found.time_offset_ms:z.3f} ms")
    else:
        parts.append("This calibration states no accuracy of its own.")
    return Report("Errors of a calibration", parts, found)


def self_calibration_report(found: SelfCalibrationResult) -> Report:
    """Report what a recording showed of each parameter, and of the depth of a point."""
    rows = [
        (each.name, f"{each.change:+.3g}", f"{each.prior_std:.3g}", f"{each.std:.3g}", each.verdict)
        for each in found.parameters
        if each.verdict != "not observed"
    ]
    heading = "parameter [px, rad, m] | change | std before | std after |"
    table = (markdown_table(heading, rows),) if rows else ()
    data = {
        "frames": found.frames,
        "seen": found.seen,
        "learned": found.learned,
        "joint_std_deg": float(np.degrees(found.reading_std)),
        "depth_std_m": found.depth_std_m,
        "observed_up_to": OBSERVED,
        "parameters": {
            each.name: {
                "change": each.change,
                "prior_std": each.prior_std,
                "std": each.std,
                "verdict": each.verdict,
            }
            for each in found.parameters
        },
        "findings": [vars(each) for each in found.findings],
    }
    return Report("Change since the calibration", (*table, *found.summary().splitlines()), data)
