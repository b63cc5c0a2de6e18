"""Render the picture in the model's README: the robot in its scene, looking at the object.

python models/shared_tilt_head/render_picture.py
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import cv2
import mujoco
import numpy as np

MODEL = Path(__file__).parent
SIDE = 840
"""Width and height of the picture [px]."""
SUPERSAMPLING = 2
"""On top of 4 samples a pixel: thin rims need it."""
NECK_RAD = {"neck_pitch": 0.05, "neck_roll": 0.06, "neck_yaw": 0.12}


def look_at(model: mujoco.MjModel, data: mujoco.MjData, target: np.ndarray) -> None:
    """Tilt both eyes and pan each of them to a point [m, world]."""
    mujoco.mj_kinematics(model, data)
    head = data.body("head")
    x, y, z = head.xmat.reshape(3, 3).T @ (target - head.xpos)
    data.joint("eyes_tilt").qpos[0] = -np.arctan2(z, x)
    for side in ("left", "right"):
        beside = y - model.body(f"{side}_eye").pos[1]
        data.joint(f"{side}_pan").qpos[0] = np.arctan2(beside, np.hypot(x, z))
    mujoco.mj_forward(model, data)


def render() -> np.ndarray:
    """Render the picture (SIDE, SIDE, 3), BGR."""
    spec = mujoco.MjSpec.from_file(str(MODEL / "scene.xml"))
    large = SIDE * SUPERSAMPLING
    getattr(spec.visual, "global").offwidth = getattr(spec.visual, "global").offheight = large
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 96, 64
    model = spec.compile()
    data = mujoco.MjData(model)
    for joint, angle in NECK_RAD.items():
        data.joint(joint).qpos[0] = angle
    look_at(model, data, model.body("object").pos)
    camera = mujoco.MjvCamera()
    camera.lookat = [-0.04, 0.0, 1.15]
    camera.distance, camera.azimuth, camera.elevation = 0.62, 207.0, -8.0
    with mujoco.Renderer(model, large, large) as renderer:
        renderer.update_scene(data, camera)
        image = renderer.render()
    small = cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_RGB2BGR)


def main() -> None:
    path = MODEL / "shared_tilt_head.png"
    cv2.imwrite(str(path), render(), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
