"""Roles of cameras and objects to look at: fewer cameras, other names, one eye, given points."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drawn_head import DrawnHead, four_cameras, point_at, straight_to
from postures import EYE_READINGS, HEAD_JOINTS, NECK
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.gaze.commands import joint_limits
from vergence.gaze.controller import run_gaze, step_gaze
from vergence.gaze.reaching import ReachSettings
from vergence.gaze.state import (
    EyeCameras,
    GazePhase,
    GazeSettings,
    GazeState,
    default_roles,
    initial_gaze_state,
    look_at,
)  # fmt: skip
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import Neck
from vergence.vision.detector import Detection
from vergence.vision.sphere import sphere_detector

HEAD = four_cameras()
TARGET = point_at(15, -10, 0.6)


def only(*names: str, **new_names: str) -> HeadCalibration:
    """Return the head with some of its cameras, some of them under a new name."""
    kept = {name: HEAD.cameras[name] for name in names}
    return replace(HEAD, cameras=kept | {new: HEAD.cameras[n] for new, n in new_names.items()})


def run(
    settings: GazeSettings,
    seconds: float = 0.5,
    *,
    path: Callable[[float], Array | None] = lambda _: TARGET,
    change: Callable[[GazeState], GazeState] = lambda state: state,
) -> tuple[DrawnHead, GazeState]:
    """Run the controller, from a state that is changed at the beginning."""
    head = DrawnHead(path)
    state = change(initial_gaze_state(settings, np.zeros(7), 0.0))
    return head, run_gaze(head, settings, state, seconds)


def at_end(head: DrawnHead, settings: GazeSettings) -> Array:
    return head.errors_px(head.time_s, settings.narrow)


def test_the_default_roles_are_the_cameras_that_are_called_so():
    roles = default_roles(HEAD)
    assert roles == {eye: EyeCameras(f"{eye}_wide", f"{eye}_narrow") for eye in EYES}
    settings = GazeSettings(calibration=HEAD)
    assert settings.cameras == ("left_wide", "right_wide", "left_narrow", "right_narrow")


@pytest.mark.parametrize("lens", ["wide", "narrow"])
def test_a_head_with_one_camera_an_eye_centres_objects_in_it(lens: str):
    settings = GazeSettings(calibration=only(f"left_{lens}", f"right_{lens}"))
    target = point_at(7, -5, 0.6)  # within both narrow images
    head, state = run(settings, path=lambda _: target)
    assert state.phase is GazePhase.FIXATION
    assert at_end(head, settings).max() < 0.3
    assert state.track is not None
    assert np.linalg.norm(state.track.position - target) < 5e-3
    assert state.cameras == settings.cameras == (f"left_{lens}", f"right_{lens}")


@pytest.mark.parametrize("eye", EYES)
def test_a_head_of_one_eye_looks_with_that_and_leaves_the_other_alone(eye):
    settings = GazeSettings(calibration=only(f"{eye}_wide", f"{eye}_narrow"))
    head, state = run(settings)
    assert state.phase is GazePhase.FIXATION
    assert at_end(head, settings).max() < 0.5
    assert state.track is None
    assert state.aim is not None
    moved = state.command.goal[EYE_READINGS].reshape(2, 2)
    assert (moved[EYES.index(eye)] != 0).all()
    assert (moved[1 - EYES.index(eye)] == 0).all()


@pytest.mark.slow
def test_one_eye_follows_a_moving_object():
    def path(time_s: float) -> Array:
        return point_at(10 * np.sin(2 * time_s), 5 * np.cos(2 * time_s), 0.8)

    settings = GazeSettings(calibration=only("left_wide", "left_narrow"))
    head, state = run(settings, 1.5, path=path)
    assert state.phase is GazePhase.PURSUIT
    assert at_end(head, settings).max() < 12  # without a feed-forward 13 px or more


# Points and objects by name.


def test_a_given_point_is_looked_at_without_images_of_it():
    settings = GazeSettings(calibration=HEAD)
    head, state = run(settings, change=lambda s: look_at(settings, s, TARGET.tolist()))
    assert state.phase is GazePhase.FIXATION
    assert head.errors_px(head.time_s).max() < 1e-6
    np.testing.assert_allclose(state.command.goal[EYE_READINGS], straight_to(TARGET), atol=1e-12)
    assert state.track is None
    hidden, state = run(
        settings, path=lambda _: None, change=lambda s: look_at(settings, s, TARGET)
    )
    assert state.phase is GazePhase.FIXATION
    np.testing.assert_allclose(hidden.posture(0.5)[EYE_READINGS], straight_to(TARGET), atol=1e-12)


class TwoSpheres(DrawnHead):
    """Shows a blue sphere beside the red one."""

    blue = point_at(-8, 6, 0.7)

    def _draw(self, name: str, time_s: float) -> np.ndarray:
        image = super()._draw(name, time_s)
        return self.dot(image, name, time_s, self.blue, 0.02, (20, 20, 220))


def test_objects_are_chosen_by_name_and_points_in_between():
    settings = GazeSettings(
        calibration=HEAD, objects={"red": sphere_detector(), "blue": sphere_detector("blue")}
    )
    head = TwoSpheres(lambda _: point_at(6, -4, 0.6))
    state = initial_gaze_state(settings, np.zeros(7), 0.0)
    assert state.target == "red"
    for target, where in (
        ("red", point_at(6, -4, 0.6)),
        ("blue", head.blue),
        (point_at(0, 0, 1.0), point_at(0, 0, 1.0)),
        ("red", point_at(6, -4, 0.6)),
    ):
        state = run_gaze(head, settings, look_at(settings, state, target), head.time_s + 0.4)
        assert state.phase is GazePhase.FIXATION
        angles = head.posture(head.time_s)[EYE_READINGS]
        np.testing.assert_allclose(angles, straight_to(where), atol=5e-4)


# What is refused, and in which words.


@pytest.mark.parametrize(
    ("roles", "words"),
    [
        ({"left": EyeCameras("left_wide", "left_tele")}, "left eye has .* narrow: 'left_tele'"),
        ({"left": EyeCameras("right_wide", "left_narrow")}, "left eye has .* wide: 'right_wide'"),
        ({"middle": EyeCameras("left_wide", "left_narrow")}, "middle eye has no camera"),
        ({}, "one or both of left, right; found none"),
    ],
)
def test_roles_that_the_head_cannot_fill_are_refused_by_name(roles, words: str):
    with pytest.raises(VergenceError, match=words):
        GazeSettings(calibration=HEAD, roles=roles)


def test_settings_without_something_to_look_at_are_refused():
    with pytest.raises(VergenceError, match="no object to look at"):
        GazeSettings(calibration=HEAD, objects={})
    with pytest.raises(VergenceError, match="geometry is 'joints' or 'seen', found 'images'"):
        GazeSettings(calibration=HEAD, geometry="images")  # type: ignore[arg-type]


def test_a_neck_that_the_calibration_does_not_describe_cannot_share():
    with pytest.raises(VergenceError, match="has 0 neck joints"):
        GazeSettings(calibration=replace(HEAD, neck=Neck()), use_neck=True)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("cup", "No object is called 'cup'.* have: sphere"),
        ([1.0, 2.0], r"three finite coordinates.*found \[1.0, 2.0\]"),
        ([1.0, np.nan, 0.0], "three finite"),
        ([0.0, 0.0, 0.0], "not its origin"),
    ],
)
def test_targets_that_do_not_exist_are_refused(target, words: str):
    settings = GazeSettings(calibration=HEAD)
    with pytest.raises(VergenceError, match=words):
        look_at(settings, initial_gaze_state(settings, np.zeros(7), 0.0), target)


def frame(**images: np.ndarray) -> Frame:
    return Frame(0.1, 0.1, np.zeros(4), np.zeros(3), images)


@pytest.mark.parametrize(
    ("images", "words"),
    [
        ({"cam0": np.zeros((480, 640, 3), np.uint8)}, "left_wide, .*images of cam0 only"),
        ({"left_wide": np.zeros((240, 320, 3), np.uint8)}, "left_wide .* 640 x 480 .* 320 x 240"),
    ],
)
def test_images_that_are_not_those_of_the_calibration_are_refused(images, words: str):
    settings = GazeSettings(calibration=HEAD)
    with pytest.raises(VergenceError, match=words):
        step_gaze(settings, initial_gaze_state(settings, np.zeros(7), 0.0), frame(**images), 0.1)


@pytest.mark.parametrize(
    ("eye_angles", "neck_angles", "words"),
    [
        (np.zeros(4), np.empty(0), r"3 neck angles neck_pitch, .*shape \(0,\)"),
        (np.zeros(7), np.zeros(3), r"4 joint readings left_pan, .*shape \(7,\)"),
        (np.zeros((1, 4)), np.zeros(3), r"4 joint readings left_pan, .*shape \(1, 4\)"),
    ],
)
def test_readings_that_are_not_those_of_the_head_are_refused(eye_angles, neck_angles, words: str):
    settings = GazeSettings(calibration=HEAD)
    state = initial_gaze_state(settings, np.zeros(7), 0.0)
    with pytest.raises(VergenceError, match=words):
        step_gaze(settings, state, Frame(0.1, 0.1, eye_angles, neck_angles, {}), 0.1)


@pytest.mark.parametrize(
    "answer",
    [(3.0, 4.0), Detection(np.zeros(3), 0.1), Detection(np.array([np.nan, 1.0]), 0.1),
     Detection(np.zeros(2), 0.0)],
)  # fmt: skip
def test_detectors_that_answer_something_else_are_refused_by_name(answer):
    def detect(image: np.ndarray, camera: Camera, near: Array | None):
        return answer

    settings = GazeSettings(calibration=HEAD, objects={"cup": detect})
    image = np.zeros((480, 640, 3), np.uint8)
    state = initial_gaze_state(settings, np.zeros(7), 0.0)
    with pytest.raises(VergenceError, match=r"detector of 'cup' must return .* in left_wide"):
        step_gaze(settings, state, frame(left_wide=image), 0.1)


def test_detectors_get_the_image_the_camera_and_the_last_pixel():
    asked: list[tuple[tuple[int, ...], float, Array | None]] = []

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        asked.append((image.shape, camera.matrix[0, 0], near))
        return Detection(np.array([319.0, 240.0]), 0.5)

    settings = GazeSettings(calibration=only("left_wide"), objects={"cup": detect})
    run(settings, 0.2)
    assert asked[0] == ((480, 640, 3), 280.0, None)
    np.testing.assert_array_equal(asked[-1][2], [319.0, 240.0])


def test_reaching_needs_two_eyes():
    with pytest.raises(VergenceError, match="the gaze uses the left eye only"):
        ReachSettings(gaze=GazeSettings(calibration=only("left_wide")))


def test_limits_are_given_by_the_names_of_joints_and_the_others_stay():
    limits = joint_limits(
        {"left_pan": (-0.5, 0.6), "left_tilt": (-0.3, 0.3)},
        {"left_pan": 4.0, "left_tilt": 5.0},
        joints=HEAD_JOINTS,
    )
    pan = HEAD_JOINTS.index("left_pan")
    assert limits.range_rad[pan].tolist() == [-0.5, 0.6]
    assert limits.speed_rad_s[pan] == 4.0
    others = np.delete(limits.setpoint_range_rad, [pan, pan + 1], axis=0)
    np.testing.assert_array_equal(others, 0)
    settings = GazeSettings(calibration=only("left_wide"), limits=limits)
    head, _ = run(settings)
    assert at_end(head, settings).max() < 0.5
    np.testing.assert_array_equal(head.posture(0.5)[NECK], 0)


@pytest.mark.parametrize(
    ("ranges", "speeds", "words"),
    [
        ({"left_pam": (-1.0, 1.0)}, {"left_pam": 1.0}, "called 'left_pam'; there are neck_pitch"),
        ({"left_pan": (-1.0, 1.0)}, {}, "left_pan needs both a range and a speed"),
        ({"left_pan": (1.0, -1.0)}, {"left_pan": 1.0}, "range of left_pan .* 1 to -1 rad"),
        ({"left_pan": (-1.0, 1.0)}, {"left_pan": 0.0}, "0 rad/s"),
    ],
)
def test_impossible_limits_are_refused_by_name(ranges, speeds, words: str):
    with pytest.raises(VergenceError, match=words):
        joint_limits(ranges, speeds, joints=HEAD_JOINTS)
