"""Commands that are stopped at random moments, and two that write the same result at once.

A command is started in a process of its own and gets SIGKILL, SIGTERM or SIGINT after a random
time. What then bears a final name must be whole, a folder whose files may be of different runs must
be marked, the next run must succeed and leave no temporary behind. Two processes that write the
same result must both tell the truth: one of them, or both, say that they wrote it, and the file is
whole.

    python benchmarks/stopped_and_doubled.py [--moments 50] [--pairs 50]
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import tyro
from PIL import Image
from rerun.chunk import RrdReader

from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.files import UNFINISHED, unfinished
from vergence.geometry.head import load_head
from vergence.interchange.formats import import_head

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
VERGENCE = (sys.executable, "-m", "vergence")


@dataclass(frozen=True)
class Command:
    """A command line, and the folder in which all its results stand."""

    arguments: tuple[str, ...]
    folder: Path
    marked: bool = True
    """Whether its results are several files that belong together."""


def commands(root: Path) -> dict[str, Command]:
    """Return the commands that are tried; `root` has a dataset `set` and its `head.json`."""

    def out(name: str) -> Path:
        return root / name

    short = ("--figures", "6", "7", "--duration", "2", "--rate", "3")
    made = out("calibrated")
    return {
        "reproduce": Command(("reproduce", "--out", f"{out('paper')}", *short), out("paper")),
        "record": Command(
            ("record", "--out", f"{out('recorded') / 'set'}", "--frames", "12"),
            out("recorded"),
            marked=False,
        ),
        "calibrate": Command(
            (
                *("calibrate", f"{root / 'set'}", "--out", f"{made / 'head.json'}"),
                *("--json", f"{made / 'accuracy.json'}", "--report", f"{made / 'report'}"),
            ),
            made,
        ),
        "export opencv": Command(
            (
                *("export", f"{root / 'head.json'}", "--format", "opencv"),
                *("--out", f"{out('exported') / 'head.yml'}"),
            ),
            out("exported"),
            marked=False,
        ),
        "export ros": Command(
            ("export", f"{root / 'head.json'}", "--format", "ros", "--out", f"{out('ros')}"),
            out("ros"),
        ),
        "track": Command(("track", "--seconds", "3", "--out", f"{out('track')}"), out("track")),
    }


def prepare(root: Path) -> None:
    """Record and calibrate a dataset, which takes half a minute."""
    root.mkdir(parents=True, exist_ok=True)
    if not (root / "head.json").exists():
        run(["record", "--out", f"{root / 'set'}", "--frames", "12"])
        run(["calibrate", f"{root / 'set'}", "--out", f"{root / 'head.json'}"])


def run(arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; CalledProcessError if it fails."""
    return subprocess.run([*VERGENCE, *arguments], capture_output=True, text=True, check=True)


