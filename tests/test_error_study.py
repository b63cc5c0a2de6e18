"""The study of the paper's numbers: its quick tables are those of its document."""

import runpy

import numpy as np
import pytest

from documents import ROOT, read
from test_replay import TABLE_MM
from vergence.paper.figures import FIGURES

STUDY = runpy.run_path(str(ROOT / "scenarios" / "error_study.py"))
DOCUMENT = "docs/error_study.md"


def test_the_quick_tables_of_the_document_are_those_of_the_scenario():
    tables = {name: STUDY[name]() for name in ("sensitivity", "orientation_alone")}
    assert STUDY["absent"](tables, read(DOCUMENT)) == []


def test_the_table_of_sensitivities_is_met_within_ten_percent():
    """Entries of 1 mm and more, under the conditions of the table."""
    for found, expected in zip(STUDY["sensitivities"]().values(), TABLE_MM.values(), strict=True):
        wanted = np.array([[float(x) for x in cell.split("/")] for cell in expected.split()])
        large = wanted >= 1
        np.testing.assert_allclose(found[large], wanted[large], rtol=0.1)


@pytest.mark.slow
def test_the_document_tells_what_the_small_model_gives():
    """Fitted again; the fit takes a few seconds."""
    model = STUDY["SMALL"]
    values = STUDY["fit"](model)
    assert STUDY["absent"]({"small": STUDY["numbers"](model, values)}, read(DOCUMENT)) == []
    judged = STUDY["judged"](STUDY["spreads_mm"](model.build(values)))
    assert f"| small | 3 | {' | '.join(judged)} |" in read(DOCUMENT)


def test_the_spread_of_white_noise_is_that_of_samples():
    errors = STUDY["Errors"](joint_noise_deg=0.1, pixel_noise_um=3.0, pan_gain_percent=(1.0, -0.5))
    for number in (6, 11):
        figure = FIGURES[number]
        closed = STUDY["spread_mm"](figure, errors)
        np.testing.assert_allclose(STUDY["sampled_mm"](figure, errors, 0), closed, rtol=0.03)
