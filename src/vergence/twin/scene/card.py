"""Replace the object of the scene, a sphere, by a flat card with a picture on it."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.errors import VergenceError
from vergence.geometry.board import marker_family
from vergence.twin.scene.board import BLACK, WHITE

MODULE_TEXELS = 64
"""Width of a marker's module in its picture: finer than the cameras resolve at any distance."""


@dataclass(frozen=True, eq=False)
class Card:
    """A flat object: upright, and facing the head."""

    picture: np.ndarray
    """(h, w, 3) uint8, RGB, as it is seen from the front; the object's place is its centre."""
    width_m: float
    """Width of the whole picture."""

    def __post_init__(self) -> None:
        shape, kind = self.picture.shape, self.picture.dtype
        if kind != np.uint8 or len(shape) != 3 or shape[2] != 3 or not min(shape):
            raise VergenceError(
                f"A card has a picture (h, w, 3) of uint8, found {shape} of {kind}."
            )
        if not 0 < self.width_m <= 1:
            raise VergenceError(f"A card is up to 1 m wide, found {self.width_m:g} m.")


def marker_card(dictionary: str, marker_id: int, side_m: float) -> Card:
    """Return a card with a marker and a white margin of one module.

    Args:
        dictionary: OpenCV's name of the family, such as DICT_4X4_50.
        marker_id: number of the marker in it.
        side_m: side of the marker, without the margin.

    Raises:
        VergenceError: there is no such dictionary or marker, or the card is too large.
    """
    family = marker_family(dictionary, marker_id)
    modules = family.markerSize + 2  # with the black frame
    drawn = cv2.aruco.generateImageMarker(family, marker_id, modules * MODULE_TEXELS)
    grey = np.pad(np.where(drawn > 0, WHITE, BLACK), MODULE_TEXELS, constant_values=WHITE)
    picture = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)
    return Card(picture, side_m * (modules + 2) / modules)


def put_card(spec: mujoco.MjSpec, card: Card) -> None:
    """Replace the sphere of a scene by a card, which faces -x of the object's frame."""
    done, png = cv2.imencode(".png", card.picture[..., ::-1])  # OpenCV writes BGR
    assert done
    # In memory, with a name of its own: MuJoCo caches files by name for a second.
    spec.assets = {**spec.assets, "card.png": png.tobytes()}
    spec.add_texture(name="card", type=mujoco.mjtTexture.mjTEXTURE_2D, file="card.png")
    # Full emission: the image shows the picture's own colours whatever the card's attitude.
    material = spec.add_material(name="card", emission=1, specular=0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "card"
    height_m = card.width_m * card.picture.shape[0] / card.picture.shape[1]
    spec.delete(spec.geom("object"))
    R = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # shown along +z, up is +y
    spec.body("object").add_geom(
        name="object",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[card.width_m / 2, height_m / 2, 1],
        quat=Rotation.from_matrix(R).as_quat(scalar_first=True),
        material="card",
        contype=0,
        conaffinity=0,
        group=0,
        mass=0,
    )
