"""Convert columns of time stamps to nanoseconds, and recognise their unit by its magnitude."""

from __future__ import annotations

import re

import numpy as np

from vergence.errors import VergenceError

UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Units of time [ns]."""
SINCE_1970_S = 9.4e8, 4.2e9
"""Times [s] that count as seconds since 1970: of the years 2000 to 2100."""
MAX_STEP_S = 20.0
"""Longest usual time [s] between successive stamps that do not count from 1970."""
_UNIT = re.compile(r"(?:^|[^a-z])(nano|micro|milli|[num])?(s|secs?|seconds?)[^a-z]*$")


def nanoseconds(values: np.ndarray, unit: str, where: str) -> np.ndarray:
    """Convert stamps (N,) of int or float to int64 [ns]; VergenceError for impossible ones."""
    factor = UNITS_NS[unit]
    possible = np.abs(values.astype(float)) * factor < 2.0**63
    if not possible.all():
        k = int(np.argmin(possible))
        raise VergenceError(f"{where}: stamp {k + 1} is {values[k]}, not a time in {unit}.")
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * factor
    whole = np.floor(values)  # a float of all nanoseconds since 1970 is exact to 256 only
    return whole.astype(np.int64) * factor + np.rint((values - whole) * factor).astype(np.int64)


def read_stamps(values: np.ndarray, name: str, where: str) -> tuple[str, np.ndarray]:
    """Convert stamps (N,) to nanoseconds, and tell the unit that they have.

    It is the last word of their name, or follows from their size and steps. VergenceError if they
    are impossible, or may as well be the numbers of frames.
    """
    unit = _unit(values, name, where)
    return unit, nanoseconds(values, unit, f"{where}: {name}")


def _unit(values: np.ndarray, name: str, where: str) -> str:
    if match := _UNIT.search(name.lower()):
        prefix = match[1] or ""
        return {"micro": "us"}.get(prefix, prefix[:1] + "s")
    stamps = values[np.isfinite(values)]
    middle = np.median(stamps) if len(stamps) else 0.0
    step = np.median(np.abs(np.diff(stamps))) if len(stamps) > 1 else 0.0
    earliest, latest = SINCE_1970_S
    for unit, factor in UNITS_NS.items():
        if earliest <= middle * factor * 1e-9 <= latest and step * factor <= 3600e9:
            return unit
    if (stamps != np.rint(stamps)).any():
        return "s"
    if step <= 1:
        raise VergenceError(
            f"{where}: {name} has steps of {step:g}, as numbers of frames have; name the "
            "column with the unit of times at its end, such as time_s or time_ns."
        )
    return next((unit for unit, f in UNITS_NS.items() if step * f <= MAX_STEP_S * 1e9), "ns")
