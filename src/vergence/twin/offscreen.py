"""Pinhole pictures of compiled models, of several sizes, in one OpenGL context for each thread.

`mujoco.Renderer` opens a context for each model and size, and in each of them Mesa compiles its
shaders anew: 0.3 to 0.4 s of processor time, as much as a dozen pictures take.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import atexit
import threading
from collections.abc import Iterable
from typing import Any, NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array

_opened = threading.local()
"""The OpenGL context of each thread, which belongs to it."""
_HIDDEN = ("SKYBOX", "HAZE", "SHADOW", "REFLECTION")  # the room is closed: they are not visible


class Format(NamedTuple):
    """The size of a picture, and how finely its edges are sampled."""

    width: int
    height: int
    samples: int
    """a pixel; 0: one."""


class Offscreen:
    """Renders a model. Use it in the thread that created it, and close it."""

    def __init__(self, model: mujoco.MjModel, formats: Iterable[Format]):
        """Open OpenGL for pictures of some formats; raises the error of the backend."""
        self._model = model
        self.scene = mujoco.MjvScene(model, maxgeom=10_000)
        for flag in _HIDDEN:
            self.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        self._option, self._view = mujoco.MjvOption(), mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._buffers: dict[Format, mujoco.MjrContext] = {}
        self._opengl = _context()
        size, quality = model.vis.global_, model.vis.quality
        before = size.offwidth, size.offheight, quality.offsamples
        try:
            self._opengl.make_current()
            for each in set(formats):
                size.offwidth, size.offheight, quality.offsamples = each
                buffer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
                buffer.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
                self._buffers[each] = buffer
        except BaseException:
            self.close()
            raise
        finally:
            size.offwidth, size.offheight, quality.offsamples = before

    def show(self, data: mujoco.MjData, camera: str) -> None:
        """Let the scene be what a camera of the model sees."""
        self._view.fixedcamid = self._model.camera(camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._view, everything, self.scene
        )

    def colours(self, form: Format) -> np.ndarray:
        """Render a picture (H, W, 3) uint8 of the scene, RGB."""
        colours = np.empty((form.height, form.width, 3), np.uint8)
        self._render(form, colours, None)
        return np.ascontiguousarray(colours[::-1])  # OpenGL's rows begin at the bottom

    def depths(self, form: Format) -> Array:
        """Render the depths (H, W) [m] of the scene along the optical axis."""
        nearness = np.empty((form.height, form.width), np.float32)
        self._render(form, None, nearness)
        extent, planes = self._model.stat.extent, self._model.vis.map
        near, far = np.float32(planes.znear * extent), np.float32(planes.zfar * extent)
        # OpenGL's projection reversed, from 1 at the near plane to 0 at the far one; with its
        # matrix in single precision, as MuJoCo hands it over.
        half = np.float32(0.5)
        scale = half * ((far + near) / (far - near)) - half
        shift = half * (2 * far * near / (far - near))
        return float(shift) / (nearness[::-1].astype(float) + float(scale))

    def _render(
        self, form: Format, colours: np.ndarray | None, nearness: np.ndarray | None
    ) -> None:
        whole, buffer = mujoco.MjrRect(0, 0, form.width, form.height), self._buffers[form]
        self._opengl.make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, buffer)
        mujoco.mjr_render(whole, self.scene, buffer)
        mujoco.mjr_readPixels(colours, nearness, whole, buffer)

    def close(self) -> None:
        """Release what the pictures take; the context stays, for the next model."""
        self._opengl.make_current()
        for buffer in self._buffers.values():
            buffer.free()
        self._buffers.clear()


def _context() -> Any:  # the class depends on the backend
    """Open the OpenGL context of this thread once."""
    if not hasattr(_opened, "context"):
        _opened.context = mujoco.GLContext(1, 1)  # of no matter: each buffer has its own size
        if threading.current_thread() is threading.main_thread():
            atexit.register(_opened.context.free)  # before the backend closes the display
    return _opened.context
