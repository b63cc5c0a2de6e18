"""Write what the twin recorded as a bag: images, and joint readings at a rate of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
_TRANSPORT_NS = 12_000_000
"""Time [ns] from taking an image to its receipt; a camera on USB needs 5 to 20 ms."""


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
        if not (0 <= self.joint_rate_hz <= MAX_RATE_HZ and 0 <= self.missing < 1):
            raise VergenceError(
                f"A bag has joint readings at 0 to {MAX_RATE_HZ:g} Hz, less a part from 0 to below "
                f"1; asked for {self.joint_rate_hz:g} Hz, less {self.missing:g}."
            )


def write_twin_bag(
    dataset: Dataset,
    log: Sequence[tuple[float, Array]],
    truth: HeadCalibration,
    settings: BagSettings,
    *,
    joints: Joints,
    seed: int,
    progress: Progress = silent,
) -> Path:
    """Write a dataset of the twin with its stream of joint readings into a bag beside its files.

    `log` has the times [s] and the postures (j,) [rad] on the sensors' side that `Twin.watch` saw,
    and `joints` the errors of the sensors. VergenceError if the bag cannot be written.
    """
    path = dataset.folder / settings.file_name
    rng = np.random.default_rng([seed, 63])
    last_ns = round(float(dataset.time_s[-1]) * 1e9)
    if settings.joint_rate_hz:
        period_ns = 1e9 / settings.joint_rate_hz
        past = np.arange(int((last_ns - log[0][0] * 1e9) / period_ns), -1, -1)
        time_ns = last_ns - np.round(past * period_ns).astype(int)
        at_s = time_ns * 1e-9 - max(0.0, joints.delay_ms * 1e-3)
        known_s, postures = zip(*log, strict=True)
        columns = np.array(postures).T
        sensed = np.stack([np.interp(at_s, known_s, column) for column in columns], axis=1)
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
    images = list(_images(dataset))
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


def _images(dataset: Dataset) -> Iterator[Message]:
    """Yield the images of a dataset, which are read when they are decoded."""
    for row, time_s in enumerate(dataset.time_s.tolist()):
        stamp_ns = BEGIN_NS + round(time_s * 1e9)
        for name, files in dataset.files.items():
            if files[row] is not None:
                decode = partial(_grey, dataset, name, row)
                yield Message(IMAGES.format(name), stamp_ns, stamp_ns + _TRANSPORT_NS, decode)


def _grey(dataset: Dataset, camera: str, row: int) -> np.ndarray:
    image = dataset.image(camera, row)
    assert image is not None
    return image[..., 0]
