"""Record self-calibration: matches in the images, and learned parameters.

Below /learned are changes since the calibration, and the same plus and minus one std [%].
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import parameter_values
from vergence.self_calibration.robust_fit import INLIER
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.viewer import style
from vergence.viewer.layouts import camera_entities


def learned_entities(known: FilterState) -> dict[str, str]:
    """Name the entities of the parameters that are plotted: gains and focal lengths."""
    found = {}
    for name in known.names:
        owner, _, parameter = name.partition(".")
        if name.endswith("gain"):
            found[name] = f"learned/gain/{owner}_{parameter.removesuffix('_gain')}"
        elif parameter == "fx" and owner in known.cameras:
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
        lines = rr.SeriesLines(
            names=[label, f"{label} + std", f"{label} - std"],
            colors=None if colour is None else [colour] * 3,
            widths=[2.0, 0.7, 0.7],
        )
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
    """Record the change of gains and, relative to their size, of focal lengths, with its std."""
    before, after = parameter_values(calibration), parameter_values(known.head)
    stds = dict(zip(known.names, np.sqrt(np.diag(known.covariance)), strict=True))
    for name, entity in learned_entities(known).items():
        value, first = after[name], before[name]
        if value is None or first is None:
            continue
        scale = 100.0 / (first if name.endswith(".fx") else 1.0)
        change, std = scale * (value - first), scale * stds[name]
        rec.log(entity, rr.Scalars([change, change + std, change - std]))
