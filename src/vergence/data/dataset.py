"""Frames of images and joint readings, and datasets: recordings of them on disk.

A dataset is a folder whose format docs/dataset.md describes. `data.description` is what its
dataset.json states; `data.reader` reads a dataset and `data.writer` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.description import FRAMES, Description
from vergence.data.images import (
    MAX_IMAGE_BYTES,
    UNREADABLE,
    decode_image,
    eight_bits,
    filled_bits,
    image_size,
)
from vergence.errors import VergenceError, counted
from vergence.files import read_bytes
from vergence.findings import Finding


@dataclass(frozen=True, eq=False)
class Frame:
    """Images and joint readings of one moment, from the twin or from a real head's driver."""

    time_s: float
    """Time stamp of the images."""
    joint_time_s: float
    """Time stamp of the joint readings."""
    eye_angles: Array
    """(r,) joint readings of the eyes [rad] in the order of the head's kinematics.readings."""
    neck_angles: Array
    """(3,) joint readings of the neck [rad] in the order of neck.NECK_JOINTS."""
    images: Mapping[str, np.ndarray]
    """By camera name: (H, W, 3) uint8, RGB."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """A recording of N frames, checked; angles in radians, positive as docs/conventions.md says."""

    folder: Path
    description: Description
    lines: np.ndarray
    """(N,) line numbers of the rows in frames.csv, for messages."""
    time_s: Array
    """(N,) time stamps of the images, strictly increasing."""
    joint_time_s: Array
    """(N,) time stamps of the joint readings, strictly increasing."""
    eye_angles: Array
    """(N, r) [rad] in the order of description.head_kinematics.readings; 0 for an eye without
    cameras, NaN where poses are given."""
    T_base_eye: Array | None
    """(N, 2, 4, 4) poses of the left and the right eye in their bases, the identity for an eye
    without cameras; None where joint angles are given instead."""
    neck_angles: Array
    """(N, 3) [rad] in the order of neck.NECK_JOINTS; 0 for joints without a column."""
    placement: np.ndarray
    """(N,) of int: rows with the same number show the board at the same pose in frame head."""
    moving: np.ndarray
    """(N,) of bool: whether the eyes were moving, so that the time of the reading matters."""
    files: Mapping[str, tuple[str | None, ...]]
    """By camera name: N image files, relative to the folder; None where there is no image."""
    findings: tuple[Finding, ...] = ()
    """What looks unusual but may be right, one sentence each, for the report."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"<Dataset {self.folder}: {counted(len(self), 'frame')} of {', '.join(self.files)}>"

    def image(self, camera: str, row: int) -> np.ndarray | None:
        """Return an image (H, W, 3) uint8, RGB; None where the camera has none in this row.

        VergenceError if the file cannot be read, or its size differs from dataset.json.
        """
        image, name = self.readable_image(camera, row), self._files_of(camera)[row]
        if image is None and name is not None:
            raise VergenceError(f"{self.where(row)}: {camera}: {name} {UNREADABLE}.")
        return image

    def readable_image(self, camera: str, row: int) -> np.ndarray | None:
        """Return an image as `image` does, but None too where the file is not a readable image.

        VergenceError if the file cannot be opened, or if by its header its size differs from
        dataset.json.
        """
        if self._files_of(camera)[row] is None:
            return None
        image = self._decoded(camera, row)
        if image is None or image.dtype == np.uint8:
            return image
        if camera not in self._bits:
            self._bits[camera] = self._filled_bits(camera, image)
        return eight_bits(image, self._bits[camera])

    def _files_of(self, camera: str) -> Sequence[str | None]:
        if camera not in self.files:
            raise VergenceError(
                f"No camera is called {camera!r}; the dataset has {', '.join(self.files)}."
            )
        return self.files[camera]

    @cached_property
    def _bits(self) -> dict[str, int]:
        """By camera, how many bits of its images of 16 bits are filled: a cache."""
        return {}

    def _filled_bits(self, camera: str, image: np.ndarray) -> int:
        """Return how many bits a camera fills, as stated or by the brightest of some images.

        These are spread over the recording, of which the first may be dark. The given image counts
        where none of them has 16 bits.
        """
        stated = self.description.cameras[camera].bits
        if stated is not None:
            return stated
        rows, deep = [k for k, name in enumerate(self.files[camera]) if name is not None], []
        for k in rows[:: 1 + len(rows) // _BRIGHTEST_OF]:
            with suppress(VergenceError):  # whoever reads that row is told
                deep.append(self._decoded(camera, k))
        deep = [each for each in deep if each is not None and each.dtype != np.uint8]
        return max(map(filled_bits, deep or [image]))

    def _decoded(self, camera: str, row: int) -> np.ndarray | None:
        path = self.folder / str(self.files[camera][row])
        content = read_bytes(path, MAX_IMAGE_BYTES)
        size = image_size(content)
        stated = self.description.cameras[camera]
        if size is not None and size != (stated.width, stated.height):
            raise VergenceError(
                f"{self.where(row)}: {camera}: {self.files[camera][row]} has {size[0]} x {size[1]} "
                f"pixels, but dataset.json says {stated.width} x {stated.height}."
            )
        return None if size is None else decode_image(content, size)

    def frame(self, row: int) -> Frame:
        """Return a row with all its images, as a head's driver would; errors: see `image`."""
        images = {name: self.image(name, row) for name in self.files}
        return Frame(
            time_s=float(self.time_s[row]),
            joint_time_s=float(self.joint_time_s[row]),
            eye_angles=self.eye_angles[row],
            neck_angles=self.neck_angles[row],
            images={name: image for name, image in images.items() if image is not None},
        )

    def where(self, row: int) -> str:
        """Return the file and line of a row, as messages cite it."""
        return f"{self.folder / FRAMES}, line {self.lines[row]}"


_BRIGHTEST_OF = 12
"""Images over a recording by which it is guessed how many bits a camera fills."""
MAX_GAP_S = 0.2
"""Longest time between successive rows of one motion."""
LEAST_MOVING = 3
"""Rows of a motion at least, so that its velocity can be estimated."""


def runs(dataset: Dataset) -> np.ndarray:
    """Return (N,) of int: the number of the motion that each row belongs to, 0 for eyes at rest.

    Motions are counted from 1; one ends where the eyes rest or rows are more than MAX_GAP_S apart.
    VergenceError if one has fewer than LEAST_MOVING rows, too few to estimate its velocity.
    """
    late = np.diff(dataset.joint_time_s, prepend=-np.inf) > MAX_GAP_S
    before = np.concatenate([[False], dataset.moving[:-1]])
    run = np.cumsum(dataset.moving & (late | ~before)) * dataset.moving
    for number in range(1, run.max(initial=0) + 1):
        rows = np.flatnonzero(run == number)
        if len(rows) < LEAST_MOVING:
            raise VergenceError(
                f"{dataset.where(rows[0])}: moving rows come at least {LEAST_MOVING} in sequence, "
                f"not more than {MAX_GAP_S} s apart; found {len(rows)}."
            )
    return run
