"""What `vergence depth` says: what dense depth came to, and its errors where the truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.writing import markdown_table

TITLE = "# Dense depth"
RANGE_M = (0.5, 1.5)
"""Distances at which accuracy is stated."""


@dataclass(frozen=True)
class DepthErrors:
    """Errors of depth at RANGE_M where there is texture, over all pairs."""

    median_relative: float
    wrong: float
    """Share of the pixels that are wrong by more than a fifth."""
    within_two_std: float
    """Share of the others whose error is within two standard deviations."""
    pixels: int
    vertical_rms_px: float
    """Difference of the rows of a point in the two rectified images."""


@dataclass(frozen=True)
class Summary:
    """What dense depth came to; written as JSON."""

    pairs: int
    left_out: int
    """Rows that were chosen too, but at whose postures the views cannot be rectified."""
    matched: float
    """Share of the rectified pixels that have a depth."""
    textured: float
    """Share that has one which texture determines well."""
    median_relative_std: float
    """Stated standard deviation over depth, of textured pixels at RANGE_M."""
    row_difference_deg: float
    """By how much the rows of a matched feature differ in the rectified images, in the median of
    the features and of the pairs; NaN: none showed enough of them."""
    doubt: str | None
    """Why the calibration is doubted; None: it is not."""
    joints: DepthErrors | None = None
    """By the calibration and the joint readings; None: the truth is not known."""
    seen: DepthErrors | None = None
    """By the geometry that both eyes see; None: it was not asked for, or the truth is not known."""
    true_geometry: DepthErrors | None = None
    """By the true head and the true angles: what the matching itself leaves."""


def as_markdown(done: Summary) -> str:
    """Return the report."""
    where = f"{RANGE_M[0]} to {RANGE_M[1]} m"
    left_out, stated = "", f"None of these is at {where}."
    if done.left_out:
        left_out = (
            f" {done.left_out} more cannot be rectified: the two views do not overlap, or an eye "
            "looks along the line from one camera to the other."
        )
    if np.isfinite(done.median_relative_std):
        stated = (
            f"At {where} the stated standard deviation of these is "
            f"{100 * done.median_relative_std:.1f} % in the median."
        )
    lines = [
        TITLE,
        "",
        f"{done.pairs} {'pair' if done.pairs == 1 else 'pairs'}.{left_out} "
        f"{100 * done.matched:.0f} % of the rectified pixels have a depth, "
        f"{100 * done.textured:.0f} % one that texture determines well. {stated}",
        "",
        f"A feature is {done.row_difference_deg:.2g} degrees beside its row in the median."
        if np.isfinite(done.row_difference_deg)
        else "Too few features are matched to compare the rows of the two images.",
        "",
    ]
    if done.doubt is not None:
        lines += [f"Warning: {done.doubt}", ""]
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
        heading = (
            "geometry | median error [%] | wrong by a fifth [%] | others within two std [%] | "
            "rows, rms [px]"
        )
        lines += [f"Errors at {where} where there is texture:", ""]
        lines += [markdown_table(heading, rows), ""]
    return "\n".join(lines)
