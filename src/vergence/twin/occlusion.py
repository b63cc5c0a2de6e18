"""Occlusion by the room: whether walls or furniture hide a place from a head at rest."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from __future__ import annotations

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.geometry.se3 import transform
from vergence.twin.head import Twin

_ROOM = 0
"""Body id of the world: floor, walls and furniture."""


def unoccluded(twin: Twin, places_lbase: Array, *, margin_m: float) -> np.ndarray:
    """Return (N,) whether the room leaves places unoccluded in all cameras of the head.

    Args:
        twin: the head, at rest.
        places_lbase: (N, 3) [m] in the left eye's base frame.
        margin_m: radius around each place that must be unoccluded too.
    """
    model = twin.model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    room = np.array([model.geom_bodyid[k] == _ROOM for k in range(model.ngeom)])
    original_groups = model.geom_group.copy()
    places = transform(twin.T_world_lbase(), places_lbase)
    groups = np.array([0, 0, 0, 0, 0, 1], np.uint8)
    found = np.ones(len(places), bool)
    try:
        model.geom_group[:] = np.where(room, 5, 0)  # rays are tested against the room's group only
        for camera in twin.truth.cameras:
            start = data.cam_xpos[model.camera(camera).id]
            for k, place in enumerate(places):
                away = place - start
                distance = float(np.linalg.norm(away))
                across = np.linalg.svd(away[None])[2][1:]  # two directions around the place
                for off in (np.zeros(3), *across, *-across):
                    ray = away + margin_m * off
                    ray /= np.linalg.norm(ray)
                    geom = np.zeros((1, 1), np.int32)
                    hit = mujoco.mj_ray(model, data, start, ray, groups, 1, -1, geom)
                    found[k] &= not 0 <= hit < distance + margin_m
    finally:
        model.geom_group[:] = original_groups
    return found
