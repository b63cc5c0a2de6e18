"""Every scenario runs, shortened, from an empty folder."""

import re
import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.render
ROOT = Path(__file__).parents[1]
SHORT = ("--duration", "1", "--rate", "2", "--profile", "ideal")
SCENARIOS = {
    ("figure_pair.py", "near"): (SHORT, r"divergent / parallel std of depth: \d"),
    ("calibration_sequence.py",): (("--lens", "4.0mm"), r"right_narrow: 0\.\d+ degrees"),
    ("two_heads.py", "budget"): (
        ("--profile", "ideal"),
        r"(?s)cbi_head.*off by.*tilt_head.*off by",
    ),
    ("own_experiment.py",): ((), r"vergence \+0\.40 rad: error (?!.*-0\.0).*, .*, .* mm"),
}
TESTED_ELSEWHERE = {"gaze_demos.py", "error_study.py"}
"""Beside the commands that they use, and with the document of the study."""


def test_every_scenario_is_tested_and_names_its_own_command():
    scripts = {path.name: path.read_text() for path in (ROOT / "scenarios").glob("*.py")}
    assert {command[0] for command in SCENARIOS} | TESTED_ELSEWHERE == set(scripts)
    for name, text in scripts.items():
        assert f"python scenarios/{name}" in text


@pytest.mark.usefixtures("few_views")
@pytest.mark.parametrize("command", SCENARIOS, ids=" ".join)
def test_scenario_runs_and_prints_its_result(command, tmp_path, monkeypatch, capsys):
    arguments, expected = SCENARIOS[command]
    script, *choice = command
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script, *choice, *arguments])
    runpy.run_path(str(ROOT / "scenarios" / script), run_name="__main__")
    assert re.search(expected, capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("calibration_sequence.py --profile perfect", "ideal, noise-only, paper"),
        ("error_study.py --check missing.md", "Cannot read missing.md"),
        ("error_study.py --seed -1", "The seed must be"),
        ("figure_pair.py far --profile perfect", "ideal, noise-only, paper"),
        ("figure_pair.py far --duration -1", "duration"),
        ("gaze_demos.py foveate --profile perfect", "ideal, noise-only, paper"),
        ("gaze_demos.py track --seed -1", "The seed must be"),
        ("two_heads.py budget --profile perfect", "ideal, noise-only, paper"),
    ],
)
def test_a_mistake_ends_a_scenario_in_a_sentence(
    words: str, said: str, tmp_path, monkeypatch, capsys
):
    script, *arguments = words.split()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(ROOT / "scenarios" / script), run_name="__main__")
    error = capsys.readouterr().err
    assert error.startswith(f"{script.removesuffix('.py')}: ")
    assert said in error
    assert error.count("\n") == 1
