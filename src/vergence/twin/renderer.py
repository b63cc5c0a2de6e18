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
from vergence.twin.offscreen import Format, Offscreen
from vergence.twin.profile import Image

OVERSAMPLING = 1.5
"""Oversampling along each axis of an image of the room that is distorted afterwards: interpolation
between pixels of the camera's own size would shift corners by 0.01 px, in every image alike."""
FINE = 3.0
"""Oversampling of recorded datasets: corners of a board in wide images are then off by 0.005 px,
not 0.02, and a picture takes three times as long."""
_WINDOW_PX = 128
"""Side [px] of the part with the object, which is rendered again with multisampling. Without it the
outline has steps, which displace a sphere of 5 px in radius by 0.04 px. Multisampling the whole
image takes twice as long."""
_NOISE_MARGIN = 256  # the noise of an image is a window of a larger one, at one of 256 x 256 places


@dataclass(frozen=True, eq=False)
class Negative:
    """A rendered image before distortion, blur and noise."""

    camera: str
    rendered: np.ndarray
    noise_at: tuple[int, int]


def overscan_sizes(head: HeadCalibration) -> dict[str, tuple[int, int]]:
    """Compute the width and height [px] of the pinhole image to render, by camera.

    It covers the field of view of the distorted image; cameras without distortion need only their
    own size. VergenceError if a lens model is not one-to-one within its image.
    """
    sizes = {}
    for name, mounted in head.cameras.items():
        camera = mounted.intrinsics
        if not camera.distortion.any():
            sizes[name] = camera.size
            continue
        last = np.array([camera.width - 1, camera.height - 1])
        every = np.indices(camera.size).reshape(2, -1).T
        rim = every[((every == 0) | (every == last)).any(axis=1)]
        map_px = _in_pinhole(camera, rim.astype(float), camera.size)
        if not np.isfinite(map_px).all():
            raise VergenceError(f"The distortion of {name} folds over within its image.")
        reach = np.abs(map_px - last / 2).max(axis=0)
        sizes[name] = tuple(int(2 * np.ceil(r + 2)) for r in reach)
    return sizes


def _map(camera: Camera, size: tuple[int, int], oversampling: float) -> Sequence[np.ndarray]:
    """Compute float32 maps x and y (H, W) into an image `oversampling` times as large as size.

    OpenCV's packed maps would round to 1/32 px.
    """
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    places = _in_pinhole(camera, np.stack([u, v], axis=-1), size)
    return cv2.split((oversampling * places + (oversampling - 1) / 2).astype(np.float32))


def _in_pinhole(camera: Camera, pixels: Array, size: tuple[int, int]) -> Array:
    """Map a camera's pixels (..., 2) into a pinhole image of a given size."""
    xy = normalise(camera, pixels)
    shift = (np.array(size) - [camera.width, camera.height]) / 2
    return xy @ camera.matrix[:2, :2].T + camera.matrix[:2, 2] + shift


def _view_corners(offscreen: Offscreen, data: mujoco.MjData, camera: str) -> Array:
    """Compute two corners (2, 2) of a view at one metre, upper left and lower right; y up."""
    offscreen.show(data, camera)
    view = offscreen.scene.camera[0]
    middle, half = view.frustum_center, view.frustum_width
    corners = [(middle - half, view.frustum_top), (middle + half, view.frustum_bottom)]
    return np.array(corners) / view.frustum_near


def _blurred(image: np.ndarray, std_px: float) -> np.ndarray:
    # OpenCV's three standard deviations give the same 8-bit images, and take half as long again.
    side = 2 * round(2.5 * std_px) + 1
    return cv2.GaussianBlur(image, (side, side), std_px)


