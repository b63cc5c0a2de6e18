"""A file is whole under its final name, whoever else writes it and whenever a run is stopped."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from recordings import small_dataset
from vergence import cli
from vergence.calibration import calibrate
from vergence.cli.options import check_outputs
from vergence.demos import depth, experiment
from vergence.errors import VergenceError
from vergence.files import (
    UNFINISHED,
    as_json,
    finished_files,
    results_folder,
    whole_folder,
    write_json,
    write_whole,
)

LINES = 20_000
WRITER = f"""
import sys
from pathlib import Path
from vergence.files import whole_file
for k in range(50):
    with whole_file(Path(sys.argv[1])) as part, part.open("w") as file:
        for _ in range({LINES} // 50):
            file.write(sys.argv[2] * 50 + "\\n")
"""
HELD = """
import sys, time
from pathlib import Path
from vergence.files import results_folder, whole_file, whole_folder, write_whole
folder = Path(sys.argv[1])
with results_folder(folder):
    write_whole(folder / "first.txt", "new")
    with whole_file(folder / "second.txt") as part, whole_folder(folder / "set") as inner:
        part.write_text("half")
        (inner / "image").write_text("half")
        print("there", flush=True)
        time.sleep(60)
"""


def start(code: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def temporaries(folder: Path) -> list[Path]:
    return sorted(folder.rglob(".*.part"))


@pytest.mark.slow
def test_of_two_processes_that_write_one_file_the_last_wins_whole(tmp_path):
    target = tmp_path / "a.txt"
    writers = [start(WRITER, target, letter) for letter in "ab"]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        if target.exists():
            lines = target.read_text().splitlines()
            seen.add(lines[0][0])
            assert len(lines) == LINES // 50
            assert len(set(lines)) == 1
    assert [writer.communicate()[1] for writer in writers] == ["", ""]
    assert seen <= {"a", "b"}
    assert temporaries(tmp_path) == []


@pytest.mark.slow
def test_what_a_killed_process_leaves_is_removed_by_the_next_run(tmp_path):
    (tmp_path / "second.txt").write_text("old")
    holder = start(HELD, tmp_path)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "there\n"
    assert len(temporaries(tmp_path)) == 2
    with pytest.raises(VergenceError, match="Another process is writing"), results_folder(tmp_path):
        pass
    write_whole(tmp_path / "second.txt", "mine")  # while the other is writing
    assert len(temporaries(tmp_path)) == 2
    holder.kill()
    holder.communicate()
    assert len(temporaries(tmp_path)) == 2
    assert (tmp_path / "second.txt").read_text() == "mine"
    assert (tmp_path / UNFINISHED).exists()
    assert "of different runs" in (tmp_path / UNFINISHED).read_text()
    with results_folder(tmp_path):
        write_whole(tmp_path / "second.txt", "next")
        with whole_folder(tmp_path / "set"):
            pass
    assert not (tmp_path / UNFINISHED).exists()
    assert temporaries(tmp_path) == []


@pytest.mark.parametrize("wrote", [False, True])
def test_a_folder_is_marked_if_a_run_that_failed_had_written_there(tmp_path, wrote):
    with pytest.raises(KeyboardInterrupt), results_folder(tmp_path):  # noqa: PT012
        assert (tmp_path / UNFINISHED).exists()
        if wrote:
            write_whole(tmp_path / "a.txt", "a")
        raise KeyboardInterrupt
    assert (tmp_path / UNFINISHED).exists() == wrote
    with results_folder(tmp_path):
        pass
    assert not (tmp_path / UNFINISHED).exists()
    with pytest.raises(KeyboardInterrupt), results_folder(tmp_path / "new"):
        raise KeyboardInterrupt
    assert not (tmp_path / "new").exists()


@pytest.mark.render  # which the import of a demo needs
@pytest.mark.parametrize("words", ["track", "depth --twin", "calibrate set --out a.json"])
def test_a_second_command_into_a_folder_is_refused_before_its_work(
    words, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    small_dataset(tmp_path / "set")
    for module, work in ((experiment, "Twin"), (depth, "Twin"), (calibrate, "calibrate")):
        monkeypatch.setattr(module, work, None)
    option = "--report" if words.startswith("calibrate") else "--out"
    monkeypatch.setattr(sys, "argv", ["vergence", *words.split(), option, "r"])
    with results_folder(Path("r")), pytest.raises(SystemExit, match="2"):
        cli.main()
    assert "Another process is writing results into r; wait for it" in capsys.readouterr().err


def test_a_link_stays_a_link_and_leads_to_what_was_written(tmp_path):
    (tmp_path / "link.txt").symlink_to("target.txt")
    write_whole(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "target.txt").read_text() == "new"
    assert finished_files[-1] == tmp_path / "link.txt"


def test_permissions_are_those_of_the_user_and_stay(tmp_path):
    """In a process of its own, whose umask keeps others out."""
    program = (
        "import os, pathlib\nos.umask(0o077)\n"
        "from vergence.files import whole_folder, write_whole\n"
        "write_whole(pathlib.Path('new.txt'), 'a')\n"
        "write_whole(pathlib.Path('shared.txt'), 'a')\n"
        "with whole_folder(pathlib.Path('set')):\n    pass\n"
    )
    (tmp_path / "shared.txt").touch(mode=0o664)
    (tmp_path / "shared.txt").chmod(0o664)
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
    assert modes == {"new.txt": 0o600, "shared.txt": 0o664, "set": 0o700}


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    with pytest.raises(ValueError, match="odd"), whole_folder(tmp_path / "set") as part:  # noqa: PT012
        (part / "a.txt").write_text("half")
        raise ValueError("odd")
    assert list(tmp_path.iterdir()) == []
    with whole_folder(tmp_path / "set") as part:
        (part / "a.txt").write_text("whole")
        (tmp_path / "set").mkdir()
        (tmp_path / "set" / "b.txt").write_text("of another process, which was faster")
        with (
            pytest.raises(VergenceError, match="already exists and is not empty"),
            whole_folder(tmp_path / "set"),
        ):
            pass
        (tmp_path / "set" / "b.txt").unlink()
    assert [path.name for path in (tmp_path / "set").iterdir()] == ["a.txt"]


def test_what_is_not_finite_is_null_in_json(tmp_path):
    write_json({"a": float("nan"), "b": [1.0, float("-inf")]}, tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": None, "b": [1.0, None]}
    assert as_json({"x": 0.1 + 0.2}) == '{\n "x": 0.30000000000000004\n}\n'


def test_an_output_that_is_also_an_input_is_refused(tmp_path):
    (tmp_path / "link").symlink_to("a.json")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "a.json").write_text("{}")
    read = [tmp_path / "a.json", tmp_path / "circle", Path("\0")]
    for outputs, folder, names in (
        ([tmp_path / "link"], None, []),
        ([tmp_path / "new" / ".." / "a.json"], None, []),
        ([], tmp_path, ["b.json", "a.json"]),
    ):
        with pytest.raises(VergenceError, match="it is also the file that is read"):
            check_outputs(*outputs, folder=folder, names=names, inputs=read)
    check_outputs(folder=tmp_path, names=["b.json"], inputs=read)


@pytest.mark.render
def test_a_stopped_command_says_what_it_had_finished(tmp_path):
    out = tmp_path / "paper"
    command = [sys.executable, "-m", "vergence", "reproduce", "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    while not (out / UNFINISHED).exists() and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM, said
    assert said.strip().splitlines()[-1] == "vergence: stopped; nothing was written."
    assert not out.exists()
