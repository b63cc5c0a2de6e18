"""The settings of `vergence design`, its command and its report."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from documents import blocks
from test_design_sweep import SMALL
from vergence import cli
from vergence.accuracy.design_settings import (
    AXES,
    DesignSettings,
    costs,
    load_settings,
)
from vergence.errors import VergenceError


def test_prices_are_interpolated_and_stay_beyond_their_ends():
    free = {name: [[0, 0]] for name in AXES}
    settings = DesignSettings.model_validate(
        {
            "designs": {"baseline_mm": [50, 60, 90, 200]},
            "prices": {**free, "baseline_mm": [[60, 10], [120, 70]]},
        }
    )
    np.testing.assert_allclose(costs(settings)[:, 0, 0, 0, 0, 0, 0, 0], [10, 10, 40, 70])


def test_ranges_lists_and_numbers_are_values(tmp_path: Path):
    text = "[designs]\nbaseline_mm = {first = 60, last = 120, steps = 4}\nfocal_px = 400\n"
    (tmp_path / "d.toml").write_text(text + "delay_ms = [0, 2]\n")
    found = load_settings(tmp_path / "d.toml").designs
    assert found.baseline_mm == (60, 80, 100, 120)
    assert (found.focal_px, found.delay_ms) == ((400,), (0, 2))
    (tmp_path / "d.json").write_text(json.dumps(SMALL.model_dump()))
    assert load_settings(tmp_path / "d.json") == SMALL
    (tmp_path / "d.json").rename(tmp_path / "D.JSON")
    assert load_settings(tmp_path / "D.JSON") == SMALL


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[designs]\nbaseline_mm = [5]", "designs.baseline_mm: values are from 10 to 1,000"),
        ("[designs]\nbaseline_mm = []", "designs.baseline_mm: Value should have at least 1 item"),
        ("[designs]\nbaseline = [60]", "unknown field; perhaps baseline_mm is meant"),
        ("[extra]\na = 1", "extra: unknown field"),
        ("[designs]\nviews = 'many'", "designs.views: Input should be a valid tuple; found 'many'"),
        ("[prices]\nfocal_px = 5", "prices.focal_px: Input should be a valid tuple; found 5"),
        (
            "[prices]\nfocal_px = [5, 6]",
            "prices.focal_px.0: Input should be a valid tuple; f",
        ),
        ("[workspace]\neye_correlation = 2", "workspace.eye_correlation"),
        ("[workspace]\nimage_px = [0, 480]", "workspace.image_px"),
        ("[workspace]\noff_deg = [[0, 200]]", "workspace.off_deg"),
        ("[designs", "is not a description of designs .*: Expected"),
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
        "design.json", "design.png", "properties.png", "report.md", "sweep.npz"
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
        (["--at-m", "-1"], "workspace.distances_m: values are from 0.05 to 100, found -1"),
        (["--jobs", "0"], "--jobs takes a number of processes"),
        (["--focal-px", "5"], "designs.focal_px: values are from 50 to 10,000, found 5"),
        (
            ["--counts-per-turn", "-5"],
            "designs.counts_per_turn: values are from 0 to 4,294,967,296, fo",
        ),
        (["missing.toml"], "missing.toml"),
    ],
)
def test_wrong_options_end_in_a_sentence(options, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, "design", *options)
    assert said in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
