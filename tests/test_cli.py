"""The command line: mistakes end in one sentence and exit code 2, runs in the stated files."""

import os
import re
import subprocess
import sys
from inspect import Parameter, signature
from pathlib import Path

import pytest

from simulated_head import plain_head
from vergence import __version__, cli
from vergence.cli.terminal import invocation, plain_ending
from vergence.geometry.head import save_head


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder: files that are in the way, and a calibration."""
    monkeypatch.chdir(tmp_path)
    for name in ("data", "mine", "runs", "full"):
        Path(name).mkdir()
    for name in ("file", "data/dataset.json", "data/frames.csv", "design.json", "mine.toml"):
        Path(name).write_text("")
    Path("mine/report.md").write_text("# Our laboratory\n")
    Path("bad.toml").write_text("[joints]\nnoise_deg = -1\n")
    Path("runs/report.md").mkdir()
    for name in ("head.json", "depth.json", "left_wide.yaml"):
        save_head(plain_head(0.09, 280.0), name)
    return tmp_path


LONG = "long" * 100
READ = "it is also the file that is read"
TWICE = "it is also the file of another result"
AMONG = "it is also a folder of other results"
OTHER = "mine holds report.md, which this command did not write"
EMPTY = "is empty"
REFUSED = [
    # values
    ("reproduce --figures 5", "figures 6 to 11"),
    ("reproduce --figures six", "figures"),
    ("reproduce --rate -1", "rate"),
    ("reproduce --duration nan", "duration"),
    ("reproduce --duration 1 --rate 0.1", "fewer than two"),
    ("reproduce --jobs -2", "all cores, found -2"),
    ("foveate --seed -1", "The seed must be a whole number from 0, found -1."),
    (
        "foveate --driver a:B --calibration head.json --seed 1",
        "leave out --trials, and the options",
    ),
    ("foveate --driver a:B", "A driver needs --calibration FILE, and --seconds"),
    ("foveate --driver a:B --calibration head.json --seconds 0", "--seconds from 1 to 3600."),
    ("foveate --driver no_such:B --calibration head.json", "No driver can be loaded from no_such"),
    ("foveate --calibration head.json", "options of a run with --driver"),
    ("track --live --serve 9090", "choose one of the two"),
    ("grasp --serve 70000", "two free ports"),
    ("reproduce --profile perfect", "ideal, noise-only, paper"),
    ("reproduce --profile missing.toml", "missing.toml"),
    ("reproduce --profile bad.toml", "joints.noise_deg: "),
    ("plan head.json --figure plan.pdf", "A figure is a PNG file, whose name ends in .png; found"),
    # arguments
    ("track --seconds 60s", "Error parsing --seconds; expected: --seconds FLOAT Length of the run"),
    ("foveate --trials 2.5", "Error parsing --trials; expected: --trials INT"),
    ("design --views 9 many", "Error parsing --views; expected: --views {[FLOAT"),
    ("plan a.json --board 9 6 x", "expected: --board COLUMNS ROWS SQUARE_M"),
    ("evaluate a.json ds --truth b", "Unrecognized options: ds."),
    ("reproduce --method fast", "invalid choice 'fast' for argument '--method'"),
    ("grasp --trails 3", "--trails, 3 Perhaps you meant: --trials INT Number of objects."),
    ("calibrate set --our x.json", "--out PATH JSON file of the calibration"),
    ("calibrate", "Missing from"),
    ("reproduced", f"reproduced Available subcommands: {', '.join(cli.COMMANDS)}."),
    ("design --jobs 1 --out EMPTY", f"The value after --out {EMPTY}"),
    ("budget --noise 0.1 --json=", f"The value after --json {EMPTY}"),
    ("export EMPTY --format ros --out r", f"The value after export {EMPTY}"),
    (
        "import a.yml --format kalibr --start nosuch.json --out x.json",
        "Cannot read nosuch.json: No",
    ),
    # a command writes over what it reads
    ("plan data --json data/dataset.json", READ),
    ("design design.json --out .", READ),
    ("budget --profile mine.toml --json mine.toml", READ),
    ("budget --motion data --noise 0.1 --json data/frames.csv", READ),
    ("depth data --calibration depth.json --out .", READ),
    ("export left_wide.yaml --format ros --out .", READ),
    ("import . --format ros --start depth.json --out left_wide.yaml", READ),
    # two results in one place
    ("calibrate data --out r/report.md --report r", TWICE),
    ("calibrate data --out a.json --json r/dataset.rrd --report r", TWICE),
    ("foveate --out f --json f/depth.png", TWICE),
    ("calibrate data --out a/report --report a/report", AMONG),
    # results in the place of something else
    ("calibrate data --out a.json --report mine", OTHER),
    ("design --out mine --jobs 1", OTHER),
    ("depth --twin --out mine", OTHER),
    ("reproduce --out file", "file"),
    ("reproduce --out runs", "report.md: it is a folder"),
    # names that are too long
    (f"plan {LONG}", "too long|There is no"),
    (f"budget --noise 0.1 --motion {LONG}", "too long|There is no"),
    (f"depth {LONG} --calibration head.json --out {LONG}", "too long"),
    (f"record --out {LONG}", "too long"),
]


def refused(words: str, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return what is printed when a command line is refused."""
    arguments = ["" if word == "EMPTY" else word for word in words.split()]
    monkeypatch.setattr(sys, "argv", ["vergence", *arguments])
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    written = capsys.readouterr()
    assert not written.out
    return written.err


