"""The geometry that both eyes see, frame after frame: for the gaze, for depth, for recordings."""

from dataclasses import replace

import numpy as np
import pytest
from rerun.chunk import RrdReader

from drawn_head import point_at
from drawn_room import RoomHead
from moving_frames import GAIN, HEAD, NOISE_RAD, frames, one_eyed, turn_error
from rrd import assert_valid, read_series
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import EyeCameras, GazeSettings, GazeState, initial_gaze_state
from vergence.geometry.kinematics import EYES, Side
from vergence.paper.figures import FIGURES
from vergence.paper.recording import figure_recording
from vergence.self_calibration.calibrator import UPDATE_S, initial_visual_geometry, update_geometry
from vergence.self_calibration.keyframe import TURNED_RAD
from vergence.viewer.seen import log_learned, log_matches


@pytest.fixture(scope="module")
def moving(slow_setup: None) -> list[tuple[Array, Frame]]:
    return frames(10)


def test_every_frame_is_better_than_the_readings_and_teaches_the_next(moving):
    geometry = initial_visual_geometry(HEAD)
    by_readings, by_sight = [], []
    for angles, each in moving:
        geometry = update_geometry(geometry, each)
        assert geometry.latest is not None
        by_readings.append(turn_error(HEAD, each.eye_angles, angles))
        by_sight.append(turn_error(geometry.latest.head, geometry.latest.joints, angles))
    assert geometry.state.frames == len(moving) - 1  # the first shows where the eyes begin
    assert np.mean(by_sight) < np.mean(by_readings) / 3
    assert geometry.state.reading_std == pytest.approx(NOISE_RAD, rel=0.4)


def test_frames_that_show_the_same_again_teach_nothing(moving):
    """Those that follow too closely, and those of eyes at rest."""
    (_, first), (_, second), *_ = moving
    once = update_geometry(initial_visual_geometry(HEAD), first)
    assert once.state.frames == 0
    close = update_geometry(once, replace(second, time_s=first.time_s + UPDATE_S / 3))
    at_rest = update_geometry(once, replace(first, time_s=first.time_s + 5.0))
    for again in (close, at_rest):
        assert again.state.frames == 0
        assert again.latest is not once.latest
    assert update_geometry(once, second).state.frames == 1
    earlier = update_geometry(once, replace(second, time_s=-100.0))  # of another run
    assert (np.diag(earlier.state.covariance) < np.diag(once.state.covariance) * 1.001).all()


def test_features_are_not_tracked_across_a_motion_of_the_neck(moving):
    geometry = initial_visual_geometry(HEAD)
    for _, each in moving[:3]:
        geometry = update_geometry(geometry, each)
    before = geometry.state.keyframe
    assert before is not None
    assert np.abs(moving[3][1].eye_angles - before.joints).max() < TURNED_RAD
    for neck, stays in ((0.0, True), (np.radians(3), False)):
        after = update_geometry(geometry, replace(moving[3][1], neck_angles=np.full(3, neck)))
        assert after.state.keyframe is not None
        assert (after.state.keyframe.images is before.images) == stays
        assert after.keyframe_neck is not None
        np.testing.assert_array_equal(after.keyframe_neck, 0.0 if stays else neck)


