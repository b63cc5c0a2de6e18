"""figures.png and depth.png: the drawn lines hold the data, and the files are whole."""

import numpy as np
import pytest

from simulated_twin import observe_points
from vergence.gaze.foveation import ideal_wide_pixel
from vergence.paper import plots
from vergence.paper.figures import FIGURES, default_duration_s
from vergence.paper.plots import draw_figures
from vergence.paper.replay import Replay, estimate
from vergence.twin.head_model import nominal_head
from vergence.twin.profile import ErrorProfile, Joints
from vergence.viewer.plots.accuracy import draw_foveation

SAMPLES = 200
NOISY = ErrorProfile(joints=Joints(noise_deg=0.1))


def result(number: int, *, dropped: int = 3) -> Replay:
    """Return a figure from projected points with noise; the first samples were not detected."""
    figure = FIGURES[number]
    head = nominal_head(figure.lens)
    times = np.linspace(0, default_duration_s(figure.motion), SAMPLES)
    seen = observe_points(head, NOISY, figure, times, rng=np.random.default_rng(number))
    seen.pixels_l[:dropped] = np.nan
    return estimate(head, figure, seen)


@pytest.mark.parametrize("numbers", [tuple(FIGURES), (9, 8), (6,)])
def test_each_figure_has_a_panel_with_its_estimates(numbers: tuple[int, ...]):
    results = {number: result(number) for number in numbers}
    panels = [axes for axes in draw_figures(list(results.values())).axes if axes.get_visible()]
    titles = [axes.get_title(loc="left") for axes in panels]
    assert titles == [FIGURES[number].title for number in sorted(numbers)]
    for axes, number in zip(panels, sorted(numbers), strict=True):
        figure, drawn = results[number].figure, results[number]
        curves = [line for line in axes.lines if len(line.get_xydata()) == SAMPLES]
        assert len(curves) == 3
        for k, curve in enumerate(curves):
            np.testing.assert_array_equal(curve.get_xdata(), drawn.measurements.time_s)
            np.testing.assert_array_equal(curve.get_ydata(), drawn.points[:, k])
        bands = [patch.get_corners()[[0, 2], 1] for patch in axes.patches]
        mean, std = np.array(figure.mean_m), np.array(figure.std_m)
        np.testing.assert_allclose(bands, np.stack([mean - std, mean + std], axis=1))
        means = [line.get_ydata()[0] for line in axes.lines if len(line.get_xydata()) == 2]
        assert means == list(figure.mean_m)


def test_the_table_states_the_papers_numbers_and_ours():
    result_ = result(9)
    columns = plots.table_cells(result_.figure, result_.statistics)
    assert columns[1][1:] == ["1109 ± 102", "17 ± 11", "1 ± 7"]
    mean_mm, std_mm = 1e3 * result_.statistics.mean_m[0], 1e3 * result_.statistics.std_m[0]
    assert columns[2][1] == f"{mean_mm:.1f} ± {std_mm:.1f}"
    assert columns[3][1] == f"{std_mm / 102:.2f}"


def test_an_error_of_depth_costs_in_proportion_and_less_far_away():
    head = nominal_head("2.8mm")
    converge, cost = draw_foveation(head).axes
    assert [line.get_label() for line in converge.lines] == ["left eye", "right eye"]
    small, _, large = (np.array(line.get_ydata()) for line in cost.lines)
    assert (np.diff(large) < 0).all()
    np.testing.assert_allclose(large[-20:], 10 * small[-20:], rtol=0.02)
    near, far = (ideal_wide_pixel(head, "left", depth_m) for depth_m in (5.0, 5.05))
    magnified = head.camera("left_narrow").intrinsics.matrix[0, 0]
    magnified /= head.camera("left_wide").intrinsics.matrix[0, 0]
    assert large[-1] == pytest.approx(magnified * np.linalg.norm(far - near), rel=0.02)
