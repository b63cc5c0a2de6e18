"""Draw a head of a model: shapes, axes of the joints and views of the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from scipy.spatial import ConvexHull, QhullError

from vergence.arrays import Array
from vergence.geometry.camera import normalise
from vergence.geometry.head import HeadCalibration, base_pose, camera_pose_in_base
from vergence.geometry.joints import Chain, joint_frames
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse, transform
from vergence.viewer.plots.canvas import label, panels, save
from vergence.viewer.style import EYE_COLOURS, html

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to draw a real head
    from vergence.twin.appearance import VisualGeom
    from vergence.twin.head_sweep import Sweep

AXIS_M, FRUSTUM_M = 0.06, 0.10
"""Drawn length of a joint's axis, and drawn depth of a camera's view [m]."""
LABEL_M = (0.03, 0.01)
"""Width and height of a label, nearer than which another one is left out [m]."""
_BOX = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
"""Corners of a box, which outline other shapes, too."""


def head_moved(head: HeadCalibration, neck: Array) -> Array:
    """Compute the pose (4, 4) of frame head against itself with a straight neck."""
    return inverse(head_pose(head.neck, 0 * neck)) @ head_pose(head.neck, neck)


def joint_axes(
    head: HeadCalibration, readings: Array, neck: Array
) -> tuple[list[str], Array, Array]:
    """Compute the axes of n joints at a posture, in frame head as with a straight neck.

    Returns their names, points (n, 3) on them and unit vectors (n, 3).
    """
    n = len(head.neck.axes)
    column = Chain(head.neck.axes, head.neck.points_m, head.neck.head_m, np.eye(n), np.zeros(n))
    chains = [([*head.neck.names], column, inverse(head_pose(head.neck, 0 * neck)), neck)]
    for eye in EYES:
        names = [f"{eye} {joint.name}" for joint in head.kinematics.eyes[eye]]
        T = head_moved(head, neck) @ base_pose(head, eye)
        chains.append((names, head.kinematics.chains[eye], T, readings))
    found, points, axes = [], [], []
    for names, chain, T, angles in chains:
        found += names
        R, t = joint_frames(chain, angles)
        points += [transform(T, t[k]) for k in range(len(names))]
        axes += [T[:3, :3] @ R[k] @ chain.axes[k] for k in range(len(names))]
    return found, np.reshape(points, (-1, 3)), np.reshape(axes, (-1, 3))


def draw_head(
    path: Path, head: HeadCalibration, geoms: Sequence[VisualGeom], moved: Sweep, title: str
) -> None:
    """Draw a head at its first posture, from above and from its left, into a PNG file."""
    readings, neck = moved.readings[0], moved.neck[0]
    names, points, axes = joint_axes(head, readings, neck)
    views = {}
    for name, mounted in head.cameras.items():
        camera = mounted.intrinsics
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * (np.array(camera.size) - 1)
        rays = np.column_stack([normalise(camera, corners.astype(float)), np.ones(5)])
        T = base_pose(head, mounted.eye) @ camera_pose_in_base(head, name, readings)
        views[name] = transform(T, FRUSTUM_M * np.insert(rays, [1, 2, 3, 4], 0, axis=0))
    shown = np.concatenate([points, *views.values()])
    low, high = shown.min(axis=0) - 0.06, shown.max(axis=0) + 0.06
    canvas, both = panels(2, title)
    for axes_of, (across, up), side in zip(
        both, ((1, 0), (0, 2)), ("above", "its left"), strict=True
    ):
        for geom in geoms:
            _fill(axes_of, transform(moved.bodies[geom.body][0], _outline(geom))[:, [across, up]])
        for name, lines in views.items():
            colour = html(EYE_COLOURS[head.cameras[name].eye][0])
            axes_of.plot(*lines[:, [across, up]].T, color=colour, linewidth=1, label=name)
        labelled: list[Array] = []
        for name, point, axis in zip(names, points, axes, strict=True):
            start, end = (point + AXIS_M * np.outer([-0.5, 0.5], axis))[:, [across, up]]
            if np.linalg.norm(end - start) < AXIS_M / 2:  # seen along it, and labelled beside
                axes_of.plot(*point[[across, up]], "o", color="0.2", markersize=3)
                continue
            axes_of.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": "0.2"})
            if not any((np.abs(end - other) < LABEL_M).all() for other in labelled):
                axes_of.annotate(name, end, fontsize=7, color="0.2")
                labelled.append(end)
        words = "xyz"
        label(
            axes_of,
            f"from {side}",
            legend=side != "above",
            xlabel=f"{words[across]} [m]",
            ylabel=f"{words[up]} [m]",
            xlim=(high[across], low[across]) if across == 1 else (low[across], high[across]),
            ylim=(low[up], high[up]),
            aspect="equal",
        )
    save(canvas, path)


def _outline(geom: VisualGeom) -> Array:
    """List points (K, 3) in its body that outline a shape."""
    if geom.triangles is not None:
        return transform(geom.T_body_geom, geom.triangles.reshape(-1, 3))
    size = geom.size.copy()
    if geom.shape in ("cylinder", "capsule"):
        size = np.array([size[0], size[0], size[1] + size[0] * (geom.shape == "capsule")])
    if geom.shape == "sphere":
        size = size[[0, 0, 0]]
    corners = _BOX
    if geom.shape in ("sphere", "ellipsoid", "capsule"):
        turn = np.linspace(0, 2 * np.pi, 24)
        ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        corners = np.concatenate([ring, ring[:, [1, 2, 0]], ring[:, [2, 0, 1]]])
    return transform(geom.T_body_geom, corners * size)


def _fill(axes: Axes, points: Array) -> None:
    """Fill the convex hull of points (K, 2); shapes that are seen edge on are left out."""
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        return
    axes.fill(*hull.T, facecolor="0.85", edgecolor="0.6", linewidth=0.5, alpha=0.35, zorder=0)
