"""Write what the twin recorded as a bag: images, and joint readings at a rate of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from heapq import merge
from operator import attrgetter
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Dataset
from vergence.data.description import Description
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.progress import Progress, silent
from vergence.recordings.bag import Storage, message, write_bag
from vergence.recordings.recording import JointSample, Message
from vergence.twin.profile import Joints
from vergence.twin.sensors import read

BEGIN_NS = 1_700_000_000_000_000_000
"""Time zero of the twin in its bags [ns since 1970]; a robot's clock is of this size."""
JOINTS = "/joint_states"
IMAGES = "/{}/image_raw"
LENSES = "/{}/camera_info"
"""Channels, with the name of a camera, as ROS's drivers name them."""
MAX_RATE_HZ = 2000.0
"""Highest rate of joint readings [Hz]; the twin moves in steps of 1 ms."""
_TRANSPORT_NS = 2_000_000, 20_000_000
"""Images are received this much later than they are taken, at least and at most [ns]; a camera on
USB needs 5 to 20 ms."""


@dataclass(frozen=True)
class BagSettings:
    """What a bag of the twin holds besides its images."""

    storage: Storage
    joint_rate_hz: float = 0.0
    """Rate of the joint readings [Hz]; 0: those of the dataset, one message a frame."""
    missing: float = 0.0
    """Part of the joint messages that is lost, from 0 to less than 1."""
    lenses: bool = False
    """Whether the true lenses are in the bag."""

    @property
    def file_name(self) -> str:
        """Name of the bag, which is a file or a folder."""
        return "recording.bag" if self.storage == "ros1" else "recording"

    def __post_init__(self) -> None:
        if not 0 <= self.joint_rate_hz <= MAX_RATE_HZ:
            raise VergenceError(
                f"Joints are read at a rate up to {MAX_RATE_HZ:g} Hz, or 0 for once a frame; asked "
                f"for {self.joint_rate_hz:g}."
            )
        if not 0 <= self.missing < 1:
            raise VergenceError(
                f"The part of joint messages that is lost is from 0 to less than 1; asked for "
                f"{self.missing:g}."
            )


@dataclass(eq=False)
class SensorLog:
    """Postures on the sensors' side during a recording, as `Twin.watch` takes them."""

    time_s: list[float] = field(default_factory=list)
    sensed: list[Array] = field(default_factory=list)
    """(j,) [rad] at each time."""

    def __call__(self, time_s: float, sensed: Array) -> None:
        """Add a posture."""
        self.time_s.append(time_s)
        self.sensed.append(sensed)


def write_twin_bag(
    dataset: Dataset,
    log: SensorLog,
    truth: HeadCalibration,
    settings: BagSettings,
    *,
    joints: Joints,
    seed: int,
    progress: Progress = silent,
) -> Path:
    """Write a dataset of the twin with its stream of joint readings into a bag beside its files.

    `joints` are the errors of the sensors. VergenceError if the bag cannot be written.
    """
    path = dataset.folder / settings.file_name
    rng = np.random.default_rng([seed, 63])
    last_ns = round(float(dataset.time_s[-1]) * 1e9)
    if settings.joint_rate_hz:
        period_ns = 1e9 / settings.joint_rate_hz
        past = np.arange(int((last_ns - log.time_s[0] * 1e9) / period_ns), -1, -1)
        time_ns = last_ns - np.round(past * period_ns).astype(int)
        at_s = time_ns * 1e-9 - max(0.0, joints.delay_ms * 1e-3)
        columns = np.array(log.sensed).T
        sensed = np.stack([np.interp(at_s, log.time_s, column) for column in columns], axis=1)
        neck, eyes = np.split(sensed, [len(dataset.description.neck_joints)], axis=1)
        eyes = read(eyes, joints, rng, dataset.description.head_kinematics)
    else:
        time_ns = np.round(dataset.joint_time_s * 1e9).astype(int)
        eyes, neck = dataset.eye_angles, dataset.neck_angles
    kept = rng.random(len(time_ns)) >= settings.missing
    names, values = _columns(dataset.description, eyes[kept], neck[kept])
    stream = (
        message(JOINTS, BEGIN_NS + at, JointSample(names, row))
        for at, row in zip(time_ns[kept].tolist(), values, strict=True)
    )
    images = sorted(_images(dataset, rng), key=attrgetter("received_ns"))
    lenses = [
        message(LENSES.format(name), BEGIN_NS, truth.camera(name).intrinsics)
        for name in (dataset.files if settings.lenses else ())
    ]
    task, total = "writing the bag", len(images)

    def messages() -> Iterator[Message]:
        written = 0
        progress(task, 0, total)
        for each in merge(lenses, stream, images, key=attrgetter("received_ns")):
            yield each
            if each.channel != JOINTS:
                written += 1
                progress(task, min(written, total), total)

    write_bag(path, messages(), storage=settings.storage)
    return path


def _columns(description: Description, eyes: Array, neck: Array) -> tuple[tuple[str, ...], Array]:
    """Name the joints (c,) as a dataset does, and make readings (N, c) in its units."""
    order = *description.head_kinematics.readings, *description.neck_joints
    angles = dict(zip(order, np.concatenate([eyes, neck], axis=1).T, strict=True))
    columns = {}
    for name, joint in description.sources.items():
        value = joint.sign * angles[name]
        columns[joint.column] = np.degrees(value) if joint.unit == "deg" else value
    return tuple(columns), np.stack(list(columns.values()), axis=1)


def _images(dataset: Dataset, rng: np.random.Generator) -> Iterator[Message]:
    """Yield the images of a dataset, which are read when they are decoded."""
    for row, time_s in enumerate(dataset.time_s.tolist()):
        stamp_ns = BEGIN_NS + round(time_s * 1e9)
        for name, files in dataset.files.items():
            if files[row] is not None:
                received_ns = stamp_ns + int(rng.integers(*_TRANSPORT_NS))
                decode = partial(_grey, dataset, name, row)
                yield Message(IMAGES.format(name), stamp_ns, received_ns, decode)


def _grey(dataset: Dataset, camera: str, row: int) -> np.ndarray:
    image = dataset.image(camera, row)
    assert image is not None
    return image[..., 0]
