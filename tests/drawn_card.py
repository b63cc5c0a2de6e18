"""Images of a flat card in space, each pixel averaged: pictures for detectors, without MuJoCo."""

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise, pinhole, project

WIDE = pinhole(640, 480, 280.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
GREY = 110.0
_FINE = 4
"""Samples along each side of a pixel."""


def draw_card(
    camera: Camera,
    picture: np.ndarray,
    T_cam_card: Array,
    width_m: float,
    *,
    noise: np.random.Generator | None = None,
) -> np.ndarray:
    """Return the image (H, W, 3) uint8 of a card before grey; noise is of three grey levels.

    The picture (h, w) uint8 is centred on the origin of frame card, x right and y down.
    """
    T, (h, w) = T_cam_card, picture.shape
    middle = project(camera, T[:3, 3])
    reach = int(1.2 * camera.matrix[0, 0] * width_m / T[2, 3] + 10)
    size = np.array([camera.width, camera.height])
    (u0, v0), (u1, v1) = (np.clip(middle.astype(int) + sign * reach, 0, size) for sign in (-1, 1))
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    u, v = ((np.arange(*ends)[:, None] + offsets).ravel() for ends in ((u0, u1), (v0, v1)))
    rays = normalise(camera, np.stack(np.meshgrid(u, v), axis=-1))
    rays = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    normal = T[:3, 2]
    along = (normal @ T[:3, 3]) / (rays @ normal)
    on_card = (rays * along[..., None] - T[:3, 3]) @ T[:3, :3]
    x = (on_card[..., 0] * w / width_m + (w - 1) / 2).astype(np.float32)
    y = (on_card[..., 1] * w / width_m + (h - 1) / 2).astype(np.float32)
    values = cv2.remap(picture.astype(np.float32), x, y, cv2.INTER_LINEAR)
    inside = (np.abs(x - (w - 1) / 2) < w / 2) & (np.abs(y - (h - 1) / 2) < h / 2)
    fine = np.where(inside, values, GREY).reshape(v1 - v0, _FINE, u1 - u0, _FINE)
    image = np.full((camera.height, camera.width), GREY)
    image[v0:v1, u0:u1] = fine.mean(axis=(1, 3))
    if noise is not None:
        image += noise.normal(0, 3, image.shape)
    grey = np.clip(image, 0, 255).round().astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def at(camera: Camera, pixel: tuple[float, float], depth_m: float) -> Array:
    """Return the point (3,) [m] in frame cam at a depth that is seen at a pixel."""
    return np.array([*normalise(camera, np.array(pixel)), 1.0]) * depth_m


def smooth_picture(side: int, seed: int = 0) -> np.ndarray:
    """Return a random picture (side, side) uint8 with a few details along each side."""
    noise = np.random.default_rng(seed).normal(size=(side, side))
    smooth = cv2.GaussianBlur(noise, (0, 0), side / 15)
    low, high = np.quantile(smooth, [0.02, 0.98])
    return (25 + 210 * np.clip((smooth - low) / (high - low), 0, 1)).round().astype(np.uint8)
