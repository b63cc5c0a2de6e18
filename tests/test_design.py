"""Designs of a head: the closed form is that of located points, and sweeps can be stopped."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from documents import blocks
from simulated_head import plain_head
from vergence import cli
from vergence.accuracy.design import gaze_at, joint_std_rad, mean_square, sensitivity
from vergence.accuracy.design_effort import (
    VIEWS,
    calibration_mean_square,
    designed_head,
    standard_recording,
)
from vergence.accuracy.design_settings import (
    AXES,
    Designs,
    DesignSettings,
    chunks,
    costs,
    load_settings,
)
from vergence.accuracy.design_sweep import (
    SOURCES,
    at_distance,
    by_source,
    cheapest,
    combinations,
    compute_chunk,
    located_points,
    most_accurate,
    values_of,
)
from vergence.accuracy.plan_views import as_seen, held_whole
from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import bundle_adjust
from vergence.commands import design_chunks as command
from vergence.commands.design_chunks import sweep
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard
from vergence.geometry.head import HeadCalibration
from vergence.geometry.projection import project_point
from vergence.stereo.depth_error import predicted_depth_std
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate

AHEAD_M = 0.02
SMALL = DesignSettings.model_validate(
    {
        "designs": {
            "baseline_mm": [60, 90],
            "focal_px": [300, 450],
            "square_mm": 30,
            "views": [20, 40],
            "counts_per_turn": [4096, 0],
            "joint_noise_deg": [0.02, 0.1],
            "pixel_noise_px": [0.1, 0.5],
            "delay_ms": [0, 5],
        },
        "workspace": {"distances_m": [0.5, 1.0], "pan_deg": [-15, 0, 15], "tilt_deg": 0},
    }
)


def of_design(baseline_m: float, focal_px: float) -> HeadCalibration:
    return plain_head(baseline_m, focal_px, camera_m=((AHEAD_M, 0, 0),) * 2)


def pixels(head: HeadCalibration, joints: Array, points: Array, baseline_m: float) -> list[Array]:
    """Return the pixels of points from the middle between the eyes."""
    from_left = points - [0.0, baseline_m / 2, 0.0]
    return [project_point(head, name, joints, from_left) for name in head.cameras]


@given(
    baseline_m=st.floats(0.03, 0.3),
    focal_px=st.floats(200, 2000),
    x=st.floats(0.25, 3),
    aside=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.4, 0.4)),
    off=st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15)),
    noise=st.tuples(st.floats(0.01, 2), st.floats(1e-5, 5e-3)),
)
def test_the_closed_form_is_the_covariance_of_a_located_point(
    baseline_m, focal_px, x, aside, off, noise
):
    point = np.array([[x, x * aside[0], x * aside[1]]])
    head, off_rad = of_design(baseline_m, focal_px), np.array(off)
    joints = np.stack(gaze_at(np.array(baseline_m), point), axis=-1) + np.tile(off_rad, 2)
    left, right = pixels(head, joints, point, baseline_m)
    located = locate(
        head, left=left, right=right, joints=joints, pixel_std_px=noise[0], joint_std_rad=noise[1]
    )
    seen = sensitivity(baseline_m, point, camera_ahead_m=AHEAD_M, off_rad=off_rad)
    found = mean_square(seen, focal_px=focal_px, pixel_std_px=noise[0], joint_std_rad=noise[1])
    np.testing.assert_allclose(found[0], np.trace(located.covariance[0]), rtol=0.01)
    pinned = np.array([[319.5, 239.5]])
    reach = max(np.abs((uv - pinned) / focal_px)[0, 0] for uv in (left, right))
    np.testing.assert_allclose(seen.image_x[0], reach, rtol=1e-9, atol=1e-9)


def test_far_ahead_it_is_equations_20_and_21():
    """Depth and baseline of these are those of the cameras, which sit ahead of eyes that converge.

    Errors sideways add less than half a percent.
    """
    for depth_m in (1.0, 3.0):
        point = np.array([depth_m, 0.0, 0.0])
        seen = sensitivity(0.07, point, camera_ahead_m=AHEAD_M)
        found = np.sqrt(mean_square(seen, focal_px=400, pixel_std_px=0.2, joint_std_rad=3e-4))
        closer = 2 * AHEAD_M * np.sin(np.arctan(0.035 / depth_m))
        wanted = predicted_depth_std(
            depth_m - AHEAD_M, 0.07 - closer, 400, pixel_std_px=0.2, joint_std_rad=3e-4,
            camera_ahead_m=AHEAD_M,
        )  # fmt: skip
        assert found == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("correlation", [-1.0, 0.0, 0.6, 1.0])
def test_samples_of_late_readings_scatter_as_stated(correlation):
    """Errors of the same joint in both eyes are correlated as the eyes' speeds are."""
    rng, n, late_rad, baseline_m = np.random.default_rng(1), 20_000, 5e-4, 0.09
    point, head = np.array([0.6, 0.15, -0.1]), of_design(0.09, 400)
    joints = np.array(gaze_at(np.array(baseline_m), point))
    left, right = pixels(head, joints, point, baseline_m)
    own, other = rng.normal(0, late_rad, (2, n, 2))
    right_error = correlation * own + np.sqrt(1 - correlation**2) * other
    found, _ = triangulate_at(
        head,
        left=np.broadcast_to(left, (n, 2)),
        right=np.broadcast_to(right, (n, 2)),
        joints=joints + np.concatenate([own, right_error], axis=1),
    )
    squares = ((found + np.array([0, baseline_m / 2, 0]) - point) ** 2).sum(axis=1)
    stated = mean_square(
        sensitivity(baseline_m, point, camera_ahead_m=AHEAD_M),
        focal_px=400, pixel_std_px=0.0, joint_std_rad=0.0, late_rad=late_rad,
        correlation=correlation,
    )  # fmt: skip
    standard_error = squares.std() / np.sqrt(n) / stated
    assert squares.mean() / stated == pytest.approx(1, abs=4 * standard_error + 0.005)


