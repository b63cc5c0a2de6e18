"""What `vergence self-calibrate` says: what a recording showed of a head, and what it did not."""

from __future__ import annotations

from typing import Any

import numpy as np

from vergence.errors import counted
from vergence.self_calibration.recorded import (
    OBSERVED,
    LearnedParameter,
    RecordedSelfCalibration,
)

HEADING = ("parameter", "change", "std before", "std after", "")
_MOST_NAMED = 6


def _unit(name: str) -> tuple[str, float]:
    """Return the unit in which a parameter is printed, and the factor from its own unit to it."""
    last = name.rpartition(".")[2]
    if last in ("fx", "fy", "cx", "cy"):
        return "px", 1.0
    if last in ("rx", "ry", "rz") or last.endswith("_rad"):
        return "deg", float(np.degrees(1.0))
    if last in ("tx", "ty", "tz") or last.endswith("_m"):
        return "mm", 1e3
    return ("%", 100.0) if last.endswith("gain") else ("", 1.0)


def table(found: RecordedSelfCalibration) -> list[tuple[str, ...]]:
    """Return a row for each parameter that was observed, at least in part, by `HEADING`."""
    rows = []
    for each in found.parameters:
        if each.verdict == "not observed":
            continue
        unit, scale = _unit(each.name)
        values = (f"{scale * v:.3g}" for v in (each.prior_std, each.std))
        change = f"{scale * each.change:+.3g} {unit}".rstrip()
        rows.append((each.name, change, *values, each.verdict))
    return rows


def sentences(found: RecordedSelfCalibration) -> list[str]:
    """Return sentences about the recording as a whole, its warnings last."""
    source = "" if found.learned else " (assumed)"
    lines = [
        f"{counted(found.frames, 'frame')}: {found.seen} determined the relative pose of the "
        f"cameras, and {found.learned} updated the parameters; noise of the readings "
        f"{np.degrees(found.joint_std_rad):.3f} degrees{source}."
    ]
    hidden = [each for each in found.parameters if each.verdict == "not observed"]
    if len(hidden) == len(found.parameters):
        lines.append("Nothing that persists is known better than before.")
    elif hidden:
        lines.append(f"Not observed, as before: {_named(hidden)}.")
    if found.depth_std_m is not None:
        before, after = (1e3 * std for std in found.depth_std_m)
        by = {
            "nothing": "by the calibration",
            "little": "by the calibration and what may have moved since",
            "anything": "by usual tolerances",
        }[found.changed]
        learned = f", {after:.3g} mm by what was learned" if found.learned else ""
        lines.append(f"Depth of a point 1 m straight ahead: std {before:.3g} mm {by}{learned}.")
    return [*lines, *(f"Warning: {each}" for each in found.findings)]


def _named(parameters: list[LearnedParameter]) -> str:
    names = [each.name for each in parameters]
    rest = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")


def as_plain(found: RecordedSelfCalibration) -> dict[str, Any]:
    """Return everything as plain values for JSON; a parameter is observed at OBSERVED or less."""
    return {
        "frames": found.frames,
        "seen": found.seen,
        "learned": found.learned,
        "joint_std_deg": float(np.degrees(found.joint_std_rad)),
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
