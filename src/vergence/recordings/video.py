"""Read frames of videos in any order with av, an optional package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
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


@contextmanager
def open_video(path: Path) -> Iterator[tuple[Array, Callable[[int], np.ndarray]]]:
    """Open a video: times (N,) [s] of its frames, and what decodes a frame (H, W, 3) by its index.

    Successive frames are decoded once, others from the key frame before them. VergenceError if it
    is damaged, or the package av is not installed.
    """
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
                        return each.to_ndarray(format="rgb24")
                    if following > wanted:
                        break
                raise ValueError("it is not where the index of the file says")
            except damaged as error:
                following = -1
                where = f"{path}: frame {wanted} is damaged"
                raise VergenceError(f"{where}: {explain(error)}.") from error

        yield pts.astype(float) * float(stream.time_base or 1), frame
