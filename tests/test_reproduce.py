"""The main job: statistics of the figures on rendered images, recordings, repeatability."""

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rrd import assert_valid, read_series
from simulated_twin import observe_points, simulate_views
from vergence import cli
from vergence.accuracy.motions import PERIOD_S
from vergence.calibration.initial import calibrate_sequentially
from vergence.files import UNFINISHED
from vergence.geometry.head import load_head
from vergence.paper import reproduce as main_job
from vergence.paper.figures import FIGURES, Lens
from vergence.paper.replay import describe, estimate, sample_times
from vergence.paper.reproduce import ReproductionSettings, reproduce
from vergence.twin import simulated_robot
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import Shot, plan
from vergence.twin.head_model import nominal_head
from vergence.twin.model import as_built_head
from vergence.twin.profile import load_profile

PAPER_STD = np.array([figure.std_m for figure in FIGURES.values()])


@cache
def planned(lens: Lens, seed: int) -> list[Shot]:
    return plan(nominal_head(lens), seed)


def point_level(profile_name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standard deviations (6, 3) and errors of the mean (6, 3) [m] without images.

    The noise of corners and object is more than their detectors have on this twin's images.
    """
    profile = load_profile(profile_name)
    std, error = [], []
    for lens in ("2.8mm", "4.0mm"):
        truth = as_built_head(nominal_head(lens), profile, seed)
        rng = np.random.default_rng(seed)
        views = simulate_views(truth, profile, planned(lens, seed), pixel_noise=0.035, rng=rng)
        head = inject_calibration_error(calibrate_sequentially(views).head, profile.by_hand)
        for figure in FIGURES.values():
            if figure.lens == lens:
                times = sample_times(figure, None, None)
                seen = observe_points(truth, profile, figure, times, pixel_noise=0.03, rng=rng)
                ours = estimate(head, figure, seen).statistics
                std.append(ours.std_m)
                error.append(ours.mean_m - figure.mean_m)
    return np.array(std), np.array(error)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_one_set_of_sources_gives_the_spreads_of_all_six_figures(seed):
    std, error = point_level("paper", seed)
    ratio = std / PAPER_STD
    assert np.exp(np.abs(np.log(ratio))).max() < 1.5
    assert (np.abs(ratio - 1) <= 0.25).sum() >= 11
    assert np.abs(ratio[:, 0] - 1).max() < 0.27
    assert (np.abs(error[:, 0]) < 2 * std[:, 0]).all()
    assert (np.linalg.norm(error[:, 1:], axis=1) < 0.010).all()


def test_the_profile_paper_names_its_fitted_numbers():
    profile = load_profile("paper")
    assert 0 < len(profile.fitted) <= 6
    values = json.dumps(profile.model_dump(exclude={"fitted"}))
    for fitted in profile.fitted:
        assert str(fitted.value) in values, f"{fitted.name} is not what the profile says"


@pytest.mark.slow
def test_noise_alone_makes_divergent_motion_no_worse_than_parallel():
    """The paper's ratios are 2.0, 1.55 and 1.53."""
    depth = np.mean([point_level("noise-only", seed)[0][:, 0] for seed in range(2)], axis=0)
    np.testing.assert_allclose(depth[1::2] / depth[::2], 1, atol=0.10)


@pytest.fixture(scope="module")
def run(tmp_path_factory, opengl: None) -> Path:
    """Figs. 6 and 7 over all their postures, coarsely sampled, on rendered images.

    Half the divergent motion's period, which is five of the parallel one's: in the other half it
    goes back the same way. The calibration has a sixth of its views, and most samples only the
    images that are needed.
    """
    out, half = tmp_path_factory.mktemp("paper"), PERIOD_S["divergent"] / 2
    short = {"duration_s": half, "rate_hz": 0.25}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plan.__kwdefaults__, "views", (4, 3, 8))
        patch.setattr(main_job, "SAMPLES_WITH_IMAGES", 4)
        reproduce(ReproductionSettings(out, (7, 6), load_profile("paper"), **short))
    return out


def statistics(folder: Path) -> dict:
    return json.loads((folder / "statistics.json").read_text())


def test_rendered_spreads_are_those_of_the_paper(run):
    """At 24 samples; a spread is then known to 15 %."""
    figures = statistics(run)["figures"]
    assert list(figures) == ["6", "7"]
    for found in figures.values():
        std, paper = np.array(found["std_m"]), np.array(found["paper_std_m"])
        assert np.exp(np.abs(np.log(std / paper))).max() < 1.6
        assert abs(std[0] / paper[0] - 1) < 0.35
        error = np.array(found["mean_m"]) - found["object_m"]
        assert abs(error[0]) < 2 * std[0]
        assert np.hypot(*error[1:]) < 0.010
        assert (found["samples"], found["dropped"]) == (24, 0)


def test_recordings_are_valid_and_hold_the_statistics(run):
    assert_valid(*sorted(run.glob("*.rrd")))
    report = (run / "report.md").read_text()
    assert "6 of its numbers were fitted" in report
    for number, found in statistics(run)["figures"].items():
        path = run / f"fig{int(number):02d}.rrd"
        series = [read_series(path, f"/estimate/{axis}")[1] for axis in "xyz"]
        ours = describe(np.stack(series, axis=-1))
        assert ours.mean_m.tolist() == found["mean_m"]
        assert ours.std_m.tolist() == found["std_m"]
        assert ours.samples == found["samples"]
        assert " / ".join(f"{std:.4f}" for std in found["std_m"]) in report


