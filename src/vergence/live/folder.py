"""A driver for frames that another program writes into a folder, as a dataset that grows."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from vergence.data.dataset import Frame
from vergence.data.description import FRAMES
from vergence.data.reader import load_dataset, load_description
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand

POLL_S = 0.05
"""Time between two looks at the folder [s]; a frame of 20 Hz."""
TORN_S = 2.0
"""Time for which a new line, or its images, may be incomplete [s]."""


class FolderHead:
    """The head whose frames appear in a folder: dataset.json, images, and lines of frames.csv.

    Images are written before their line. If lines come faster than they are read, the latest one
    counts.
    """

    limits = None

    def __init__(self, folder: Path):
        """Read dataset.json; VergenceError if it is missing."""
        self.description = load_description(folder)
        self._table, self._rows, self._time_s = folder / FRAMES, 0, 0.0
        self._fails_s: float | None = None

    def now_s(self) -> float:
        """Return the time of the latest frame [s]."""
        return self._time_s

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Read the images of a new line; None if no line was added."""
        rows = self._table.read_text("utf-8").count("\n") - 1 if self._table.exists() else 0
        if rows <= self._rows:
            time.sleep(POLL_S)
            return None
        try:
            dataset = load_dataset(self._table.parent)
            frame = dataset.frame(len(dataset) - 1)
        except VergenceError:
            self._fails_s = self._fails_s or time.monotonic()
            if time.monotonic() > self._fails_s + TORN_S:
                raise
            time.sleep(POLL_S)
            return None
        self._rows, self._time_s, self._fails_s = rows, frame.time_s, None
        return frame

    def command(self, command: HeadCommand) -> None:
        """Ignore the command."""

    def close(self) -> None:
        """Leave the folder as it is."""
