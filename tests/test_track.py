"""Tracking on the twin, with its physics and renders, and with the true calibration."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from postures import LIMITS
from rrd import read_series
from vergence.arrays import Array
from vergence.demos import track as module
from vergence.demos.experiment import Experiment
from vergence.demos.track import SPEED_M_S, follow, smooth_path, track
from vergence.errors import VergenceError
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import GazeSettings, initial_gaze_state
from vergence.twin.head import Twin
from vergence.twin.head_model import nominal_head
from vergence.twin.profile import ErrorProfile, load_profile
from vergence.twin.simulated_robot import FRAME_S, SimulatedHead, foveal_errors

LENSES = ("wide", "narrow")
SCENARIO = Path(__file__).parents[1] / "scenarios" / "gaze_demos.py"


@pytest.mark.parametrize("seed", range(3))
def test_paths_keep_to_their_space_and_come_to_the_stated_speed(seed: int):
    path = smooth_path(seed, 20.0)
    times = np.linspace(0, 20, 1001)
    points = np.array([path(t) for t in times])
    assert points[:, 0].min() >= 0.4
    assert points[:, 0].max() <= 1.0
    assert np.abs(np.arctan2(points[:, 1], points[:, 0])).max() <= 0.3
    speeds = np.linalg.norm(np.diff(points, axis=0), axis=1) / (times[1] - times[0])
    assert speeds.max() == pytest.approx(SPEED_M_S, rel=0.02)


@pytest.mark.render
@pytest.mark.usefixtures("coarse_images")
def test_a_moving_object_stays_on_both_foveas_and_is_found_again_after_it_was_hidden():
    with Twin(load_profile("paper"), seed=1) as twin:
        settings = GazeSettings(calibration=twin.truth, reading_std=2.6e-3)
        found = follow(twin, settings, 0, smooth_path(4, 3.0), 1.8, hidden_s=0.8)
    assert found.found_again
    assert found.in_both > 0.9
    assert found.rms_px < 32
    assert found.position_rms_m < found.single_frame_rms_m
    assert 0 < found.wide_rms_m < 0.1


@pytest.mark.render
@pytest.mark.usefixtures("coarse_images")
def test_a_gaze_shift_shared_with_the_neck_keeps_the_image_still():
    """A shift of nearly 60 degrees with the twin's heavy neck: below 20 px while it turns."""
    before, after = (0.9 * np.array([np.cos(a), np.sin(a), 0.1]) for a in np.radians([-26.0, 26.0]))
    seen: list[tuple[float, Array, Array]] = []
    with Twin(load_profile("ideal"), seed=1) as twin:
        settings = GazeSettings(calibration=twin.truth, use_neck=True)
        head = SimulatedHead(twin, 0, lambda t: before if t < 0.8 else after)

        def keep(*_: object) -> None:
            seen.append((twin.time_s, foveal_errors(twin, settings), twin.true_angles()))

        run_gaze(head, settings, initial_gaze_state(settings, np.zeros(7), 0.0), 2.0, watch=keep)
    times = np.array([t for t, _, _ in seen])
    errors, angles = np.array([e.max() for _, e, _ in seen]), np.array([a for _, _, a in seen])
    limits = LIMITS.range_rad
    assert (angles >= limits[:, 0] - 1e-3).all()
    assert (angles <= limits[:, 1] + 1e-3).all()
    turning = np.abs(np.gradient(angles[:, 2], times)) > 0.05
    for first, last in ((0.0, 0.8), (0.8, 2.1)):
        inside = (times >= first) & (times < last)
        reached = np.flatnonzero(inside & (errors < 10))[0]
        on_target = inside & (np.arange(len(times)) >= reached)
        assert (turning & on_target).sum() > 8
        assert errors[on_target].max() < 20
        assert errors[inside][-1] < 3
    assert np.degrees(np.ptp(angles[:, 2])) > 30


@pytest.mark.render
@pytest.mark.usefixtures("true_calibration", "coarse_images")
def test_the_scenario_shows_that_the_narrow_images_beat_the_wide_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """By Eq. 20 errors are inversely proportional to the focal lengths, for equal pixel errors."""
    monkeypatch.setattr(module, "SHORTEST_S", 1.0)
    runpy.run_path(str(SCENARIO))["track"](out=tmp_path, profile="ideal", seed=2, seconds=1.6)
    found = json.loads((tmp_path / "track.json").read_text())
    assert re.search(rf"images in \d+\.\d% of {found['frames']} fr", capsys.readouterr().out)
    assert found["frames"] > 15
    wide, narrow = (nominal_head("2.8mm").camera(f"left_{lens}").intrinsics for lens in LENSES)
    ratio = narrow.matrix[0, 0] / wide.matrix[0, 0]
    assert found["wide_rms_m"] > ratio * found["single_frame_rms_m"]
    times, _ = read_series(tmp_path / "track.rrd", "/position/x")
    np.testing.assert_allclose(times, FRAME_S * np.arange(49), atol=1e-9)


@pytest.mark.parametrize(("seconds", "seed"), [(0.0, 0), (1e9, 0), (10.0, -1)])
def test_arguments_out_of_range_are_refused(seconds: float, seed: int):
    with pytest.raises(VergenceError, match=r"A run takes|The seed"):
        track(Experiment(ErrorProfile(), seed), seconds=seconds)