@pytest.fixture
def simulated_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calibrate the head of seed 0 with simulated views of the board, which take no rendering."""
    profile, rng = load_profile("paper"), np.random.default_rng(0)
    head = as_built_head(nominal_head("2.8mm"), profile, 0)
    views = simulate_views(head, profile, planned("2.8mm", 0), pixel_noise=0.03, rng=rng)
    found = calibrate_sequentially(views)
    monkeypatch.setattr(main_job, "paper_calibration", lambda *_, **__: found)


@pytest.mark.usefixtures("simulated_views", "coarse_images")
@pytest.mark.render
def test_methods_are_compared_on_the_same_images(tmp_path, monkeypatch):
    monkeypatch.setattr(simulated_robot, "LOOK_S", 0.6)
    profile = load_profile("paper")
    settings = ReproductionSettings(tmp_path / "paper", (7,), profile, duration_s=9, rate_hz=1)
    reproduce(settings)
    every = {"method": "self-calibrated", "compare": True, "floor": True}
    reproduce(replace(settings, out=tmp_path / "all", **every))
    paper, found = (statistics(tmp_path / name) for name in ("paper", "all"))
    assert "methods" not in paper
    methods = {name: each["figures"]["7"] for name, each in found["methods"].items()}
    assert list(methods) == ["paper", "single-frame", "learned", "floor"]
    assert methods["paper"] == paper["figures"]["7"]
    assert found["figures"]["7"] == methods["learned"]
    depth = {name: each["std_m"][0] for name, each in methods.items()}
    assert depth["floor"] < depth["learned"] < depth["paper"] / 3
    assert "## Methods compared" in (tmp_path / "all" / "report.md").read_text()
    assert load_head(tmp_path / "all" / "fig07-learned.json").accuracy is not None
    recording = tmp_path / "all" / "fig07.rrd"
    assert_valid(recording)
    beside = read_series(recording, "/beside/x")[1]
    assert np.std(beside, ddof=1) == pytest.approx(depth["paper"])
    assert len(read_series(recording, "/learned/gain/right_pan")[1]) == 9


@pytest.mark.usefixtures("simulated_views")  # processes beside know nothing of coarse images
@pytest.mark.render
def test_figures_are_the_same_one_after_another_and_in_processes_of_their_own(tmp_path):
    turns, beside = (tmp_path / name for name in ("turns", "beside"))
    profile, short = load_profile("paper"), {"duration_s": 1, "rate_hz": 2}
    settings = ReproductionSettings(turns, (6, 7), profile, seed=1, **short)
    reproduce(settings)
    reproduce(replace(settings, out=beside), jobs=2)
    for name in ("statistics.json", "report.md", "figures.png", "calibration-2.8mm.json"):
        assert (turns / name).read_bytes() == (beside / name).read_bytes()
    assert {path.name for path in turns.iterdir()} == {path.name for path in beside.iterdir()}
    assert_valid(beside / "fig07.rrd")


@pytest.mark.usefixtures("coarse_images")
@pytest.mark.render
def test_a_seed_gives_its_digits_even_if_interrupted_and_another_seed_others(tmp_path, monkeypatch):
    def interrupted(twin, believed, figure, *args, **kwargs):
        if figure.number == 7:
            raise KeyboardInterrupt
        return replay(twin, believed, figure, *args, **kwargs)

    monkeypatch.setitem(plan.__kwdefaults__, "views", (3, 3, 3))
    replay, shown = main_job.replay, {}
    alone, partly, other = (tmp_path / name for name in ("alone", "partly", "other"))
    profile, short = load_profile("paper"), {"duration_s": 1, "rate_hz": 3}
    settings = ReproductionSettings(alone, (6,), profile, seed=1, **short)
    reproduce(settings)

    def progress(task: str, done: int, total: int) -> None:
        shown[task] = done, total

    with monkeypatch.context() as patch:
        patch.setattr(main_job, "replay", interrupted)
        with pytest.raises(KeyboardInterrupt):
            reproduce(replace(settings, out=partly, figures=(6, 7)), progress=progress)
    arguments = "--figures 6 --duration 1 --rate 3 --seed 2 --profile paper --out"
    monkeypatch.setattr(sys, "argv", ["vergence", "reproduce", *arguments.split(), str(other)])
    cli.main()

    first, again, another = (statistics(folder) for folder in (alone, partly, other))
    assert first == again
    assert list(first["figures"]) == ["6"]
    assert (first["seed"], another["seed"]) == (1, 2)
    assert (another["profile"], another["fitted_parameters"]) == ("paper", 6)
    assert first["figures"]["6"]["std_m"] != another["figures"]["6"]["std_m"]
    assert list(shown) == ["calibrating, 2.8mm lens", "figure 6, parallel"]
    assert all(done == total > 0 for done, total in shown.values())
    times, values = read_series(partly / "fig06.rrd", "/estimate/x")
    assert len(times) == len(values) == 3
    for folder, mark in ((partly, {UNFINISHED}), (other, set())):
        assert {path.name for path in folder.iterdir()} == mark | {
            *("calibration-2.8mm.json", "fig06.rrd", "figures.png"),
            *("report.md", "statistics.json"),
        }