def test_an_encoder_rounds_uniformly():
    step = 2 * np.pi / 4096
    errors = np.random.default_rng(0).uniform(-step / 2, step / 2, 100_000)
    assert joint_std_rad(4096, 0.0) == pytest.approx(errors.std(), rel=0.01)
    assert joint_std_rad(0, 0.1) == np.radians(0.1)
    assert joint_std_rad(4096, 0.1) == pytest.approx(np.hypot(errors.std(), np.radians(0.1)), 1e-3)


@pytest.mark.parametrize(("baseline_m", "focal_px"), [(0.06, 280.0), (0.1, 500.0)])
def test_what_the_calibration_adds_is_what_bundle_adjustment_of_the_recording_states(
    baseline_m, focal_px
):
    """And with the noise of a point, it is the whole covariance of `locate`."""
    board = Chessboard(9, 6, 0.03)
    head = designed_head(baseline_m, focal_px, AHEAD_M, (640, 480))
    views = standard_recording(head, board)
    assert held_whole(head, board, views).mean() > 0.9
    estimate = bundle_adjust(head, as_seen(head, board, views), pixel_std_px=0.1, joint_std=1e-3)
    calibrated = replace(head, accuracy=estimate.accuracy)
    points, off = located_points(SMALL)
    points, off = points.reshape(-1, 3), np.tile(off, (2, 1))
    joints = np.stack(gaze_at(np.array(baseline_m), points), axis=-1) + np.tile(off, 2)
    left, right = pixels(head, joints, points, baseline_m)
    located = locate(
        calibrated, left=left, right=right, joints=joints, pixel_std_px=0.2, joint_std_rad=1e-3
    )
    by_views = calibration_mean_square(
        head,
        board,
        points_m=points - [0.0, baseline_m / 2, 0.0],
        joints=joints,
        corner_std_px=0.1,
        joint_std_rad=np.array([1e-3]),
    )[0]
    seen = sensitivity(baseline_m, points, camera_ahead_m=AHEAD_M, off_rad=off)
    noise = mean_square(seen, focal_px=focal_px, pixel_std_px=0.2, joint_std_rad=1e-3)
    whole = np.trace(located.covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(by_views / VIEWS, whole - noise, rtol=0.02)
    np.testing.assert_allclose(noise + by_views / VIEWS, whole, rtol=0.01)


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory):
    return sweep(SMALL, tmp_path_factory.mktemp("chunks"))


def test_a_sweep_is_the_sum_of_its_sources(swept):
    """In the worst direction, where all postures but fixation are left out."""
    fixating = {"distances_m": [0.5], "pan_deg": 15, "tilt_deg": 0, "off_deg": [[0, 0]]}
    settings = SMALL.model_copy(update={"workspace": SMALL.workspace.model_validate(fixating)})
    first = next(chunks(settings))
    found = compute_chunk(first)
    points, _ = located_points(settings)
    for place in ((0, 0, 0, 0, 0), (1, 1, 0, 1, 1), (1, 0, 1, 0, 1)):
        values = values_of(settings, (0, 0, 0, *place))
        squares = by_source(settings, values, points[0])
        assert squares.shape == (len(SOURCES), 1)
        np.testing.assert_allclose(found[:, *place, 0] ** 2, squares.sum(), rtol=1e-9)
    assert combinations(settings) == np.prod(costs(settings).shape)
    assert swept.worst_m.shape == (2, 2, 1, 2, 2, 2, 2, 2, 2)
    assert (swept.worst_m >= swept.mean_m).all()


