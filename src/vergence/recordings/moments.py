"""What a map needs of a recording: the moments at which cameras took images, and those images."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.errors import VergenceError, explain
from vergence.findings import Finding, note, warning
from vergence.progress import Progress, silent
from vergence.recordings.readings import joint_track, postures
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import RecordingMap, describe
from vergence.recordings.scan import Scan, scan

SYNC_S = 1e-3
"""Images of several cameras are of one moment if their stamps differ by at most this [s]; eyes that
turn by 1 rad/s turn by 0.06 degrees meanwhile."""
WINDOW_NS = 200_000_000
"""Time before and after a moment in which all stands still [ns]: the largest latency of readings,
so that a reading of an eye at rest is of the same posture as the image."""
SAMPLES = 9
"""Number of times within WINDOW_NS at which the posture is taken: one each 50 ms."""
APART_S = 1.0
"""Difference [s] of the times from stamp to receipt that no latency of a robot explains."""
REMEDY = 'set stamps = "received" in the map if the recorder has one clock'
"""What to do about stamps of two clocks."""


@dataclass(frozen=True, eq=False)
class Moments:
    """All N moments at which cameras took images, in order of time."""

    time_ns: np.ndarray
    """(N,) of int, increasing."""
    images: Mapping[str, np.ndarray]
    """By camera (N,) of int: the index of its image in the track of its channel; -1: none."""
    change: Mapping[str, Array]
    """By camera (N,) [px], as the values of its Track; NaN without an image."""
    eye_angles: Array
    """(N, r) [rad] in the order of the description's readings; NaN where not known."""
    neck_angles: Array
    """(N, n) [rad] in the order of the description's neck_joints."""
    around: Array
    """(m, N, s) elements of the posture at m times within WINDOW_NS; NaN where not known."""
    T_base_eye: Array | None = None
    """(N, 2, 4, 4) measured poses of the left and the right eye in their bases [m], NaN where not
    known, the identity for an eye without cameras; None where joints are read instead."""

    @property
    def known(self) -> np.ndarray:
        """Whether the readings, or poses, of each moment (N,) are known."""
        return np.asarray(np.isfinite(self.elements).all(axis=1))

    @property
    def elements(self) -> Array:
        """What is read of the eyes, or the elements of their poses, and of the neck (N, s)."""
        return _elements(self.eye_angles, self.neck_angles, self.T_base_eye)

    def take(self, rows: np.ndarray) -> Moments:
        """Select moments by index or by a mask."""
        return Moments(
            time_ns=self.time_ns[rows],
            images={name: each[rows] for name, each in self.images.items()},
            change={name: each[rows] for name, each in self.change.items()},
            eye_angles=self.eye_angles[rows],
            neck_angles=self.neck_angles[rows],
            around=self.around[:, rows],
            T_base_eye=None if self.T_base_eye is None else self.T_base_eye[rows],
        )

    def __len__(self) -> int:
        return len(self.time_ns)


def scan_mapped(
    recording: Recording, mapped: RecordingMap, *, progress: Progress = silent
) -> tuple[Scan, Description]:
    """Scan what a map needs of a recording, and describe the dataset of it.

    VergenceError if the recording is damaged, or does not have what the map names.
    """
    sources = mapped.cameras.values()
    needed = [(source.images, "images") for source in sources]
    needed += [(source.lens, "lens") for source in sources if source.lens]
    for name, kind in needed:
        channel = recording.channels.get(name)
        if channel is None or channel.kind != kind or not channel.count:
            has = ", ".join(n for n, other in recording.channels.items() if other.kind == kind)
            raise VergenceError(
                f"{recording.path} has no {kind} in a channel {name}, which the map names; "
                f"channels of that kind are {has or 'missing'}."
            )
    channels = [name for name, _ in needed]
    kinds = ("joints", "poses") if mapped.poses else ("joints",)
    channels += [name for name, other in recording.channels.items() if other.kind in kinds]
    scanned = scan(recording, channels, progress=progress)
    try:
        return scanned, describe(mapped, scanned.sizes, scanned.lenses)
    except ValueError as error:
        raise VergenceError(f"The map describes no head: {explain(error)}.") from None


