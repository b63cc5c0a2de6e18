"""Record one figure: its frames, its series, its report."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import rerun as rr

from vergence.arrays import Array
from vergence.dataset import Frame
from vergence.errors import VergenceError
from vergence.experiments.paper import Figure
from vergence.experiments.statistics import Statistics
from vergence.head import HeadCalibration
from vergence.kinematics import EYE_JOINTS

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom
from vergence.recording import style
from vergence.recording.layout import blueprint, title
from vergence.recording.shapes import (
    lines_of_sight,
    log_cameras,
    log_geoms,
    placed,
    quaternions,
    spread_ellipsoid,
)


@contextmanager
def figure_recording(
    path: Path, figure: Figure, head: HeadCalibration, geoms: Sequence[VisualGeom]
) -> Iterator[rr.RecordingStream]:
    """Record a figure in a `with` block.

    The file appears under its name only when the block ends well: an interrupted run leaves no
    half a file.

    Args:
        path: of the `.rrd` file; one that is there is replaced.
        figure: which one.
        head: whose cameras are drawn, as it is believed to be.
        geoms: the head's shapes.

    Raises:
        VergenceError: the file cannot be written.
    """
    rr.set_strict_mode(True)  # by default bad data is dropped with a warning
    part = path.with_name(f".{path.name}.part")
    folder = path.resolve().parent
    try:
        if path.is_dir():  # found out now, not when all is recorded
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        folder.mkdir(parents=True, exist_ok=True)
        part.write_bytes(b"")  # rerun's own message names neither the file nor the reason
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    try:
        # The viewer takes recordings of one id for one: those of two runs must differ.
        with rr.RecordingStream(
            style.APPLICATION, recording_id=f"{folder.name}-{path.stem}"
        ) as rec:
            rec.save(part, default_blueprint=blueprint(figure, head))
            rec.set_log_time_enabled(False)  # recordings of one seed stay comparable
            rec.send_recording_name(f"{title(figure)} ({folder.name})")
            rec.log("world", rr.ViewCoordinates.FLU, static=True)
            log_geoms(rec, geoms)
            log_cameras(rec, head)
            log_styles(rec)
            yield rec
        os.replace(part, path)
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    finally:
        part.unlink(missing_ok=True)


def log_styles(rec: rr.RecordingStream) -> None:
    for axis, color in style.AXIS_COLOURS.items():
        # Plots average the samples that share a pixel, unless told to keep the extremes.
        curve = rr.SeriesLines(names=axis, colors=color, widths=1.5, aggregation_policy="MinMax")
        rec.log(f"estimate/{axis}", curve, static=True)
        for entity, color3, name in (
            (f"estimate_mean/{axis}", style.PALE[axis], "mean"),
            (f"paper/{axis}", style.PAPER, "paper's mean"),
        ):
            names = [name, f"{name} + std", f"{name} - std"]
            levels = rr.SeriesLines(names=names, colors=[color3] * 3, widths=[2.5, 1.5, 1.5])
            rec.log(entity, levels, static=True)
    for joint, color in style.JOINT_COLOURS.items():
        curve = rr.SeriesLines(names=joint.replace("_", " "), colors=color)
        rec.log(f"joints/{joint}", curve, static=True)
    for name, radius_px, color in (
        ("trail", 1.5, style.OLD),
        ("recent", 2.5, style.ESTIMATE),
        ("estimate", 6.0, style.ESTIMATE),
    ):
        points = rr.Points3D.from_fields(radii=-radius_px, colors=color)  # negative: in pixels
        rec.log(f"world/left_base/{name}", points, static=True)
    rays = rr.LineStrips3D.from_fields(colors=style.RAY, radii=-1.0)
    rec.log("world/left_base/rays", rays, static=True)


def log_frame(
    rec: rr.RecordingStream,
    *,
    time_s: float,
    index: int,
    frame: Frame | None,
    body_poses: Mapping[str, Array],
    detected: Mapping[str, Array],
    truth: Mapping[str, Array],
) -> None:
    """Record one moment; may be called from another thread.

    Args:
        rec: the recording.
        time_s: since the first sample.
        index: of the sample.
        frame: images; None: only the head moves.
        body_poses: by name, poses (4, 4) in the world.
        detected: by camera, the pixel (2,) at which the object was found; NaN: not found.
        truth: by camera, the pixel (2,) at which it truly is.
    """
    rec.set_time("sim_time", duration=time_s)
    rec.set_time("frame", sequence=index)
    bodies = [body for body in body_poses if body != "world"]
    if bodies:
        T = np.array([body_poses[body] for body in bodies])
        turns = quaternions(T[:, :3, :3])
        for body, translation, quaternion in zip(bodies, T[:, :3, 3], turns, strict=True):
            at = rr.Transform3D(translation=translation, quaternion=quaternion)
            rec.log(f"world/{body}", at)
    for name, image in ({} if frame is None else frame.images).items():
        entity = f"world/{name.split('_')[0]}_eye/{name}"
        bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, style.JPEG_QUALITY])
        encoded = rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
        rec.log(f"{entity}/image", encoded)
        size = (image.shape[1], image.shape[0])
        crosses = [pixel + style.CROSS_PX for pixel in _within(detected.get(name), size)]
        strips = np.concatenate(crosses) if crosses else []
        rec.log(f"{entity}/detected", rr.LineStrips2D.from_fields(strips=strips))
        centers = _within(truth.get(name), size)
        radii = np.full_like(centers, style.RING_PX)
        rec.log(f"{entity}/truth", rr.Ellipses2D.from_fields(centers=centers, half_sizes=radii))


def _within(pixel: Array | None, size: tuple[int, int]) -> Array:
    """Return a pixel in rerun's coordinates (1, 2), or (0, 2) if it is not in the image."""
    if pixel is None or not (np.abs(2 * pixel + 1 - size) <= size).all():
        return np.empty((0, 2))
    return pixel[None] + 0.5


