"""Progress bars, and what is left of an earlier run that was stopped."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from vergence.progress import Progress
from vergence.writing import unfinished


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Show each task as a bar on standard error."""
    columns = TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn()
    bars, tasks = Bars(*columns, TimeElapsedColumn(), console=Console(stderr=True)), {}

    def show(task: str, done: int, total: int) -> None:
        bars.start()  # not earlier: refused arguments have no bar
        if task not in tasks:
            tasks[task] = bars.add_task(task, total=total)
        bars.update(tasks[task], completed=done, total=total)

    try:
        yield show
    finally:
        if tasks:
            bars.stop()


def say_if_unfinished(folder: Path | None) -> None:
    """Warn that files in a folder may be of different runs."""
    if folder is not None and unfinished(folder):
        print(
            f"An earlier run into {folder} was stopped before its end: until this one has ended, "
            "files there may be of different runs.",
            file=sys.stderr,
        )
