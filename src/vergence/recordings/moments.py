"""What a map needs of a recording: the moments at which cameras took images, and those images."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.errors import VergenceError, explain
from vergence.findings import Finding, note, warning
from vergence.progress import Progress, silent
from vergence.recordings.readings import joint_track, needed_frames, postures
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import RecordingMap, describe
from vergence.recordings.scan import Scan, scan

SYNC_S = 1e-3
"""Images of several cameras are of one moment if their stamps differ by at most this [s]; eyes that
turn by 1 rad/s turn by 0.06 degrees meanwhile."""
WINDOW_NS = 200_000_000
"""Time before and after a moment in which all stands still [ns]: the largest latency of readings,
so that a reading of an eye at rest is of the same posture as the image."""
APART_S = 1.0
"""Difference [s] of the times from stamp to receipt that no latency of a robot explains."""
LEAST_TURN_RAD = 0.03
"""Range of a reading that one of the eyes' joints exceeds [rad]: with less, the place of a camera
in its eye cannot be found."""
JOINED_NS = 10**9
"""Images received within this time [ns] are read in one go: to seek takes as long as to read on for
some tenths of a second."""


@dataclass(frozen=True, eq=False)
class Moments:
    """All N moments at which cameras took images, in order of time."""

    time_ns: np.ndarray
    """(N,) of int, increasing."""
    images: Mapping[str, np.ndarray]
    """By camera (N,) of int: the index of its image in the track of its channel; -1: none."""
    change: Mapping[str, Array]
    """By camera (N,) [px], as in ImageTrack; NaN without an image."""
    eye_angles: Array
    """(N, r) [rad] in the order of the description's readings; NaN where not known."""
    neck_angles: Array
    """(N, n) [rad] in the order of the description's neck_joints."""
    T_base_eye: Array | None = None
    """(N, 2, 4, 4) measured poses of the left and the right eye in their bases [m], NaN where not
    known, the identity for an eye without cameras; None where joints are read instead."""
    around: Array | None = None
    """(4, N, s) elements of the posture within WINDOW_NS before and after; NaN where unknown. None:
    only the moments are known."""

    @property
    def known(self) -> np.ndarray:
        """Whether the readings, or poses, of each moment (N,) are known."""
        given = self.eye_angles if self.T_base_eye is None else self.T_base_eye
        given = np.hstack([given.reshape(len(self), -1), self.neck_angles])
        return np.asarray(np.isfinite(given).all(axis=1))

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
            T_base_eye=None if self.T_base_eye is None else self.T_base_eye[rows],
            around=None if self.around is None else self.around[:, rows],
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
    needed = [(each.images, "images") for each in sources]
    needed += [(each.lens, "lens") for each in sources if each.lens]
    for name, kind in needed:
        channel = recording.channels.get(name)
        if channel is None or channel.kind != kind or not channel.count:
            has = ", ".join(n for n, each in recording.channels.items() if each.kind == kind)
            raise VergenceError(
                f"{recording.path} has no {kind} in a channel {name}, which the map names; "
                f"channels of that kind are {has or 'missing'}."
            )
    channels = [name for name, _ in needed]
    kinds = ("joints", "poses") if mapped.poses else ("joints",)
    channels += [name for name, each in recording.channels.items() if each.kind in kinds]
    columns = {joint.column for joint in mapped.joints.values()} | set(mapped.readings)
    frames = needed_frames(recording, mapped.poses) if mapped.poses else ()
    scanned = scan(recording, channels, columns=columns, frames=frames, progress=progress)
    sizes = {name: track.size for name, track in scanned.images.items()}
    try:
        return scanned, describe(mapped, sizes, scanned.lenses)
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
        for part in (-1.0, -0.5, 0.5, 1.0)
    ])  # fmt: skip
    change = {
        name: np.where(rows >= 0, tracks[name].change[rows], np.nan)
        for name, rows in images.items()
    }
    return Moments(time_ns, images, change, eye_angles, neck_angles, T_base_eye, around)


def _elements(eye_angles: Array, neck_angles: Array, T_base_eye: Array | None) -> Array:
    """Join what is read of the eyes, or the elements of their poses, and of the neck (N, s)."""
    eyes = eye_angles if T_base_eye is None else T_base_eye[:, :, :3].reshape(len(T_base_eye), -1)
    return np.hstack([eyes, neck_angles])


