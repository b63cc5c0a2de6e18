"""Tasks in processes of their own, side by side, with their progress.

A process that ends takes its tasks with it and no other: Ctrl-C and errors end all of them, what
they were writing is removed, and none outlives the process that started it.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol, TypeVar

import cv2
import joblib

from vergence.errors import VergenceError
from vergence.progress import Progress
from vergence.writing import add_finished, finished_files

_STOP = {signal.SIGINT, signal.SIGTERM}

T = TypeVar("T")
Task = Callable[[Progress], Iterable[T]]
"""Yields its results, and calls the progress that it is given."""


class Run(Protocol):
    """Run tasks, and yield what they yield as it comes."""

    def __call__(self, tasks: Sequence[Task[T]], progress: Progress) -> Iterator[T]: ...


def process_count(jobs: int) -> int:
    """Return how many processes are asked for; -1: as many as there are cores.

    VergenceError if none is asked for, or fewer.
    """
    if jobs == 0 or jobs < -1:
        raise VergenceError(
            f"--jobs takes a number of processes, or -1 for all cores, found {jobs}."
        )
    return joblib.effective_n_jobs(jobs)


@contextmanager
def processes(jobs: int) -> Iterator[Run]:
    """Give a `with` block a function that runs up to a number of tasks side by side.

    One job, or a single task, runs in this process. Else tasks and results are pickled, and a
    script needs `if __name__ == "__main__":`, since each process imports it.
    """
    workers: list[tuple[SpawnProcess, Connection]] = []
    try:
        yield _in_turn if jobs == 1 else partial(_side_by_side, workers, jobs)
    finally:
        for process, _ in workers:
            process.terminate()
        while workers:  # one that was being started may have come to them
            process, link = workers.pop()
            process.terminate()
            link.close()
            process.join()


def _in_turn(tasks: Sequence[Task[T]], progress: Progress) -> Iterator[T]:
    for task in tasks:
        yield from task(progress)


def _side_by_side(
    workers: list[tuple[SpawnProcess, Connection]],
    jobs: int,
    tasks: Sequence[Task[T]],
    progress: Progress,
) -> Iterator[T]:
    if len(tasks) == 1:
        yield from _in_turn(tasks, progress)
        return
    # In a thread, which no signal interrupts: a process that is half started could not be ended.
    with ThreadPoolExecutor(max_workers=1) as starter:
        starter.submit(_start, workers, min(jobs, len(tasks))).result()
    waiting, idle, busy = list(tasks), [link for _, link in workers], list[Connection]()
    while waiting or busy:
        while waiting and idle:
            link = idle.pop()
            with _noticing_its_end():
                link.send(waiting.pop(0))
            busy.append(link)
        for link in wait(busy):
            assert isinstance(link, Connection)
            with _noticing_its_end():
                kind, *values = link.recv()
            if kind == "progress":
                progress(*values)
            elif kind == "result":
                yield values[0]
            elif kind == "error":
                raise values[0]
            else:
                add_finished(values[0])
                busy.remove(link)
                idle.append(link)


@contextmanager
def _noticing_its_end() -> Iterator[None]:
    """Raise a VergenceError if the process at the other end of a link has ended."""
    try:
        yield
    except (EOFError, OSError):
        raise VergenceError(
            "A process ended before its work was done, perhaps for want of memory; fewer "
            "processes (--jobs) need less."
        ) from None


def _start(workers: list[tuple[SpawnProcess, Connection]], count: int) -> None:
    """Start processes that wait for tasks, until there are `count` of them.

    They inherit that signals are blocked, and let them through once they can handle them.
    """
    resource_tracker.ensure_running()  # else it would start with them, and let signals through
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOP)
    context = multiprocessing.get_context("spawn")  # a copy of this one could not use OpenGL
    threads = max(1, joblib.effective_n_jobs(-1) // count)
    while len(workers) < count:
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, threads), daemon=True)
        process.start()
        theirs.close()  # so that either side notices when the other has ended
        workers.append((process, ours))


def _work(link: Connection, threads: int) -> None:
    """Do tasks until the other end of the link is closed; OpenCV uses a number of threads."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started this process ends it
    signal.signal(signal.SIGTERM, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOP)
    cv2.setNumThreads(threads)  # more than there are cores would wait for each other
    try:
        while True:
            task, before = link.recv(), len(finished_files())
            try:
                for result in task(partial(_tell, link)):
                    link.send(("result", result))
            except (EOFError, BrokenPipeError):
                raise
            except Exception as error:
                if not isinstance(error, VergenceError):
                    error.add_note(traceback.format_exc())
                link.send(("error", error))
            else:
                link.send(("end", finished_files()[before:]))
    except (EOFError, OSError):
        return


def _leave(*_: object) -> None:
    """End this process, once: a task that cleans up after itself is not stopped in this again."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit()


def _tell(link: Connection, *progress: Any) -> None:
    link.send(("progress", *progress))
