"""A disk that is full ends every command in one sentence, and leaves the old files as they were."""

import contextlib
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from mutated_files import stated_head, true_of
from recordings import CHESSBOARD, seen_dataset
from vergence import cli
from vergence.calibration import calibrate as calibrate_module
from vergence.calibration.calibrate import CalibrationResult
from vergence.data.reader import load_dataset
from vergence.demos import foveate, track
from vergence.files import UNFINISHED, write_json
from vergence.geometry.head import save_head
from vergence.interchange.formats import export_head
from vergence.twin.calibration_sequence import plan
from vergence.twin.profile import load_profile
from vergence.twin.record import record

OLD = "what was there before\n"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a calibration, a truth, an export and a dataset that shows a board."""
    folder, head = tmp_path_factory.mktemp("inputs"), stated_head()
    save_head(head, folder / "head.json")
    write_json(true_of(head), folder / "t.json")
    export_head(head, folder / "chain.yaml", "kalibr")
    seen_dataset(folder / "set", CHESSBOARD, 3)
    return folder


@contextlib.contextmanager
def full_disk(free: int) -> Iterator[None]:
    """Let no file grow beyond a number of bytes, as on a disk that is full."""
    before, caches = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True  # Python would leave it cut off, to be read by the next import
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = caches


def refused(arguments: list[str], capsys, monkeypatch) -> str:
    """Return the sentence with which a command ends, exit code 2."""
    monkeypatch.setattr(sys, "argv", ["vergence", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    written = capsys.readouterr()
    assert ended.value.code == 2, written.err
    assert "Traceback" not in written.err
    assert "Wrote" not in written.out
    said = written.err.strip().splitlines()[-1]
    assert said.startswith("vergence: Cannot write")
    return said


def check(
    folder: Path, results: list[str], arguments: list[str], free: int, capsys, monkeypatch, old=OLD
):
    """Run a command on a disk where old results stand and that is full.

    `results` are the names of its results, which the arguments name as `out/<name>`.
    """
    for name in results:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(old)
    there = [argument.replace("out/", f"{folder}/") for argument in arguments]
    with full_disk(free):
        said = refused(there, capsys, monkeypatch)
    assert "File too large" in said
    assert [(folder / name).read_text() for name in results] == [old] * len(results)
    assert [path.name for path in folder.rglob(".*")] == []
    kept = {folder / name for name in results}
    for path in folder.rglob("*"):  # other results that were finished before it stand beside a mark
        assert path in kept or path.is_dir() or (path.parent / UNFINISHED).exists()


SMALL = {
    "evaluate": ("a.json", "evaluate {inputs}/head.json --truth {inputs}/t.json --json out/a.json"),
    "import": (
        "a.json",
        "import {inputs}/chain.yaml --format kalibr --start {inputs}/head.json --out out/a.json",
    ),
    "opencv yml": ("a.yml", "export {inputs}/head.json --format opencv --out out/a.yml"),
    "opencv json": ("a.json", "export {inputs}/head.json --format opencv --out out/a.json"),
    "kalibr": ("a.yaml", "export {inputs}/head.json --format kalibr --out out/a.yaml"),
    "urdf": ("a.urdf", "export {inputs}/head.json --format urdf --out out/a.urdf"),
    "mrcal": (
        "r/left_wide.cameramodel",
        "export {inputs}/head.json --format mrcal --out out/r",
    ),
    "ros": ("r/left_wide.yaml", "export {inputs}/head.json --format ros --out out/r"),
}  # fmt: skip


@pytest.mark.parametrize("name", SMALL)
def test_a_full_disk_leaves_the_old_file(name, tmp_path, inputs, capsys, monkeypatch):
    result, line = SMALL[name]
    check(tmp_path, [result], line.format(inputs=inputs).split(), 300, capsys, monkeypatch)


CALIBRATE = "calibrate {recorded} --method paper --out "
LARGE = {
    "calibration": (["a.json", "b.json"], CALIBRATE + "out/a.json --json out/b.json", 300),
    "report": (["r/dataset.rrd"], CALIBRATE + "{inputs}/new.json --report out/r", 100_000),
    "record": ([], "record --out out/set --frames 12", 16_384),
    "reproduce": (
        ["p/fig06.rrd", "p/statistics.json"],
        "reproduce --out out/p --figures 6 --duration 1 --rate 4",
        50_000,
    ),
    "track": (["t/track.rrd"], "track --seconds 0.6 --out out/t", 200_000),
    "summary": (["a.json"], "foveate --trials 1 --json out/a.json", 16),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, opengl: None, coarsely) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "set"
    with pytest.MonkeyPatch.context() as patch:
        coarsely(patch)
        record(folder, profile=load_profile("ideal"), frames=12)
    return folder


@pytest.fixture(scope="module")
def calibrated(recorded: Path) -> CalibrationResult:
    return calibrate_module.calibrate(load_dataset(recorded), method="paper")


@pytest.fixture
def short_runs(
    coarse_images: None, calibrated: CalibrationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Let commands come to their results by little work: they fail when they write them."""
    monkeypatch.setattr(calibrate_module, "calibrate", lambda *_, **__: calibrated)
    monkeypatch.setitem(plan.__kwdefaults__, "views", (3, 3, 3))
    monkeypatch.setattr(foveate, "WITHIN_S", 0.2)
    monkeypatch.setattr(track, "SHORTEST_S", 0.5)


@pytest.mark.parametrize("name", LARGE)
def test_a_disk_that_fills_leaves_the_old_results(
    name, tmp_path, inputs, recorded, short_runs, true_calibration, capsys, monkeypatch
):
    results, line, free = LARGE[name]
    arguments = line.format(inputs=inputs, recorded=recorded).split()
    # A calibration replaces nothing else.
    old = (inputs / "head.json").read_text() if name == "calibration" else OLD
    check(tmp_path, results, arguments, free, capsys, monkeypatch, old)


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("file/a.json", "Not a directory"),
        ("folder", "it is a folder"),
        ("/dev/null", "it is not a regular file"),
        ("circle", "circle"),
        ("x" * 300, "File name too long"),
        ("a\0b", "is not a possible file name"),
        ("head.json", "it is also the file that is read"),
    ],
)
def test_a_path_that_cannot_work_is_refused_before_the_work(
    path, says, inputs, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder").mkdir()
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "head.json").write_bytes((inputs / "head.json").read_bytes())
    for line in (
        ["calibrate", f"{inputs / 'set'}", "--out", "good.json", "--json", path],
        ["export", "head.json", "--format", "opencv", "--out", path],
        ["track", "--json", path],
    ):
        if says.endswith("read") and line[0] != "export":
            continue
        monkeypatch.setattr(sys, "argv", ["vergence", *line])
        with pytest.raises(SystemExit, match="2"):
            cli.main()
        assert says in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["circle", "file", "folder", "head.json"]