def check_stamps(
    scanned: Scan, mapped: RecordingMap, description: Description
) -> tuple[Finding, ...]:
    """Note stamps that are repeated or go backward.

    VergenceError if images and joint readings cannot be brought together by their stamps.
    """
    remedy = 'set stamps = "received" in the map if the recorder has one clock'
    images = {each.images: scanned.images[each.images] for each in mapped.cameras.values()}
    sources = description.sources.values()
    joints = {each.column: joint_track(scanned, each.column) for each in sources}
    findings = []
    for name, track in (images | joints).items():
        steps = np.diff(track.stamp_ns)
        count = int((steps <= 0).sum())
        odd = f"{count} of {len(steps) + 1} stamps of {name} repeat the one before"
        if 2 * (steps == 0).sum() > len(steps) > 1:
            raise VergenceError(f"{odd}; {remedy}.")
        if count:
            late_s = -steps.min() * 1e-9
            sentence = f"{odd}, or are up to {late_s:.3g} s earlier; they were put in order."
            findings.append(warning("stamps-out-of-order", sentence, name))
    for pair in itertools.product(images.items(), joints.items()):
        (first, early), (last, late) = sorted(pair, key=lambda each: each[1].stamp_ns.max())
        end_s, begin_s = early.stamp_ns.max() * 1e-9, late.stamp_ns.min() * 1e-9
        if end_s < begin_s:
            raise VergenceError(
                f"The stamps are of two clocks: those of {first} end at {end_s:.3f} s, before "
                f"those of {last} begin at {begin_s:.3f} s; {remedy}."
            )
        if abs(early.late_s - late.late_s) > APART_S:
            sentence = (
                f"The stamps may be of two clocks: those of {first} are {early.late_s:.2f} s "
                f"before their receipt, those of {last} {late.late_s:.2f} s; {remedy}."
            )
            findings.append(warning("two-clocks", sentence, last))
    return tuple(findings)


def check_readings(
    moments: Moments, mapped: RecordingMap, description: Description
) -> tuple[Finding, ...]:
    """Note images without readings; VergenceError if all are, or a unit cannot be right."""
    sentence = (
        f"{int((~moments.known).sum())} of {len(moments)} images have no joint readings around "
        f"them within max_gap_s = {mapped.max_gap_s:g} s of the map"
    )
    if not moments.known.any():
        raise VergenceError(f"{sentence}.")
    kinematics = description.head_kinematics
    if moments.T_base_eye is None and len(kinematics.readings):
        turns = moments.eye_angles[moments.known] * kinematics.gear_ratios
        largest, ranges = np.abs(turns).max(axis=0), np.ptp(turns, axis=0)
        if largest.max() > 2 * np.pi:
            name = kinematics.readings[int(largest.argmax())]
            raise VergenceError(
                f"The readings of {name} turn an eye by {largest.max():.3g} rad, which is more "
                'than a turn; if they are in degrees, set its unit to "deg" in the map.'
            )
        if description.board is not None and ranges.max() < LEAST_TURN_RAD:
            raise VergenceError(
                f"By the readings no eye turns by more than {np.degrees(ranges.max()):.2g} degrees "
                'in the recording; if they are in radians, set their unit to "rad" in the map.'
            )
    return () if moments.known.all() else (note("no-readings", f"{sentence}; they were left out."),)


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
    channels = {name: source.images for name, source in mapped.cameras.items()}
    wanted: dict[tuple[str, int, int], tuple[int, str]] = {}
    missing = [0] * len(rows)
    for camera, channel in channels.items():
        images, track = moments.images[camera][rows], scanned.images[channel]
        for k in np.flatnonzero(images >= 0).tolist():
            stamp_ns, received_ns = track.stamp_ns[images[k]], track.received_ns[images[k]]
            wanted[channel, int(received_ns), int(stamp_ns)] = k, camera
            missing[k] += 1
    waiting: list[dict[str, np.ndarray]] = [{} for _ in rows]  # until their turn
    turn = 0
    received = np.unique([received_ns for _, received_ns, _ in wanted])
    for span in np.split(received, np.flatnonzero(np.diff(received) > JOINED_NS) + 1):
        for each in recording.read({*channels.values()}, int(span[0]), int(span[-1]) + 1):
            # Of repeated messages the first counts.
            k, camera = wanted.pop((each.channel, each.received_ns, each.stamp_ns), (-1, ""))
            if k < 0:
                continue
            content = each.decode()
            assert isinstance(content, np.ndarray)
            waiting[k][camera] = content
            while turn < len(rows) and len(waiting[turn]) == missing[turn]:
                yield waiting[turn]
                waiting[turn], turn = {}, turn + 1
    if turn < len(rows):
        raise VergenceError(f"{recording.path} has changed while it was read.")
