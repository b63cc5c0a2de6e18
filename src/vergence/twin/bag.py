"""Write what the twin recorded as a bag: images, and joint readings at a rate of their own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.progress import Progress, silent
from vergence.recordings.bag import Storage, message, write_bag
from vergence.recordings.recording import JointSample, Message
from vergence.twin.profile import Joints
from vergence.twin.sensors import read

BEGIN_NS = 1_700_000_000_000_000_000
"""Time zero of the twin in its bags [ns since 1970]; a robot's clock is of this size."""
JOINTS, IMAGES, LENSES = "/joint_states", "/{}/image_raw", "/{}/camera_info"
"""Channels, with the name of a camera, as ROS's drivers name them."""
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

    def __post_init__(self) -> None:
        if not (0 <= self.joint_rate_hz <= 1000 and 0 <= self.missing < 1):
            raise VergenceError("Joints are read at 0 to 1000 Hz, and 0 to below 1 is missing.")


def write_twin_bag(
    dataset: Dataset,
    log: Sequence[tuple[float, Array]],
    truth: HeadCalibration,
    settings: BagSettings,
    *,
    joints: Joints,
    seed: int,
    progress: Progress = silent,
) -> None:
    """Write a dataset of the twin with joint readings [rad] into the bag `recording` in its folder.

    `log` has the times [s] and the postures (j,) [rad] on the sensors' side that `Twin.watch` saw,
    and `joints` the errors of the sensors. VergenceError if the bag cannot be written.
    """
    description, rng = dataset.description, np.random.default_rng([seed, 63])
    joint_s, eyes, neck = dataset.joint_time_s, dataset.eye_angles, dataset.neck_angles
    if settings.joint_rate_hz:
        log_s, postures = np.array([at for at, _ in log]), np.array([each for _, each in log])
        joint_s = np.arange(log_s[0], log_s[-1], 1 / settings.joint_rate_hz)
        at_s = joint_s - max(0.0, joints.delay_ms * 1e-3)
        sensed = np.stack([np.interp(at_s, log_s, column) for column in postures.T], axis=1)
        neck, eyes = np.split(sensed, [len(description.neck_joints)], axis=1)
        eyes = read(eyes, joints, rng, description.head_kinematics)
    names = *description.head_kinematics.readings, *description.neck_joints
    values = np.concatenate([eyes, neck], axis=1)
    kept = np.flatnonzero(rng.random(len(joint_s)) >= settings.missing)
    stamp_ns, joint_ns = (
        (BEGIN_NS + np.round(at_s * 1e9).astype(int)).tolist() for at_s in (dataset.time_s, joint_s)
    )
    messages = [message(JOINTS, joint_ns[k], JointSample(names, values[k])) for k in kept]
    for name, files in dataset.files.items():
        if settings.lenses:
            messages.append(message(LENSES.format(name), BEGIN_NS, truth.camera(name).intrinsics))
        for row in (row for row, file in enumerate(files) if file):
            at_ns, show = stamp_ns[row], partial(_grey, dataset, name, row)
            messages.append(Message(IMAGES.format(name), at_ns, at_ns + _TRANSPORT_NS, show))
    messages.sort(key=lambda each: each.received_ns)

    def written() -> Iterator[Message]:
        progress("writing the bag", 0, len(messages))
        for done, each in enumerate(messages, 1):
            yield each
            progress("writing the bag", done, len(messages))

    path = dataset.folder / ("recording.bag" if settings.storage == "ros1" else "recording")
    write_bag(path, written(), storage=settings.storage)


def _grey(dataset: Dataset, camera: str, row: int) -> np.ndarray:
    return np.asarray(dataset.image(camera, row))[..., 0]
