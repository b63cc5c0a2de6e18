"""Flat cards with a picture in the place of the twin's object, a red sphere."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.geometry.board import marker_family
from vergence.twin.scene import BLACK, WHITE

MODULE_TEXELS = 64
"""Width of a marker's module in its picture, finer than the cameras resolve at any distance."""


@dataclass(frozen=True, eq=False)
class Card:
    """A flat object: upright, and facing the head. `Twin(furnish=card.put)` shows it."""

    picture: np.ndarray
    """(h, w, 3) uint8, RGB, as it is seen from the front; the object's place is its centre."""
    width_m: float
    """Width of the whole picture."""

    def put(self, spec: mujoco.MjSpec) -> None:
        """Replace the sphere of a scene by the card, which faces -x of the object's frame."""
        done, png = cv2.imencode(".png", self.picture[..., ::-1])  # OpenCV writes BGR
        assert done
        # In memory, with a name of its own: MuJoCo caches files by name for a second.
        spec.assets = {**spec.assets, "card.png": png.tobytes()}
        spec.add_texture(name="card", type=mujoco.mjtTexture.mjTEXTURE_2D, file="card.png")
        # Full emission: the image shows the picture's own colours whatever the card's attitude.
        material = spec.add_material(name="card", emission=1, specular=0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "card"
        height_m = self.width_m * self.picture.shape[0] / self.picture.shape[1]
        spec.delete(spec.geom("object"))
        R = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # shown along +z
        spec.body("object").add_geom(
            name="object",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[self.width_m / 2, height_m / 2, 1],
            quat=Rotation.from_matrix(R).as_quat(scalar_first=True),
            material="card",
            contype=0,
            conaffinity=0,
            group=0,
            mass=0,
        )


def marker_card(dictionary: str, marker_id: int, side_m: float) -> Card:
    """Make a card with a marker of a side [m] and a white margin of one module."""
    family = marker_family(dictionary, marker_id)
    modules = family.markerSize + 2  # with the black frame
    drawn = cv2.aruco.generateImageMarker(family, marker_id, modules * MODULE_TEXELS)
    grey = np.pad(np.where(drawn > 0, WHITE, BLACK), MODULE_TEXELS, constant_values=WHITE)
    picture = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)
    return Card(picture, side_m * (modules + 2) / modules)
