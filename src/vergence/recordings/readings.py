"""Joint readings, and poses of the eyes from a tree of frames such as TF, at the times of images.

They are interpolated, never extrapolated. Times are subtracted as whole numbers: seconds since 1970
as floats are exact to 0.2 us only.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import boxminus, boxplus, inverse
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import Scan, Track


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
    tracks = {
        f"{channel}:{name}": track
        for (channel, name), track in scanned.joints.items()
        if column in (name, f"{channel}:{name}")
    }
    if len(tracks) != 1:
        raise VergenceError(
            f"The map names a joint {column!r}; the recording has {', '.join(tracks) or 'none'} of "
            "that name."
        )
    return next(iter(tracks.values()))


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
        read = last + part * (next_ - last)
    else:
        read = boxplus(last, part[:, None] * boxminus(next_, last))
    inside = (part >= 0) & (part <= 1)
    inside &= (gap_ns <= max_gap_s * 1e9) | (part == 0) | (part == 1)
    read[~inside] = np.nan
    return read


def _eye_poses(scanned: Scan, mapped: RecordingMap, at_ns: np.ndarray) -> Array:
    """Compute T_base_eye (N, 2, 4, 4); the identity for an eye without a source of its poses.

    VergenceError if the recording does not connect the frames.
    """
    parents = {child: parent for parent, child in scanned.poses}
    T_base_eye = np.tile(np.eye(4), (len(at_ns), len(EYES), 1, 1))
    for eye, source in mapped.poses.items():
        of_base, of_eye = (_edges_above(parents, frame) for frame in (source.base, source.eye))
        root_of_base = of_base[-1][0] if of_base else source.base
        if root_of_base != (of_eye[-1][0] if of_eye else source.eye):
            raise VergenceError(
                f"The recording does not connect the frames {source.base} and {source.eye}, which "
                f"the map names; it has {', '.join(sorted({*parents, *parents.values()}))}."
            )
        T_top_base, T_top_eye = np.eye(4), np.eye(4)
        for edge in (each for each in of_base if each not in of_eye):
            T_top_base = _edge_poses(scanned.poses[edge], mapped, at_ns) @ T_top_base
        for edge in (each for each in of_eye if each not in of_base):
            T_top_eye = _edge_poses(scanned.poses[edge], mapped, at_ns) @ T_top_eye
        T_base_eye[:, EYES.index(eye)] = inverse(T_top_base) @ T_top_eye
    return T_base_eye


def _edges_above(parents: Mapping[str, str], frame: str) -> list[tuple[str, str]]:
    """List parent and child of each edge from a frame up to the root."""
    edges = list[tuple[str, str]]()
    while frame in parents and (parents[frame], frame) not in edges:
        edges.append((parents[frame], frame))
        frame = parents[frame]
    return edges


def _edge_poses(track: Track, mapped: RecordingMap, at_ns: np.ndarray) -> Array:
    """Interpolate poses; those that never change may be sent once, and hold at all times."""
    if np.ptp(track.values, axis=0).max() < 1e-12:
        return track.values[0]
    return interpolate(track, at_ns, max_gap_s=mapped.max_gap_s)
