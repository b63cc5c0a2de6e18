"""Record a head of a model that moves; the world is frame head with a straight neck."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.kinematics import EYES, eye_pose
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse
from vergence.viewer.layouts import playing, report_view, view_3d
from vergence.viewer.recording import log_report, recording_file, set_time
from vergence.viewer.shapes import placed

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom
    from vergence.twin.head_checks import View

STEP_S = 0.1
"""Time between postures of the recording [s]."""


def record_head(
    path: Path, head: HeadCalibration, geoms: Sequence[VisualGeom], views: Iterable[View], text: str
) -> None:
    """Write a recording of a head that moves; VergenceError if the file cannot be written."""
    near, far = np.array([0.05, 0.0, 0.0]), np.array([0.45, 0.45, 0.25])
    space = view_3d("the head, axes of its joints and views of its cameras", middle=near, eye=far)
    layout = playing(rrb.Horizontal(space, report_view()), speed=1.0)
    part = rr.escape_entity_path_part
    inside = [replace(geom, body=f"robot/{part(geom.body)}") for geom in geoms]
    with recording_file(path, "head", layout, head, inside) as rec:
        for k, view in enumerate(views):
            set_time(rec, STEP_S * k, k)
            for body in {geom.body for geom in geoms}:
                rec.log(f"world/robot/{part(body)}", placed(view.bodies[body]))
            neck, readings = np.split(view.posture, [len(head.neck.axes)])
            T_head = inverse(head_pose(head.neck, 0 * neck)) @ head_pose(head.neck, neck)
            for eye in EYES:
                T = T_head @ base_pose(head, eye) @ eye_pose(head.kinematics, eye, readings)
                rec.log(f"world/{eye}_eye", placed(T))
            start, end = np.array(list(view.axes.values())).swapaxes(0, 1)
            arrows = rr.Arrows3D(origins=start, vectors=end - start, labels=list(view.axes))
            rec.log("world/axes", arrows)
        log_report(rec, text)