def test_a_frame_that_showed_nothing_does_not_keep_the_next_from_teaching(moving):
    """A hand covers an eye while the eyes move, and is gone when they rest."""
    geometry = update_geometry(initial_visual_geometry(HEAD), moving[0][1])
    dark = {**moving[5][1].images, "right_wide": np.full((480, 640, 3), 20, np.uint8)}
    covered = update_geometry(geometry, replace(moving[5][1], images=dark))
    assert covered.state.frames == geometry.state.frames
    assert covered.updated_s == geometry.updated_s
    assert covered.latest is not None
    assert covered.latest.status == "little seen"
    np.testing.assert_array_equal(covered.latest.joints, moving[5][1].eye_angles)
    at_rest = replace(moving[5][1], time_s=moving[5][1].time_s + 1.0)
    assert update_geometry(covered, at_rest).state.frames == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: replace(f, images={}), "the frame has images of no camera"),
        (lambda f: replace(f, images={n: i[::2] for n, i in f.images.items()}), "640 x 240 px"),
        (lambda f: replace(f, images=dict.fromkeys(f.images)), "found None: the file was not read"),
        (lambda f: replace(f, images={n: i / 255 for n, i in f.images.items()}), "of float64"),
        (lambda f: replace(f, time_s=np.nan), "found nan"),
        (lambda f: replace(f, neck_angles=np.full(3, np.nan)), "nan"),
        (lambda f: replace(f, eye_angles=np.zeros(2)), r"readings left_pan.*shape \(2,\)"),
        (lambda f: replace(f, eye_angles=np.full(4, np.nan)), "leave out frames without readings"),
    ],
)
def test_a_frame_that_cannot_be_used_is_refused(change, said, moving):
    with pytest.raises(VergenceError, match=said):
        update_geometry(initial_visual_geometry(HEAD), change(moving[0][1]))


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
    settings = GazeSettings(calibration=HEAD, roles=roles, geometry=geometry, reading_std=NOISE_RAD)
    run_gaze(head, settings, initial_gaze_state(settings, np.zeros(7), 0.0), seconds, watch=keep)
    return float(np.sqrt(np.mean(np.square(errors)))), states


@pytest.mark.slow
def test_the_gaze_locates_better_by_what_it_sees_and_steers_as_before():
    (by_joints, before), (by_sight, after) = follow("joints", 0.35), follow("seen", 0.35)
    assert by_sight < by_joints / 3
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one.command.goal, other.command.goal, atol=5e-4)
    assert [one.phase for one in before[2:]] == [other.phase for other in after[2:]]
    last = after[-1]
    assert last.geometry is not None
    assert last.geometry.state.frames > 0
    assert last.track is not None


def test_one_eye_cannot_see_the_geometry():
    with pytest.raises(VergenceError, match="images of both eyes; the gaze uses the left eye"):
        GazeSettings(calibration=one_eyed(), geometry="seen")


def test_recordings_show_the_matches_and_what_was_learned(moving, tmp_path):
    path, geometry = tmp_path / "seen.rrd", initial_visual_geometry(HEAD)
    before = geometry.state
    with figure_recording(path, FIGURES[7], HEAD, [], beside="learned", known=before) as rec:
        for k, (_, each) in enumerate(moving[:3]):
            geometry = update_geometry(geometry, each)
            assert geometry.latest is not None
            rec.set_time("sim_time", duration=each.time_s)
            rec.set_time("frame", sequence=k)
            log_matches(rec, HEAD, geometry.latest)
            log_learned(rec, HEAD, geometry.state)
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
    true, learned = (h.camera("right_wide").intrinsics.matrix for h in (HEAD, geometry.state.head))
    assert focal[-1][0] == pytest.approx(100 * (learned[0, 0] / true[0, 0] - 1))


def test_what_a_driver_writes_into_its_images_later_does_not_reach_the_keyframe(moving):
    geometry = initial_visual_geometry(HEAD)
    grey = [
        replace(each, images={name: image[..., 0] for name, image in each.images.items()})
        for _, each in moving[:2]
    ]
    for each in grey:
        geometry = update_geometry(geometry, each)
    key = geometry.state.keyframe
    assert key is not None
    assert key.images is not None
    before = key.images[0].copy()
    for image in grey[1].images.values():
        image[:] = 0
    np.testing.assert_array_equal(key.images[0], before)


def test_a_change_is_reported_once(moving):
    geometry = update_geometry(initial_visual_geometry(HEAD), moving[0][1])
    reported = replace(geometry, state=replace(geometry.state, change="camera turned"))
    at_rest = update_geometry(reported, moving[0][1]).state
    assert at_rest.change is None


def test_a_frame_without_a_time_is_refused(moving):
    geometry = update_geometry(initial_visual_geometry(HEAD), moving[0][1])
    with pytest.raises(VergenceError, match="found nan"):
        update_geometry(geometry, replace(moving[1][1], time_s=np.nan))
