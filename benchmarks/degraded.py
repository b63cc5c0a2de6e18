"""Pairs of images made worse, for `degraded_images.py`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.camera import Camera, project, unproject
from vergence.geometry.head import HeadCalibration

CAMERAS = ("left_wide", "right_wide")
NEAR_M, SQUARE_M = 0.6, 0.02
FINER = 3
"""Rays along each side of a pixel, of which the near chessboard's grey levels are the mean."""
Images = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Sample:
    """A pair of images of a figure."""

    images: Images
    """(H, W) grey."""
    later: np.ndarray
    """(H, W) the right image, 5 ms later."""
    joints: Array
    """(4,) readings."""
    pixels: tuple[Array, Array]
    """(2,) the object in both."""
    T_rcam_lcam: Array
    """The truth."""


def contrast(share: float) -> Callable[[Sample], Images]:
    """Return what takes contrast away; the noise of the sensor (one grey level) comes after."""

    def change(sample: Sample) -> Images:
        rng = np.random.default_rng(int(sample.joints[0] * 1e9) % 2**32)
        both = []
        for image in sample.images:
            smooth = cv2.GaussianBlur(image, (0, 0), 0.6).astype(float)
            faint = 128 + share * (smooth - 128) + rng.normal(0, 1.0, image.shape)
            both.append(np.clip(np.round(faint), 0, 255).astype(np.uint8))
        return both[0], both[1]

    return change


def quarter(sample: Sample) -> Images:
    """Show the upper left quarter of the left image, and grey elsewhere."""
    left = np.full_like(sample.images[0], 128)
    h, w = left.shape
    left[: h // 2, : w // 2] = sample.images[0][: h // 2, : w // 2]
    return left, sample.images[1]


def covered(sample: Sample) -> Images:
    """Show nothing to the right eye."""
    return sample.images[0], np.full_like(sample.images[1], 20)


def darker(sample: Sample) -> Images:
    """Expose the right eye for 0.6 times as long."""
    return sample.images[0], np.round(0.6 * sample.images[1].astype(float)).astype(np.uint8)


def blurred(sample: Sample) -> Images:
    """Blur along rows, 5 px."""
    row = np.full((1, 5), 0.2)
    left, right = (cv2.filter2D(image, -1, row) for image in sample.images)
    return left, right


def compressed(sample: Sample) -> Images:
    """Store both images as JPEG files of quality 50."""
    options = [cv2.IMWRITE_JPEG_QUALITY, 50]
    left, right = (
        cv2.imdecode(cv2.imencode(".jpg", image, options)[1], cv2.IMREAD_GRAYSCALE)
        for image in sample.images
    )
    assert left is not None
    assert right is not None
    return left, right


def dusty(sample: Sample) -> Images:
    """Darken spots that stay at the same places of each image, as dust before its sensor does."""
    both = []
    for k, image in enumerate(sample.images):
        rng, light = np.random.default_rng(k), np.ones(image.shape)
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        for _ in range(25):
            middle, size = rng.uniform(0, image.shape), rng.uniform(2, 6)
            square = (rows - middle[0]) ** 2 + (columns - middle[1]) ** 2
            light *= 1 - 0.5 * np.exp(-square / (2 * size**2))
        both.append(np.round(light * image).astype(np.uint8))
    return both[0], both[1]


def unfocused(sample: Sample) -> Images:
    """Blur the right image by 2 px, standard deviation."""
    return sample.images[0], cv2.GaussianBlur(sample.images[1], (0, 0), 2.0)


def apart(sample: Sample) -> Images:
    """Expose the right eye 5 ms later."""
    return sample.images[0], sample.later


def chessboard(truth: HeadCalibration) -> Callable[[Sample], Images]:
    """Return what covers a quarter of the left view by a near chessboard, as the cameras show it.

    It is fixed to the left eye, 0.6 m ahead.
    """

    cameras = [truth.camera(name).intrinsics for name in CAMERAS]
    rays = [rays_within_pixels(camera) for camera in cameras]

    def change(sample: Sample) -> Images:
        both = []
        for k, image in enumerate(sample.images):
            T = np.eye(4) if k == 0 else se3.inverse(sample.T_rcam_lcam)
            turned, centre = rays[k] @ T[:3, :3].T, T[:3, 3]
            hit = centre + turned * ((NEAR_M - centre[2]) / turned[:, 2])[:, None]
            left = project(cameras[0], hit)
            middle = np.array(image.shape[::-1]) / 2
            inside = np.asarray(((left > 0) & (left < middle)).all(axis=1), float)
            dark = (np.floor(hit[:, :2] / SQUARE_M).astype(int).sum(axis=1) % 2) == 0
            share, board = (
                mean_within_pixels(each, image.shape)
                for each in (inside, inside * np.where(dark, 40.0, 210.0))
            )
            both.append(np.round(board + (1 - share) * image).astype(np.uint8))
        return both[0], both[1]

    return change


def rays_within_pixels(camera: Camera) -> Array:
    """Return rays (N, 3) evenly spread over each pixel, by rows of the finer image."""
    u, v = ((np.arange(FINER * n) + 0.5) / FINER - 0.5 for n in camera.size)
    return unproject(camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))


def mean_within_pixels(values: Array, size: tuple[int, ...]) -> Array:
    """Return the means (H, W) of values (N,) at the rays of rays_within_pixels."""
    return values.reshape(size[0], FINER, size[1], FINER).mean(axis=(1, 3))
