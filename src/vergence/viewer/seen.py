"""Record self-calibration: the matches in the images, and what was learned since the calibration.

/world/<side>_eye/<camera>/matches  features that both eyes see: green where they fit, red where
                                    they do not
/learned/gain/<joint>, focal/<camera>  change since the calibration, and plus and minus its
                                    standard deviation [%]
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import parameter_values
from vergence.self_calibration.robust_fit import INLIER
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.viewer import style
from vergence.viewer.layout import camera_entities, curves_view


def learned_entities(known: FilterState) -> dict[str, str]:
    """Return by parameter that is plotted its entity: gains of the joints and focal lengths."""
    found = {}
    for name in known.names:
        owner, _, rest = name.partition(".")
        if name.endswith("gain"):
            found[name] = f"learned/gain/{owner}_{rest.removesuffix('_gain')}"
        elif rest == "fx" and owner in known.cameras:
            found[name] = f"learned/focal/{owner}"
    return found


def log_seen_styles(rec: rr.RecordingStream, head: HeadCalibration, known: FilterState) -> None:
    """Record the names and colours of curves and marks."""
    for name, entity in learned_entities(known).items():
        short = entity.rpartition("/")[2]
        colour = style.JOINT_COLOURS.get(short)
        if name.endswith(".fx"):
            colour = style.EYE_COLOURS[head.camera(short).eye][0]
        label = short.replace("_", " ")
        names = [label, f"{label} + std", f"{label} - std"]
        colours = None if colour is None else [colour] * 3
        lines = rr.SeriesLines(names=names, colors=colours, widths=[2.0, 0.7, 0.7])
        rec.log(entity, lines, static=True)


def log_matches(rec: rr.RecordingStream, head: HeadCalibration, seen: FrameEstimate) -> None:
    """Record the matches of a frame in both images, at the time that was set."""
    colours = np.where(seen.weights[:, None] > INLIER, style.FITTING, style.MISFIT)
    entities = camera_entities(head)
    both = seen.matches.left, seen.matches.right
    for camera, pixels in zip(seen.cameras, both, strict=True):
        points = rr.Points2D(pixels + 0.5, colors=colours, radii=rr.Radius.ui_points(1.5))
        rec.log(f"{entities[camera]}/matches", points)


def log_learned(rec: rr.RecordingStream, calibration: HeadCalibration, known: FilterState) -> None:
    """Record what was learned since the calibration, with its deviation, at the time that was set.

    Gains by their difference, focal lengths by their ratio.
    """
    before, after = parameter_values(calibration), parameter_values(known.head)
    stds = dict(zip(known.names, np.sqrt(np.diag(known.covariance)), strict=True))
    for name, entity in learned_entities(known).items():
        value, first = after[name], before[name]
        if value is None or first is None:
            continue
        scale = 100.0 / (first if name.endswith(".fx") else 1.0)
        change, std = scale * (value - first), scale * stds[name]
        rec.log(entity, rr.Scalars([change, change + std, change - std]))


def learned_views() -> rrb.Tabs:
    """Return the plots of what was learned."""
    return rrb.Tabs(
        curves_view("gains since the calibration [%], ± std: orange left, teal right",
                    "learned/gain", legend=False),
        curves_view("focal lengths since the calibration [%], ± std: orange left, teal right",
                    "learned/focal", legend=False),
    )  # fmt: skip
