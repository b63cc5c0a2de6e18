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


def chosen_lens(stated: HeadFile, lens: str | None) -> str | None:
    """Check a lens to choose, and return its name; None: the first, if there are any."""
    if lens is None:
        return next(iter(stated.lenses), None)
    if lens not in stated.lenses:
        known = ", ".join(stated.lenses) or "none to choose from"
        raise VergenceError(f"This head has no lens {lens!r}; it has {known}.")
    return lens


def lens_of(
    stated: HeadFile, folder: Path, name: str, model: mujoco.MjModel, lens: str | None = None
) -> Camera:
    """Determine the intrinsics of a camera of a head with one of its lenses.

    `folder` is that of head.toml. Raises VergenceError for a lens that the head does not have, and
    a camera without field of view.
    """
    camera = stated.cameras.get(name, CameraFile())
    choice = stated.lenses.get(chosen_lens(stated, lens) or "")
    own: LensFile = choice if choice is not None and name in choice.cameras else camera
    if own.camera_info is not None:
        found = [*ros.load(folder / own.camera_info).values()]
        if len(found) != 1:
            raise VergenceError(f"The lens of {name} is one camera_info, found {len(found)}.")
        return found[0]
    by_model = None if camera.body is not None else model.camera(camera.camera or name)
    size = camera.size
    if size is None and by_model is not None:
        resolution = tuple(model.cam_resolution[by_model.id].tolist())
        size = resolution if min(resolution) > 1 else None  # MuJoCo's default is one pixel
    width, height = size or USUAL_SIZE
    fx, fy, centre = _pinhole(name, own, model, by_model, (width, height))
    matrix = np.diag([fx, fy, 1.0])
    matrix[:2, 2] = centre
    return Camera(width, height, matrix, np.array(own.distortion), own.model)


def _pinhole(
    name: str, own: LensFile, model: mujoco.MjModel, by_model: object, size: tuple[int, int]
) -> tuple[float, float, tuple[float, float]]:
    """Compute focal lengths and principal point [px]."""
    width, height = size
    middle = (width - 1) / 2, (height - 1) / 2
    if own.fov_deg is not None:
        focal = width / 2 / np.tan(np.radians(own.fov_deg) / 2)
        return focal, focal, middle
    if by_model is None:
        raise VergenceError(
            f"The camera {name} is on a body and has no lens; give its fov_deg or camera_info."
        )
    k = by_model.id
    sensor_m = model.cam_sensorsize[k]
    if not sensor_m.any():
        if own.focal_mm is not None:
            raise VergenceError(
                f"The lens of {name} has focal_mm, and the model states no sensorsize for it; "
                "give fov_deg."
            )
        focal = height / 2 / np.tan(np.radians(model.cam_fovy[k]) / 2)
        return focal, focal, middle
    pitch_m = sensor_m / np.array(size, np.float32)
    if np.isclose(*pitch_m, rtol=1e-5):  # square pixels, as far as the model's numbers tell
        pitch_m = pitch_m[[0, 0]]
    fx, fy, x, y = model.cam_intrinsic[k] / np.tile(pitch_m, 2)
    if own.focal_mm is not None:
        fx = fy = own.focal_mm * 1e-3 / pitch_m[0]
    return fx, fy, (middle[0] - float(x), middle[1] - float(y))
