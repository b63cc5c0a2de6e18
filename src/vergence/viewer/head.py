"""Record a head of a model that moves.

The world is frame head as it stands with a straight neck. The robot's bodies are below
/world/robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.kinematics import EYES, eye_pose
from vergence.viewer import style
from vergence.viewer.layouts import curves_view, playing, report_view, view_3d
from vergence.viewer.plots.head import AXIS_M, head_moved, joint_axes
from vergence.viewer.recording import log_curve, log_report, recording_file, set_time, time_columns
from vergence.viewer.shapes import placed

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom
    from vergence.twin.head_sweep import Sweep

STEP_S = 0.1
"""Time between postures of the recording [s]."""


def record_head(
    path: Path, head: HeadCalibration, geoms: Sequence[VisualGeom], moved: Sweep, report: str
) -> None:
    """Write a recording of a head that moves; VergenceError if the file cannot be written."""
    space = view_3d(
        "the head, the axes of its joints and the views of its cameras",
        middle=np.array([0.05, 0.0, 0.0]),
        eye=np.array([0.45, 0.45, 0.25]),
    )
    curves = curves_view("neck and readings of the eyes [rad]", "joints")
    layout = playing(rrb.Horizontal(space, rrb.Vertical(curves, report_view())), speed=1.0)
    inside = [replace(geom, body=f"robot/{_part(geom.body)}") for geom in geoms]
    with recording_file(path, "head", layout, head, inside) as rec:
        for k, (readings, neck) in enumerate(zip(moved.readings, moved.neck, strict=True)):
            set_time(rec, STEP_S * k, k)
            for body in {geom.body for geom in geoms}:
                rec.log(f"world/robot/{_part(body)}", placed(moved.bodies[body][k]))
            T_head = head_moved(head, neck)
            for eye in EYES:
                T = T_head @ base_pose(head, eye) @ eye_pose(head.kinematics, eye, readings)
                rec.log(f"world/{eye}_eye", placed(T))
            names, points, axes = joint_axes(head, readings, neck)
            arrows = rr.Arrows3D(
                origins=points - AXIS_M / 2 * axes, vectors=AXIS_M * axes, labels=names
            )
            rec.log("world/axes", arrows)
            seen = moved.points[[k]][np.isfinite(moved.points[[k]]).all(axis=1)]
            rec.log("world/object", rr.Points3D(seen, radii=0.01, colors=style.AXIS_COLOURS["z"]))
        number = np.arange(len(moved.neck))
        times = time_columns(STEP_S * number.astype(float), number)
        names = [*head.neck.names, *head.kinematics.readings]
        for name, values in zip(names, np.hstack([moved.neck, moved.readings]).T, strict=True):
            log_curve(rec, f"joints/{_part(name)}", times, values)
        log_report(rec, report)


def _part(name: str) -> str:
    """Make a part of an entity's path."""
    return rr.escape_entity_path_part(name)
