"""Foveation on the twin, in short runs and with the true calibration."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from rrd import read_series
from vergence.demos.experiment import Experiment
from vergence.demos.foveate import Trial, foveate, run_trial, summary, targets
from vergence.errors import VergenceError
from vergence.gaze.state import GazeSettings
from vergence.geometry.head import base_pose
from vergence.geometry.se3 import inverse, transform
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile, load_profile
from vergence.twin.simulated_robot import FRAME_S, unoccluded

SCENARIO = Path(__file__).parents[1] / "scenarios" / "gaze_demos.py"


def test_targets_fill_the_stated_space_and_follow_the_seed():
    where = targets(500, 3)
    pan, tilt = np.arctan2(where[:, 1], where[:, 0]), np.arctan2(-where[:, 2], where[:, 0])
    for angle in (pan, tilt):
        assert np.abs(angle).max() <= np.radians(20)
        assert np.abs(angle).max() > np.radians(19)
    assert where[:, 0].min() > 0.3
    assert where[:, 0].max() < 1.5
    np.testing.assert_array_equal(targets(500, 3), where)
    np.testing.assert_array_equal(targets(5, 3).shape, (5, 3))


def test_occluded_places_are_drawn_again_and_the_others_stay():
    before = targets(50, 3)
    after = targets(50, 3, free=lambda places: places[:, 0] < 1.2)
    assert (after[:, 0] < 1.2).all()
    kept = before[:, 0] < 1.2
    np.testing.assert_array_equal(after[kept], before[kept])


@pytest.mark.render
def test_furniture_occludes_the_places_behind_it():
    with Twin(ErrorProfile()) as twin:
        box = transform(inverse(twin.T_world_lbase()), np.array([1.52, 0.12, 0.78]))
        beyond, before, beside = 1.2 * box, 0.5 * box, box + np.array([0, 0.5, 0.3])
        places_lbase = np.array([box, beyond, before, beside])
        places = transform(base_pose(twin.truth, "left"), places_lbase)
        seen = unoccluded(twin, places, margin_m=0.02)
    assert seen.tolist() == [False, False, True, True]


@pytest.mark.render
@pytest.mark.usefixtures("coarse_images")
@pytest.mark.parametrize(("profile", "worst_px", "number"), [("ideal", 1.0, 0), ("paper", 15.0, 1)])
def test_an_object_that_appears_comes_to_the_centre_of_both_foveas(
    profile: str, worst_px: float, number: int
):
    with Twin(load_profile(profile), seed=1) as twin:
        settings = GazeSettings(calibration=twin.truth, reading_std=2.6e-3)
        trial = run_trial(twin, settings, number, targets(2, 7)[number])
    assert not trial.lost
    assert trial.time_s[-1] <= 0.5
    assert trial.final_px < worst_px
    assert trial.errors_px[0].max() > 10


def made(*errors: float, lost: bool = False) -> Trial:
    both = np.array([[error, 0.0] for error in errors])
    return Trial(0.1 * np.arange(len(errors)), both, lost)


def test_a_trial_settles_when_it_stays_within_the_bound():
    assert made(300, 5, 20, 3, 1).settle_s == pytest.approx(0.3)
    assert made(2, 1).settle_s == 0
    assert made(2, 9).settle_s == np.inf
    assert made(2, np.inf).settle_s == np.inf


def test_the_summary_counts_the_worse_eye():
    found = summary([made(100, 2.0), made(100, 4.0), made(100, 50.0, lost=True)])
    assert (found.trials, found.median_px, found.p95_px, found.lost) == (3, 4.0, 50.0, 1)
    assert found.settle_s_p95 is None


@pytest.mark.render
@pytest.mark.usefixtures("true_calibration", "coarse_images")
def test_the_scenario_prints_writes_and_records_what_it_found(tmp_path: Path, capsys):
    runpy.run_path(str(SCENARIO))["foveate"](out=tmp_path / "new", trials=1)
    assert re.search(r"distance from the centre: median 0\.\d\d px", capsys.readouterr().out)
    written = json.loads((tmp_path / "new" / "foveate.json").read_text())
    assert list(written) == ["trials", "median_px", "p95_px", "settle_s_p95", "lost"]
    assert written["trials"] == 1
    times, left = read_series(tmp_path / "new" / "foveate.rrd", "/gaze_error/left")
    _, right = read_series(tmp_path / "new" / "foveate.rrd", "/gaze_error/right")
    np.testing.assert_allclose(times, FRAME_S * np.arange(len(times)), atol=1e-9)
    assert written["median_px"] == max(left[-1], right[-1])
    assert (tmp_path / "new" / "depth.png").is_file()


@pytest.mark.parametrize(("trials", "seed"), [(0, 0), (-3, 0), (20_000, 0), (1, -1)])
def test_arguments_out_of_range_are_refused(trials: int, seed: int):
    with pytest.raises(VergenceError, match=r"Asked for|The seed"):
        foveate(Experiment(ErrorProfile(), seed), trials=trials)
