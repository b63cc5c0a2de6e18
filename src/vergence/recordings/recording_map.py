"""What channels of a recording mean: the description of a dataset, with the source of each part.

A map is a TOML file with the fields of dataset.json (docs/dataset.md). A camera also names its
channel of images, and the column of a joint is the joint's name in the recording, or
`channel:name` where two channels have a joint of that name.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from vergence.data.description import STRICT, BoardAndJoints, DatasetCamera, Description
from vergence.files import read_parsed, validated
from vergence.geometry.camera import Camera
from vergence.geometry.kinematics import Side

UNKNOWN = "?"
"""Stands in a first map for what cannot be guessed."""
MAX_GAP_S = 0.1
"""Longest time [s] over which readings are interpolated, if the map states none: eyes that swing by
0.2 rad at 0.5 Hz are then at most 2.5 mrad off the line."""
MAX_MAP_BYTES = 2**18
"""Largest map [bytes]; one of 64 cameras has 20 kB."""
Span = tuple[float, float]
"""Begin and end [s] after the first image of the recording."""
Stamps = Literal["header", "received"]
"""Which times count: those in the messages, or those of the recorder."""


@dataclass(frozen=True, eq=False, config=STRICT)
class CameraSource:
    """A camera of the head, and where its images are."""

    eye: Side
    images: str
    """Channel with its images."""
    lens: str | None = None
    """Channel with its lens; None: unknown."""
    intrinsics_std_percent: Annotated[float, Field(ge=0, le=5)] | None = None
    """As in dataset.json: how well that lens is known; 0: exactly, None: it is not used."""


@dataclass(frozen=True, eq=False, config=STRICT)
class PoseSource:
    """The measured pose of an eye in its base."""

    base: str
    """Frame that stays where it is in the head."""
    eye: str
    """Frame that turns with the eye."""


@dataclass(frozen=True, eq=False, config=STRICT)
class FrameChoice:
    """Which frames are taken; None: found in the recording."""

    rest: tuple[Span, ...] | None = None
    """Spans in which head and board stand still; one frame is taken of each."""
    moving: tuple[Span, ...] | None = None
    """Spans in which the eyes move and the board stands still."""
    placements: tuple[Span, ...] | None = None
    """Spans in which the board stays at one place in frame head, whatever the eyes do."""


@dataclass(frozen=True, eq=False, config=STRICT, kw_only=True)
class RecordingMap(BoardAndJoints):
    """Content of map.toml; the `column` of a joint is its name in the recording."""

    cameras: dict[str, CameraSource]
    poses: dict[Side, PoseSource] = field(default_factory=dict)
    """Measured poses of the eyes, in place of joints."""
    frames: FrameChoice = field(default_factory=FrameChoice)
    stamps: Stamps = "header"
    max_gap_s: Annotated[float, Field(gt=0, le=10)] = MAX_GAP_S
    """Longest time between two readings between which one is interpolated [s]."""


def load_map(path: Path) -> RecordingMap:
    """Read a map; VergenceError if it is missing or invalid."""
    return read_parsed(
        path,
        "a map of a recording",
        lambda content: validated(content, RecordingMap),
        tomllib.loads,
        most_bytes=MAX_MAP_BYTES,
    )


def describe(
    mapped: RecordingMap, sizes: Mapping[str, tuple[int, int]], lenses: Mapping[str, Camera]
) -> Description:
    """Describe the dataset that a map makes of a recording.

    `sizes` [px] and `lenses` are by channel. ValueError if the parts contradict each other.
    """
    for eye in {source.eye for source in mapped.cameras.values()} if mapped.poses else ():
        if eye not in mapped.poses:
            raise ValueError(f"poses.{eye} is missing; that eye has a camera")
    cameras = {
        name: DatasetCamera(
            eye=source.eye,
            width=sizes[source.images][0],
            height=sizes[source.images][1],
            intrinsics=lenses.get(source.lens or ""),
            intrinsics_std_percent=source.intrinsics_std_percent,
        )
        for name, source in mapped.cameras.items()
    }
    return Description(
        cameras=cameras,
        eye_motion="poses" if mapped.poses else "pan-tilt",
        **{each.name: getattr(mapped, each.name) for each in fields(BoardAndJoints)},
    )
