"""Two textured walls before a head, drawn without OpenGL: what both its eyes see of a room."""

from functools import cache

import cv2
import numpy as np

from drawn_head import DrawnHead
from postures import EYE_READINGS
from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise
from vergence.geometry.head import HeadCalibration, camera_pose_in_base
from vergence.geometry.lens import CameraModel
from vergence.geometry.se3 import inverse

_PX_M = 300
_WALLS = ((np.array([1.0, 0.0, 0.0]), 1.6), (np.array([0.0, 0.0, -1.0]), 0.5))
"""Normals in the left eye's base, and distances [m]: one ahead, and a table below the eyes."""


@cache
def _texture() -> np.ndarray:
    noise = np.random.default_rng(7).normal(0, 1, (1536, 1536))
    grey = cv2.GaussianBlur(noise, (0, 0), 1.6) + 2 * cv2.GaussianBlur(noise, (0, 0), 5)
    return (120 + 40 * grey / grey.std()).clip(0, 255).astype(np.float32)


@cache
def _rays(width: int, height: int, matrix: bytes, distortion: bytes, model: CameraModel) -> Array:
    """Return the directions (H, W, 3) of a camera's pixels; a lens takes long to invert."""
    K, coefficients = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    pixels = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1)
    xy = normalise(Camera(width, height, K, coefficients, model), pixels)
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def view(head: HeadCalibration, camera: str, angles: Array) -> np.ndarray:
    """Return the image (H, W, 3) of a camera at true angles (r,) of the eyes."""
    mounted = head.camera(camera)
    lens = mounted.intrinsics
    sizes = lens.width, lens.height
    own = _rays(*sizes, lens.matrix.tobytes(), lens.distortion.tobytes(), lens.model)
    T = camera_pose_in_base(head, camera, angles)
    if mounted.eye == "right":
        T = inverse(head.T_rbase_lbase) @ T
    rays = own @ T[:3, :3].T
    image, nearest = np.full(rays.shape[:2], 60.0), np.full(rays.shape[:2], 20.0)
    for k, (normal, distance_m) in enumerate(_WALLS):
        along = rays @ normal
        far = (distance_m - normal @ T[:3, 3]) / np.where(along > 1e-3, along, 1e-3)
        points = T[:3, 3] + far[..., None] * rays
        on_wall = np.delete(points, int(np.abs(normal).argmax()), axis=-1) * _PX_M + 700 + 137 * k
        u, v = (np.ascontiguousarray(on_wall[..., i], dtype=np.float32) for i in (0, 1))
        seen = cv2.remap(_texture(), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        nearer = (along > 1e-3) & (far < nearest) & np.isfinite(far)
        image[nearer], nearest[nearer] = seen[nearer], far[nearer]
    return cv2.cvtColor(np.round(image).astype(np.uint8), cv2.COLOR_GRAY2RGB)


class RoomHead(DrawnHead):
    """A drawn head in this room; its neck does not move."""

    def _draw(self, name: str, time_s: float) -> np.ndarray:
        self._blank = view(self.calibration, name, self.posture(time_s)[EYE_READINGS])
        return super()._draw(name, time_s)