def _columns(time_s: Array, index: np.ndarray) -> list[rr.TimeColumn]:
    # A float array would be truncated to nanoseconds, while set_time rounds.
    nanoseconds = np.round(time_s * 1e9).astype("timedelta64[ns]")
    return [
        rr.TimeColumn("sim_time", duration=nanoseconds),
        rr.TimeColumn("frame", sequence=index),
    ]


def log_series(
    rec: rr.RecordingStream,
    *,
    figure: Figure,
    head: HeadCalibration,
    time_s: Array,
    points: Array,
    object_m: Array,
    eye_angles: Array,
    T_world_lbase: Array,
    statistics: Statistics,
) -> None:
    """Record what was estimated, as curves and as a trail in space.

    Args:
        rec: the recording.
        figure: which one, for the paper's values beside ours.
        head: the calibration, for the lines of sight.
        time_s: (N,) since the first sample.
        points: (N, 3) estimates in the left eye's base frame; samples with NaN are left out.
        object_m: (3,) where the object truly is, in the same frame.
        eye_angles: (N, 4) joint readings.
        T_world_lbase: (4, 4) where that frame is.
        statistics: of the points.
    """
    index = np.arange(len(time_s))
    for joint, angles in zip(EYE_JOINTS, eye_angles.T, strict=True):
        scalars = rr.Scalars.columns(scalars=angles)
        rec.send_columns(f"joints/{joint}", _columns(time_s, index), scalars)
    good = np.isfinite(points).all(axis=1)
    times, points = _columns(time_s[good], index[good]), points[good]
    for k, axis in enumerate(style.AXIS_COLOURS):
        rec.send_columns(f"estimate/{axis}", times, rr.Scalars.columns(scalars=points[:, k]))
        for kind, mean, std in (
            ("estimate_mean", statistics.mean_m[k], statistics.std_m[k]),
            ("paper", figure.mean_m[k], figure.std_m[k]),
        ):
            levels = np.tile([mean, mean + std, mean - std], (2, 1))
            if len(time_s) and np.isfinite(levels).all():
                ends = _columns(time_s[[0, -1]], index[[0, -1]])
                rec.send_columns(f"{kind}/{axis}", ends, rr.Scalars.columns(scalars=levels))
    rec.log("world/left_base", placed(T_world_lbase), static=True)
    marker = rr.Points3D([object_m], radii=-4.0, colors=style.OBJECT)
    rec.log("world/left_base/object", marker, static=True)
    if len(points) > 3:
        rec.log("world/left_base/spread", spread_ellipsoid(points), static=True)
    for name in ("trail", "recent", "estimate"):
        entity = f"world/left_base/{name}"
        rec.send_columns(entity, times, rr.Points3D.columns(positions=points))
    rays = rr.LineStrips3D.columns(strips=list(lines_of_sight(head, points, eye_angles[good])))
    rec.send_columns("world/left_base/rays", times, rays)


def log_report(rec: rr.RecordingStream, markdown: str) -> None:
    """Record the report of a figure."""
    rec.log("report", rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)


def log_statistics(
    rec: rr.RecordingStream, *, figure: Figure, object_m: Array, statistics: Statistics
) -> None:
    """Record a figure's statistics as a property of the recording."""
    rec.send_property(
        "statistics",
        rr.AnyValues(
            figure=figure.number,
            paper_mean_m=np.array(figure.mean_m),
            paper_std_m=np.array(figure.std_m),
            object_m=object_m,
            mean_m=statistics.mean_m,
            std_m=statistics.std_m,
            samples=statistics.samples,
            dropped=statistics.dropped,
        ),
    )
