"""The recording of the gaze: what the controller said and what was true, read back."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from rrd import assert_valid, read_series
from vergence.data.dataset import Frame
from vergence.demos.experiment import Experiment, recorded
from vergence.gaze.controller import run_gaze
from vergence.gaze.foveation import ideal_wide_pixel
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.simulated_robot import FRAME_S, SimulatedHead, foveal_errors
from vergence.viewer.gaze import aims

TARGET = np.array([0.6, 0.05, -0.1])
HIDDEN_S = 0.2
HAND = np.array([0.3, 0.0, -0.2])


@dataclass(frozen=True, eq=False)
class Recorded:
    path: Path
    settings: GazeSettings
    states: list[GazeState]
    frames: list[Frame]
    errors: np.ndarray
    """(N, 2) px."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, opengl: None) -> Recorded:
    """Two runs of a quarter of a second; in the second the object is hidden at the end."""
    path = tmp_path_factory.mktemp("gaze") / "gaze.rrd"
    states: list[GazeState] = []
    frames: list[Frame] = []
    errors: list[np.ndarray] = []
    with Twin(ErrorProfile(), seed=0) as twin:
        settings = GazeSettings(calibration=twin.truth)
        experiment = Experiment(twin.profile, out=path.parent)
        with recorded(experiment, "gaze", twin, settings, reach_m=1.0) as (watch, _):
            for run in (0, 1):

                def path_of(t: float, run=run) -> np.ndarray | None:
                    return TARGET if run == 0 or t < HIDDEN_S else None

                def keep(state: GazeState, frame: Frame | None, run=run) -> None:
                    watch(state, frame, {"run": f"{run}"}, HAND)
                    assert frame is not None
                    states.append(state)
                    frames.append(frame)
                    errors.append(foveal_errors(twin, settings))

                head = SimulatedHead(twin, run, path_of, all_cameras_every=4)
                begin = initial_gaze_state(settings, np.zeros(7), 0.0)
                run_gaze(head, settings, begin, 0.25, watch=keep)
    return Recorded(path, settings, states, frames, np.array(errors))


def texts(path: Path, entity: str) -> list[str]:
    rows = []
    for chunk in RrdReader(path).stream().filter(content=entity, has_timeline="sim_time"):
        batch = chunk.to_record_batch()
        rows += zip(
            batch.column("sim_time").cast("int64").to_pylist(),
            batch.column("StateChange:state").to_pylist(),
            strict=True,
        )
    return [state for _, (state,) in sorted(rows)]


def test_it_passes_the_viewers_own_check_and_brings_its_layout(made: Recorded):
    assert_valid(made.path)


def test_runs_follow_each_other_on_one_timeline(made: Recorded):
    times, numbers = read_series(made.path, "/gaze_error/left")
    each = len(times) // 2
    assert len(times) == len(made.frames) == len(numbers)
    assert (np.diff(times) > 0).all()
    assert times[each] - times[each - 1] == pytest.approx(FRAME_S)
    assert texts(made.path, "/doing/run") == ["0", "1"]


def test_phases_are_logged_when_they_change(made: Recorded):
    phases = [state.phase.value for state in made.states]
    changes = [b for a, b in zip([None, *phases], phases, strict=False) if a != b]
    assert texts(made.path, "/doing/gaze") == changes
    assert "saccade" in changes


def test_errors_estimates_and_joints_come_back_to_the_last_digit(made: Recorded):
    half = slice(0, len(made.frames) // 2)  # in which the object is not hidden
    for k, eye in enumerate(("left", "right")):
        _, errors = read_series(made.path, f"/gaze_error/{eye}")
        np.testing.assert_array_equal(errors[half], made.errors[half, k])
    _, x = read_series(made.path, "/position/x")
    tracks = [np.nan if s.track is None else s.track.position[0] for s in made.states]
    np.testing.assert_array_equal(x, tracks)
    _, pan = read_series(made.path, "/eyes/right_pan")
    np.testing.assert_array_equal(pan, [frame.eye_angles[2] for frame in made.frames])
    _, sent = read_series(made.path, "/eyes/command_right_pan")
    assert np.abs(sent - pan).max() < 0.3
    _, hand = read_series(made.path, "/world/gaze/hand_trail", component="Points3D:positions")
    np.testing.assert_allclose(hand, np.tile(HAND, (len(made.frames), 1)), atol=1e-6)


def test_the_estimate_is_near_the_truth_and_the_truth_is_unknown_while_it_is_hidden(made):
    _, error_mm = read_series(made.path, "/error/fused")
    times, truth = read_series(made.path, "/position/true_x")
    assert np.nanmax(error_mm) < 5
    last = times > times[-1] - (0.25 - HIDDEN_S)
    assert np.isnan(truth[last]).any()
    assert np.isfinite(truth[: len(times) // 2]).all()


def test_aims_are_the_centres_of_the_narrow_images_and_the_ideal_places_in_the_wide_ones(made):
    k = len(made.frames) // 2 - 1
    state, frame, head = made.states[k], made.frames[k], made.settings.calibration
    found = aims(made.settings, state, frame)
    np.testing.assert_array_equal(
        found["left_narrow"], head.camera("left_narrow").intrinsics.matrix[:2, 2]
    )
    strips = read_series(made.path, "/world/gaze/axes", component="LineStrips3D:strips")[1]
    depth = np.linalg.norm(strips[k, 0, 1] - strips[k, 0, 0])  # the object is on the axis by now
    np.testing.assert_allclose(found["left_wide"], ideal_wide_pixel(head, "left", depth), atol=0.05)
    unknown = aims(made.settings, initial_gaze_state(made.settings, np.zeros(7), 0.0), frame)
    np.testing.assert_array_equal(unknown["right_wide"], ideal_wide_pixel(head, "right", np.inf))


def test_images_are_recorded_of_frames_that_have_them_of_all_cameras(made: Recorded):
    for camera in ("left_eye/left_wide", "right_eye/right_narrow"):
        times, _ = read_series(
            made.path, f"/world/{camera}/image", component="EncodedImage:media_type"
        )
        assert len(times) == sum(len(frame.images) == 4 for frame in made.frames)
        assert len(times) < len(made.frames)


@pytest.mark.render
def test_looking_on_changes_nothing(made: Recorded):
    with Twin(ErrorProfile(), seed=0) as twin:
        head = SimulatedHead(twin, 0, lambda _: TARGET, all_cameras_every=4)
        begin = initial_gaze_state(made.settings, np.zeros(7), 0.0)
        alone = run_gaze(head, made.settings, begin, 0.25).track
    recorded_track = made.states[len(made.states) // 2 - 1].track
    assert alone is not None
    assert recorded_track is not None
    np.testing.assert_array_equal(alone.mean, recorded_track.mean)
