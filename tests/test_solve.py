"""From a dataset folder to a calibrated head, through the command line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from vergence import cli
from vergence.head import load


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, arguments)])
    cli.main()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibration") / "dataset"
    with pytest.MonkeyPatch.context() as monkeypatch:
        run(monkeypatch, "record", "--out", folder, "--frames", 20, "--profile", "noise-only")
    return folder


def test_a_recorded_head_is_calibrated_and_evaluated(recorded, tmp_path, monkeypatch, capsys):
    out = tmp_path / "calibration.json"
    report, accuracy, errors = tmp_path / "report", tmp_path / "a.json", tmp_path / "e.json"
    hidden = recorded / "truth.json"
    aside = hidden.rename(recorded / "hidden.json")  # calibration must do without it
    try:
        run(
            monkeypatch,
            *("calibrate", recorded, "--out", out, "--report", report, "--json", accuracy),
        )
    finally:
        aside.rename(hidden)
    run(monkeypatch, "evaluate", out, "--truth", hidden, "--json", errors)
    printed = capsys.readouterr().out
    head = load(out)
    assert head.accuracy is not None
    assert head.accuracy.method == "refined"
    assert np.linalg.eigvalsh(head.accuracy.covariance).min() > -1e-12
    assert head.accuracy.held_out is not None
    assert set(head.cameras) == {"left_wide", "left_narrow", "right_wide", "right_narrow"}
    found = json.loads(errors.read_text())
    assert set(found["cameras"]) == set(head.cameras)
    for camera in found["cameras"].values():
        assert camera["rotation_deg"] < 0.5
        assert camera["translation_mm"] < 4
        assert camera["focal_percent"] < 0.5
    stated = json.loads(accuracy.read_text())
    assert stated["verdict"] in printed
    assert (report / "report.md").read_text().splitlines()[2].startswith(stated["verdict"])
