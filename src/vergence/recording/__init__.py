"""Recordings for the rerun viewer: files that explain themselves when they are opened.

The only package that imports rerun. The entities of a figure's recording (those of the gaze are
in `recording.gaze`), on the timelines `sim_time` [s] and `frame`:

    /world/<body>                 poses of the head's bodies and of the object, with their shapes
    /world/<side>_eye/<camera>    a pinhole, with its /image, and the object /detected and in /truth
    /world/left_base              the left eye's base frame, with the estimates
    /estimate/x, y, z             the estimates [m], all their digits
    /estimate_mean/x, y, z        their mean, and mean ± standard deviation
    /paper/x, y, z                the paper's
    /joints/<joint>               joint readings [rad]
    /report                       markdown

A pixel's centre is at +0.5 in rerun, and at 0 in the rest of the project.
"""

from vergence.recording.figure import (
    figure_recording,
    log_report,
    log_series,
    log_statistics,
)
from vergence.recording.frame import log_frame
from vergence.recording.layout import blueprint
from vergence.recording.opening import recording_file
from vergence.recording.reading import read_series

__all__ = [
    "blueprint",
    "figure_recording",
    "log_frame",
    "log_report",
    "log_series",
    "log_statistics",
    "read_series",
    "recording_file",
]
