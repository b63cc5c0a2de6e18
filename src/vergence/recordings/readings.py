"""Joint readings, and poses of the eyes from a tree of frames such as TF, at the times of images.

They are interpolated, never extrapolated. Times are subtracted as whole numbers: seconds since 1970
as floats are exact to 0.2 us only.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import boxminus, boxplus, inverse
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import PoseSource, RecordingMap
from vergence.recordings.scan import Scan, Track

MESSAGES = 1000
"""Messages of a channel by which all its frames are known; robots send each at 10 Hz or more."""
Edge = tuple[str, str]
"""Parent and child."""


def postures(
    scanned: Scan, mapped: RecordingMap, description: Description, at_ns: np.ndarray
) -> tuple[Array, Array, Array | None]:
    """Interpolate readings of eyes (N, r) and neck (N, n) [rad], and measured poses, at N times.

    In the order of the description; poses are T_base_eye (N, 2, 4, 4), and None where joints are
    read. NaN where not known. VergenceError unless the recording has each joint once.
    """
    angles = {}
    for name, joint in description.sources.items():
        track = joint_track(scanned, joint.column)
        values = interpolate(track, at_ns, max_gap_s=mapped.max_gap_s) * joint.sign
        angles[name] = np.radians(values) if joint.unit == "deg" else values
    others = np.full(len(at_ns), np.nan if mapped.poses else 0.0)
    readings = description.head_kinematics.readings
    eyes, neck = (
        np.array([angles.get(name, others) for name in names]).reshape(-1, len(at_ns)).T
        for names in (readings, description.neck_joints)
    )
    return eyes, neck, _eye_poses(scanned, mapped, at_ns) if mapped.poses else None


def joint_track(scanned: Scan, column: str) -> Track:
    """Find the joint that a column names, as `name` or `channel:name`.

    VergenceError unless there is exactly one.
    """
    found = {
        f"{channel}:{name}": track
        for (channel, name), track in scanned.joints.items()
        if column in (name, f"{channel}:{name}")
    }
    if len(found) != 1:
        raise VergenceError(
            f"The map names a joint {column!r}; the recording has {', '.join(found) or 'none'} of "
            "that name."
        )
    return next(iter(found.values()))


def interpolate(track: Track, at_ns: np.ndarray, *, max_gap_s: float) -> Array:
    """Interpolate readings (N,) or poses (N, 4, 4) at times (N,) [ns]; NaN in gaps and outside."""
    stamps, first = np.unique(track.stamp_ns, return_index=True)  # the first of equal ones
    values = track.values[first]
    if len(stamps) < 2:
        return np.full((len(at_ns), *values.shape[1:]), np.nan)
    after = np.searchsorted(stamps[1:-1], at_ns) + 1
    gap_ns = stamps[after] - stamps[after - 1]
    part = (at_ns - stamps[after - 1]) / gap_ns
    last, next_ = values[after - 1], values[after]
    if values.ndim == 1:
        found = last + part * (next_ - last)
    else:
        found = boxplus(last, part[:, None] * boxminus(next_, last))
    inside = (part >= 0) & (part <= 1)
    inside &= (gap_ns <= max_gap_s * 1e9) | (part == 0) | (part == 1)
    found[~inside] = np.nan
    return found


def needed_frames(recording: Recording, sources: Mapping[Side, PoseSource]) -> set[Edge]:
    """Find the poses between the frames of sources, as far as the first messages have them.

    VergenceError if the recording does not connect them.
    """
    parents: dict[str, str] = {}
    for channel in (name for name, each in recording.channels.items() if each.kind == "poses"):
        for message in islice(recording.read([channel], None, None), MESSAGES):
            content = message.decode()
            assert isinstance(content, tuple)
            parents |= {each.child: each.parent for each in content}
    found = set[Edge]()
    for source in sources.values():
        base, eye = _branches(parents, source)
        top_of_base = base[-1][0] if base else source.base
        if top_of_base != (eye[-1][0] if eye else source.eye):
            raise VergenceError(
                f"{recording.path} does not connect the frames {source.base} and {source.eye}, "
                f"which the map names; it has {', '.join(sorted({*parents, *parents.values()}))}."
            )
        found |= {*base, *eye}
    return found


def _branches(parents: Mapping[str, str], source: PoseSource) -> tuple[list[Edge], list[Edge]]:
    """List the edges above the base and above the eye, up to where they meet."""
    chains = []
    for frame in (source.base, source.eye):
        edges = list[Edge]()
        while frame in parents and (parents[frame], frame) not in edges:
            edges.append((parents[frame], frame))
            frame = parents[frame]
        chains.append(edges)
    base, eye = chains
    return [each for each in base if each not in eye], [each for each in eye if each not in base]


def _eye_poses(scanned: Scan, mapped: RecordingMap, at_ns: np.ndarray) -> Array:
    """Compute T_base_eye (N, 2, 4, 4); the identity for an eye without a source of its poses."""
    parents = {child: parent for parent, child in scanned.poses}
    found = np.tile(np.eye(4), (len(at_ns), len(EYES), 1, 1))
    for eye, source in mapped.poses.items():
        T_top_base, T_top_eye = np.eye(4), np.eye(4)
        base, above_eye = _branches(parents, source)
        for edge in base:
            T_top_base = _edge_poses(scanned.poses[edge], mapped, at_ns) @ T_top_base
        for edge in above_eye:
            T_top_eye = _edge_poses(scanned.poses[edge], mapped, at_ns) @ T_top_eye
        found[:, EYES.index(eye)] = inverse(T_top_base) @ T_top_eye
    return found


def _edge_poses(track: Track, mapped: RecordingMap, at_ns: np.ndarray) -> Array:
    """Interpolate poses; those that never change may be sent once, and hold at all times."""
    if np.ptp(track.values, axis=0).max() < 1e-12:
        return track.values[0]
    return interpolate(track, at_ns, max_gap_s=mapped.max_gap_s)
