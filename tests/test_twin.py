"""The twin against MuJoCo, and what its frames show and hide."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import fields

import mujoco
import numpy as np
import pytest

from described_heads import KINDS, described_head
from simulated_head import pan_tilt_pose
from vergence.data.dataset import Frame
from vergence.geometry.head import base_pose, camera_pose_in_base
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse, pose
from vergence.twin.designed_head import R_MJCAM_CAM
from vergence.twin.head import Twin
from vergence.twin.model import (
    as_built_head,
    body_in_room,
    compile_head,
    shared_joints,
)
from vergence.twin.model_joints import body_pose
from vergence.twin.offscreen import Format, Offscreen
from vergence.twin.profile import Axes, ErrorProfile, Image, Joints, Mounting, Optics
from vergence.twin.renderer import overscan_sizes

EVERYTHING = ErrorProfile(
    mounting=Mounting(
        rotation_deg=2, translation_mm=3, base_rotation_deg=1, base_translation_mm=2, baseline_mm=80
    ),
    axes=Axes(nonorthogonality_deg=(1.0, -0.7), distance_mm=(0.8, -0.5)),
    optics=Optics(focal_percent=2, principal_px=5),
    image=Image(noise_grey=2, blur_px=0.5),
    joints=Joints(noise_deg=0.05, gain_percent=(1, 2, -1, 0), offset_deg=(0.2, 0, 0, -0.3)),
)
NOTHING_SEEN: tuple[str, ...] = ()
EYES = slice(3, None)


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_has_its_cameras_where_mujoco_has_them(kind: str, tmp_path):
    """At random angles of all joints, with every imperfection: to 1e-9."""
    head = described_head(kind, tmp_path)
    designed, shared = head.designed, len(shared_joints(head.designed))
    truth = as_built_head(designed.head, EVERYTHING, 0, shared=shared)
    model = compile_head(head, truth, overscan_sizes(truth))
    data, rng, n = mujoco.MjData(model), np.random.default_rng(0), len(designed.neck)
    places = []
    for _ in range(10):
        angles = rng.uniform(-0.4, 0.4, len(head.limits.joints))
        for name, angle in zip(designed.neck, angles[:n], strict=True):
            data.joint(name).qpos = angle
        for eye, names in designed.eyes.items():
            turned = truth.kinematics.chains[eye].mixing @ angles[n:]
            for name, angle in zip(names, turned, strict=True):
                data.joint(name).qpos = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        T_world_head = body_pose(data, body_in_room(model, designed.base)) @ designed.T_base_head
        places.append(T_world_head @ inverse(head_pose(truth.neck, angles[:n])))
        for name, mounted in truth.cameras.items():
            T = T_world_head @ base_pose(truth, mounted.eye)
            T = T @ camera_pose_in_base(truth, name, angles[n:]) @ pose(R_MJCAM_CAM)
            camera = data.camera(name)
            np.testing.assert_allclose(T[:3, 3], camera.xpos, atol=1e-9)
            np.testing.assert_allclose(T[:3, :3], camera.xmat.reshape(3, 3), atol=1e-9)
    np.testing.assert_allclose(np.ptp(places, axis=0), 0, atol=1e-9)  # frame body stands still
    straight = places[0] @ head_pose(truth.neck, np.zeros(n))
    np.testing.assert_allclose(straight, pose(t=[0, 0, 1.2]), atol=1e-6)


# Frames

Make = Callable[..., Twin]


@pytest.fixture
def make(opengl: None) -> Iterator[Make]:
    """Make twins, and close them in the end."""
    with ExitStack() as stack:
        yield lambda *args, **kwargs: stack.enter_context(Twin(*args, **kwargs))


@pytest.fixture(scope="module")
def perfect(opengl: None) -> Iterator[Twin]:
    """A twin without any error, which every test restarts."""
    with Twin(ErrorProfile(), seed=0) as twin:
        yield twin


def sweep(time_s: float) -> np.ndarray:
    """Return a command (7,) that moves all eye joints at up to 1 rad/s."""
    swing = 0.2 * np.sin(5 * time_s + np.array([0.0, 1.0, 2.0, 3.0]))
    return np.concatenate([np.zeros(3), swing])


def test_the_same_seed_takes_the_same_frame_and_another_seed_another(make: Make):
    frames = []
    for seed in (4, 4, 5):
        twin = make(EVERYTHING, seed=seed)
        twin.place_object(np.array([0.5, 0, 0]))
        twin.advance(0.05, sweep)
        frames.append(twin.capture(("left_wide", "right_narrow")))
    one, same, other = frames
    for name in one.images:
        assert one.images[name].tobytes() == same.images[name].tobytes()
        assert (one.images[name] != other.images[name]).mean() > 0.3
    np.testing.assert_array_equal(one.eye_angles, same.eye_angles)
    assert (one.eye_angles != other.eye_angles).all()


def test_a_frame_carries_what_a_real_head_would_give_and_no_truth(make: Make):
    twin = make(EVERYTHING, seed=0)
    twin.advance(0.1, sweep)
    frame = twin.capture(("left_wide", "left_narrow"))
    known = {"time_s", "joint_time_s", "eye_angles", "neck_angles", "images"}
    assert {field.name for field in fields(Frame)} == known
    assert set(vars(frame)) == known
    assert list(frame.images) == ["left_wide", "left_narrow"]
    for image in frame.images.values():
        assert type(image) is np.ndarray
        assert image.shape == (480, 640, 3)
        assert image.dtype == np.uint8
    error = np.degrees(np.abs(frame.eye_angles - twin.true_angles()[EYES]))
    assert error[0] > 0.05  # the offset of 0.2 degrees is in the readings
    assert frame.time_s == frame.joint_time_s == pytest.approx(0.1)


@pytest.mark.parametrize("delay_ms", [26, -26])
def test_readings_are_older_than_the_image_by_the_delay(make: Make, delay_ms: int):
    """With a negative delay the image is the older one."""
    twin = make(ErrorProfile(joints=Joints(delay_ms=delay_ms)), seed=0)
    twin.advance(0.5, sweep)
    read, true = twin.expose(NOTHING_SEEN).frame.eye_angles, twin.true_angles()[EYES]
    twin.advance(0.526, sweep)
    read_later, true_later = twin.expose(NOTHING_SEEN).frame.eye_angles, twin.true_angles()[EYES]
    older, before = (read_later, true) if delay_ms > 0 else (true_later, read)
    np.testing.assert_allclose(older, before, atol=1e-12)
    assert np.abs(read_later - true_later).max() > 0.01
    # And the true angles are where the eye stands in the picture.
    poses = twin.body_poses()
    R_head_eye = poses["head"][:3, :3].T @ poses["left_eye"][:3, :3]
    np.testing.assert_allclose(R_head_eye, pan_tilt_pose(true_later[:2])[:3, :3], atol=1e-9)


def test_backlash_shows_when_a_posture_is_reached_from_both_sides(make: Make):
    twin = make(ErrorProfile(joints=Joints(backlash_deg=0.5)), seed=0)
    errors = []
    for start in (0.1, -0.1):
        twin.settle(np.array([0, 0, 0, start, start, start, start]))
        twin.settle(np.zeros(7))
        exposure = twin.expose(NOTHING_SEEN)
        errors.append(np.degrees(exposure.frame.eye_angles - twin.true_angles()[EYES]))
    # A servo that overshoots by a little takes that much of the play back.
    np.testing.assert_allclose(errors[0] - errors[1], 0.5, atol=0.05)


def test_the_motion_does_not_depend_on_where_it_is_stopped(perfect: Twin):
    ways = []
    for stops in ([0.5], [0.033, 0.067, 0.1, 0.312, 0.5]):
        perfect.restart(0)
        for until_s in stops:
            perfect.advance(until_s, sweep)
        ways.append(perfect.true_angles())
    np.testing.assert_array_equal(*ways)


def hide_what_lies_outside_the_room(renderer: mujoco.Renderer) -> None:
    """As the twin's own renderer does."""
    for flag in ("SKYBOX", "HAZE", "SHADOW", "REFLECTION"):
        renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0