class Renderer:
    """The cameras of a compiled head. Use it in the thread that created it, and close it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        head: HeadCalibration,
        sizes: dict[str, tuple[int, int]],
        image: Image,
        seed: int,
        oversampling: float,
    ):
        """Open OpenGL for a model of a head with its `overscan_sizes`; VergenceError: none.

        Oversampling is of images that are distorted.
        """
        self._model, self._image, self._seed = model, image, seed
        self._oversampling = oversampling
        self.restart(0)
        self._maps = {
            name: _map(mounted.intrinsics, sizes[name], self._oversampling)
            for name, mounted in head.cameras.items()
            if mounted.intrinsics.distortion.any()
        }
        height = max(m.intrinsics.height for m in head.cameras.values()) + _NOISE_MARGIN
        width = max(m.intrinsics.width for m in head.cameras.values()) + _NOISE_MARGIN
        noise = np.round(self._rng.normal(0, image.noise_grey, (height, width, 3)))
        # What it adds and what it takes away: OpenCV is fast where all are of one type.
        self._noise = [np.clip(each, 0, 255).astype(np.uint8) for each in (noise, -noise)]
        samples, self._formats = model.vis.quality.offsamples, {}
        for name, size in sizes.items():
            finer, once = (self._oversampling, 0) if name in self._maps else (1, samples)
            width, height = (round(finer * side) for side in size)
            self._formats[name] = Format(width, height, once)
        side = min(_WINDOW_PX, *np.ravel(list(sizes.values())).tolist())
        self._window = Format(side, side, samples) if samples else None
        formats = [*self._formats.values(), *([self._window] if self._window else [])]
        try:
            self._offscreen = Offscreen(model, formats)
        except Exception as error:  # each backend raises its own kind
            raise no_opengl(error) from error
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        self._corners = {name: _view_corners(self._offscreen, data, name) for name in sizes}

    def restart(self, run: int) -> None:
        """Restart the noise, which depends only on the seed and the number of the run."""
        self._rng = np.random.default_rng([self._seed, 2, run])

    def expose(self, data: mujoco.MjData, camera: str) -> Negative:
        """Render the image of one camera, and draw the position of its noise."""
        self._show(data, camera, self._corners[camera])
        v, u = self._rng.integers(0, _NOISE_MARGIN, 2)
        rendered = self._offscreen.colours(self._formats[camera])
        if camera in self._maps and self._window is not None:
            self._multisample_object(self._window, rendered, data, camera)
        return Negative(camera, rendered, (int(v), int(u)))

    def _show(self, data: mujoco.MjData, camera: str, corners: Array) -> None:
        """Show a camera's view between two corners (2, 2)."""
        self._offscreen.show(data, camera)
        for view in self._offscreen.scene.camera:  # of either eye, of which the mean is rendered
            (left, top), (right, bottom) = corners * view.frustum_near
            view.frustum_center, view.frustum_width = (left + right) / 2, (right - left) / 2
            view.frustum_top, view.frustum_bottom = top, bottom

    def _multisample_object(
        self, window: Format, image: np.ndarray, data: mujoco.MjData, camera: str
    ) -> None:
        """Render anew, in place, the part of an image (H, W, 3) in whose middle the object is."""
        seen_by, (corner, right_lower) = data.camera(camera), self._corners[camera]
        where = (data.body("object").xpos - seen_by.xpos) @ seen_by.xmat.reshape(3, 3)
        if where[2] >= 0:  # z points back
            return
        side, size = window.width, np.array([image.shape[1], image.shape[0]])
        step = (right_lower - corner) / size
        middle = (where[:2] / -where[2] - corner) / step
        if ((middle < -side) | (middle > size + side)).any():
            return
        first = np.clip(np.round(middle - side / 2).astype(int), 0, size - side)
        self._show(data, camera, corner + step * np.array([first, first + side]))
        u, v = first
        image[v : v + side, u : u + side] = self._offscreen.colours(window)

    def develop(self, negative: Negative) -> np.ndarray:
        """Distort, blur and add noise to an image (H, W, 3) uint8."""
        image, blur_px = negative.rendered, self._image.blur_px
        if negative.camera in self._maps:
            x, y = self._maps[negative.camera]
            # The area of a pixel [px]; with multisampling (0.2 px) and interpolation (0.3 px) it
            # covers slightly more.
            std = self._oversampling * float(np.hypot(0.36, blur_px))
            image = cv2.remap(_blurred(image, std), x, y, cv2.INTER_LINEAR)
        elif blur_px:
            image = _blurred(image, blur_px)
        if self._image.noise_grey:
            v, u = negative.noise_at
            more, less = (
                each[v : v + image.shape[0], u : u + image.shape[1]] for each in self._noise
            )
            image = cv2.subtract(cv2.add(image, more), less)
        return image

    def true_depth(self, data: mujoco.MjData, camera: str) -> Array:
        """Render the depth (H, W) [m] of each pixel along the optical axis."""
        self._offscreen.show(data, camera)
        depth = self._offscreen.depths(self._formats[camera])
        if camera in self._maps:  # no mean of what is before and behind an edge
            x, y = self._maps[camera]
            depth = cv2.remap(depth, x, y, cv2.INTER_NEAREST).astype(float)
        return depth

    def close(self) -> None:
        """Release OpenGL's resources."""
        self._offscreen.close()
