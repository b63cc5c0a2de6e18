"""Sweeps over designs: sums of their sources, that can be stopped and go on."""

import os
from pathlib import Path

import numpy as np
import pytest

from vergence.accuracy import design_sweep as command
from vergence.accuracy.design_settings import (
    AXES,
    Designs,
    DesignSettings,
    chunks,
)
from vergence.accuracy.design_sweep import (
    SOURCES,
    at_distance,
    by_source,
    cheapest,
    compute_chunk,
    located_points,
    most_accurate,
    sweep,
    values_of,
)
from vergence.arrays import Array

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
    with pytest.raises(KeyboardInterrupt) as stop:
        sweep(SMALL, tmp_path)
    said = "2 of 4 parts finished; the same command goes on from there"
    assert stop.value.__notes__ == [said]
    kept = sorted(tmp_path.glob("*.f64"))
    assert len(kept) == 2
    kept[0].write_bytes(kept[0].read_bytes()[:100])  # as no write of ours leaves a file
    other = tmp_path / "other"
    other.mkdir()
    for file in kept:
        (other / file.name).write_bytes(bytes(24))

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


def test_parts_that_other_code_has_computed_are_computed_again(monkeypatch):
    first = next(chunks(SMALL))
    before = command.digest(first)
    assert command.digest(first) == before
    monkeypatch.setattr(command, "_code", lambda: "another formula")
    assert command.digest(first) != before


@pytest.mark.parametrize("kind", ["too short", "too long", "pipe"])
def test_finished_work_of_another_size_is_computed_again(kind: str, tmp_path: Path):
    file, numbers = tmp_path / "chunk.f64", np.arange(6.0).reshape(2, 3)
    file.write_bytes(numbers.tobytes())
    np.testing.assert_array_equal(command.read_chunk(file, (2, 3)), numbers)
    if kind == "pipe":
        file.unlink()
        os.mkfifo(file)
    else:
        file.write_bytes(bytes(8 if kind == "too short" else 56))
    assert command.read_chunk(file, (2, 3)) is None


@pytest.mark.slow
def test_two_processes_give_the_same_numbers(swept, tmp_path):
    found = sweep(SMALL, tmp_path, jobs=2)
    np.testing.assert_array_equal(found.worst_m, swept.worst_m)
    np.testing.assert_array_equal(found.mean_m, swept.mean_m)
