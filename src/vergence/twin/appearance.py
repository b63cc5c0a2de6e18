"""The visible shapes of a model, for drawing the head without MuJoCo."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.geometry.se3 import pose


@dataclass(frozen=True, eq=False)
class VisualGeom:
    """One visible shape, fixed to a body."""

    body: str
    shape: str
    """Of MuJoCo's shapes: box, sphere, ellipsoid, cylinder, capsule, plane or mesh."""
    size: Array
    """(3,) [m] as in MuJoCo: half sizes of a box, an ellipsoid and a plane, radius of a sphere,
    radius and half length along z of a cylinder and a capsule; unused for a mesh."""
    T_body_geom: Array
    """(4, 4) pose in the body."""
    rgba: Array
    """(4,) colour and opacity, from 0 to 1."""
    texture: np.ndarray | None = None
    """(H, W, 3) uint8 RGB, spread once over a plane: first row at +y, columns from -x to +x."""
    triangles: Array | None = None
    """(F, 3, 3) corners [m] of a mesh, in frame geom."""
    normals: Array | None = None
    """(F, 3, 3) unit normals at the corners of a mesh."""


def visual_geoms(model: mujoco.MjModel) -> list[VisualGeom]:
    """List the visible shapes of all bodies, without the room and the collision shapes."""
    geoms = []
    for k in range(model.ngeom):
        # Group 3 has the head's collision shapes, body 0 the room, which would hide the head.
        if model.geom_group[k] in (3, 4) or model.geom_bodyid[k] == 0:
            continue
        shape = mujoco.mjtGeom(int(model.geom_type[k])).name.removeprefix("mjGEOM_").lower()
        material = int(model.geom_matid[k])
        rgba = model.geom_rgba[k] if material < 0 else model.mat_rgba[material]
        if rgba[3] == 0:
            continue
        R = Rotation.from_quat(model.geom_quat[k], scalar_first=True)
        triangles, normals = _mesh(model, k) if shape == "mesh" else (None, None)
        geoms.append(
            VisualGeom(
                body=model.body(model.geom_bodyid[k]).name,
                shape=shape,
                size=model.geom_size[k].copy(),
                T_body_geom=pose(R.as_matrix(), model.geom_pos[k]),
                rgba=rgba.astype(float),
                texture=_texture(model, material) if shape == "plane" and material >= 0 else None,
                triangles=triangles,
                normals=normals,
            )
        )
    return geoms


def _mesh(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Read corners and normals (F, 3, 3) of a mesh."""
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_faceadr[mesh])
    faces = slice(first, first + int(model.mesh_facenum[mesh]))
    corners = model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[faces]]
    normals = model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[faces]]
    return corners.astype(float), normals.astype(float)


def _texture(model: mujoco.MjModel, material: int) -> np.ndarray | None:
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture < 0:
        return None
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    channels, start = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
    image = model.tex_data[start : start + height * width * channels]
    return image.reshape(height, width, channels)[:, :, :3].copy()
