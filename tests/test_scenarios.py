"""Every documented command runs, shortened, in a process of its own from an empty folder."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.render
ROOT = Path(__file__).parents[1]
SHORT = ("--duration", "3", "--rate", "4", "--profile", "ideal")
SCENARIOS = {
    "near.py": (SHORT, r"divergent / parallel depth spread: \d"),
    "far.py": (SHORT, r"Fig\. 9: std \d+ mm in depth"),
    "longer_lens.py": (SHORT, r"Fig\. 11: std \d+ mm in depth"),
    "calibration_sequence.py": (("--lens", "4.0mm"), r"right_narrow: 0\.\d+ degrees"),
    "own_experiment.py": ((), r"vergence \+0\.40 rad: error"),
}


def test_every_paper_scenario_is_tested():
    """Scenarios of other commands are tested beside those commands."""
    paper = {path.name for path in (ROOT / "scenarios").glob("*.py")}
    assert set(SCENARIOS) <= paper


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_runs_and_says_what_it_found(name, tmp_path):
    arguments, expected = SCENARIOS[name]
    done = subprocess.run(
        [sys.executable, "-W", "error", str(ROOT / "scenarios" / name), *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(expected, done.stdout)


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_names_its_own_command(name):
    text = (ROOT / "scenarios" / name).read_text()
    assert f"python scenarios/{name}" in text


def test_the_benchmark_prints_its_ratio(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "replay.py"), "--samples", "8", "--rounds", "1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"same frames: \d+\.\d\d", done.stdout)
