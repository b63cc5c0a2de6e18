"""Ground truth of a dataset recorded on the twin: truth.json in the dataset's folder.

Only evaluation reads it; calibration never does.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import Matrix, Transform
from vergence.files import read_json
from vergence.geometry.board import Charuco, Chessboard
from vergence.geometry.head import HeadCalibration
from vergence.twin.profile import ErrorProfile

TRUTH = "truth.json"
"""Name of the file in the folder of the dataset."""


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Truth:
    """Ground truth of a dataset."""

    head: HeadCalibration
    """The head as built, with gains and offsets that turn joint readings into true angles."""
    time_offset_s: float
    """Time from a joint reading to the moment that its image shows."""
    eye_angles: Matrix
    """(N, r) true angles [rad] at the moment of each row's images, in the order of the readings."""
    T_lbase_target: dict[int, Transform]
    """True pose of the board, by the number of its placement."""
    board: Chessboard | Charuco
    """The board as printed; dataset.json may state wrong dimensions."""
    seed: int
    lens: str
    profile: ErrorProfile
    format: Literal["vergence-truth-1"] = "vergence-truth-1"


def load(path: Path) -> Truth:
    """Read a truth.json. Raises VergenceError as `read_json` does."""
    return read_json(path, Truth, TRUTH)
