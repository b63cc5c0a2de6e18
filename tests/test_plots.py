"""figures.png: drawn from any of the figures, and whole or not there."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.paper import plots
from vergence.paper.figures import FIGURES, Figure
from vergence.paper.plots import AXIS_COLOURS, paper_figures
from vergence.paper.statistics import Statistics, describe
from vergence.stereo.uncertainty import depth_error
from vergence.twin.model import nominal_head
from vergence.viewer.plots_depth import by_disparity, depth, miss_px

SAMPLES = 200


@dataclass(frozen=True, eq=False)
class Observed:
    time_s: Array


@dataclass(frozen=True, eq=False)
class Points:
    points: Array


@dataclass(frozen=True, eq=False)
class Result:
    figure: Figure
    observations: Observed
    located: Points
    statistics: Statistics


def result(number: int, *, dropped: int = 3) -> Result:
    figure = FIGURES[number]
    points = np.random.default_rng(number).normal(figure.mean_m, figure.std_m, (SAMPLES, 3))
    points[:dropped] = np.nan
    times = np.linspace(0, 60, SAMPLES)
    return Result(figure, Observed(times), Points(points), describe(points))


def colour_near(image: np.ndarray, html: str) -> int:
    """Return the number of pixels (H, W, 3), BGR, within ten levels of a colour."""
    rgb = [int(html[k : k + 2], 16) for k in (1, 3, 5)]
    return int((np.abs(image.astype(int) - rgb[::-1]).max(axis=2) < 10).sum())


def draw(path: Path, *numbers: int) -> np.ndarray:
    paper_figures(path, [result(number) for number in numbers])
    image = cv2.imread(str(path))
    assert image is not None
    return image


def test_six_figures_fill_three_rows_of_two(tmp_path: Path):
    image = draw(tmp_path / "figures.png", *FIGURES)
    assert image.shape == (1800, 1600, 3)
    panel_height = 580
    for row in range(3):
        for half in (slice(0, 800), slice(800, 1600)):
            top = 60 + row * panel_height
            panel = image[top : top + panel_height, half]
            for colour in AXIS_COLOURS.values():
                assert colour_near(panel, colour) > 100


@pytest.mark.parametrize(
    ("numbers", "shape"),
    [((8,), (640, 800)), ((9, 8), (640, 1600)), ((6, 10), (1220, 800)), ((6, 9), (1220, 1600))],
)
def test_some_figures_keep_their_places(
    tmp_path: Path, numbers: tuple[int, ...], shape: tuple[int, int]
):
    assert draw(tmp_path / "figures.png", *numbers).shape[:2] == shape


def test_the_table_states_the_papers_numbers_and_ours():
    result_ = result(9)
    columns = plots._cells(result_.figure, result_.statistics)
    assert columns[1][1:] == ["1109 ± 102", "17 ± 11", "1 ± 7"]
    mean_mm, std_mm = 1e3 * result_.statistics.mean_m[0], 1e3 * result_.statistics.std_m[0]
    assert columns[2][1] == f"{mean_mm:.1f} ± {std_mm:.1f}"
    assert columns[3][1] == f"{std_mm / 102:.2f}"


def test_a_figure_that_located_nothing_says_so(tmp_path: Path):
    nothing = result(6, dropped=SAMPLES)
    paper_figures(tmp_path / "figures.png", [nothing])
    assert (tmp_path / "figures.png").exists()
    assert plots._cells(nothing.figure, nothing.statistics)[2][1:] == ["not located"] * 3


def test_the_folder_holds_the_picture_and_nothing_else(tmp_path: Path):
    first = draw(tmp_path / "new" / "figures.png", 6)
    second = draw(tmp_path / "new" / "figures.png", 6)
    np.testing.assert_array_equal(first, second)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["figures.png"]


def test_a_path_that_cannot_be_written_is_one_sentence(tmp_path: Path):
    (tmp_path / "figures.png").mkdir()
    with pytest.raises(VergenceError, match=r"^Cannot write .*figures\.png: .*\.$"):
        paper_figures(tmp_path / "figures.png", [result(6)])
    assert [path.name for path in tmp_path.iterdir()] == ["figures.png"]


def test_the_cost_of_depth_is_drawn_as_computed(tmp_path: Path):
    head = nominal_head("2.8mm")
    depth(tmp_path / "depth.png", head)
    image = cv2.imread(str(tmp_path / "depth.png"))
    assert image is not None
    for html in ("#1e8caa", "#12389b", "#4a7fe0", "#8fb4f0"):
        assert colour_near(image, html) > 100


def test_a_right_depth_costs_nothing_and_a_wrong_one_less_and_less_with_distance():
    head, depths = nominal_head("2.8mm"), np.array([0.3, 0.6, 1.2, 2.4])
    np.testing.assert_allclose(miss_px(head, depths, np.zeros(4), eye="right"), 0, atol=1e-9)
    cost = miss_px(head, depths, np.full(4, 1e-4), eye="left")
    np.testing.assert_allclose(cost[:-1] / cost[1:], 4, rtol=1e-2)  # as 1 / depth^2


def test_an_error_of_disparity_costs_the_same_near_and_far():
    head, depths = nominal_head("2.8mm"), np.array([0.3, 1.0, 5.0])
    wrong = by_disparity(head, depths, 1.0)
    np.testing.assert_allclose(wrong[0], depth_error(0.3, 0.092, 280, 1.0), rtol=0.02)
    cost = miss_px(head, depths, wrong, eye="left")
    np.testing.assert_allclose(cost, cost[0], rtol=0.01)
