"""The lens of a camera of a head, from head.toml or from the model."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.interchange import ros
from vergence.twin.head_file import CameraFile, HeadFile, LensFile

USUAL_SIZE = 640, 480
"""Size of the images [px] of a camera for which neither head.toml nor the model has one."""


def chosen_lens(stated: HeadFile, lens: str | None) -> str:
    """Check a lens to choose; None: the first, or an empty name if there is no choice."""
    if lens and lens not in stated.lenses:
        known = ", ".join(stated.lenses) or "none to choose from"
        raise VergenceError(f"This head has no lens {lens!r}; it has {known}.")
    return lens or next(iter(stated.lenses), "")


def lens_of(
    stated: HeadFile, folder: Path, name: str, model: mujoco.MjModel, lens: str | None = None
) -> Camera:
    """Determine the intrinsics of a camera of a head with one of its lenses.

    `folder` is that of head.toml. VergenceError for a lens that the head does not have, or none.
    """
    camera = stated.cameras.get(name, CameraFile())
    choice = stated.lenses.get(chosen_lens(stated, lens))
    own: LensFile = choice if choice is not None and name in choice.cameras else camera
    if own.camera_info is not None:
        return next(iter(ros.load(folder / own.camera_info).values()))
    by_model = None if camera.body is not None else model.camera(camera.camera or name).id
    size = camera.size or USUAL_SIZE
    if camera.size is None and by_model is not None and min(model.cam_resolution[by_model]) > 1:
        size = tuple(model.cam_resolution[by_model].tolist())  # 1 x 1: the model has none
    matrix, shift = np.eye(3), np.zeros(2)
    sensor_m = np.zeros(2) if by_model is None else model.cam_sensorsize[by_model]
    if own.fov_deg is not None:
        matrix[[0, 1], [0, 1]] = size[0] / 2 / np.tan(np.radians(own.fov_deg) / 2)
    elif by_model is not None and sensor_m.any():
        pitch_m = sensor_m / np.array(size, np.float32)
        if np.isclose(*pitch_m, rtol=1e-5):  # square pixels, as far as the model's numbers tell
            pitch_m = pitch_m[[0, 0]]
        focal, shift = np.split(model.cam_intrinsic[by_model] / np.tile(pitch_m, 2), 2)
        given = own.focal_mm
        matrix[[0, 1], [0, 1]] = focal if given is None else given * 1e-3 / pitch_m[0]
    elif by_model is not None and own.focal_mm is None:
        fovy = np.radians(model.cam_fovy[by_model])
        matrix[[0, 1], [0, 1]] = size[1] / 2 / np.tan(fovy / 2)
    else:
        raise VergenceError(f"The lens of {name} is not known; give its fov_deg or camera_info.")
    matrix[:2, 2] = (np.array(size) - 1) / 2 - shift
    width, height = size
    return Camera(width, height, matrix, np.array(own.distortion), own.model)
