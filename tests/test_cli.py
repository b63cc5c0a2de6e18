"""The command line: mistakes end in one sentence and exit code 2, runs in the stated files."""

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from inspect import Parameter, signature
from pathlib import Path

import pytest

from simulated_head import plain_head
from vergence import __version__, cli
from vergence.cli.terminal import invocation, plain_ending
from vergence.geometry.head import save_head

BAD_ARGUMENTS = {
    "unknown figure": (["--figures", "5"], "figures 6 to 11"),
    "figure that is text": (["--figures", "six"], "figures"),
    "negative rate": (["--rate", "-1"], "rate"),
    "zero rate": (["--rate", "0"], "rate"),
    "rate beyond the physics": (["--rate", "5000"], "rate"),
    "negative duration": (["--duration", "-3"], "duration"),
    "infinite duration": (["--duration", "inf"], "duration"),
    "duration that is not a number": (["--duration", "nan"], "duration"),
    "too short for two samples": (["--duration", "0.001"], "duration"),
    "negative seed": (["--seed", "-1"], "seed"),
    "seed that is a fraction": (["--seed", "0.5"], "seed"),
    "unknown profile": (["--profile", "perfect"], "ideal, noise-only, paper"),
    "missing profile file": (["--profile", "missing.toml"], "missing.toml"),
    "profile that is a folder": (["--profile", "folder.toml"], "folder.toml"),
    "folder that is a file": (["--out", "file"], "file"),
    "unknown option": (["--fast"], "--fast"),
    "rate too low for two samples": (["--duration", "1", "--rate", "0.1"], "fewer than two"),
    "no processes": (["--jobs", "0"], "--jobs"),
    "fewer than no processes": (["--jobs", "-2"], "all cores, found -2"),
}


def refused(arguments: Sequence[str], capsys: pytest.CaptureFixture, monkeypatch) -> str:
    """Return what is printed when a command line is refused."""
    monkeypatch.setattr(sys, "argv", ["vergence", *arguments])
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    written = capsys.readouterr()
    return written.err + written.out


