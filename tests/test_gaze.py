"""The gaze controller on a head that draws its own images; on the twin: test_foveate.py."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drawn_head import DrawnHead, four_cameras, point_at, straight_to
from postures import EYE_READINGS, HEAD_JOINTS, NECK
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand, hold, setpoint
from vergence.gaze.controller import run_gaze, step_gaze
from vergence.gaze.observation import posture_at_image
from vergence.gaze.state import GazePhase, GazeSettings, GazeState, initial_gaze_state
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import pose, rotation

SETTINGS = GazeSettings(calibration=four_cameras())


@dataclass(frozen=True, eq=False)
class Run:
    """A run of the controller, frame by frame."""

    head: DrawnHead
    states: list[GazeState]
    times: Array
    """(N,) times of the images [s]."""
    errors: Array
    """(N, 2) distances of the object from the centres of the narrow images [px]."""

    @property
    def phases(self) -> list[GazePhase]:
        return [state.phase for state in self.states]

    def after(self, time_s: float) -> Array:
        return self.errors[self.times >= time_s]


def run(head: DrawnHead, seconds: float, settings: GazeSettings = SETTINGS) -> Run:
    states: list[GazeState] = []

    def keep(state: GazeState, frame: Frame | None) -> None:
        states.append(state)

    begin = initial_gaze_state(settings, np.zeros(len(settings.joints)), 0.0)
    run_gaze(head, settings, begin, seconds, watch=keep)
    times = np.arange(len(states)) * head.period_s
    return Run(head, states, times, np.array([head.errors_px(t) for t in times]))


def circling(speed_m_s: float, distance_m: float = 0.6) -> Callable[[float], Array]:
    """Return the path of a point on a circle of 8 cm radius before the head."""
    middle = point_at(0, 5, distance_m)

    def path(time_s: float) -> Array:
        turn = speed_m_s / 0.08 * time_s
        return middle + 0.08 * np.array([0.3 * np.sin(turn), np.cos(turn), np.sin(turn)])

    return path


@pytest.mark.parametrize(
    ("pan", "tilt", "distance"), [(18, -15, 0.35), (-20, 20, 1.5), (2, 1, 0.8)]
)
def test_a_still_object_comes_to_the_middle_of_both_foveas_and_stays(pan, tilt, distance):
    target = point_at(pan, tilt, distance)
    done = run(DrawnHead(lambda _: target), 0.5)
    assert done.after(0.2).max() < 0.5
    assert set(done.phases[6:]) == {GazePhase.FIXATION}
    assert set(done.states[-1].pixels) == set(SETTINGS.narrow)
    np.testing.assert_allclose(
        done.states[-1].command.goal[EYE_READINGS], straight_to(target), atol=1e-3
    )


@pytest.mark.slow
def test_a_moving_object_is_followed_without_lag():
    path = circling(0.2)
    done = run(DrawnHead(path), 1.3)
    assert set(done.phases[15:]) == {GazePhase.PURSUIT}
    assert np.sqrt((done.after(0.5) ** 2).mean()) < 8
    # Without the feed-forward the eyes lag by the motion of a frame: 13 px.
    blind = replace(SETTINGS, moving_rad_s=np.inf)
    behind = run(DrawnHead(path), 1.3, blind)
    assert np.sqrt((behind.after(0.5) ** 2).mean()) > 12


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.02, 0.1])
def test_late_frames_are_used_at_the_time_of_their_stamp(latency):
    still = run(DrawnHead(lambda _: point_at(15, -10, 0.6), latency_s=latency), 0.8)
    assert still.after(0.7).max() < 0.5
    moving = run(DrawnHead(circling(0.15), latency_s=latency), 1.5)
    assert GazePhase.LOST not in moving.phases[20:]
    assert np.sqrt((moving.after(1.0) ** 2).mean()) < 25


def test_readings_that_are_older_than_the_image_are_carried_to_it():
    path = circling(0.2)
    done = run(DrawnHead(path, joint_lag_s=0.02), 1.0)
    errors = [
        np.linalg.norm(state.measured - path(state.frame_s))
        for state in done.states[10:]
        if state.measured is not None
    ]
    assert np.median(errors) < 2e-3


@pytest.mark.parametrize("servo_lag_s", [0.005, 0.05])
def test_joints_that_lag_behind_their_set_points_come_to_rest(servo_lag_s: float):
    target = point_at(12, -8, 0.8)
    head = DrawnHead(lambda _: target, latency_s=0.06, servo_lag_s=servo_lag_s)
    done = run(head, 1.1, replace(SETTINGS, servo_lag_s=servo_lag_s))
    assert done.after(0.7).max() < 0.5


def test_an_object_that_both_eyes_see_but_whose_rays_do_not_meet_is_followed():
    """As one far away is by a head whose calibration is a little off."""
    right = SETTINGS.calibration.cameras
    turned = {
        name: replace(each, T_eye_cam=pose(rotation([0, 0, -0.12])) @ each.T_eye_cam)
        if each.eye == "right"
        else each
        for name, each in right.items()
    }
    settings = replace(SETTINGS, calibration=replace(SETTINGS.calibration, cameras=turned))

    def sweep(time_s: float) -> Array:
        return point_at(11 - 8 * time_s, 0, 2.0)

    done = run(DrawnHead(sweep), 2.5, settings)
    assert not [state for state in done.states[1:] if state.measured is not None]
    aim = done.states[-1].aim
    assert aim is not None
    away = aim.position - four_cameras().neck.head_m
    assert np.degrees(np.arctan2(away[1], away[0])) == pytest.approx(-9, abs=8)
    assert done.after(1.0)[:, 0].max() < 15


def test_an_object_that_moves_slowly_is_pursued_though_readings_are_noisy():
    done = run(DrawnHead(circling(0.02), joint_noise_rad=1e-3), 1.5)
    assert np.mean([phase is GazePhase.PURSUIT for phase in done.phases[15:]]) > 0.9


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"time_s": np.nan}, "of one clock .* found nan s of the images"),
        ({"joint_time_s": -1000.0}, "of one clock .* found 0.0+ s of the images and -1000.0+ s"),
        ({"time_s": 1000.0, "joint_time_s": 1000.0}, "one clock .* 1000.0+ s of the images"),
        ({"time_s": -1000.0, "joint_time_s": -1000.0}, "one clock .* -1000.0+ s of the images"),
        ({"images": {"left_wide": None}}, "image of left_wide is missing"),
    ],
)
def test_time_stamps_of_another_clock_and_missing_images_are_named(changed, said: str):
    frame = DrawnHead(lambda _: point_at(0, 0, 0.6)).read(SETTINGS.cameras)
    assert frame is not None
    state = initial_gaze_state(SETTINGS, np.zeros(7), 0.0)
    with pytest.raises(VergenceError, match=said):
        step_gaze(SETTINGS, state, replace(frame, **changed), 0.0)


def test_repeated_and_missing_frames_are_tolerated():
    head = DrawnHead(circling(0.15), dropped=lambda n: n % 7 == 3, repeated=lambda n: n % 5 == 4)
    done = run(head, 1.3)
    assert GazePhase.LOST not in done.phases[10:]
    assert np.sqrt((done.after(0.6) ** 2).mean()) < 20


@pytest.mark.slow
def test_a_hidden_object_is_lost_and_found_again():
    path = circling(0.2)
    done = run(DrawnHead(lambda t: None if 1.0 <= t < 1.5 else path(t)), 3.0)
    assert GazePhase.LOST in done.phases[30:46]
    assert GazePhase.LOST not in done.phases[48:]
    assert done.after(2.0).max() < 32


@pytest.mark.slow
def test_a_stuck_joint_is_named_and_the_others_continue():
    held = np.full(7, np.nan)
    held[HEAD_JOINTS.index("left_pan")] = 0.0
    target = point_at(15, 8, 0.6)
    head = DrawnHead(lambda _: target, stuck=lambda t: held if t < 1.5 else None)
    done = run(head, 3.0)
    during = done.states[40]
    assert during.stuck == ("left_pan",)
    assert done.errors[40, 1] < 1
    assert during.track is not None
    assert np.linalg.norm(during.track.position - target) < 5e-3
    assert done.states[-1].stuck == ()
    assert done.errors[-1].max() < 1


def test_both_eyes_turn_to_an_object_that_only_one_sees():
    hidden = point_at(50, 0, 0.25)  # beyond the right eye's image, within the left one's
    done = run(DrawnHead(lambda _: hidden), 1.5, replace(SETTINGS, use_neck=True))
    assert done.phases[-1] is not GazePhase.LOST
    assert done.errors[-1].max() < 5


def test_a_head_without_a_calibrated_neck_works_in_frame_head():
    plain = replace(four_cameras(), neck=type(four_cameras().neck)())
    target = point_at(10, 5, 0.6)
    head, settings = DrawnHead(lambda _: target), GazeSettings(calibration=plain)
    head.calibration, head.commands = plain, [hold(np.zeros(4), settings.limits, -1.0)]
    done = run(head, 0.4, settings)
    assert done.states[-1].track is not None
    assert np.linalg.norm(done.states[-1].track.position - target) < 3e-3


@pytest.mark.parametrize("use_neck", [False, True])
def test_a_neck_may_have_other_joints_in_another_order(use_neck: bool):
    """It yaws, then pitches, and does not roll."""
    axes, points_m = np.array([[0.0, 0, 1], [0, 1, 0]]), np.array([[0, 0, 0.05], [0, 0, 0.1]])
    neck = Neck(axes, points_m, np.array([0.06, 0, 0.2]), joints=("twist", "nod"))
    target = np.array([0.55, 0.35, 0.1])
    head = DrawnHead(lambda _: target)
    head.calibration = replace(four_cameras(), neck=neck)
    settings = GazeSettings(calibration=head.calibration, use_neck=use_neck)
    begin = np.array([0.3, 0.1, 0, 0, 0, 0])
    head.commands = [hold(begin, settings.limits, -1.0)]
    state = run_gaze(head, settings, initial_gaze_state(settings, begin, 0.0), 2.5)
    assert state.track is not None
    assert np.linalg.norm(state.track.position - target) < 3e-3
    assert head.errors_px(2.4).max() < 3
    turned = head.posture(2.4)[0] - begin[0]
    assert (turned > 0.05) == use_neck


@pytest.mark.parametrize("offset_s", [0.04, -0.03])
def test_a_calibrated_time_offset_moves_readings_and_not_set_points(offset_s: float):
    """The neck's angles are read, those of the eyes are taken from the commands."""
    settings = replace(SETTINGS, calibration=replace(four_cameras(), time_offset_s=offset_s))
    state = initial_gaze_state(settings, np.zeros(7), 0.0)
    away = HeadCommand(0.0, np.zeros(7), np.full(7, 0.3), np.zeros(7), settings.limits)
    state = replace(state, commands=(away,))
    image_s = 0.06
    read = setpoint(away, image_s - offset_s)
    frame = Frame(image_s, image_s, read[EYE_READINGS], read[NECK], {})
    posture = posture_at_image(settings, state, frame)
    np.testing.assert_allclose(posture, setpoint(away, image_s), atol=1e-12)
    plain = posture_at_image(SETTINGS, state, frame)
    np.testing.assert_allclose(plain[NECK], read[NECK], atol=1e-12)
