"""The scenes that the head may stand in, and what moves in them by itself."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError

Scene = Literal["room", "sparse", "moving"]
"""`room`: a furnished laboratory; `sparse`: plain walls, texture on table and furniture only;
`moving`: the room, and an object as large as a head that passes."""
_FILES: dict[Scene, str] = {
    "room": "scene.xml",
    "sparse": "scene_sparse.xml",
    "moving": "scene_moving.xml",
}
FINENESS: dict[Scene, float] = {"room": 1.0, "sparse": 2.0, "moving": 1.0}
"""Oversampling relative to the room. Aliasing matters more where there is less texture to match; a
picture of the sparse scene takes twice as long."""
PASSER = "passer"
"""The body that moves by itself, where there is one."""
_PASSER_M = np.array([0.75, 0.30, 1.20])
"""Middle of its path in the world: 0.75 m before the head, to its left."""
_PASSER_SWING_M = 0.19
"""With its own width it sweeps over a third of a 2.8 mm lens's view."""
_PASSER_PERIOD_S = 5.0


def load_scene(folder: Path, scene: Scene) -> mujoco.MjSpec:
    """Read a scene: the head, a room, the calibration board, the object and the hand.

    VergenceError if there is no such scene, or it cannot be read.
    """
    if scene not in _FILES:
        raise VergenceError(f"There is no scene {scene!r}; there are {', '.join(get_args(Scene))}.")
    path = folder / _FILES[scene]
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise VergenceError(f"Cannot load the model {path}: {error}.") from error


def passer_position(time_s: float) -> Array:
    """Compute the position (3,) [m] of the passing object in the world."""
    phase = 2 * np.pi * time_s / _PASSER_PERIOD_S
    swing = np.array([0.0, _PASSER_SWING_M * np.sin(phase), 0.03 * np.sin(2 * phase)])
    return _PASSER_M + swing
