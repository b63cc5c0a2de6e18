"""Shapes in the 3-D view of a recording: the robot, its cameras, lines of sight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.stereo.extrinsics import camera_poses
from vergence.viewer import style
from vergence.viewer.layouts import camera_entities

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom


def placed(T: Array) -> rr.Transform3D:
    """Place an entity at pose T (4, 4) in its parent."""
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def log_geoms(rec: rr.RecordingStream, geoms: Sequence[VisualGeom]) -> None:
    """Record visible shapes, each fixed to the entity of its body."""
    for k, geom in enumerate(geoms):
        opacity = 0.35 if geom.body == "object" else 1.0  # most estimates lie inside the object
        rgba = geom.rgba * [1, 1, 1, opacity]
        shape = _shape(geom, np.round(255 * rgba).astype(np.uint8))
        rec.log(f"world/{geom.body}/shape/{k}", placed(geom.T_body_geom), shape, static=True)


def _shape(geom: VisualGeom, color: np.ndarray) -> rr.AsComponents:
    """Draw a shape in frame geom."""
    size, look = geom.size, {"colors": [color], "fill_mode": "solid"}
    if geom.triangles is not None and geom.normals is not None:
        corners, normals = geom.triangles.reshape(-1, 3), geom.normals.reshape(-1, 3)
        return rr.Mesh3D(vertex_positions=corners, vertex_normals=normals, albedo_factor=color)
    if geom.shape == "box":
        return rr.Boxes3D(half_sizes=[size], **look)
    if geom.shape in ("sphere", "ellipsoid"):
        half_sizes = size[[0, 0, 0]] if geom.shape == "sphere" else size
        return rr.Ellipsoids3D(half_sizes=[half_sizes], **look)
    look |= {"radii": [size[0]], "lengths": [2 * size[1]]}
    if geom.shape == "cylinder":
        return rr.Cylinders3D(**look)
    if geom.shape == "capsule":  # rerun's begins at its origin; MuJoCo's has it in the middle
        return rr.Capsules3D(translations=[[0, 0, -size[1]]], **look)
    x, y = size[:2]
    return rr.Mesh3D(
        vertex_positions=[[-x, y, 0], [x, y, 0], [x, -y, 0], [-x, -y, 0]],
        vertex_normals=np.tile([0, 0, 1], (4, 1)),
        vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
        triangle_indices=[[0, 2, 1], [0, 3, 2]],
        albedo_texture=geom.texture,
        albedo_factor=color,
    )


def log_points_style(
    rec: rr.RecordingStream, entity: str, radius_px: float, color: tuple[int, int, int]
) -> None:
    """Record the size and the colour of the points that an entity gets later."""
    points = rr.Points3D.from_fields(radii=-radius_px, colors=color)  # negative: in pixels
    rec.log(entity, points, static=True)


def log_cameras(rec: rr.RecordingStream, head: HeadCalibration) -> None:
    """Record the cameras in their eyes."""
    for name, entity in camera_entities(head).items():
        mounted = head.camera(name)
        camera, image_from_camera = mounted.intrinsics, mounted.intrinsics.matrix.copy()
        lens = float(camera.matrix[0, 0]) / camera.width
        image_from_camera[:2, 2] += 0.5
        rec.log(
            entity,
            placed(mounted.T_eye_cam),
            rr.Pinhole(
                image_from_camera=image_from_camera,
                width=camera.width,
                height=camera.height,
                image_plane_distance=0.095 * lens,  # [m]: all images are equally wide
            ),
            rr.TransformAxes3D(0),  # else the viewer draws axes as long as the frustum
            static=True,
        )


def spread_ellipsoid(points: Array) -> rr.Ellipsoids3D:
    """Draw the ellipsoid of two standard deviations around the mean of points (N, 3)."""
    variances, axes = np.linalg.eigh(np.cov(points.T))
    axes[:, 0] *= np.linalg.det(axes)  # a rotation, not a reflection
    return rr.Ellipsoids3D(
        centers=[points.mean(axis=0)],
        half_sizes=[2 * np.sqrt(np.maximum(variances, 0))],
        quaternions=[rr.Quaternion(xyzw=Rotation.from_matrix(axes).as_quat())],
        colors=style.OBJECT,
        fill_mode="majorwireframe",
    )


def lines_of_sight(head: HeadCalibration, points: Array, eye_angles: Array) -> Array:
    """Draw polylines (N, 3, 3) from the left main camera to a point to the right main camera.

    Points (N, 3) [m] are in the left eye's base frame, as the result; `eye_angles` (N, r) [rad].
    """
    left, right = np.moveaxis(camera_poses(head, eye_angles)[..., :3, 3], 1, 0)
    return np.stack([left, points, right], axis=1)
