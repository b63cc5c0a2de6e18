"""Record one moment of a head: its posture, its images, and the marks in them."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import rerun as rr

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.geometry.head import HeadCalibration
from vergence.viewer import style
from vergence.viewer.layout import camera_entities
from vergence.viewer.shapes import placed


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
    """Record posture, images and marks of one moment; may be called from another thread.

    Args:
        rec: the recording.
        head: whose cameras are drawn.
        time_s: since the first sample.
        index: number of the sample.
        frame: the images; None: only the posture is recorded.
        body_poses: by name, poses (4, 4) in the world.
        detected: by camera, the detected pixel (2,) of the object; NaN: not found.
        truth: by camera, the true pixel (2,) of the object.
    """
    rec.set_time("sim_time", duration=time_s)
    rec.set_time("frame", sequence=index)
    for body, T in body_poses.items():
        if body != "world":
            rec.log(f"world/{body}", placed(T))
    entities = camera_entities(head)
    for name, image in ({} if frame is None else frame.images).items():
        entity = entities[name]
        log_image(rec, entity, image)
        size = (image.shape[1], image.shape[0])
        crosses = [pixel + style.CROSS_PX for pixel in _within(detected.get(name), size)]
        strips = np.concatenate(crosses) if crosses else []
        rec.log(f"{entity}/detected", rr.LineStrips2D.from_fields(strips=strips))
        centers = _within(truth.get(name), size)
        radii = np.full_like(centers, style.RING_PX)
        rec.log(f"{entity}/truth", rr.Ellipses2D.from_fields(centers=centers, half_sizes=radii))


def log_image(rec: rr.RecordingStream, entity: str, image: np.ndarray) -> None:
    """Record an RGB image (H, W, 3) uint8 of a camera's entity as JPEG."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, style.JPEG_QUALITY])
    rec.log(f"{entity}/image", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))


def _within(pixel: Array | None, size: tuple[int, int]) -> Array:
    """Return a pixel in rerun's coordinates (1, 2), or (0, 2) if it is not in the image."""
    if pixel is None or not (np.abs(2 * pixel + 1 - size) <= size).all():
        return np.empty((0, 2))
    return pixel[None] + 0.5


def time_columns(time_s: Array, index: np.ndarray) -> list[rr.TimeColumn]:
    """Return the timelines sim_time and frame for times (N,) [s] and sample numbers (N,)."""
    # A float array would be truncated to nanoseconds, while set_time rounds.
    nanoseconds = np.round(time_s * 1e9).astype("timedelta64[ns]")
    return [rr.TimeColumn("sim_time", duration=nanoseconds), rr.TimeColumn("frame", sequence=index)]