def test_better_parts_never_make_a_point_worse(swept):
    worst = swept.worst_m
    for name, better in (("baseline_mm", 1), ("views", 1), ("counts_per_turn", 1)):
        own = np.moveaxis(worst, AXES.index(name), 0)
        assert (own[better] < own[1 - better]).all(), name
    for name in ("joint_noise_deg", "pixel_noise_px", "delay_ms"):
        own = np.moveaxis(worst, AXES.index(name), 0)
        assert (own[0] < own[1]).all(), name


def test_the_cheapest_design_is_that_of_all_that_are_accurate_enough(swept):
    worst = at_distance(swept, 0.5)
    wanted = float(np.median(worst))
    found = cheapest(swept, wanted, 0.5, most=1000)
    assert len(found) == (worst <= wanted).sum()
    assert swept.cost[found[0]] == swept.cost[worst <= wanted].min()
    order = [(swept.cost[place], worst[place]) for place in found]
    assert order == sorted(order)
    assert cheapest(swept, 1e-6, 0.5) == []
    assert worst[most_accurate(swept, 0.5)] == worst.min()


def test_prices_are_interpolated_and_stay_beyond_their_ends():
    free = {name: [[0, 0]] for name in AXES}
    settings = DesignSettings.model_validate(
        {
            "designs": {"baseline_mm": [50, 60, 90, 200]},
            "prices": {**free, "baseline_mm": [[60, 10], [120, 70]]},
        }
    )
    np.testing.assert_allclose(costs(settings)[:, 0, 0, 0, 0, 0, 0, 0], [10, 10, 40, 70])


def test_points_that_no_image_holds_are_left_out():
    narrow = {"distances_m": [0.5], "pan_deg": 0, "tilt_deg": 0, "off_deg": [[0, 0], [30, 0]]}
    small = SMALL.model_copy(update={"workspace": SMALL.workspace.model_validate(narrow)})
    first = next(chunks(small))
    both = compute_chunk(first)
    longer = first.model_copy(update={"designs": Designs(**{**first.designs.model_dump(),
                                                            "focal_px": (800.0,)})})  # fmt: skip
    np.testing.assert_array_equal(*compute_chunk(longer))  # the worst posture is the only one
    assert (both[0] > both[1]).all()
    out = SMALL.workspace.model_validate({**narrow, "off_deg": [[60, 0]]})
    assert np.isnan(compute_chunk(first.model_copy(update={"workspace": out}))).all()


def test_a_sweep_that_was_stopped_goes_on_without_doing_finished_work_again(
    swept, tmp_path, monkeypatch
):
    computed: list[DesignSettings] = []

    def stopped_after_two(chunk: DesignSettings) -> Array:
        if len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(chunk)
        return compute_chunk(chunk)

    monkeypatch.setattr(command, "compute_chunk", stopped_after_two)
    with pytest.raises(KeyboardInterrupt):
        sweep(SMALL, tmp_path)
    kept = sorted(tmp_path.glob("*.npy"))
    assert len(kept) == 2
    kept[0].write_bytes(kept[0].read_bytes()[:100])  # as no write of ours leaves a file
    other = tmp_path / "other"
    other.mkdir()
    for file in kept:
        np.save(other / file.name, np.zeros(3))

    def counted(chunk: DesignSettings) -> Array:
        computed.append(chunk)
        return compute_chunk(chunk)

    monkeypatch.setattr(command, "compute_chunk", counted)
    steps: list[tuple[int, int]] = []
    found = sweep(SMALL, tmp_path, progress=lambda _, done, total: steps.append((done, total)))
    assert len(computed) == 2 + 3  # of four chunks one was whole
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]
    np.testing.assert_array_equal(found.worst_m, swept.worst_m)
    np.testing.assert_array_equal(sweep(SMALL, other).worst_m, swept.worst_m)
    del computed[5:]
    wider = SMALL.designs.model_copy(update={"baseline_mm": (60.0, 90.0, 120.0)})
    sweep(SMALL.model_copy(update={"designs": wider}), tmp_path)
    assert len(computed) == 5 + 2  # those of the new baseline


def test_processes_that_compute_do_not_wait_for_what_draws():
    code = "import sys, vergence.commands.design_chunks; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = run.stdout.split()
    assert "joblib" in loaded
    assert not {"matplotlib", "rerun"} & set(loaded)


@pytest.mark.slow
def test_two_processes_give_the_same_numbers(swept, tmp_path):
    found = sweep(SMALL, tmp_path, jobs=2)
    np.testing.assert_array_equal(found.worst_m, swept.worst_m)
    np.testing.assert_array_equal(found.mean_m, swept.mean_m)


