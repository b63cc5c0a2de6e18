"""Run tasks in processes with joblib: their progress, their errors and their end."""

from __future__ import annotations

import json
import os
import signal
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import joblib
from joblib.externals.loky.backend import resource_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError

from vergence.errors import VergenceError
from vergence.progress import Progress, silent

T = TypeVar("T")
POLL_S = 0.2
"""Period [s] of reading the workers' progress; below what a progress bar shows."""
_SIGNALS = {signal.SIGINT, signal.SIGTERM}


def process_count(jobs: int) -> int:
    """Resolve a number of processes; -1: one for each core. VergenceError for 0 or below -1."""
    if jobs == 0 or jobs < -1:
        raise VergenceError(
            f"--jobs takes a number of processes, or -1 for all cores, found {jobs}."
        )
    return joblib.effective_n_jobs(jobs)


def run_tasks(
    tasks: Sequence[Callable[[Progress], T]],
    finished: Callable[[T], None],
    *,
    jobs: int,
    progress: Progress = silent,
) -> None:
    """Run tasks, and pass each result to `finished` in the order of completion.

    Tasks report to the progress that they are called with. One job or a single task runs in this
    process. Otherwise tasks and results are pickled, and a script needs
    `if __name__ == "__main__":`. An error or an interrupt ends all processes; errors of tasks are
    raised as they are, and VergenceError if a process was killed.
    """
    count = min(process_count(jobs), len(tasks))
    if count <= 1:
        for task in tasks:
            finished(task(progress))
        return
    with _followed(progress) as steps, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # joblib's, of results that were not taken
        run = joblib.Parallel(count, return_as="generator_unordered", max_nbytes=None)
        # Workers inherit that signals are blocked: this process alone handles them, and kills them.
        _start_tracker()  # its start unblocks them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            results: Any = run(
                joblib.delayed(_run)(task, steps, os.getpid(), count) for task in tasks
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        with closing(results):
            try:
                for result in results:
                    finished(result)
            except TerminatedWorkerError:
                raise VergenceError(
                    "A process ended before its work was done, perhaps for want of memory; fewer "
                    "processes (--jobs) need less."
                ) from None


def _start_tracker() -> None:
    """Start the process that removes what killed workers leave, without its warnings of that.

    It outlives this process, and would have the last word in its place.
    """
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = "ignore"
    try:
        resource_tracker.ensure_running()
    finally:
        del os.environ["PYTHONWARNINGS"]
        os.environ.update({} if before is None else {"PYTHONWARNINGS": before})


@contextmanager
def _followed(progress: Progress) -> Iterator[Path]:
    """Give a `with` block a file whose lines, appended by workers, are passed on as progress."""
    ended = threading.Event()
    with tempfile.NamedTemporaryFile("r", suffix=".steps") as file:

        def follow() -> None:
            while True:
                last = ended.wait(POLL_S)
                for line in file:
                    progress(*json.loads(line))
                if last:
                    return

        thread = threading.Thread(target=follow, daemon=True)
        thread.start()
        try:
            yield Path(file.name)
        finally:
            ended.set()
            thread.join()


def _run(task: Callable[[Progress], T], steps: Path, parent: int, count: int) -> T:
    """Run a task in a worker."""

    def tell(*step: Any) -> None:
        with steps.open("a") as file:
            file.write(json.dumps(step) + "\n")

    _settle(parent, count)
    return task(tell)


@cache
def _settle(parent: int, count: int) -> None:
    """Share the cores among the workers, and end this one when its parent was killed."""
    import cv2

    cv2.setNumThreads(max(1, (os.cpu_count() or 1) // count))

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
