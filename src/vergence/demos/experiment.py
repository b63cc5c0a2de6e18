"""Settings and calibrated twin that the demos have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, check_seed
from vergence.files import results_folder, write_json
from vergence.gaze.state import GazeSettings
from vergence.progress import Progress
from vergence.self_calibration.calibrator import Geometry, VisualGeometry, initial_visual_geometry
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene import Scene
from vergence.twin.simulated_robot import calibrate_twin, learn_by_looking

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

LOOKING = 100_000
"""Number of the run in which the twin looks around first, beyond those of trials."""


@dataclass(frozen=True)
class Experiment:
    """The settings that foveate, track and grasp have in common."""

    profile: ErrorProfile
    """Imperfections of the head."""
    seed: int = 0
    """Seed of everything random."""
    scene: Scene = "room"
    """What the head looks at."""
    geometry: Geometry = "joints"
    """How objects are located. With "seen" the head looks around first, and keeps what it learns
    from trial to trial."""
    out: Path | None = None
    """Folder for the summary as JSON, and for a recording; None: nothing is written."""

    def __post_init__(self) -> None:
        check_seed(self.seed)


def p95(values: Sequence[float] | Array) -> float:
    """Select the 95 % quantile among values."""
    return float(np.quantile(values, 0.95, method="higher"))


@contextmanager
def calibrated_twin(
    experiment: Experiment, progress: Progress
) -> Iterator[tuple[Twin, GazeSettings]]:
    """Calibrate a twin for a `with` block, and make the settings of its gaze controller.

    The folder of results is marked as unfinished from before the calibration until the block ends.
    """
    with (
        results_folder(experiment.out),
        Twin(experiment.profile, seed=experiment.seed, scene=experiment.scene) as twin,
    ):
        settings = calibrate_twin(twin, experiment.seed, progress)
        yield twin, replace(settings, geometry=experiment.geometry)


def initial_geometry(twin: Twin, settings: GazeSettings) -> VisualGeometry | None:
    """Let the twin look around if its geometry is seen; None: it is that of the joints."""
    if settings.geometry == "joints":
        return None
    left, right = settings.wide
    geometry = initial_visual_geometry(settings.calibration, cameras=(left, right))
    return learn_by_looking(twin, geometry, run=LOOKING)


def check_trials(trials: int) -> None:
    """Raise VergenceError unless a number of trials can be made."""
    if not 1 <= trials <= 10_000:
        raise VergenceError(f"Asked for {trials} trials; from 1 to 10000 can be made.")


def write_summary(out: Path | None, name: str, summary: DataclassInstance) -> None:
    """Write a demo's summary to `name`.json in a folder; None: nothing is written."""
    if out is not None:
        write_json(summary, out / f"{name}.json")