def test_pictures_of_several_sizes_are_those_of_mujoco_s_renderer(make: Make):
    """Which has an OpenGL context for each size."""
    twin = make(EVERYTHING)
    sizes = [(320, 240), (200, 300)]
    offscreen = Offscreen(twin.model, [Format(*size, samples=4) for size in sizes])
    for width, height in sizes:
        form = Format(width, height, samples=4)
        with mujoco.Renderer(twin.model, height, width) as renderer:
            hide_what_lies_outside_the_room(renderer)
            for name in ("left_wide", "right_narrow"):
                offscreen.show(twin._seen, name)
                renderer.update_scene(twin._seen, camera=name)
                np.testing.assert_array_equal(offscreen.colours(form), renderer.render())
                renderer.enable_depth_rendering()
                depths = offscreen.depths(form)
                np.testing.assert_allclose(depths, renderer.render(), rtol=1e-6)
                renderer.disable_depth_rendering()
    offscreen.close()


def test_the_object_is_multisampled_where_the_rest_is_not(make: Make):
    """Beside a picture that MuJoCo multisamples as a whole, of each wide camera."""
    twin = make(EVERYTHING)
    buffer = twin.model.vis.global_
    before = buffer.offwidth, buffer.offheight
    for name in ("left_wide", "right_wide"):
        height, width = twin.expose((name,)).negatives[0].rendered.shape[:2]
        buffer.offwidth, buffer.offheight = width, height
        with mujoco.Renderer(twin.model, height, width) as renderer:
            buffer.offwidth, buffer.offheight = before
            hide_what_lies_outside_the_room(renderer)
            for place in ((0.3, 0.25, 0.1), (1.1, 0.0, 0.0)):
                twin.place_object(np.array(place))
                image = twin.expose((name,)).negatives[0].rendered.astype(int)
                renderer.update_scene(twin._seen, camera=name)
                wanted = renderer.render().astype(int)
                off = np.abs(image - wanted).max(axis=2)
                v, u = np.nonzero(wanted[..., 0] - wanted[..., 1] > 40)  # red
                assert len(v) > 50
                rows = slice(max(0, v.min() - 4), v.max() + 5)
                columns = slice(max(0, u.min() - 4), u.max() + 5)
                assert off[rows, columns].max() <= 2
                assert off.max() > 40


def test_a_later_run_does_not_depend_on_what_came_before(make: Make):
    twin = make(EVERYTHING, seed=1)
    frames = []
    for before in (0.0, 0.2):
        twin.restart(0)
        twin.advance(before, sweep)
        twin.restart(7)
        twin.advance(0.1, sweep)
        frames.append(twin.capture(("right_wide",)))
    np.testing.assert_array_equal(frames[0].eye_angles, frames[1].eye_angles)
    np.testing.assert_array_equal(frames[0].images["right_wide"], frames[1].images["right_wide"])
