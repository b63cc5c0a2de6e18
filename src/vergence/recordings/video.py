"""Read frames of videos in any order with av, an optional package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.geometry.camera import MAX_IMAGE_AREA_PX
from vergence.recordings.series import Replay

VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")
_OPTIONS = {
    "format_whitelist": "matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,avi",
    "protocol_whitelist": "none",
}
"""Containers only: FFmpeg's playlists name other files and addresses."""


@dataclass(frozen=True, eq=False)
class Video:
    """An open video of N frames in the order in which they are shown."""

    time_s: Array
    """(N,) times of the frames in the video, increasing."""
    frame: Callable[[int], np.ndarray]
    """Decodes a frame (H, W, 3), RGB, or (H, W), by its index. VergenceError if it is damaged."""


@contextmanager
def open_video(path: Path) -> Iterator[Video]:
    """Open a video; VergenceError if it is damaged, or the package av is not installed."""
    try:
        import av
        from av.error import FFmpegError
    except ImportError:
        raise VergenceError(
            f"{path} is a video; to read it install the package av, as by "
            "`pip install 'vergence[video]'`."
        ) from None
    try:
        with path.open("rb") as file, av.open(file, "r", options=_OPTIONS) as container:
            if not container.streams.video:
                raise VergenceError(f"{path} has no images.")
            stream = container.streams.video[0]
            stream.codec_context.options = {"max_pixels": str(MAX_IMAGE_AREA_PX)}
            packets = [
                (each.pts, each.is_keyframe) for each in container.demux(stream) if each.size
            ]
            if any(pts is None for pts, _ in packets):
                raise VergenceError(f"{path} has frames without times.")
            packets.sort()
            pts = np.array([time for time, _ in packets], np.int64)
            begins = np.flatnonzero([key for _, key in packets])
            if not len(begins) or (np.diff(pts) <= 0).any():
                raise VergenceError(f"{path} has no frames, or several of one time.")
            begins[0] = 0
            replay = Replay(begins, partial(_frames, container, stream, pts))
            time_s = pts.astype(float) * float(stream.time_base or 1)
            yield Video(time_s, partial(_frame, replay, path))
    except (OSError, ValueError, FFmpegError) as error:
        raise VergenceError(f"{path} cannot be read as a video: {explain(error)}.") from error


def _frames(container: Any, stream: Any, pts: np.ndarray, begin: int) -> Iterator[tuple[int, Any]]:
    """Decode the frames from a key frame on."""
    container.seek(int(pts[begin]), stream=stream, backward=True)
    for frame in container.decode(stream):
        index = int(np.searchsorted(pts, frame.pts))
        if index >= begin:  # a seek may go to an earlier key frame
            yield index, frame


def _frame(replay: Replay[Any], path: Path, index: int) -> np.ndarray:
    from av.error import FFmpegError

    try:
        frame = replay(index)
    except (OSError, ValueError, FFmpegError) as error:
        raise VergenceError(f"{path}: frame {index} is damaged: {explain(error)}.") from error
    if frame is None:
        raise VergenceError(f"{path}: frame {index} is damaged or missing.")
    grey = frame.format.name.startswith("gray")
    deep = grey and frame.format.components[0].bits > 8
    return frame.to_ndarray(format="gray16le" if deep else "gray" if grey else "rgb24")