@pytest.mark.slow
def test_a_local_dask_cluster_gives_the_same_numbers(swept, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        found = sweep(SMALL, tmp_path, cluster=cluster.scheduler_address)
    np.testing.assert_array_equal(found.worst_m, swept.worst_m)
    np.testing.assert_array_equal(found.mean_m, swept.mean_m)


def test_a_cluster_that_does_not_answer_is_named(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(command, "TIMEOUT_S", 0.2)
    with pytest.raises(VergenceError, match="No Dask scheduler answers at"):
        sweep(SMALL, tmp_path, cluster="tcp://127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(VergenceError, match="pip install"):
        sweep(SMALL, tmp_path, cluster="tcp://127.0.0.1:9")


def test_ranges_lists_and_numbers_are_values(tmp_path: Path):
    text = "[designs]\nbaseline_mm = {first = 60, last = 120, steps = 4}\nfocal_px = 400\n"
    (tmp_path / "d.toml").write_text(text + "delay_ms = [0, 2]\n")
    found = load_settings(tmp_path / "d.toml").designs
    assert found.baseline_mm == (60, 80, 100, 120)
    assert (found.focal_px, found.delay_ms) == ((400,), (0, 2))
    (tmp_path / "d.json").write_text(json.dumps(SMALL.model_dump()))
    assert load_settings(tmp_path / "d.json") == SMALL


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[designs]\nbaseline_mm = [5]", "designs.baseline_mm: values are from 10 to 1000"),
        ("[designs]\nbaseline_mm = []", "designs.baseline_mm"),
        ("[designs]\nbaseline = [60]", "designs.baseline: Extra inputs"),
        ("[designs]\nviews = [20, 20.0]", "a value is there twice"),
        ("[prices]\nviews = [[10, 1], [10, 2]]", "values of views rise"),
        ("[workspace]\neye_correlation = 2", "workspace.eye_correlation"),
        ("[designs", "is not a description of designs"),
    ],
)
def test_settings_that_are_not_possible_end_in_a_sentence(text, said, tmp_path: Path):
    (tmp_path / "d.toml").write_text(text)
    with pytest.raises(VergenceError, match=said):
        load_settings(tmp_path / "d.toml")


def test_the_settings_that_are_printed_can_be_used_and_are_the_default_ones(tmp_path: Path):
    (text,) = (b.text for b in blocks("docs/design_and_plan.md") if b.language == "toml")
    (tmp_path / "mine.toml").write_text(text)
    found, usual = load_settings(tmp_path / "mine.toml"), DesignSettings()
    assert found.prices == usual.prices
    assert found.designs.baseline_mm == (60, 70, 80, 90, 100, 110, 120)
    for name in ("eye_speed_deg_s", "camera_ahead_mm", "image_px", "board", "corner_noise_px"):
        assert getattr(found.workspace, name) == getattr(usual.workspace, name)


def test_too_many_designs_are_refused():
    many = {"first": 100, "last": 1000, "steps": 1000}
    with pytest.raises(ValidationError, match="at most 50,000,000"):
        DesignSettings.model_validate({"designs": {"baseline_mm": many, "focal_px": many}})


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, arguments)])
    cli.main()


def test_the_command_writes_a_report_with_the_cheapest_head(tmp_path, monkeypatch, capsys):
    (tmp_path / "d.json").write_text(json.dumps(SMALL.model_dump()))
    words = ["design", tmp_path / "d.json", "--out", tmp_path / "out", "--jobs", 1]
    run(monkeypatch, *words, "--accuracy-mm", 8, "--at-m", 0.6, "--baseline-mm", 60, 120)
    printed = capsys.readouterr().out
    assert "reach 8 mm at 0.6 m" in printed
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {
        "chunks", "design.json", "design.png", "properties.png", "report.md", "sweep.npz"
    }  # fmt: skip
    found = json.loads((tmp_path / "out" / "design.json").read_text())
    assert found["settings"]["designs"]["baseline_mm"] == [60, 120]
    assert found["cheapest"][0]["worst_mm"] <= 8
    arrays = np.load(tmp_path / "out" / "sweep.npz")
    assert arrays["worst_m"].shape == (2, 2, 1, 2, 2, 2, 2, 2, 3)
    run(monkeypatch, *words, "--accuracy-mm", 0.01, "--at-m", 0.5)
    assert "None of 128 designs reaches 0.01 mm at 0.5 m" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--accuracy-mm", "0"], "--accuracy-mm takes a number above 0"),
        (["--at-m", "-1"], "--at-m takes a number above 0"),
        (["--jobs", "0"], "--jobs takes a number of processes"),
        (["--focal-px", "5"], "designs.focal_px: values are from 50 to 10000, found 5"),
        (["missing.toml"], "missing.toml"),
    ],
)
def test_wrong_options_end_in_a_sentence(options, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, "design", *options)
    assert said in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
