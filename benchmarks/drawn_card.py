"""Images of a flat card in space, each pixel averaged: pictures for detectors, without MuJoCo."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise, pinhole, project, unproject
from vergence.geometry.se3 import inverse, transform

WIDE = pinhole(640, 480, 280.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
GREY = 110.0
NOISE_GREY = 3.0
"""Standard deviation of a pixel's noise [grey levels]."""
_FINE = 4
"""Samples along each side of a pixel."""
_MARGIN_PX = 6
"""Around the card, within which its blur is."""


def draw_card(
    camera: Camera,
    picture: np.ndarray,
    T_cam_card: Array,
    width_m: float,
    *,
    noise: np.random.Generator | None = None,
    blur_px: float = 0.0,
    slopes: Array | None = None,
) -> np.ndarray:
    """Return the image (H, W, 3) uint8 of a card before grey.

    Args:
        camera: its lens says along which ray each sample of a pixel looks.
        picture: (h, w) uint8, centred on the origin of frame card, x right and y down.
        T_cam_card: (4, 4).
        width_m: of the picture [m].
        noise: of NOISE_GREY, in each pixel; None: none.
        blur_px: standard deviation of a Gaussian blur.
        slopes: of `sample_slopes(camera)`, where several images of one camera are drawn.
    """
    T, (h, w) = T_cam_card, picture.shape
    u0, v0, u1, v1 = _bounds(camera, T, width_m, width_m * h / w)
    if slopes is None:
        x, y = sample_slopes(camera, u0, v0, u1, v1)
    else:
        x, y = slopes[:, v0 * _FINE : v1 * _FINE, u0 * _FINE : u1 * _FINE]
    # Rows of the inverse pose; as Python's numbers they leave arrays in single precision.
    (ax, ay, az, at), (bx, by, bz, bt), (cx, cy, cz, ct), _ = inverse(T).tolist()
    with np.errstate(divide="ignore"):
        along = -ct / (cx * x + cy * y + cz)
    along[~(along > 0)] = np.nan  # a card behind the camera is not seen
    scale = float(w / width_m)
    on_x = ((ax * x + ay * y + az) * along + at) * scale + (w - 1) / 2
    on_y = ((bx * x + by * y + bz) * along + bt) * scale + (h - 1) / 2
    values = cv2.remap(picture.astype(np.float32), on_x, on_y, cv2.INTER_LINEAR)
    inside = (np.abs(on_x - (w - 1) / 2) < w / 2) & (np.abs(on_y - (h - 1) / 2) < h / 2)
    fine = np.where(inside, values, GREY).reshape(v1 - v0, _FINE, u1 - u0, _FINE)
    image = np.full((camera.height, camera.width), GREY)
    image[v0:v1, u0:u1] = fine.mean(axis=(1, 3))
    if blur_px:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    if noise is not None:
        image += noise.normal(0, NOISE_GREY, image.shape)
    grey = np.clip(image, 0, 255).round().astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def sample_slopes(
    camera: Camera, u0: int = 0, v0: int = 0, u1: int | None = None, v1: int | None = None
) -> np.ndarray:
    """Return (2, 4 H, 4 W) float32 x/z and y/z of the rays of all samples of some pixels.

    NaN where the lens has no direction. Pixels are u0 to u1 and v0 to v1, the last ones left out.
    """
    ends = (u0, camera.width if u1 is None else u1), (v0, camera.height if v1 is None else v1)
    u, v = ((np.arange(*each)[:, None] + [-0.25, 0.25]).ravel() for each in ends)
    half = np.empty((len(v), len(u), 2), np.float32)
    for k in range(0, len(v), 64):  # the lens takes much memory
        pixels = np.stack(np.meshgrid(u, v[k : k + 64]), axis=-1, dtype=float)
        half[k : k + 64] = normalise(camera, pixels)
    # Rays are straight between samples half a pixel apart, to a thousandth of a pixel.
    fine = cv2.resize(half, None, fx=_FINE / 2, fy=_FINE / 2, interpolation=cv2.INTER_LINEAR)
    return np.moveaxis(fine, -1, 0)


def _bounds(
    camera: Camera, T_cam_card: Array, width_m: float, height_m: float
) -> tuple[int, int, int, int]:
    """Return the first u and v of the pixels that may show a card, and the ends."""
    size = np.array(camera.size)
    side = np.linspace(-0.5, 0.5, 25)
    x, y = np.meshgrid(side * width_m, side * height_m)
    card = transform(T_cam_card, np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3))
    with np.errstate(over="ignore", invalid="ignore"):
        uv = project(camera, card)
    if not (np.abs(uv) < 1e5).all():  # part of it is behind the camera
        return 0, 0, int(size[0]), int(size[1])
    low = np.clip(np.floor(uv.min(axis=0)) - _MARGIN_PX, 0, size - 1).astype(int)
    high = np.clip(np.ceil(uv.max(axis=0)) + _MARGIN_PX, low + 1, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def at(camera: Camera, pixel: tuple[float, float], depth_m: float) -> Array:
    """Return the point (3,) [m] in frame cam at a depth that is seen at a pixel."""
    return unproject(camera, np.array(pixel)) * depth_m


def smooth_picture(side: int, seed: int = 0) -> np.ndarray:
    """Return a random picture (side, side) uint8 with a few details along each side."""
    noise = np.random.default_rng(seed).normal(size=(side, side))
    smooth = cv2.GaussianBlur(noise, (0, 0), side / 15)
    low, high = np.quantile(smooth, [0.02, 0.98])
    return (25 + 210 * np.clip((smooth - low) / (high - low), 0, 1)).round().astype(np.uint8)
