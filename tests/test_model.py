"""The MuJoCo model of the head and its scene: frames, optics, servos, and what the cameras see."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import itertools
import runpy
from pathlib import Path
from typing import get_args

import cv2
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from vergence.twin.head_model import load_head_model
from vergence.twin.model import compile_head
from vergence.twin.renderer import overscan_sizes
from vergence.twin.scene import Scene

MODELS = Path(__file__).parents[1] / "models"
MODEL, ROOM = MODELS / "cbi_head", MODELS / "room"
JOINT_RANGE_DEG = {
    "neck_pitch": (-30, 40),
    "neck_roll": (-30, 30),
    "neck_yaw": (-50, 50),
    "left_pan": (-35, 35),
    "left_tilt": (-30, 30),
    "right_pan": (-35, 35),
    "right_tilt": (-30, 30),
}
FOCAL_PX = {"wide": 280.0, "narrow": 1200.0}
WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(MODEL / "scene.xml"))


@pytest.fixture
def data(model) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def redness(image: NDArray) -> NDArray[np.float64]:
    red, green, blue = np.moveaxis(image.astype(float) / 255.0, -1, 0)
    return red - (green + blue) / 2.0


SCENES = get_args(Scene)


@pytest.mark.parametrize(
    "file",
    [
        *("cbi_head/cbi_head.xml", "cbi_head/scene.xml"),
        *("shared_tilt_head/shared_tilt_head.xml", "shared_tilt_head/scene.xml"),
    ],
)
def test_random_control_raises_no_warning(file: str):
    model = mujoco.MjModel.from_xml_path(str(MODELS / file))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    low, high = model.actuator_ctrlrange.T
    for step in range(round(2.0 / model.opt.timestep)):
        if step % 10 == 0:
            data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data)
    assert [warning.number for warning in data.warning] == [0] * len(data.warning)
    assert np.isfinite(data.qpos).all()
    assert data.ncon == 0


def test_joints_actuators_and_sensors_share_names_and_ranges(model):
    assert [model.joint(i).name for i in range(model.njnt)] == list(JOINT_RANGE_DEG)
    assert [model.actuator(i).name for i in range(model.nu)] == list(JOINT_RANGE_DEG)
    sensors = [f"{joint}_{kind}" for kind in ("pos", "vel") for joint in JOINT_RANGE_DEG]
    assert [model.sensor(i).name for i in range(model.nsensor)] == sensors
    for name, limits_deg in JOINT_RANGE_DEG.items():
        np.testing.assert_allclose(model.joint(name).range, np.radians(limits_deg), atol=1e-6)
        np.testing.assert_allclose(model.actuator(name).ctrlrange, model.joint(name).range)


MUTED = 0.25
"""Redness of everything but the object, at most; its detector begins at 0.39."""


@pytest.mark.parametrize("camera", ["left_wide", "right_narrow"])
@pytest.mark.render
def test_object_is_red_and_shaded_and_nothing_else_is_as_red(model, data, camera: str):
    centre = data.cam(camera).xpos + np.array((0.45, 0.0, 0.0))
    data.mocap_pos[model.body("object").mocapid[0]] = centre
    radius_px = FOCAL_PX[camera.split("_")[1]] * 0.020 / 0.45
    rows, columns = np.indices((HEIGHT, WIDTH))
    distance_px = np.hypot(columns - (WIDTH - 1) / 2, rows - (HEIGHT - 1) / 2)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera)
        image = renderer.render()
    sphere = image[distance_px < radius_px - 1.0]
    assert (sphere[:, 1:] == 0).all()
    assert sphere[:, 0].min() > 110
    assert 255 > sphere[:, 0].max() > 1.3 * sphere[:, 0].min()
    assert redness(image)[distance_px > radius_px + 1.5].max() <= MUTED


@pytest.mark.render
@pytest.mark.parametrize("scene", SCENES)
def test_no_view_of_a_scene_is_red_or_blue_and_scenes_differ_in_texture(scene: Scene):
    head = load_head_model()
    truth = head.designed.head
    model = compile_head(head, truth, overscan_sizes(truth), scene=scene)
    data = mujoco.MjData(model)
    data.mocap_pos[:, 2] = np.where(np.arange(model.nmocap) < 5, -10.0, 1.2)  # not what passes
    seen = []
    with mujoco.Renderer(model, HEIGHT // 2, WIDTH // 2) as renderer:
        for neck_yaw, pitch in itertools.product((-0.8, 0.0, 0.8), (-0.4, 0.6)):
            data.joint("neck_yaw").qpos[0], data.joint("neck_pitch").qpos[0] = neck_yaw, pitch
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, "left_wide")
            seen.append(renderer.render())
    images = np.array(seen)
    assert redness(images).max() <= MUTED
    assert redness(images[..., ::-1]).max() <= MUTED  # blueness
    assert np.ptp(images.astype(int), axis=-1).max() > 20  # in colour
    edges = np.mean([cv2.Canny(image, 60, 120) > 0 for image in images])
    assert (edges < 0.04) if "sparse" in scene else (edges > 0.06)


@pytest.mark.parametrize("joint", ["left_pan", "right_tilt"])
def test_eyes_are_fast_follow_closely_and_do_not_overshoot(model, data, joint: str):
    speed, angle = [], []
    for _ in range(200):
        data.actuator(joint).ctrl[0] = 0.35
        mujoco.mj_step(model, data)
        speed.append(data.joint(joint).qvel[0])
        angle.append(data.joint(joint).qpos[0])
    assert max(speed) > 10.0
    assert max(angle) < 0.35 * 1.02
    assert angle[-1] == pytest.approx(0.35, abs=1e-3)

    mujoco.mj_resetDataKeyframe(model, data, 0)
    errors = []
    while data.time < 3.0:
        data.actuator(joint).ctrl[0] = 0.25 * np.sin(data.time)
        mujoco.mj_step(model, data)
        errors.append(data.joint(joint).qpos[0] - 0.25 * np.sin(data.time))
    assert np.abs(errors).max() < 1.5e-3


def test_textures_and_meshes_are_made_by_their_scripts():
    made = runpy.run_path(str(ROOM / "assets/make_textures.py"))["textures"]()
    assert set(made) == {path.name for path in (ROOM / "assets").glob("*.png")}
    for name, image in made.items():
        stored = cv2.imread(str(ROOM / "assets" / name), cv2.IMREAD_UNCHANGED)
        rgb = stored[..., ::-1] if stored.ndim == 3 else stored
        np.testing.assert_array_equal(rgb, image, err_msg=name)
    meshes = runpy.run_path(str(MODEL / "assets/make_meshes.py"))
    for name, closed in (("shell", True), ("crest", False)):
        text = (MODEL / "assets" / f"{name}.obj").read_text()
        assert text.count("\nv ") == meshes[name]().vertices[..., 0].size
        assert text == meshes[name]().obj(closed=closed)


def test_the_motors_of_the_other_head_turn_both_eyes_alike_and_towards_each_other():
    path = MODELS / "shared_tilt_head/shared_tilt_head.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    wanted = {"eyes_tilt": 0.2, "version": 0.1, "vergence": 0.3, "neck_yaw": -0.4}
    for name, angle in wanted.items():
        data.actuator(name).ctrl[0] = angle
    mujoco.mj_step(model, data, 1500)
    for name, angle in wanted.items():
        assert data.sensor(f"{name}_pos").data[0] == pytest.approx(angle, abs=1e-3), name
    assert data.joint("left_pan").qpos[0] == pytest.approx(0.1 - 0.15, abs=1e-3)
    assert data.joint("right_pan").qpos[0] == pytest.approx(0.1 + 0.15, abs=1e-3)
