"""Sweeps over designs: sums of their sources."""

import numpy as np
import pytest

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
def swept():
    return sweep(SMALL)


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


@pytest.mark.parametrize("change", [{"square_mm": (5.0,)}, {"baseline_mm": (600.0,)}])
def test_designs_whose_board_the_cameras_do_not_see_together_are_out_of_reach(change):
    designs = {**SMALL.designs.model_dump(), **dict.fromkeys(("baseline_mm", "focal_px"))}
    designs |= {"baseline_mm": (60.0,), "focal_px": (450.0,), **change}
    found = sweep(SMALL.model_copy(update={"designs": Designs(**designs)}))
    assert np.isnan(found.worst_m).all()
    assert cheapest(found, 1.0, 0.5) == []


@pytest.mark.slow
def test_two_processes_give_the_same_numbers(swept):
    found = sweep(SMALL, jobs=2)
    np.testing.assert_array_equal(found.worst_m, swept.worst_m)
    np.testing.assert_array_equal(found.mean_m, swept.mean_m)
