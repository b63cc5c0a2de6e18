"""The file of a recording, and what every kind of recording has: images, marks, curves, a report.

Images and their marks are below /world/<side>_eye/<camera>, the report is /report.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.files import whole_file
from vergence.geometry.head import HeadCalibration
from vergence.viewer import style
from vergence.viewer.layouts import camera_entities
from vergence.viewer.shapes import log_cameras, log_geoms, placed

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom

Recording = rr.RecordingStream
"""A recording that is being written, for rooms that do not import rerun."""


@contextmanager
def recording_file(
    path: Path,
    title: str,
    layout: rrb.Blueprint | None,
    head: HeadCalibration | None,
    geoms: Sequence[VisualGeom] = (),
) -> Iterator[rr.RecordingStream]:
    """Record in a `with` block; the file appears when the block ends without an error.

    The cameras of the head and the visible shapes of a robot are drawn.
    """
    rr.set_strict_mode(True)  # by default bad data is dropped with a warning
    folder = path.resolve().parent
    # The viewer merges recordings that have the same id: those of two runs must differ.
    recording_id = f"{folder.name}-{path.stem}"
    # Rows of ten seconds are stored together: rerun keeps 25 kB for the batches of each frame else.
    batches = rr.ChunkBatcherConfig(flush_tick=10.0)
    with (
        whole_file(path) as part,
        _noticing_errors(part) as sink,
        rr.RecordingStream(
            style.APPLICATION, recording_id=recording_id, batcher_config=batches
        ) as rec,
    ):
        rec.save(sink, default_blueprint=layout)
        rec.set_log_time_enabled(False)  # recordings of one seed stay comparable
        rec.send_recording_name(f"{title} ({folder.name})")
        log_surroundings(rec, head, geoms)
        yield rec


def log_surroundings(
    rec: rr.RecordingStream, head: HeadCalibration | None, geoms: Sequence[VisualGeom]
) -> None:
    """Record the axes of the world, the shapes of a robot and the cameras of a head."""
    rec.log("world", rr.ViewCoordinates.FLU, static=True)
    log_geoms(rec, geoms)
    if head is not None:
        log_cameras(rec, head)


@contextmanager
def _noticing_errors(path: Path) -> Iterator[str]:
    """Give a `with` block a pipe to write to, and copy its content to a file.

    OSError at the end of the block if the file cannot be written. Rerun's own writer would only
    log that a disk is full, and then wait for ever.
    """
    if sys.platform == "win32":
        yield str(path)
        return
    errors: list[OSError] = []
    source, sink = os.pipe()

    def copy() -> None:
        with os.fdopen(source, "rb", buffering=0) as pipe:
            try:
                with path.open("wb") as file:
                    shutil.copyfileobj(pipe, file, 1 << 20)
            except OSError as error:
                errors.append(error)
                while pipe.read(1 << 20):  # rerun would wait for a full pipe
                    pass

    copier = threading.Thread(target=copy)
    copier.start()
    try:
        yield f"/dev/fd/{sink}"
    finally:
        os.close(sink)
        copier.join()
    if errors:
        raise errors[0]


def log_report(rec: rr.RecordingStream, markdown: str) -> None:
    """Record a report, which the viewer shows next to the data."""
    rec.log("report", rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)


def set_time(rec: rr.RecordingStream, time_s: float, index: int) -> None:
    """Set the time and the frame of what is recorded next."""
    rec.set_time("sim_time", duration=time_s)
    rec.set_time("frame", sequence=index)


def time_columns(time_s: Array, index: np.ndarray) -> list[rr.TimeColumn]:
    """Make the timelines sim_time and frame of times (N,) [s] and sample numbers (N,)."""
    # A float array would be truncated to nanoseconds, while set_time rounds.
    nanoseconds = np.round(time_s * 1e9).astype("timedelta64[ns]")
    return [rr.TimeColumn("sim_time", duration=nanoseconds), rr.TimeColumn("frame", sequence=index)]


def log_curve(
    rec: rr.RecordingStream, entity: str, times: list[rr.TimeColumn], values: Array
) -> None:
    """Record values (N,) or (N, k) of k curves at times as of `time_columns`."""
    rec.send_columns(entity, times, rr.Scalars.columns(scalars=values))


def log_frame(
    rec: rr.RecordingStream,
    head: HeadCalibration,
    *,
    time_s: float,
    index: int,
    frame: Frame | None,
    body_poses: Mapping[str, Array],
    detected: Mapping[str, Array],
    truth: Mapping[str, Array],
) -> None:
    """Record posture, images and marks of one moment; any thread may call it.

    `body_poses` are poses (4, 4) in the world. `detected` and `truth` are pixels (2,) of the object
    by camera; NaN: not found. Without a frame only the posture is recorded.
    """
    set_time(rec, time_s, index)
    for body, T in body_poses.items():
        if body != "world":
            rec.log(f"world/{body}", placed(T))
    entities = camera_entities(head)
    for name, image in ({} if frame is None else frame.images).items():
        entity = entities[name]
        log_image(rec, entity, image)
        crosses = [at + style.CROSS_PX for at in _within(detected.get(name), image)]
        strips = np.concatenate(crosses) if crosses else []
        rec.log(f"{entity}/detected", rr.LineStrips2D(strips, colors=style.DETECTED, radii=1.0))
        centers = _within(truth.get(name), image)
        radii = np.full_like(centers, 20.0)
        ring = rr.Ellipses2D(centers=centers, half_sizes=radii, colors=style.TRUTH, line_radii=1.0)
        rec.log(f"{entity}/truth", ring)


def log_image(rec: rr.RecordingStream, entity: str, image: np.ndarray) -> None:
    """Record an RGB image (H, W, 3) uint8 below an entity as JPEG."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    # Sensor noise of 3 grey levels takes 24 kB at this quality, 54 kB at 85, and looks the same.
    _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 40])
    rec.log(f"{entity}/image", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))


def _within(pixel: Array | None, image: np.ndarray) -> Array:
    """Convert a pixel to rerun's coordinates (1, 2), or (0, 2) if it is not in the image."""
    size = image.shape[1], image.shape[0]
    if pixel is None or not (np.abs(2 * pixel + 1 - size) <= size).all():
        return np.empty((0, 2))
    return pixel[None] + 0.5