def find_moments(scanned: Scan, mapped: RecordingMap, description: Description) -> Moments:
    """Group images of all cameras by their stamps, and interpolate the readings.

    Of images of one camera with one stamp the first counts.
    """
    tracks = {name: scanned.images[source.images] for name, source in mapped.cameras.items()}
    every = np.sort(np.concatenate([track.stamp_ns for track in tracks.values()]))
    time_ns = every[np.diff(every, prepend=every[0] - 10**10) > SYNC_S * 1e9]
    images = {}
    for name, track in tracks.items():
        row = np.searchsorted(time_ns, track.stamp_ns, side="right") - 1
        rows, first = np.unique(row, return_index=True)
        images[name] = np.full(len(time_ns), -1)
        images[name][rows] = first
    eye_angles, neck_angles, T_base_eye = postures(scanned, mapped, description, time_ns)
    around = np.stack([
        _elements(*postures(scanned, mapped, description, time_ns + round(part * WINDOW_NS)))
        for part in np.linspace(-1, 1, SAMPLES)
    ])  # fmt: skip
    change = {
        name: np.where(rows >= 0, tracks[name].values[rows], np.nan)
        for name, rows in images.items()
    }
    return Moments(time_ns, images, change, eye_angles, neck_angles, around, T_base_eye)


def _elements(eye_angles: Array, neck_angles: Array, T_base_eye: Array | None) -> Array:
    """Join what is read of the eyes, or the elements of their poses, and of the neck (N, s)."""
    eyes = eye_angles if T_base_eye is None else T_base_eye[:, :, :3].reshape(len(T_base_eye), -1)
    return np.hstack([eyes, neck_angles])


def check_moments(
    moments: Moments, scanned: Scan, mapped: RecordingMap, description: Description
) -> tuple[Finding, ...]:
    """Note images without readings, and stamps that go backward or seem to be of two clocks.

    VergenceError if stamps stand still, no image has readings, or these cannot be radians.
    """
    images = {source.images: scanned.images[source.images] for source in mapped.cameras.values()}
    sources = description.sources.values()
    joints = {source.column: joint_track(scanned, source.column) for source in sources}
    findings = []
    for name, track in (images | joints).items():
        steps = np.diff(track.stamp_ns)
        count = int((steps <= 0).sum())
        odd = f"{count} of {len(steps) + 1} stamps of {name} repeat the one before"
        if 2 * (steps == 0).sum() > len(steps) > 1:
            raise VergenceError(f"{odd}; {REMEDY}.")
        if count:
            late_s = -steps.min() * 1e-9
            sentence = f"{odd}, or are up to {late_s:.3g} s earlier; they were put in order."
            findings.append(warning("stamps-out-of-order", sentence, name))
    for (first, shown), (last, read) in itertools.product(images.items(), joints.items()):
        if abs(shown.late_s - read.late_s) > APART_S:
            sentence = (
                f"The stamps may be of two clocks: those of {first} are {shown.late_s:.2f} s "
                f"before their receipt, those of {last} {read.late_s:.2f} s; {REMEDY}."
            )
            findings.append(warning("two-clocks", sentence, last))
    if not moments.known.all():
        sentence = (
            f"{int((~moments.known).sum())} of {len(moments)} images have no joint readings around "
            f"them within max_gap_s = {mapped.max_gap_s:g} s of the map"
        )
        if not moments.known.any():
            raise VergenceError(f"{sentence}; {REMEDY}.")
        findings.append(note("no-readings", f"{sentence}; they were left out."))
    turns = np.abs(moments.eye_angles * description.head_kinematics.gear_ratios)
    if (turns > 2 * np.pi).any():
        name = description.head_kinematics.readings[int(np.nanargmax(turns)) % turns.shape[1]]
        raise VergenceError(
            f"The readings of {name} turn an eye by {np.nanmax(turns):.3g} rad, more than a turn; "
            'if they are in degrees, set its unit to "deg" in the map.'
        )
    return tuple(findings)


def read_images(
    recording: Recording,
    scanned: Scan,
    mapped: RecordingMap,
    moments: Moments,
    rows: np.ndarray,
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the images by camera of moments (F,), in their order.

    VergenceError if an image is damaged.
    """
    sources = {name: source.images for name, source in mapped.cameras.items()}
    for row in rows.tolist():
        wanted = {}  # of repeated messages the first counts
        for camera, channel in sources.items():
            if (k := moments.images[camera][row]) >= 0:
                track = scanned.images[channel]
                wanted[channel, int(track.received_ns[k]), int(track.stamp_ns[k])] = camera
        times = [received_ns for _, received_ns, _ in wanted]
        images: dict[str, np.ndarray] = {}
        for message in recording.read({*sources.values()}, min(times), max(times) + 1):
            key = message.channel, message.received_ns, message.stamp_ns
            if camera := wanted.pop(key, None):
                images[camera] = cast(np.ndarray, message.decode())
        if wanted:
            raise VergenceError(f"{recording.path} has changed while it was read.")
        yield images
