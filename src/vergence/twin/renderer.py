"""Cameras: render with MuJoCo, distort, blur, add noise.

An image is taken in two steps. `expose` renders, in the thread that owns OpenGL, and draws the
random numbers; `develop` does the rest and may run in another thread, at the same time as the next
rendering.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, normalise
from vergence.geometry.head import HeadCalibration
from vergence.twin import no_opengl
from vergence.twin.profile import Image

OVERSAMPLING = 1.5
"""Oversampling along each axis of an image that is distorted afterwards: interpolation between
pixels of the camera's own size would shift corners by 0.01 px, in every image alike. Edges are
multisampled besides: by 2.25 samples a pixel alone they are stepped, which displaces a sphere of
5 px in radius by 0.04 px and spreads self-calibrated depth up to twice as far."""
_PIXEL_STD_PX = 0.36
"""Standard deviation of the filter by which a pixel gathers light before the image is sampled.
With multisampling (0.2 px) and interpolation (0.3 px) a pixel sees somewhat more than itself."""
_NOISE_MARGIN = 256  # the noise of an image is a window of a larger one, at one of 256 x 256 places


@dataclass(frozen=True, eq=False)
class Negative:
    """A rendered image before distortion, blur and noise."""

    camera: str
    rendered: np.ndarray
    noise_at: tuple[int, int]


def overscan_sizes(head: HeadCalibration) -> dict[str, tuple[int, int]]:
    """Return by camera the width and height [px] of the pinhole image to render.

    It covers the field of view of the distorted image; cameras without distortion need only their
    own size. VergenceError if a lens model is not one-to-one within its image.
    """
    sizes = {}
    for name, mounted in head.cameras.items():
        camera = mounted.intrinsics
        if not camera.distortion.any():
            sizes[name] = (camera.width, camera.height)
            continue
        last = np.array([camera.width - 1, camera.height - 1])
        every = np.indices((camera.width, camera.height)).reshape(2, -1).T
        rim = every[((every == 0) | (every == last)).any(axis=1)]
        map_px = _in_pinhole(camera, rim.astype(float), (camera.width, camera.height))
        if not np.isfinite(map_px).all():
            raise VergenceError(f"The distortion of {name} folds over within its image.")
        reach = np.abs(map_px - last / 2).max(axis=0)
        sizes[name] = tuple(int(2 * np.ceil(r + 2)) for r in reach)
    return sizes


def _map(camera: Camera, size: tuple[int, int]) -> Sequence[np.ndarray]:
    """Return float32 maps x and y (H, W) into the rendered image for each pixel of the camera.

    That image is OVERSAMPLING times as large as size. OpenCV's packed maps would round to 1/32 px.
    """
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    finer = (
        OVERSAMPLING * _in_pinhole(camera, np.stack([u, v], axis=-1), size) + (OVERSAMPLING - 1) / 2
    )
    return cv2.split(finer.astype(np.float32))


def _in_pinhole(camera: Camera, pixels: Array, size: tuple[int, int]) -> Array:
    """Return the positions of a camera's pixels (..., 2) in a pinhole image of a given size."""
    xy = normalise(camera, pixels)
    shift = (np.array(size) - [camera.width, camera.height]) / 2
    return xy @ camera.matrix[:2, :2].T + camera.matrix[:2, 2] + shift


class Renderer:
    """The cameras of a compiled head. Use it in the thread that created it, and close it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        head: HeadCalibration,
        sizes: dict[str, tuple[int, int]],
        image: Image,
        seed: int,
    ):
        """Open OpenGL for a model of a head with its `overscan_sizes`; VergenceError: none."""
        self._image = image
        self._seed = seed
        self.restart(0)
        self._maps = {
            name: _map(mounted.intrinsics, sizes[name])
            for name, mounted in head.cameras.items()
            if mounted.intrinsics.distortion.any()
        }
        height = max(m.intrinsics.height for m in head.cameras.values()) + _NOISE_MARGIN
        width = max(m.intrinsics.width for m in head.cameras.values()) + _NOISE_MARGIN
        noise = self._rng.normal(0, image.noise_grey, (height, width, 3))
        self._noise = np.round(noise).astype(np.int16) if image.noise_grey else None
        self._renderers: dict[tuple[int, int], mujoco.Renderer] = {}
        self._sizes: dict[str, tuple[int, int]] = {}
        buffer = model.vis.global_
        before = buffer.offwidth, buffer.offheight
        try:
            for name, (width, height) in sizes.items():
                finer = OVERSAMPLING if name in self._maps else 1
                self._sizes[name] = size = round(finer * width), round(finer * height)
                if size in self._renderers:
                    continue
                buffer.offwidth, buffer.offheight = size
                self._renderers[size] = mujoco.Renderer(model, height=size[1], width=size[0])
        except Exception as error:  # each backend raises its own kind
            self.close()
            raise no_opengl(error) from error
        finally:
            buffer.offwidth, buffer.offheight = before
        for renderer in self._renderers.values():  # the room is closed: none of these is visible
            for flag in ("SKYBOX", "HAZE", "SHADOW", "REFLECTION"):
                renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0

    def restart(self, run: int) -> None:
        """Restart the noise, which depends only on the seed and the number of the run."""
        self._rng = np.random.default_rng([self._seed, 2, run])

    def expose(self, data: mujoco.MjData, camera: str) -> Negative:
        """Render the image of one camera, and draw the position of its noise."""
        renderer = self._renderers[self._sizes[camera]]
        renderer.update_scene(data, camera=camera)
        v, u = self._rng.integers(0, _NOISE_MARGIN, 2)
        return Negative(camera, renderer.render(), (int(v), int(u)))

    def develop(self, negative: Negative) -> np.ndarray:
        """Return the image (H, W, 3) uint8 of the camera."""
        image, blur_px = negative.rendered, self._image.blur_px
        if negative.camera in self._maps:
            x, y = self._maps[negative.camera]
            std = OVERSAMPLING * float(np.hypot(_PIXEL_STD_PX, blur_px))
            image = cv2.remap(cv2.GaussianBlur(image, (0, 0), std), x, y, cv2.INTER_LINEAR)
        elif blur_px:
            image = cv2.GaussianBlur(image, (0, 0), blur_px)
        if self._noise is not None:
            v, u = negative.noise_at
            window = self._noise[v : v + image.shape[0], u : u + image.shape[1]]
            image = cv2.add(image, window, dtype=cv2.CV_8U)
        return image

    def true_depth(self, data: mujoco.MjData, camera: str) -> Array:
        """Return the depth (H, W) [m] along a camera's optical axis, of each of its pixels."""
        renderer = self._renderers[self._sizes[camera]]
        renderer.update_scene(data, camera=camera)
        renderer.enable_depth_rendering()
        try:
            depth = renderer.render()
        finally:
            renderer.disable_depth_rendering()
        if camera in self._maps:  # no mean of what is before and behind an edge
            x, y = self._maps[camera]
            depth = cv2.remap(depth, x, y, cv2.INTER_NEAREST)
        return depth.astype(float)

    def close(self) -> None:
        """Release OpenGL's resources."""
        for renderer in self._renderers.values():
            renderer.close()