@pytest.mark.parametrize(("words", "said"), REFUSED, ids=lambda text: text[:60])
def test_a_mistake_ends_in_one_sentence(words: str, said: str, capsys, monkeypatch):
    before = sorted(Path().rglob("*"))
    text = refused(words, capsys, monkeypatch)
    assert text.startswith("vergence: ")
    assert text.count("\n") == 1
    assert re.search(said if "|" in said else re.escape(said), text)
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "there"),
    [
        ("calibrate data --out a.json --report full", "dataset.json"),
        ("depth data --calibration head.json --out full", "track.rrd"),
        ("export head.json --format ros --out full", "dataset.json"),
        ("foveate --out full", "dataset.rrd"),
        ("track --out full", "statistics.json"),
        ("design --out full", "depth.rrd"),
    ],
)
def test_results_do_not_go_into_a_dataset_or_among_those_of_another_command(
    words, there, capsys, monkeypatch
):
    Path("full", there).touch()
    assert f"full holds {there}, which this command did" in refused(words, capsys, monkeypatch)


def run(*words: str | Path, **options) -> subprocess.CompletedProcess:
    typed = [sys.executable, "-m", "vergence", *words]
    return subprocess.run(typed, stderr=subprocess.PIPE, text=True, check=False, **options)


def test_missing_opengl_says_what_to_install():
    done = run(
        "reproduce", "--figures", "6",
        env={**os.environ, "MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "osmesa"},
    )  # fmt: skip
    assert done.returncode == 2
    assert "libegl1" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full")
def test_an_output_that_is_full_ends_in_a_sentence():
    with open("/dev/full", "w") as full:
        done = run("budget", "--calibration", "head.json", "--noise", "0.1", stdout=full)
    said = "vergence: Cannot go on: No space left on device (standard output, or the folder"
    assert done.returncode == 2
    assert done.stderr.startswith(said)


@pytest.mark.parametrize(
    ("before", "words", "said"),
    [
        ("", "calibrate . --out .", "Cannot write .: it is a folder"),
        ("exec >&-;", "--version --help", "Standard output is closed"),
        (
            "mkdir a; cd a; rmdir ../a;",
            "evaluate a --truth b",
            "Cannot go on: No such file or directory",
        ),
    ],
)
def test_what_the_system_refuses_ends_in_a_sentence(before, words, said, tmp_path):
    command = f"{before} exec {sys.executable} -m vergence {words}"
    done = subprocess.run(
        ["/bin/sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_too_little_memory_ends_in_a_sentence(capsys):
    with pytest.raises(SystemExit) as ended, plain_ending("vergence"):
        raise MemoryError
    assert ended.value.code == 2
    assert "There is too little memory" in capsys.readouterr().err


def test_a_reader_that_stops_reading_ends_the_command_without_a_word():
    typed = [sys.executable, "-m", "vergence", "evaluate", "--help"]
    with subprocess.Popen(typed, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_describes_every_option(name: str, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["vergence", name, "--help"])
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    text = capsys.readouterr().out
    shown = set(re.findall(r"(?<!\S)--[a-z]+(?:-[a-z]+)*", text))
    parameters = signature(cli.COMMANDS[name]).parameters.values()
    names = {each.name for each in parameters if each.kind is Parameter.KEYWORD_ONLY}
    assert {f"--{each.replace('_', '-')}" for each in names - {"options", "viewer"}} <= shown
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


def test_a_printed_command_can_be_typed(folder: Path, monkeypatch):
    scripts = folder / ".venv" / "bin"
    scripts.mkdir(parents=True)
    (scripts / "rerun").write_text("#!/bin/sh\n")
    (scripts / "rerun").chmod(0o755)
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(scripts))
    monkeypatch.setenv("PATH", os.defpath)
    assert invocation("rerun", Path("a b.rrd")) == ".venv/bin/rerun 'a b.rrd'"
    monkeypatch.chdir(scripts)
    assert invocation("rerun") == str(scripts / "rerun")
    monkeypatch.setenv("PATH", str(scripts))
    assert invocation("rerun", "a.rrd") == "rerun a.rrd"
    assert invocation("absent") == "absent"
