"""Render the picture in the model's README.

    python models/cbi_head/render_picture.py

The robot alone, before a plain backdrop, with shadows and a studio's three lights: the scene itself
has neither, because its images are measured, and shadows cost time.
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
WIDTH, HEIGHT = 840, 840
SUPERSAMPLING = 2
"""On top of 4 samples a pixel: thin rims need it."""
FIXATION = np.array([0.50, 0.10, 1.16])
"""Where the eyes look [m, world]: near, so that the picture shows the vergence."""
NECK_RAD = {"neck_pitch": 0.06, "neck_roll": 0.05, "neck_yaw": 0.10}
LIGHTS = (
    # position [m], brightness, shadow
    ((1.6, -0.5, 2.3), 0.55, True),
    ((0.9, 1.6, 1.5), 0.30, False),
    ((-1.2, 0.6, 2.2), 0.35, False),
)


def studio() -> mujoco.MjModel:
    """The robot with a floor, a backdrop and lights."""
    spec = mujoco.MjSpec.from_file(str(MODEL / "cbi_head.xml"))
    getattr(spec.visual, "global").offwidth = WIDTH * SUPERSAMPLING
    getattr(spec.visual, "global").offheight = HEIGHT * SUPERSAMPLING
    spec.visual.quality.shadowsize = 4096
    spec.visual.quality.offsamples = 4
    spec.visual.quality.numslices = 96
    spec.visual.quality.numstacks = 64
    spec.visual.headlight.ambient = [0.30, 0.30, 0.30]
    spec.visual.headlight.diffuse = [0.10, 0.10, 0.10]
    spec.visual.headlight.specular = [0.1, 0.1, 0.1]
    spec.stat.extent = 1.0
    spec.stat.center = [0.0, 0.0, 1.15]
    spec.visual.map.znear = 0.05
    spec.visual.map.shadowclip = 0.45
    spec.visual.map.zfar = 30.0
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.80, 0.85, 0.90],
        rgb2=[0.42, 0.50, 0.58],
        width=256,
        height=256,
    )
    for position, brightness, shadow in LIGHTS:
        spec.worldbody.add_light(
            pos=position,
            dir=np.array([-0.06, 0.0, 1.15]) - position,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            diffuse=[brightness] * 3,
            specular=[0.6 * brightness] * 3,
            castshadow=shadow,
        )
    return spec.compile()


def look_at(model: mujoco.MjModel, data: mujoco.MjData, target: np.ndarray) -> None:
    """Turn both eyes towards a point [m, world]."""
    for side in ("left", "right"):
        site = data.site(f"{side}_base")
        x, y, z = site.xmat.reshape(3, 3).T @ (target - site.xpos)
        data.joint(f"{side}_pan").qpos[0] = np.arctan2(y, x)
        data.joint(f"{side}_tilt").qpos[0] = -np.arctan2(z, np.hypot(x, y))
    mujoco.mj_forward(model, data)


def render() -> np.ndarray:
    """The picture, (HEIGHT, WIDTH, 3), BGR."""
    model = studio()
    data = mujoco.MjData(model)
    for joint, angle in NECK_RAD.items():
        data.joint(joint).qpos[0] = angle
    mujoco.mj_forward(model, data)
    look_at(model, data, FIXATION)

    camera = mujoco.MjvCamera()
    camera.lookat = [-0.05, 0.0, 1.135]
    camera.distance = 0.64
    camera.azimuth = 210.0
    camera.elevation = -8.0
    with mujoco.Renderer(model, HEIGHT * SUPERSAMPLING, WIDTH * SUPERSAMPLING) as renderer:
        renderer.update_scene(data, camera)
        image = renderer.render()
    image = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(image, cv2.COLOR_RGB2BGR)


def main() -> None:
    path = MODEL / "cbi_head.png"
    cv2.imwrite(str(path), render(), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
