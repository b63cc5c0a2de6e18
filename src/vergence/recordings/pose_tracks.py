"""Poses of the eyes in their bases from a tree of frames, such as TF, at the moments of images."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse, pose
from vergence.recordings.interpolation import between
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import PoseSource
from vergence.recordings.scan import PoseTrack

MESSAGES = 1000
"""Messages of a channel by which all its frames are known; robots send each at 10 Hz or more."""
Edge = tuple[str, str]
"""Parent and child."""


def needed_frames(recording: Recording, sources: Mapping[Side, PoseSource]) -> set[Edge]:
    """Find the poses between the frames of sources.

    VergenceError if the recording does not connect them.
    """
    parents, found = pose_frames(recording), set[Edge]()
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


def pose_frames(recording: Recording) -> dict[str, str]:
    """List the parents of frames by their children, as far as the first messages have them."""
    channels = [name for name, each in recording.channels.items() if each.kind == "poses"]
    parents: dict[str, str] = {}
    for channel in channels:
        for message in islice(recording.read([channel], None, None), MESSAGES):
            content = message.decode()
            assert isinstance(content, tuple)
            parents |= {each.child: each.parent for each in content}
    return parents


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


def eye_poses(
    tracks: Mapping[Edge, PoseTrack],
    sources: Mapping[Side, PoseSource],
    at_ns: np.ndarray,
    *,
    max_gap_s: float,
) -> Array:
    """Compute T_base_eye (N, 2, 4, 4) at times (N,) [ns]; NaN where not known.

    The identity stands for an eye without a source of its poses.
    """
    parents = {child: parent for parent, child in tracks}
    found = np.tile(np.eye(4), (len(at_ns), len(EYES), 1, 1))
    for eye, source in sources.items():
        T_top_base, T_top_eye = np.eye(4), np.eye(4)
        base, above_eye = _branches(parents, source)
        for edge in base:
            T_top_base = _interpolate(tracks[edge], at_ns, max_gap_s=max_gap_s) @ T_top_base
        for edge in above_eye:
            T_top_eye = _interpolate(tracks[edge], at_ns, max_gap_s=max_gap_s) @ T_top_eye
        found[:, EYES.index(eye)] = inverse(T_top_base) @ T_top_eye
    return found


def _interpolate(track: PoseTrack, at_ns: np.ndarray, *, max_gap_s: float) -> Array:
    """Interpolate poses (N, 4, 4) at times (N,) [ns]; NaN outside of the track and in its gaps.

    Poses that never change hold at all times.
    """
    if np.ptp(track.T_parent_child, axis=0).max() < 1e-12:
        return np.broadcast_to(track.T_parent_child[0], (len(at_ns), 4, 4))
    stamps, first = np.unique(track.stamp_ns, return_index=True)
    T, found = track.T_parent_child[first], np.full((len(at_ns), 4, 4), np.nan)
    after, part = between(stamps, at_ns, max_gap_s=max_gap_s)
    inside = np.isfinite(part)
    if inside.any():
        turns = Slerp(stamps - stamps[0], Rotation.from_matrix(T[:, :3, :3]))
        at, part = after[inside], part[inside, None]
        t = T[at - 1, :3, 3] + part * (T[at, :3, 3] - T[at - 1, :3, 3])
        found[inside] = pose(turns(at_ns[inside] - stamps[0]).as_matrix(), t)
    return found
