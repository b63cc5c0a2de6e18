"""Tasks for tests of processes: a process imports this module, and no test."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2

from vergence.progress import Progress
from vergence.writing import write_whole


def count_up(name: str, steps: int, progress: Progress) -> Iterator[tuple[str, int, int]]:
    for step in range(steps):
        progress(name, step, steps)
        yield name, step, os.getpid()


def write(path: Path, progress: Progress) -> Iterator[Path]:
    write_whole(path, "whole")
    yield path


def fail(error: Exception, progress: Progress) -> Iterator[None]:
    raise error


def end(progress: Progress) -> Iterator[None]:
    os._exit(1)


def wait_for_ever(path: Path, progress: Progress) -> Iterator[None]:
    try:
        progress("waiting", 0, 1)
        time.sleep(60)
        yield
    finally:
        time.sleep(0.1)  # it takes its time
        path.write_text("cleaned up")


def opencv_threads(progress: Progress) -> Iterator[int]:
    yield cv2.getNumThreads()