def start(arguments: Sequence[str]) -> subprocess.Popen[str]:
    """Start a command."""
    return subprocess.Popen(
        [*VERGENCE, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def broken(folder: Path) -> list[str]:
    """Return what is not whole among the files of a folder that bear a final name."""
    found = []
    for path in sorted(folder.rglob("*")) if folder.exists() else []:
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        try:
            check_whole(path)
        except Exception as error:
            found.append(f"{path.relative_to(folder)}: {type(error).__name__} {error}")
    return found


def check_whole(path: Path) -> None:
    """Raise an error of any kind if a file, or a dataset's folder, is not whole."""
    if path.name == UNFINISHED or path.parent.name == "images":
        return
    if path.is_dir():
        if (path / "frames.csv").exists() or path.name == "set":
            dataset = load_dataset(path)
            for row in range(len(dataset)):
                dataset.frame(row)
            json.loads((path / "truth.json").read_text())
        return
    readers: dict[str, Callable[[Path], object]] = {
        ".json": lambda path: json.loads(path.read_text()),
        ".rrd": lambda path: RrdReader(path).recordings()[0],
        ".png": lambda path: Image.open(path).load(),
        ".yml": lambda path: import_head(path, "opencv"),
        ".urdf": ElementTree.parse,
    }
    if path.name.startswith("calibration-") or path.name == "head.json":
        load_head(path)
    readers.get(path.suffix, lambda path: path.read_text())(path)
    if path.stat().st_size == 0:
        raise ValueError("it is empty")


def temporaries(folder: Path) -> list[str]:
    """Return the temporary files and folders that are left beside the results."""
    return [path.name for path in folder.rglob(".*.part")]


def stop_at(command: Command, after_s: float, number: int) -> list[str]:
    """Return what is wrong after a command was stopped; its earlier results may be there."""
    before = {path: path.stat().st_mtime_ns for path in files(command.folder)}
    process = start(command.arguments)
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    _, said = process.communicate()
    wrong = broken(command.folder)
    name = signal.Signals(number).name
    ended = process.returncode
    if ended == -number and not said:
        return wrong  # killed, or stopped while Python was still starting: it had done nothing
    # Python ends with -SIGINT where the signal met code that it was making, as dataclasses do.
    if ended not in (0, 128 + number, -signal.SIGINT):
        wrong.append(f"{name}: exit code {ended}: {said[-300:]}")
    if "Traceback" in said:
        wrong.append(f"{name}: {said[-600:]}")
    if number != signal.SIGKILL and (left := temporaries(command.folder)):
        wrong.append(f"{name}: temporaries {left}")
    after = {path: path.stat().st_mtime_ns for path in files(command.folder)}
    changed = {path.parent for path in after if after[path] != before.get(path)}
    kept = {path.parent for path in after if after[path] == before.get(path)}
    mixed = [folder for folder in changed & kept if folder != command.folder or command.marked]
    if command.marked and ended != 0:
        apart = "calibrate" in command.arguments  # the calibration is a file of its own
        for folder in mixed:
            if not unfinished(folder) and not (apart and folder == command.folder):
                wrong.append(f"{name}: {folder.name} has results of two runs and no mark")
    if said and number != signal.SIGKILL and ended == 128 + number:
        wrong += untrue(said, command.folder, before)
    return wrong


def files(folder: Path) -> list[Path]:
    """Return the files of a folder that bear a final name, the mark left out."""
    return [
        path
        for path in (folder.rglob("*") if folder.exists() else [])
        if path.is_file() and path.name != UNFINISHED and not path.match(".*.part/**")
        and not any(part.endswith(".part") for part in path.parts)
    ]  # fmt: skip


def untrue(said: str, folder: Path, before: dict[Path, int]) -> list[str]:
    """Return what an interrupted command said that is not true of its files."""
    wrong = []
    line = next((line for line in said.splitlines() if line.startswith("vergence: stopped")), "")
    if not line:
        return [f"it said: {said[-300:]}"]
    named = line.rpartition("finished before: ")[2].rstrip(".").split() if ":" in line[9:] else []
    for name in named:
        if not Path(name).exists():
            wrong.append(f"it said that {name} was finished")
    new = [path for path in files(folder) if path.stat().st_mtime_ns != before.get(path)]
    if new and "nothing was written" in line:
        wrong.append(f"it said that nothing was written, but {new[0].name} was")
    return wrong


def stopped(tried: dict[str, Command], moments: int, seed: int) -> None:
    """Stop each command at random moments, and print what is wrong."""
    rng = np.random.default_rng(seed)
    for name, command in tried.items() if moments else ():
        shutil.rmtree(command.folder, ignore_errors=True)
        began = time.perf_counter()
        run(command.arguments)
        length = time.perf_counter() - began
        ends: Counter[str] = Counter()
        wrong: list[str] = []
        for k in range(moments):
            number = SIGNALS[k % len(SIGNALS)]
            if name == "record":
                shutil.rmtree(command.folder / "set", ignore_errors=True)
            found = stop_at(command, float(rng.uniform(0, 1.1 * length)), number)
            wrong += found
            ends["wrong" if found else "right"] += 1
        if name == "record":
            shutil.rmtree(command.folder / "set", ignore_errors=True)
        run(command.arguments)
        left = temporaries(command.folder) + [
            str(path) for path in command.folder.rglob(UNFINISHED)
        ]
        wrong += [f"left after the next run: {each}" for each in left]
        print(f"{name}: stopped {moments} times, {ends['wrong']} wrong", flush=True)
        for each in wrong:
            print("   ", each)


def doubled(tried: dict[str, Command], pairs: int) -> None:
    """Start each command twice at once, and print what is wrong."""
    for name, command in tried.items() if pairs else ():
        ends: Counter[str] = Counter()
        wrong: list[str] = []
        for _ in range(pairs):
            if name == "record":
                shutil.rmtree(command.folder, ignore_errors=True)
            processes = [start(command.arguments) for _ in range(2)]
            said = [process.communicate() for process in processes]
            codes = [process.returncode for process in processes]
            ends["both" if codes == [0, 0] else "one"] += 1
            for code, (_, error) in zip(codes, said, strict=True):
                refused = "Another process" in error or "not empty" in error
                if code not in (0, 2) or (code == 2 and not refused) or "Traceback" in error:
                    wrong.append(f"exit code {code}: {error[-300:]}")
            if 0 not in codes:
                wrong.append("neither wrote the result")
            wrong += broken(command.folder) + temporaries(command.folder)
            if unfinished(command.folder):
                wrong.append("the folder is marked")
        print(f"{name}: {pairs} pairs, {dict(ends)} said they wrote it, {len(wrong)} wrong")
        for each in wrong:
            print("   ", each, flush=True)


def main(
    moments: int = 50,
    pairs: int = 50,
    only: tuple[str, ...] = (),
    seed: int = 0,
    out: Path = Path("runs/stopped_and_doubled"),
) -> None:
    """Print what goes wrong, by command.

    Args:
        moments: number of times that each command is stopped.
        pairs: number of times that each command is run twice at once.
        only: names of the commands, such as reproduce or "export ros"; default: all.
        seed: of the moments.
        out: folder for the results.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        prepare(out)
        tried = {name: each for name, each in commands(out).items() if not only or name in only}
        stopped(tried, moments, seed)
        doubled(tried, pairs)
    except (subprocess.CalledProcessError, VergenceError) as error:
        print(getattr(error, "stderr", error))
        raise SystemExit(1) from None


if __name__ == "__main__":
    tyro.cli(main)
