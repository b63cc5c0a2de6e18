"""Read frames of videos in any order with av, an optional package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.geometry.camera import MAX_IMAGE_AREA_PX

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
    """Decodes a frame (H, W, 3), RGB, or (H, W), by its index. VergenceError if it is damaged.
    Successive frames are decoded once; others from the key frame before them."""


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
    damaged = FFmpegError, OSError, LookupError, TypeError, ValueError
    with ExitStack() as stack:
        try:
            file = stack.enter_context(path.open("rb"))
            container = stack.enter_context(av.open(file, "r", options=_OPTIONS))
            stream = container.streams.video[0]
            stream.codec_context.options = {"max_pixels": str(MAX_IMAGE_AREA_PX)}
            packets = sorted((p.pts, p.is_keyframe) for p in container.demux(stream) if p.size)
            pts = np.array([time for time, _ in packets], np.int64)
            keys = np.flatnonzero([key for _, key in packets])
            if not len(keys) or (np.diff(pts) <= 0).any():
                raise ValueError("it has no frames, or several of one time")
        except damaged as error:
            raise VergenceError(f"{path} cannot be read as a video: {explain(error)}.") from error
        decoded: Iterator[Any] = iter(())
        following = -1  # the index of the next frame in `decoded`

        def frame(wanted: int) -> np.ndarray:
            nonlocal decoded, following
            key = int(keys[max(0, int(np.searchsorted(keys, wanted, side="right")) - 1)])
            try:
                if not key <= following <= wanted:
                    container.seek(int(pts[key]), stream=stream, backward=True)
                    decoded = container.decode(stream)
                for each in decoded:
                    following = int(np.searchsorted(pts, each.pts)) + 1
                    if following == wanted + 1:
                        return _image(each)
                    if following > wanted:
                        break
                raise ValueError("it is not where the index of the file says")
            except damaged as error:
                following = -1
                where = f"{path}: frame {wanted} is damaged"
                raise VergenceError(f"{where}: {explain(error)}.") from error

        yield Video(pts.astype(float) * float(stream.time_base or 1), frame)


def _image(frame: Any) -> np.ndarray:
    grey = frame.format.name.startswith("gray")
    deep = grey and frame.format.components[0].bits > 8
    return frame.to_ndarray(format="gray16le" if deep else "gray" if grey else "rgb24")


def open_latest(stack: ExitStack) -> Callable[[Path], Video]:
    """Make a function that opens a video and keeps it open until it is asked for another."""
    opened: dict[Path, Video] = {}
    inner = stack.enter_context(ExitStack())

    def get(path: Path) -> Video:
        if path not in opened:
            opened.clear()
            inner.close()
            opened[path] = inner.enter_context(open_video(path))
        return opened[path]

    return get
