"""Read the images of chosen moments again, in short spans of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from vergence.errors import VergenceError
from vergence.recordings.moments import Moments
from vergence.recordings.recording import Recording
from vergence.recordings.scan import ImageTrack

JOINED_NS = 10**9
"""Images received within this time [ns] are read in one go: to seek takes as long as to read on for
some tenths of a second."""

_Key = tuple[str, int, int]  # channel, time of receipt, stamp


def read_images(
    recording: Recording,
    tracks: Mapping[str, ImageTrack],
    channels: Mapping[str, str],
    moments: Moments,
    rows: np.ndarray,
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the images by camera of moments (F,), in their order.

    `tracks` are by channel, and `channels` by camera. VergenceError if an image is damaged, or is
    not found again.
    """
    wanted: list[dict[_Key, str]] = []  # by moment the cameras
    for row in rows.tolist():
        keys = {}
        for camera, channel in channels.items():
            image, track = int(moments.images[camera][row]), tracks[channel]
            if image >= 0:
                keys[channel, int(track.received_ns[image]), int(track.stamp_ns[image])] = camera
        wanted.append(keys)
    of_moment = {key: k for k, keys in enumerate(wanted) for key in keys}
    waiting: dict[int, dict[str, np.ndarray]] = {}  # until their turn
    turn = 0
    for message in _messages(recording, of_moment):
        key = message.channel, message.received_ns, message.stamp_ns
        k = of_moment.pop(key, None)  # of repeated messages the first
        if k is None:
            continue
        content = message.decode()
        assert isinstance(content, np.ndarray)
        waiting.setdefault(k, {})[wanted[k][key]] = content
        while turn < len(rows) and len(waiting.get(turn, ())) == len(wanted[turn]):
            yield waiting.pop(turn, {})
            turn += 1
    if turn < len(rows):
        raise VergenceError(f"{recording.path} has changed while it was read.")


def _messages(recording: Recording, keys: Mapping[_Key, int]) -> Iterator:
    """Read the spans of a recording in which images were received."""
    received = np.unique([received_ns for _, received_ns, _ in keys])
    channels = sorted({channel for channel, _, _ in keys})
    for span in np.split(received, np.flatnonzero(np.diff(received) > JOINED_NS) + 1):
        if len(span):
            yield from recording.read(channels, int(span[0]), int(span[-1]) + 1)
