"""The geometry that both eyes see, frame after frame: for the gaze, for depth, for recordings."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rerun.chunk import RrdReader

from drawn_head import four_cameras, point_at
from drawn_room import RoomHead, view
from rrd import assert_valid, read_series
from vergence import cli
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.gaze.controller import run_gaze
from vergence.gaze.roles import EyeCameras
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.geometry.board import Chessboard
from vergence.geometry.head import HeadCalibration, load_head, save_head
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Joint, Kinematics, Side, pan_tilt
from vergence.geometry.parameters import change_named
from vergence.geometry.se3 import boxminus, pose, rotation
from vergence.paper.figures import FIGURES
from vergence.paper.recording import figure_recording
from vergence.self_calibration import recorded as recorded_self_calibration
from vergence.self_calibration.keyframe import TURNED_RAD
from vergence.self_calibration.prior import MOVED, USUAL
from vergence.self_calibration.recorded import self_calibrate_dataset
from vergence.self_calibration.sequence import LEARNING_S, initial_seen_geometry, update_geometry
from vergence.stereo.extrinsics import T_rcam_lcam
from vergence.viewer.seen import log_learned, log_matches

HEAD = four_cameras()
WIDE = ("left_wide", "right_wide")
GAIN, NOISE_RAD = 1.03, 2.6e-3


def angles_at(time_s: float) -> Array:
    """Return angles (4,) [rad] of eyes whose pan, tilt and vergence change."""
    pan, vergence, tilt = 0.12 * np.sin(1.7 * time_s), 0.05 * np.sin(2.9 * time_s), 0.08
    return np.array([pan - vergence, tilt * np.sin(time_s), pan + vergence, tilt * np.cos(time_s)])


def frame(time_s: float, angles: Array, readings: Array, cameras=WIDE) -> Frame:
    images = {name: view(HEAD, name, angles) for name in cameras}
    return Frame(time_s, time_s, readings, np.zeros(3), images)


def frames(count: int, *, step_s: float = 0.3) -> list[tuple[Array, Frame]]:
    """Return true angles and frames of moving eyes, whose readings have noise and a gain."""
    rng = np.random.default_rng(1)
    found = []
    for time_s in step_s * np.arange(count):
        angles = angles_at(time_s)
        readings = GAIN * angles + rng.normal(0, NOISE_RAD, 4)
        found.append((angles, frame(float(time_s), angles, readings)))
    return found


@pytest.fixture(scope="module")
def moving(slow_setup: None) -> list[tuple[Array, Frame]]:
    return frames(10)


def turn_error(head: HeadCalibration, joints: Array, angles: Array) -> float:
    T = boxminus(T_rcam_lcam(head, joints), T_rcam_lcam(HEAD, angles))
    return float(np.linalg.norm(T[:3]))


def test_every_frame_is_better_than_the_readings_and_teaches_the_next(moving):
    geometry = initial_seen_geometry(HEAD)
    by_readings, by_sight = [], []
    for angles, each in moving:
        geometry = update_geometry(geometry, each)
        assert geometry.latest is not None
        by_readings.append(turn_error(HEAD, each.eye_angles, angles))
        by_sight.append(turn_error(geometry.latest.head, geometry.latest.joints, angles))
    assert geometry.known.frames == len(moving) - 1  # the first shows where the eyes begin
    assert np.mean(by_sight) < np.mean(by_readings) / 3
    assert geometry.known.joint_std_rad == pytest.approx(NOISE_RAD, rel=0.4)


def test_frames_that_show_the_same_again_teach_nothing(moving):
    """Those that follow too closely, and those of eyes at rest."""
    (_, first), (_, second), *_ = moving
    once = update_geometry(initial_seen_geometry(HEAD), first)
    assert once.known.frames == 0
    close = update_geometry(once, replace(second, time_s=first.time_s + LEARNING_S / 3))
    at_rest = update_geometry(once, replace(first, time_s=first.time_s + 5.0))
    for again in (close, at_rest):
        assert again.known is once.known
        assert again.latest is not once.latest
    assert update_geometry(once, second).known.frames == 1
    earlier = update_geometry(once, replace(second, time_s=-100.0))  # of another run
    assert (np.diag(earlier.known.covariance) < np.diag(once.known.covariance) * 1.001).all()


def test_features_are_not_tracked_across_a_motion_of_the_neck(moving):
    geometry = initial_seen_geometry(HEAD)
    for _, each in moving[:3]:
        geometry = update_geometry(geometry, each)
    before = geometry.known.keyframe
    assert before is not None
    assert np.abs(moving[3][1].eye_angles - before.joints).max() < TURNED_RAD
    for neck, stays in ((0.0, True), (np.radians(3), False)):
        after = update_geometry(geometry, replace(moving[3][1], neck_angles=np.full(3, neck)))
        assert after.known.keyframe is not None
        assert (after.known.keyframe.images is before.images) == stays
        assert after.keyframe_neck is not None
        np.testing.assert_array_equal(after.keyframe_neck, 0.0 if stays else neck)


def test_an_eye_that_sees_alone_corrects_its_readings_unless_the_neck_has_moved(moving):
    geometry = initial_seen_geometry(HEAD)
    for _, each in moving[:5]:
        geometry = update_geometry(geometry, each)
    dark = {**moving[5][1].images, "right_wide": np.full((480, 640, 3), 20, np.uint8)}
    covered = replace(moving[5][1], images=dark)
    found = update_geometry(geometry, covered)
    assert found.latest is not None
    assert found.latest.status == "little seen"
    assert found.known.frames == geometry.known.frames
    corrected = np.abs(found.latest.joints - covered.eye_angles) > 1e-9
    np.testing.assert_array_equal(corrected, [True, True, False, False])
    stds = np.sqrt(np.diag(found.latest.covariance)[-4:])
    assert (stds[:2] < 0.9 * stds[2:]).all()
    turned = update_geometry(geometry, replace(covered, neck_angles=np.full(3, np.radians(3))))
    assert turned.latest is not None
    np.testing.assert_array_equal(turned.latest.joints, covered.eye_angles)


def test_a_frame_that_showed_nothing_does_not_keep_the_next_from_teaching(moving):
    """A hand covers an eye while the eyes move, and is gone when they rest."""
    geometry = update_geometry(initial_seen_geometry(HEAD), moving[0][1])
    dark = {**moving[5][1].images, "right_wide": np.full((480, 640, 3), 20, np.uint8)}
    covered = update_geometry(geometry, replace(moving[5][1], images=dark))
    assert covered.known is geometry.known
    assert covered.learned_s == geometry.learned_s
    at_rest = replace(moving[5][1], time_s=moving[5][1].time_s + 1.0)
    assert update_geometry(covered, at_rest).known.frames == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: replace(f, images={}), "the frame has images of no camera"),
        (lambda f: replace(f, images={n: i[::2] for n, i in f.images.items()}), "640 x 240 px"),
        (lambda f: replace(f, eye_angles=np.zeros(2)), r"readings left_pan.*shape \(2,\)"),
        (lambda f: replace(f, eye_angles=np.full(4, np.nan)), "leave out frames without readings"),
    ],
)
def test_a_frame_that_cannot_be_used_is_refused(change, said, moving):
    with pytest.raises(VergenceError, match=said):
        update_geometry(initial_seen_geometry(HEAD), change(moving[0][1]))


def follow(geometry, seconds: float) -> tuple[float, list[GazeState]]:
    """Return the rms error [m] of single frames, and the states, for an object on a circle.

    The eyes use their wide cameras alone, which saves time.
    """
    middle, states, errors = point_at(0, 0, 0.6), [], []

    def path(time_s: float) -> Array:
        return middle + np.array([0.0, 0.1 * np.sin(3 * time_s), 0.05 * np.cos(3 * time_s)])

    def keep(state: GazeState, frame: Frame | None) -> None:
        states.append(state)
        if state.measured is not None:
            errors.append(np.linalg.norm(state.measured - path(state.frame_s)))

    head = RoomHead(path, joint_gain=GAIN, joint_noise_rad=NOISE_RAD)
    roles: dict[Side, EyeCameras] = {eye: EyeCameras(f"{eye}_wide", f"{eye}_wide") for eye in EYES}
    settings = GazeSettings(
        calibration=HEAD, roles=roles, geometry=geometry, joint_std_rad=NOISE_RAD
    )
    run_gaze(head, settings, initial_gaze_state(settings, np.zeros(7), 0.0), seconds, watch=keep)
    return float(np.sqrt(np.mean(np.square(errors)))), states


@pytest.mark.slow
def test_the_gaze_locates_better_by_what_it_sees_and_steers_as_before():
    (by_joints, before), (by_sight, after) = follow("joints", 0.35), follow("seen", 0.35)
    assert by_sight < by_joints / 3
    for one, other in zip(before, after, strict=True):
        assert one.phase is other.phase
        np.testing.assert_allclose(one.command.goal, other.command.goal, atol=2e-4)
    last = after[-1]
    assert last.geometry is not None
    assert last.geometry.known.frames > 0
    assert last.track is not None


def test_one_eye_cannot_see_the_geometry():
    with pytest.raises(VergenceError, match="needs both; the gaze uses the left eye only"):
        GazeSettings(calibration=one_eyed(), geometry="seen")


def test_recordings_show_the_matches_and_what_was_learned(moving, tmp_path):
    path, geometry = tmp_path / "seen.rrd", initial_seen_geometry(HEAD)
    before = geometry.known
    with figure_recording(path, FIGURES[7], HEAD, [], beside="learned", known=before) as rec:
        for k, (_, each) in enumerate(moving[:3]):
            geometry = update_geometry(geometry, each)
            assert geometry.latest is not None
            rec.set_time("sim_time", duration=each.time_s)
            rec.set_time("frame", sequence=k)
            log_matches(rec, HEAD, geometry.latest)
            log_learned(rec, HEAD, geometry.known)
    assert_valid(path)
    entity = "/world/right_eye/right_wide/matches"
    stream = RrdReader(path).stream().filter(content=entity, components="Points2D:positions")
    rows = [
        row
        for chunk in stream
        for row in chunk.to_record_batch().column("Points2D:positions").to_pylist()
    ]
    assert geometry.latest is not None
    assert len(rows) == 3
    np.testing.assert_allclose(rows[-1], geometry.latest.matches.right + 0.5, atol=1e-3)
    times, levels = read_series(path, "/learned/gain/left_pan")
    assert len(times) == 3
    std = 100 * np.sqrt(before.covariance.diagonal()[before.names.index("left.pan_gain")])
    np.testing.assert_allclose(levels[0], [0, std, -std], atol=1e-9)
    assert levels[-1][1] - levels[-1][0] < std
    _, focal = read_series(path, "/learned/focal/right_wide")
    true, learned = (h.camera("right_wide").intrinsics.matrix for h in (HEAD, geometry.known.head))
    assert focal[-1][0] == pytest.approx(100 * (learned[0, 0] / true[0, 0] - 1))


DESCRIPTION = Description(
    cameras={f"{eye}_wide": DatasetCamera(eye=eye, width=640, height=480) for eye in EYES},
    board=Chessboard(columns=9, rows=6, square_m=0.03),
    joints={name: DatasetJoint(column=name, unit="rad") for name in EYE_JOINTS},
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, moving):
    """A dataset of the moving eyes, and their calibration."""
    folder = tmp_path_factory.mktemp("recorded")
    rows = [DatasetRow(each, k, False) for k, (_, each) in enumerate(moving)]
    write_dataset(folder / "data", DESCRIPTION, rows)
    save_head(HEAD, folder / "head.json")
    return folder


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", "self-calibrate", *map(str, words)])
    cli.main()


def test_a_recording_says_what_it_shows_and_claims_no_more(recorded, monkeypatch, capsys):
    out, figures = recorded / "learned.json", recorded / "figures.json"
    words = recorded / "data", "--calibration", recorded / "head.json", "--out", out
    command(monkeypatch, *words, "--json", figures)
    said, found = capsys.readouterr().out, json.loads(figures.read_text())
    learned = load_head(out)
    assert learned.accuracy is not None
    assert (found["frames"], found["seen"], found["learned"]) == (10, 10, 9)
    assert found["depth_std_m"][1] < found["depth_std_m"][0] / 2
    assert "states no covariance" in said
    assert "observed" in said
    assert "Depth of a point 1 m straight ahead" in said
    for name, each in found["parameters"].items():
        std = float(np.sqrt(learned.accuracy.covariance.diagonal()[
            learned.accuracy.parameters.index(name)
        ]))  # fmt: skip
        assert each["std"] == pytest.approx(std)
        true = 1 / GAIN - 1 if name.endswith("gain") else 0.0
        assert abs(each["change"] - true) < 4 * std
    assert found["parameters"]["left.pan_gain"]["verdict"] == "observed"


def test_a_head_that_was_just_calibrated_is_better_known_before(recorded, monkeypatch, capsys):
    stds = {}
    for flags in ((), ("--fresh",)):
        out, figures = recorded / "again.json", recorded / "again_figures.json"
        words = recorded / "data", "--calibration", recorded / "head.json", "--out", out
        command(monkeypatch, *words, "--json", figures, *flags)
        found, said = json.loads(figures.read_text()), capsys.readouterr().out
        stds[flags] = {name: each["prior_std"] for name, each in found["parameters"].items()}
        assert ("what may have moved since" in said) == (not flags)
    assert all(stds[("--fresh",)][name] <= std for name, std in stds[()].items())
    assert stds[("--fresh",)]["left_wide.cx"] == pytest.approx(USUAL.centre_px, rel=1e-3)
    both = np.hypot(USUAL.centre_px, MOVED.centre_px)
    assert stds[()]["left_wide.cx"] == pytest.approx(both, rel=1e-3)


def test_eyes_that_do_not_move_show_nothing_that_persists(tmp_path, moving):
    _, one = moving[0]
    rows = [
        DatasetRow(replace(one, time_s=float(k), joint_time_s=float(k)), k, False) for k in range(3)
    ]
    write_dataset(tmp_path / "still", DESCRIPTION, rows)
    found = self_calibrate_dataset(load_dataset(tmp_path / "still"), HEAD)
    assert found.head is HEAD
    assert {each.verdict for each in found.parameters} == {"not observed"}
    assert any("did not move" in each for each in found.warnings)


def test_a_recording_in_which_one_eye_was_covered_returns_the_calibration(tmp_path, moving):
    dark = np.full((480, 640, 3), 20, np.uint8)
    rows = [
        DatasetRow(replace(each, images={**each.images, "right_wide": dark}), k, False)
        for k, (_, each) in enumerate(moving[:3])
    ]
    write_dataset(tmp_path / "covered", DESCRIPTION, rows)
    found = self_calibrate_dataset(load_dataset(tmp_path / "covered"), HEAD)
    assert found.head is HEAD
    assert found.learned == 0
    assert any("showed enough of the scene" in each for each in found.warnings)


def test_vergence_is_told_from_tilt_in_cameras_of_any_roll():
    joints = np.array([0.05, 0.1, -0.02, 0.1])
    turns = {name: pose(rotation([0, 0, np.radians(90)])) for name in WIDE}
    cameras = {
        name: replace(HEAD.camera(name), T_eye_cam=HEAD.camera(name).T_eye_cam @ turn)
        for name, turn in turns.items()
    }
    seen = SimpleNamespace(head=replace(HEAD, cameras=cameras), cameras=WIDE)
    at = [
        recorded_self_calibration._vergence(cast("Any", SimpleNamespace(**vars(seen), joints=each)))
        for each in (np.zeros(4), joints)
    ]
    assert abs(at[1] - at[0]) == pytest.approx(0.07, abs=0.005)


def test_a_head_that_is_not_as_calibrated_is_learned_anew(recorded):
    drawn = change_named(
        HEAD,
        ("left_wide.fx", "left_wide.fy", "left_wide.cx", "right_wide.cy", "T_rbase_lbase.ry"),
        np.array([-20.0, -20.0, 5.0, -5.0, np.radians(2.0)]),
    )
    data = load_dataset(recorded / "data")
    found = self_calibrate_dataset(data, drawn)
    straight = np.zeros(4)
    assert turn_error(found.head, straight, straight) < 0.1 * turn_error(drawn, straight, straight)
    assert any(
        "farther from its calibration than the stated covariance" in each for each in found.warnings
    )


def test_little_motion_in_parallel_is_said_to_show_little(tmp_path, slow_setup):
    rows = []
    for k, pan in enumerate(np.radians([0.0, 2.5, 5.0])):
        angles = np.array([pan, 0.0, pan, 0.0])
        rows.append(DatasetRow(frame(float(k), angles, angles), k, False))
    write_dataset(tmp_path / "little", DESCRIPTION, rows)
    found = self_calibrate_dataset(load_dataset(tmp_path / "little"), HEAD)
    assert any("moved in parallel, by 5.0 degrees" in each for each in found.warnings)


def one_eyed() -> HeadCalibration:
    return replace(HEAD, cameras={n: c for n, c in HEAD.cameras.items() if c.eye == "left"})


def other_names() -> HeadCalibration:
    cameras = {name.replace("wide", "main"): each for name, each in HEAD.cameras.items()}
    return replace(HEAD, cameras={n: c for n, c in cameras.items() if "main" in n})


def half_size() -> HeadCalibration:
    cameras = {
        name: replace(each, intrinsics=replace(each.intrinsics, width=320, height=240))
        for name, each in HEAD.cameras.items()
    }
    return replace(HEAD, cameras=cameras)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (one_eyed, "Stereo needs a camera in each eye"),
        (other_names, "The calibration's main cameras are left_main and right_main"),
        (half_size, "is for images of 320 x 240 px"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused(
    head, said, recorded, tmp_path, monkeypatch, capsys
):
    save_head(head(), tmp_path / "head.json")
    words = recorded / "data", "--calibration", tmp_path / "head.json", "--out", tmp_path / "x.json"
    with pytest.raises(SystemExit) as stop:
        command(monkeypatch, *words)
    assert stop.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()


def test_poses_and_other_readings_are_refused(recorded):
    data = load_dataset(recorded / "data")
    poses = replace(data, T_base_eye=np.tile(np.eye(4), (len(data), 2, 1, 1)))
    with pytest.raises(VergenceError, match="has poses of the eyes"):
        self_calibrate_dataset(poses, HEAD)
    joints: dict[Side, tuple[Joint, ...]] = {eye: tuple(shared_tilt(eye)) for eye in EYES}
    other = replace(HEAD, kinematics=Kinematics(joints, ("left_pan", "right_pan", "tilt")))
    with pytest.raises(VergenceError, match="is for the joint readings left_pan, right_pan, tilt;"):
        self_calibrate_dataset(data, other)


def shared_tilt(eye: Side) -> Iterator[Joint]:
    for joint in pan_tilt(eye):
        yield replace(joint, readings={"tilt": 1.0}) if joint.name == "tilt" else joint
