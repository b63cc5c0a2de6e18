"""The moments of a recording at which cameras took images, with the joint readings then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.geometry.neck import NECK_JOINTS
from vergence.recordings.interpolation import interpolate
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import JointTrack, Scan

SYNC_S = 1e-3
"""Images of several cameras are of one moment if their stamps differ by at most this [s]; eyes that
turn by 1 rad/s turn by 0.06 degrees meanwhile."""


@dataclass(frozen=True, eq=False)
class Moments:
    """All N moments at which cameras took images, in order of time."""

    time_ns: np.ndarray
    """(N,) of int, increasing."""
    images: Mapping[str, np.ndarray]
    """By camera (N,) of int: the index of its image in the track of its channel; -1: none."""
    change: Mapping[str, Array]
    """By camera (N,) [grey levels], as in ImageTrack; NaN without an image."""
    eye_angles: Array
    """(N, r) [rad] in the order of the description's readings; NaN where not known."""
    neck_angles: Array
    """(N, 3) [rad] in the order of NECK_JOINTS; 0 for joints that the map does not name."""

    def __len__(self) -> int:
        return len(self.time_ns)


def find_moments(scanned: Scan, mapped: RecordingMap, description: Description) -> Moments:
    """Group images of all cameras by their stamps, and interpolate the readings."""
    stamps, of_camera = {}, {}
    for name, source in mapped.cameras.items():
        track = scanned.images[source.images]
        stamps[name] = track.stamp_ns if mapped.stamps == "header" else track.received_ns
        of_camera[name] = track
    every = np.sort(np.concatenate(list(stamps.values())))
    new = np.diff(every, prepend=every[0] - 10**10) > SYNC_S * 1e9
    time_ns = every[new]
    images, change = {}, {}
    for name, at in stamps.items():
        row = np.searchsorted(time_ns, at, side="right") - 1
        images[name] = np.full(len(time_ns), -1)
        images[name][row] = np.arange(len(at))
        shown = images[name] >= 0
        change[name] = np.where(shown, of_camera[name].change[images[name]], np.nan)
    angles = readings_at(scanned, mapped, description, time_ns)
    zero = np.zeros(len(time_ns))
    readings = description.head_kinematics.readings
    eye_angles = np.stack([angles.get(name, zero) for name in readings], axis=-1)
    neck_angles = np.stack([angles.get(name, zero) for name in NECK_JOINTS], axis=-1)
    return Moments(time_ns, images, change, eye_angles, neck_angles)


def readings_at(
    scanned: Scan, mapped: RecordingMap, description: Description, at_ns: np.ndarray
) -> dict[str, Array]:
    """Interpolate the readings by name (N,) [rad] at times (N,) [ns]; NaN where not known."""
    angles = {}
    for name, joint in description.sources.items():
        track = joint_track(scanned, joint.column)
        values = interpolate(track, at_ns, max_gap_s=mapped.max_gap_s) * joint.sign
        angles[name] = np.radians(values) if joint.unit == "deg" else values
    return angles


def joint_track(scanned: Scan, column: str) -> JointTrack:
    """Find the joint that a column names, as `name` or `channel:name`."""
    return next(
        track
        for (channel, name), track in scanned.joints.items()
        if column in (name, f"{channel}:{name}")
    )
