"""The terminal: progress bars, commands to type, and programs that end without a traceback."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vergence.errors import VergenceError
from vergence.files import UNFINISHED, finished_files

if TYPE_CHECKING:
    from vergence.cli.options import ViewerOptions
    from vergence.progress import Progress
    from vergence.viewer.live import Viewer


@contextmanager
def plain_ending(program: str) -> Iterator[None]:
    """End a program named `program` in one sentence and an exit code.

    VergenceError exits with 2. Ctrl-C and SIGTERM name the files that were finished before, or
    print the note of the interrupt in their place.
    """
    try:
        if sys.stdout is None:
            raise VergenceError("Standard output is closed; redirect it to a file or to /dev/null.")
        signal.signal(signal.SIGINT, _stop)
        signal.signal(signal.SIGTERM, _stop)
        try:
            yield
        finally:
            sys.stdout.flush()
    except VergenceError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        _discard_output()
        raise SystemExit(128 + signal.SIGPIPE) from None
    except MemoryError:
        print(f"{program}: There is too little memory.", file=sys.stderr)
        raise SystemExit(2) from None
    except OSError as error:
        _discard_output()
        of = error.filename or "standard output, or the folder of the command"
        reason = f"{error.strerror} ({of})" if error.strerror else error  # of a driver
        print(f"{program}: Cannot go on: {reason}.", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt as stop:
        done = " ".join(map(str, finished_files))
        note = f"finished before: {done}" if done else "nothing was written"
        print(f"{program}: stopped; {note}.", file=sys.stderr)
        raise SystemExit(128 + (stop.args[0] if stop.args else signal.SIGINT)) from None


def _stop(number: int, frame: object) -> None:
    raise KeyboardInterrupt(number)


def _discard_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def invocation(program: str, *arguments: str | Path) -> str:
    """Quote a command line that runs a program of this Python environment in the current folder.

    The program is named with its folder unless the shell finds the same one without it.
    """
    here = shutil.which(program, path=sysconfig.get_path("scripts"))
    on_path = shutil.which(program)
    if here is not None and (on_path is None or not os.path.samefile(on_path, here)):
        below = Path.cwd() in Path(here).parent.parents
        program = str(Path(here).relative_to(Path.cwd())) if below else here
    return shlex.join([program, *map(str, arguments)])


@contextmanager
def progress_bars(folder: Path | None = None) -> Iterator[Progress]:
    """Show each task as a bar on standard error.

    Warn first if an earlier run into `folder` was stopped before its end.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    if folder is not None and os.path.exists(folder / UNFINISHED):
        print(
            f"An earlier run into {folder} was stopped before its end: until this one has ended, "
            "files there may be of different runs.",
            file=sys.stderr,
        )
    columns = TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn()
    bars, tasks = Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True)), {}

    def show(task: str, done: int, total: int) -> None:
        bars.start()  # refused arguments show no bar
        if task not in tasks:
            tasks[task] = bars.add_task(task, total=total)
        bars.update(tasks[task], completed=done, total=total)

    try:
        yield show
    finally:
        if tasks:
            bars.stop()


@contextmanager
def viewing(options: ViewerOptions) -> Iterator[tuple[Viewer | None, ExitStack]]:
    """Open the viewer that options ask for, for a `with` block and for that of its report.

    Yields the viewer, if any, and the block for `Report.shown`: at its end a page that is served
    waits for Ctrl-C.
    """
    shown = ExitStack()
    if not options.live and options.serve is None:
        yield None, shown
        return
    if options.live and options.serve is not None:
        raise VergenceError("--live opens a window, --serve a page; choose one of the two.")
    from vergence.viewer.live import open_viewer, stay

    with ExitStack() as opened:
        viewer = opened.enter_context(open_viewer(options.serve))
        yield viewer, shown
        opened.callback(stay, viewer)
        shown.enter_context(opened.pop_all())
