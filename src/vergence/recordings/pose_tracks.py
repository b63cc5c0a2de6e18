"""Poses of the eyes in their bases from a tree of frames, such as TF, at the moments of images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    parents, found = pose_frames(recording), set()
    for source in sources.values():
        path = _path(parents, source.base, source.eye)
        if path is None:
            raise VergenceError(
                f"{recording.path} does not connect the frames {source.base} and {source.eye}, "
                f"which the map names; it has {', '.join(sorted({*parents, *parents.values()}))}."
            )
        found |= {edge for edge, _ in path}
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


def _path(edges: Mapping[str, str], base: str, eye: str) -> list[tuple[Edge, bool]] | None:
    """List the edges from one frame to another, with whether each leads to its child."""
    up, down = _ancestors(edges, base), _ancestors(edges, eye)
    meeting = next((frame for frame in up if frame in down), None)
    if meeting is None:
        return None
    before = [((edges[frame], frame), False) for frame in up[: up.index(meeting)]]
    after = [((edges[frame], frame), True) for frame in down[: down.index(meeting)]]
    return [*before, *reversed(after)]


def _ancestors(edges: Mapping[str, str], frame: str) -> list[str]:
    """List a frame and those above it, each once."""
    found = [frame]
    while (above := edges.get(found[-1])) is not None and above not in found:
        found.append(above)
    return found


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
    edges = {child: parent for parent, child in tracks}
    found = np.tile(np.eye(4), (len(at_ns), len(EYES), 1, 1))
    for eye, source in sources.items():
        path: Iterable[tuple[Edge, bool]] = _path(edges, source.base, source.eye) or ()
        for edge, forward in path:
            T = _interpolate(tracks[edge], at_ns, max_gap_s=max_gap_s)
            k = EYES.index(eye)
            found[:, k] = found[:, k] @ (T if forward else inverse(T))
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
