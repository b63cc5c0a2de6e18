"""Tasks for the tests of processes; workers import this module and no test."""

import os
import time
from pathlib import Path

import cv2

from vergence.files import whole_file
from vergence.progress import Progress


def count_up(name: str, steps: int, progress: Progress) -> tuple[str, int]:
    for step in range(steps):
        progress(name, step, steps)
    return name, os.getpid()


def fail(error: Exception, progress: Progress) -> None:
    raise error


def end(progress: Progress) -> None:
    os._exit(1)


def write_for_ever(path: Path, progress: Progress) -> None:
    with whole_file(path) as part:
        part.write_text("half")
        progress("writing", 0, 1)
        time.sleep(60)


def opencv_threads(progress: Progress) -> int:
    return cv2.getNumThreads()
