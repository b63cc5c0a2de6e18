"""Options that commands share, and the check of the files that options name."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import tyro

from vergence.errors import VergenceError
from vergence.files import REPORT, UNFINISHED, check_writable

T = TypeVar("T")

Optional = Annotated[T | None, tyro.conf.arg(help_behavior_hint="")]
"""An option whose description states what its absence means."""
Positional = tyro.conf.Positional
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Points = Annotated[tuple[tuple[float, float, float], ...], tyro.conf.UseAppendAction]
Geometry = Literal["joints", "seen"]
"""As in `self_calibration.calibrator`; repeated here since importing that needs numpy."""


@dataclass(frozen=True)
class TwinOptions:
    """Options of every command that runs the twin."""

    seed: int = 0
    """Seed of everything random."""
    profile: str = "ideal"
    """Error profile of the twin: ideal, paper, noise-only, or a TOML file."""
    scene: Literal["room", "sparse", "moving"] = "room"
    """What the head looks at."""
    head: Optional[Path] = None
    """The head, a head.toml as `vergence head` writes it; default: the one of this project."""


@dataclass(frozen=True)
class ViewerOptions:
    """Options of commands that can be watched while they run."""

    live: Flag = False
    """Show the run while it goes on, in a window of rerun."""
    serve: Optional[int] = None
    """Port of a page that shows the run while it goes on, in a browser on this computer."""


@dataclass(frozen=True)
class ExperimentOptions(TwinOptions, ViewerOptions):
    """Options that foveate, track and grasp have in common."""

    geometry: Geometry = "joints"
    """Locate objects by the joint readings, or by readings corrected by vision (seen)."""
    out: Optional[Path] = None
    """Folder for the summary as JSON and a recording; left out: the summary is only printed."""
    json: Optional[Path] = None
    """JSON file of the summary."""


@dataclass(frozen=True)
class BagOptions:
    """Options of a bag that is recorded beside a dataset."""

    bag: Optional[Literal["ros1", "ros2", "mcap"]] = None
    """Bag of ROS 1, or of ROS 2 in SQLite or MCAP, that is written too; default: none."""
    joint_rate: float = 100.0
    """Rate of the joint readings in the bag [Hz]; 0: one reading an image, as in the dataset."""
    missing: float = 0.0
    """Part of the joint messages that is lost, from 0 to less than 1."""
    camera_info: Flag = False
    """Write the true lenses into the bag."""


IDEAL, PAPER = TwinOptions(), TwinOptions(profile="paper")
EXPERIMENT, NO_BAG, NO_VIEWER = ExperimentOptions(), BagOptions(), ViewerOptions()
TwinArguments = Annotated[TwinOptions, tyro.conf.arg(name="")]
ViewerArguments = Annotated[ViewerOptions, tyro.conf.arg(name="")]
BagArguments = Annotated[BagOptions, tyro.conf.arg(name="")]
ExperimentArguments = Annotated[ExperimentOptions, tyro.conf.arg(name="")]

DATASET_FILES = ("dataset.json", "frames.csv")
IDENTIFYING = (
    "dataset.json", "dataset.rrd", "depth.rrd", "design.json", "foveate.rrd", "grasp.rrd",
    "head.rrd", "statistics.json", "track.rrd",
)  # fmt: skip
"""Files that identify a folder as a dataset, or as the results of a command."""


def check_outputs(
    *outputs: Path | None,
    figure: Path | None = None,
    folder: Path | None = None,
    names: Iterable[str] = (),
    inputs: Iterable[Path | str | None] = (),
) -> None:
    """Check that files and a folder of results can be written, without creating any.

    Args:
        outputs: files to write; None: not requested.
        figure: PNG file to write.
        folder: folder of results.
        names: files to write into the folder.
        inputs: files and folders of datasets that the command reads.

    Raises:
        VergenceError: a path cannot be written, two paths are the same, one is an input or the
            folder, the folder holds results of another command, or the figure's name does not end
            in .png.
    """
    if figure is not None and figure.suffix.lower() != ".png":
        raise VergenceError(f"A figure is a PNG file, whose name ends in .png; found {figure}.")
    read = [Path(path) / name for path in inputs if path for name in ("", *DATASET_FILES)]
    taken = {path.resolve(): "the file that is read" for path in read if os.path.isfile(path)}
    names = tuple(names)
    if folder is not None:
        place = check_writable(folder, folder=True)
        outputs = (*outputs, *(folder / name for name in (*names, UNFINISHED)))
        taken |= dict.fromkeys((place, *place.parents), "a folder of other results")
    for path in filter(None, (*outputs, figure)):
        place = check_writable(path)
        if place in taken:
            raise VergenceError(f"Cannot write {path}: it is also {taken[place]}.")
        taken[place] = "the file of another result"
    there = set(os.listdir(folder)) if folder is not None and folder.is_dir() else set()
    foreign = (there & set(IDENTIFYING)) - set(names)
    if REPORT in there & set(names) and not there & (set(names) - {REPORT}):
        foreign.add(REPORT)
    if foreign:
        raise VergenceError(
            f"{folder} holds {min(foreign)}, which this command did not write. Name another folder."
        )