@pytest.mark.parametrize("case", BAD_ARGUMENTS)
def test_bad_argument_ends_in_a_sentence(case, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("in the way")
    Path("folder.toml").mkdir()
    arguments, named = BAD_ARGUMENTS[case]
    text = refused(["reproduce", *arguments], capsys, monkeypatch)
    assert named in text
    assert "Traceback" not in text


def test_no_command_writes_over_what_it_reads(capsys, monkeypatch, tmp_path):
    """Where the file that is read has the name of a result, or is part of a folder."""
    monkeypatch.chdir(tmp_path)
    Path("data").mkdir()
    for name in ("data/dataset.json", "data/frames.csv", "design.json", "depth.json", "mine.toml"):
        Path(name).write_text("")
    save_head(plain_head(0.09, 280.0), "left_wide.yaml")
    for words in (
        "plan data --json data/dataset.json",
        "design design.json --out .",
        "budget --profile mine.toml --json mine.toml",
        "budget --motion data --noise 0.1 --json data/frames.csv",
        "depth data --calibration depth.json --out .",
        "depth --twin --calibration depth.json --out .",
        "export left_wide.yaml --format ros --out .",
        "import . --format ros --out left_wide.yaml",
    ):
        assert "it is also the file that is read" in refused(words.split(), capsys, monkeypatch)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("calibrate data --out r/report.md --report r", "the file of another result"),
        ("calibrate data --out a.json --json r/dataset.rrd --report r", "the file of another res"),
        ("calibrate data --out r/UNFINISHED.txt --report r", "the file of another result"),
        ("calibrate data --out a.json --report a.json", "a folder of other results"),
        ("calibrate data --out a --report a/report", "a folder of other results"),
        ("foveate --out f --json f/foveate.rrd", "the file of another result"),
        ("foveate --out f --json f/depth.png", "the file of another result"),
        ("track --out f --json f/track.rrd", "the file of another result"),
    ],
)
def test_no_result_takes_the_place_of_another(words, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert f"it is also {said}" in refused(words.split(), capsys, monkeypatch)


@pytest.mark.parametrize(
    "words",
    [
        "calibrate data --out a.json --report r",
        "design --out r --jobs 1",
        "depth data --calibration head.json --out r",
        "depth --twin --out r",
        "reproduce --out r",
    ],
)
def test_the_report_of_another_command_is_not_lost(words, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("r").mkdir()
    Path("r/report.md").write_text("# Our laboratory\n")
    said = refused(words.split(), capsys, monkeypatch)
    assert "r/report.md is the report of something else" in said
    assert "it begins with '# Our laboratory'" in said


@pytest.mark.parametrize(
    ("words", "there", "said"),
    [
        ("calibrate set --out a.json --report r", "dataset.json", "r is a dataset"),
        ("calibrate set --out a.json --report r", "foveate.rrd", "r is results of foveate"),
        ("depth set --calibration head.json --out r", "track.rrd", "r is results of track"),
        ("export head.json --format ros --out r", "dataset.json", "r is a dataset"),
        ("foveate --out r", "dataset.rrd", "r is a report of calibrate"),
        ("track --out r", "statistics.json", "r is results of reproduce"),
        ("reproduce --out r", "design.json", "r is results of design"),
        ("design --out r", "depth.rrd", "r is results of depth"),
    ],
)
def test_results_do_not_go_into_a_dataset_or_among_those_of_another_command(
    words, there, said, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    save_head(plain_head(0.09, 280.0), "head.json")
    Path("r").mkdir()
    Path("r", there).touch()
    text = refused(words.split(), capsys, monkeypatch)
    assert f"{said}, since it has {there}" in text
    assert [path.name for path in Path("r").iterdir()] == [there]


@pytest.mark.parametrize("name", ["report.md", "fig06.rrd", "calibration-2.8mm.json"])
def test_a_folder_in_the_place_of_a_figures_result_is_refused_before_the_work(
    name, capsys, monkeypatch, tmp_path
):
    (tmp_path / name).mkdir()
    said = refused(["reproduce", "--out", str(tmp_path)], capsys, monkeypatch)
    assert f"{name}: it is a folder, not a file" in said


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["design", "--jobs", "1", "--out", ""], "--out"),
        (["budget", "--noise", "0.1", "--json="], "--json"),
        (["export", "", "--format", "ros", "--out", "r"], "export"),
    ],
)
def test_an_empty_name_does_not_stand_for_the_folder_one_is_in(
    words: list[str], option: str, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    assert f"The value after {option} is empty" in refused(words, capsys, monkeypatch)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("demo", ["foveate", "track", "grasp"])
def test_a_seed_is_refused_before_progress_is_shown(demo, capsys, monkeypatch):
    text = refused([demo, "--seed", "-1"], capsys, monkeypatch)
    assert text == "vergence: The seed must be a whole number from 0, found -1.\n"


def test_an_import_of_a_whole_head_starts_from_none(capsys, monkeypatch):
    words = "import a.yml --format opencv --start b.json --out c.json"
    assert "leave --start out" in refused(words.split(), capsys, monkeypatch)


@pytest.mark.parametrize("command", ["plan data", "budget --noise 0.1"])
def test_a_figure_that_is_not_called_a_png_file_is_refused(command, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    said = refused([*command.split(), "--figure", "plan.pdf"], capsys, monkeypatch)
    assert "A figure is a PNG file, whose name ends in .png; found plan.pdf." in said


@pytest.mark.parametrize(
    "words",
    [
        "plan LONG",
        "calibrate LONG --out a.json",
        "budget --noise 0.1 --motion LONG",
        "import LONG --format ros --start head.json --out a.json",
        "depth LONG --calibration head.json --out LONG",
        "reproduce --out LONG",
        "foveate --out LONG",
        "record --out LONG",
    ],
)
def test_a_name_that_is_too_long_ends_in_a_sentence(words, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    save_head(plain_head(0.09, 280.0), "head.json")
    said = refused(words.replace("LONG", "long" * 100).split(), capsys, monkeypatch)
    assert re.search("too long|There is no", said)


def test_a_bad_profile_ends_in_a_sentence_that_names_the_value(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text("[joints]\nnoise_deg = -1\n")
    text = refused(["reproduce", "--profile", "mine.toml"], capsys, monkeypatch)
    assert text.count("\n") == 1
    assert "mine.toml" in text
    assert "joints.noise_deg: " in text


def test_missing_opengl_says_what_to_install():
    done = subprocess.run(
        [sys.executable, "-m", "vergence", "reproduce", "--figures", "6"],
        env={**os.environ, "MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "osmesa"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "libegl1" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_reader_that_stops_reading_ends_the_command_without_a_word():
    typed = [sys.executable, "-m", "vergence", "evaluate", "--help"]
    with subprocess.Popen(typed, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("track --seconds 60s", "Error parsing --seconds: expected a number without a unit, found"),
        ("foveate --trials 2.5", "Error parsing --trials: expected a whole number, found '2.5'"),
        ("depth --twin --out r --seed a", "Error parsing --seed: expected a whole number, found"),
        ("design --views 9 many", "Error parsing --views: expected a number without a unit, found"),
        ("plan a.json --board 9 6", "Missing value for argument '--board'. Expected 3 values."),
        ("plan a.json --board 9 6 x", "expected a number without a unit, found 'x'"),
        ("evaluate a.json ds --truth b", "Unrecognized options: ds."),
        ("reproduce --method fast", "invalid choice 'fast' for argument '--method'"),
        ("grasp --trails 3", "--trails, 3 Perhaps you meant: --trials INT Number of objects."),
        ("calibrate set --our x.json", "--out PATH JSON file of the calibration"),
        ("calibrate", "Missing from"),
    ],
)
def test_wrong_arguments_end_in_one_line_that_says_where_to_read_more(
    words, said, capsys, monkeypatch
):
    text = refused(words.split(), capsys, monkeypatch)
    assert said in text
    assert text.count("\n") == 1
    assert not set("[│╭") & set(text.replace("[dB]", ""))
    assert text.endswith(f"vergence {words.split()[0]} --help.\n")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full")
def test_an_output_that_is_full_ends_in_a_sentence(tmp_path):
    save_head(plain_head(0.09, 280.0), tmp_path / "a.json")
    typed = [sys.executable, "-m", "vergence", "budget", "--calibration", tmp_path / "a.json"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*typed, "--noise", "0.1"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    said = "vergence: Cannot write to standard output: No space left on device.\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_a_stopped_command_says_the_note_of_its_work_in_place_of_files(capsys):
    stop = KeyboardInterrupt()
    stop.add_note("2 of 4 parts finished")
    with pytest.raises(SystemExit, match="130"), plain_ending("vergence"):
        raise stop
    assert capsys.readouterr().err == "vergence: stopped; 2 of 4 parts finished.\n"


def test_an_unknown_command_is_answered_with_the_known_ones(capsys, monkeypatch):
    text = refused(["reproduced"], capsys, monkeypatch)
    assert text.count("\n") == 1
    assert "'reproduced'" in text
    assert ", ".join(cli.COMMANDS) in text
    assert "vergence --help" in text


def test_a_missing_file_of_opencv_is_missing_whatever_its_suffix(capsys, monkeypatch):
    words = ["import", "nosuch", "--format", "opencv", "--out", "x.json"]
    assert "Cannot read nosuch: No such file" in refused(words, capsys, monkeypatch)


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_describes_every_option(name: str, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["vergence", name, "--help"])
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    text = capsys.readouterr().out
    shown = set(re.findall(r"(?<!\S)--[a-z]+(?:-[a-z]+)*", text))
    parameters = signature(cli.COMMANDS[name]).parameters.values()
    names = {each.name for each in parameters if each.kind is Parameter.KEYWORD_ONLY}
    assert {f"--{each.replace('_', '-')}" for each in names - {"options"}} <= shown
    assert "None" not in text  # the description says what an absent option means


def test_help_loads_no_library_of_numbers_images_or_drawing():
    code = "import sys, vergence.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "cv2", "pydantic", "matplotlib", "rerun", "rich", "mujoco"}
    assert not heavy & set(done.stdout.split())


def test_the_version_is_that_of_the_package(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["vergence", "--version"])
    cli.main()
    assert capsys.readouterr().out == f"vergence {__version__}\n"


def test_a_refused_run_does_not_speak_of_replacing_results(capsys, monkeypatch, tmp_path):
    (tmp_path / "statistics.json").write_text("{}")
    arguments = ["reproduce", "--out", str(tmp_path), "--figures", "5"]
    assert "Replacing" not in refused(arguments, capsys, monkeypatch)


@pytest.fixture
def environment(tmp_path, monkeypatch) -> Path:
    """A Python environment in the current folder, with a program that is not on the PATH."""
    scripts = tmp_path / ".venv" / "bin"
    scripts.mkdir(parents=True)
    program = scripts / "rerun"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(scripts))
    monkeypatch.setenv("PATH", os.defpath)
    return scripts


def test_a_printed_command_can_be_typed(environment, monkeypatch):
    assert invocation("rerun", Path("a b.rrd")) == ".venv/bin/rerun 'a b.rrd'"
    monkeypatch.chdir(environment)
    assert invocation("rerun") == str(environment / "rerun")
    monkeypatch.setenv("PATH", str(environment))
    assert invocation("rerun", "a.rrd") == "rerun a.rrd"
    assert invocation("absent") == "absent"
