"""Recordings for the rerun viewer: one file a figure, that explains itself when it is opened.

The only module that imports rerun. The entities, on the timelines `sim_time` [s] and `frame`:

    /world/<body>                 poses of the head's bodies and of the object, with their shapes
    /world/<side>_eye/<camera>    a pinhole, with its /image, and the object /detected and in /truth
    /world/left_base              the left eye's base frame, with the estimates
    /estimate/x, y, z             the estimates [m], all their digits
    /estimate_mean/x, y, z        their mean, and mean ± standard deviation
    /paper/x, y, z                the paper's
    /joints/<joint>               joint readings [rad]
    /report                       markdown

A pixel's centre is at +0.5 in rerun, and at 0 in the rest of the project.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.dataset import Frame
from vergence.errors import VergenceError
from vergence.experiments.paper import Figure
from vergence.experiments.statistics import Statistics
from vergence.geometry import inverse, transform
from vergence.head import HeadCalibration, T_base_cam
from vergence.kinematics import EYE_JOINTS, EYES

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom

APPLICATION = "vergence"  # the same for every recording: no dots or slashes

AXIS_COLOURS = {"x": (31, 90, 255), "y": (0, 150, 40), "z": (225, 30, 30)}
"""The paper's: x (depth) blue, y green, z red."""
_PALE = {"x": (150, 185, 255), "y": (140, 215, 150), "z": (255, 165, 160)}
_PAPER = (150, 150, 150)
_JOINT_COLOURS = {
    "left_pan": (230, 120, 20),
    "left_tilt": (240, 190, 90),
    "right_pan": (30, 140, 170),
    "right_tilt": (120, 200, 215),
}
_BACKGROUND = (236, 239, 243)
_EYE_HEIGHT_M = 1.2
"""Of the model, above the floor; the neck stays straight in the experiments."""
_ALPHA = {"object": 0.35}
"""Bodies that one must see through: most estimates lie in the object."""
_DETECTED, _TRUTH = (255, 230, 0), (0, 240, 255)
_ESTIMATE, _OLD, _RAY, _OBJECT = (20, 60, 220), (120, 150, 235), (250, 150, 30), (60, 60, 60)
_CROSS_PX = np.array([[[-9.0, 0.0], [9.0, 0.0]], [[0.0, -9.0], [0.0, 9.0]]])
_RING_PX = 20.0
_FRUSTUM_M = {"wide": 0.045, "narrow": 0.16}
"""Distance at which an image is drawn before its camera: both are then about as large."""
_JPEG_QUALITY = 40
"""Sensor noise inflates JPEG: 24 kB for a 640 x 480 image with noise of 3 grey levels, and 54 kB
at 85, for no more to see."""
_TRAIL_S = 10.0
"""How long an estimate stays bright."""
_SPEED = 3.0
"""Playback, in recorded seconds a second: the eyes' period of 2 pi s is slow to watch."""


def _title(figure: Figure) -> str:
    return f"Fig. {figure.number} - {figure.motion}, {figure.lens.removesuffix('mm')} mm"


def _cameras(head: HeadCalibration) -> dict[str, str]:
    """Return the entity of each camera."""
    return {name: f"world/{mounted.eye}_eye/{name}" for name, mounted in head.cameras.items()}


def blueprint(figure: Figure, head: HeadCalibration) -> rrb.Blueprint:
    """Return the layout of a figure's recording, complete as it opens.

    Args:
        figure: the one that is recorded; its object and the head fill the 3-D view.
        head: whose cameras are shown.
    """
    # Without it a plot keeps the range of what was loaded when it was first drawn.
    ever = rr.TimeRangeBoundary.infinite()
    whole = rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))
    axes = [
        rrb.TimeSeriesView(
            name=f"{label} [m]: bright estimate, pale mean and ± std, grey the paper's",
            origin="/",
            contents=[f"+ /{kind}/{axis}" for kind in ("paper", "estimate_mean", "estimate")],
            axis_x=whole,
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for axis, label in zip(AXIS_COLOURS, ("x = depth", "y", "z"), strict=True)
    ]
    joints = rrb.TimeSeriesView(name="joint readings [rad]", origin="joints", axis_x=whole)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _head_view(figure, head),
                rrb.Grid(*_camera_views(head), grid_columns=2),
                row_shares=[6, 7],
            ),
            rrb.Vertical(*axes, joints),
            rrb.Vertical(
                rrb.TextDocumentView(name="report", origin="report"),
                _close_up(figure),
                row_shares=[5, 4],
            ),
            column_shares=[6, 5, 4],
        ),
        rrb.TimePanel(
            timeline="sim_time",
            state="collapsed",
            playback_speed=_SPEED,
            loop_mode="all",
            play_state="playing",
        ),
        auto_views=False,
        collapse_panels=True,
    )


def _head_view(figure: Figure, head: HeadCalibration) -> rrb.Spatial3DView:
    marks = [
        f"- {entity}/{mark}" for entity in _cameras(head).values() for mark in ("detected", "truth")
    ]
    back, front = -0.20, figure.mean_m[0] + 2 * figure.std_m[0]  # of all that is to be seen
    middle = np.array([(back + front) / 2, 0.3 * figure.mean_m[1], _EYE_HEIGHT_M - 0.03])
    return _view_3d(
        f"{_title(figure)}: head, lines of sight, estimates",
        origin="world",
        contents=["+ $origin/**", "- world/left_base/spread", *marks],
        middle=middle,
        eye=middle + np.array([0.30, 0.85, 0.42]) * (0.10 + 0.74 * (front - back)),
    )


def _close_up(figure: Figure) -> rrb.Spatial3DView:
    middle = np.array(figure.mean_m)
    return _view_3d(
        "close-up: object, estimates and their 2-std ellipsoid",
        origin="world/left_base",
        contents=["+ $origin/**", "+ world/object/**"],
        middle=middle,
        eye=middle + np.array([-0.25, 0.85, 0.45]) * (0.06 + 2.8 * figure.std_m[0]),
    )


def _view_3d(
    name: str, *, origin: str, contents: list[str], middle: Array, eye: Array
) -> rrb.Spatial3DView:
    overrides: dict[Any, rrb.VisibleTimeRanges] = {
        "world/left_base/trail": _last_seconds(None),
        "world/left_base/recent": _last_seconds(_TRAIL_S),
    }
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=contents,
        background=rrb.Background(color=_BACKGROUND),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0, 0, 1)),
        overrides=overrides,
    )


def _last_seconds(seconds: float | None) -> rrb.VisibleTimeRanges:
    """Show what was logged in so many seconds before the cursor; None: since the beginning."""
    boundary = rr.TimeRangeBoundary
    start = boundary.infinite() if seconds is None else boundary.cursor_relative(seconds=-seconds)
    now = boundary.cursor_relative(seconds=0)
    return rrb.VisibleTimeRanges(rrb.VisibleTimeRange("sim_time", start=start, end=now))


def _camera_views(head: HeadCalibration) -> list[rrb.Spatial2DView]:
    views = []
    entities = _cameras(head)
    for name in (f"{eye}_{lens}" for lens in ("wide", "narrow") for eye in EYES):
        if name in entities:
            camera = head.camera(name).intrinsics
            bounds = rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height))
            views.append(
                rrb.Spatial2DView(
                    name=f"{name.replace('_', ' ')}: + found, ○ truth",
                    origin=entities[name],
                    visual_bounds=bounds,
                )
            )
    return views


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
        with rr.RecordingStream(APPLICATION, recording_id=f"{folder.name}-{path.stem}") as rec:
            rec.save(part, default_blueprint=blueprint(figure, head))
            rec.set_log_time_enabled(False)  # recordings of one seed stay comparable
            rec.send_recording_name(f"{_title(figure)} ({folder.name})")
            rec.log("world", rr.ViewCoordinates.FLU, static=True)
            _log_geoms(rec, geoms)
            _log_cameras(rec, head)
            _log_styles(rec)
            yield rec
        os.replace(part, path)
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    finally:
        part.unlink(missing_ok=True)


def _quaternions(R: Array) -> Array:
    """Return (..., 4) xyzw of rotations (..., 3, 3)."""
    return Rotation.from_matrix(R).as_quat()


def _at(T: Array) -> rr.Transform3D:
    quaternion = rr.Quaternion(xyzw=_quaternions(T[:3, :3]))
    return rr.Transform3D(translation=T[:3, 3], quaternion=quaternion)


def _log_geoms(rec: rr.RecordingStream, geoms: Sequence[VisualGeom]) -> None:
    batches: dict[tuple[str, str], list[VisualGeom]] = {}
    for geom in geoms:
        batches.setdefault((geom.body, geom.shape), []).append(geom)
    for (body, shape), batch in batches.items():
        entity = f"world/{body}/shape/{shape}"
        T = np.array([geom.T_body_geom for geom in batch])
        size = np.array([geom.size for geom in batch])
        rgba = np.array([geom.rgba for geom in batch]) * [1, 1, 1, _ALPHA.get(body, 1)]
        colors = np.round(255 * rgba).astype(np.uint8)
        look: dict[str, Any] = {"colors": colors, "fill_mode": "solid"}
        look["quaternions"] = _quaternions(T[:, :3, :3])
        centers = T[:, :3, 3]
        if shape == "box":
            solids = rr.Boxes3D(half_sizes=size, centers=centers, **look)
        elif shape in ("sphere", "ellipsoid"):
            half_sizes = size[:, [0, 0, 0]] if shape == "sphere" else size
            solids = rr.Ellipsoids3D(half_sizes=half_sizes, centers=centers, **look)
        elif shape in ("cylinder", "capsule"):
            look |= {"radii": size[:, 0], "lengths": 2 * size[:, 1]}
            if shape == "cylinder":
                solids = rr.Cylinders3D(centers=centers, **look)
            else:  # rerun's capsule begins at its origin; MuJoCo's has it in the middle
                starts = centers - size[:, 1:2] * T[:, :3, 2]
                solids = rr.Capsules3D(translations=starts, **look)
        else:
            for k, geom in enumerate(batch):
                rec.log(f"{entity}/{k}", _mesh(geom, colors[k]), static=True)
            continue
        rec.log(entity, solids, static=True)


def _mesh(geom: VisualGeom, color: np.ndarray) -> rr.Mesh3D:
    R, t = geom.T_body_geom[:3, :3], geom.T_body_geom[:3, 3]
    if geom.triangles is not None and geom.normals is not None:
        return rr.Mesh3D(
            vertex_positions=geom.triangles.reshape(-1, 3) @ R.T + t,
            vertex_normals=geom.normals.reshape(-1, 3) @ R.T,
            albedo_factor=color,
        )
    x, y = geom.size[:2]
    corners = np.array([[-x, y, 0], [x, y, 0], [x, -y, 0], [-x, -y, 0]])
    return rr.Mesh3D(
        vertex_positions=corners @ R.T + t,
        vertex_normals=np.tile(R[:, 2], (4, 1)),
        vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
        triangle_indices=[[0, 2, 1], [0, 3, 2]],
        albedo_texture=geom.texture,
        albedo_factor=color,
    )


def _log_cameras(rec: rr.RecordingStream, head: HeadCalibration) -> None:
    for name, entity in _cameras(head).items():
        mounted = head.camera(name)
        camera, image_from_camera = mounted.intrinsics, mounted.intrinsics.matrix.copy()
        image_from_camera[:2, 2] += 0.5
        rec.log(
            entity,
            _at(mounted.T_eye_cam),
            rr.Pinhole(
                image_from_camera=image_from_camera,
                width=camera.width,
                height=camera.height,
                image_plane_distance=_FRUSTUM_M[name.split("_")[1]],
            ),
            rr.TransformAxes3D(0),  # else the viewer draws axes as long as the frustum
            static=True,
        )
        cross = rr.LineStrips2D.from_fields(colors=_DETECTED, radii=1.0)
        rec.log(f"{entity}/detected", cross, static=True)
        ring = rr.Ellipses2D.from_fields(colors=_TRUTH, line_radii=1.0)
        rec.log(f"{entity}/truth", ring, static=True)


def _log_styles(rec: rr.RecordingStream) -> None:
    for axis, color in AXIS_COLOURS.items():
        # Plots average the samples that share a pixel, unless told to keep the extremes.
        curve = rr.SeriesLines(names=axis, colors=color, widths=1.5, aggregation_policy="MinMax")
        rec.log(f"estimate/{axis}", curve, static=True)
        for entity, color3, name in (
            (f"estimate_mean/{axis}", _PALE[axis], "mean"),
            (f"paper/{axis}", _PAPER, "paper's mean"),
        ):
            names = [name, f"{name} + std", f"{name} - std"]
            levels = rr.SeriesLines(names=names, colors=[color3] * 3, widths=[2.5, 1.5, 1.5])
            rec.log(entity, levels, static=True)
    for joint, color in _JOINT_COLOURS.items():
        curve = rr.SeriesLines(names=joint.replace("_", " "), colors=color)
        rec.log(f"joints/{joint}", curve, static=True)
    for name, radius_px, color in (
        ("trail", 1.5, _OLD),
        ("recent", 2.5, _ESTIMATE),
        ("estimate", 6.0, _ESTIMATE),
    ):
        points = rr.Points3D.from_fields(radii=-radius_px, colors=color)  # negative: in pixels
        rec.log(f"world/left_base/{name}", points, static=True)
    rays = rr.LineStrips3D.from_fields(colors=_RAY, radii=-1.0)
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
        quaternions = _quaternions(T[:, :3, :3])
        for body, translation, quaternion in zip(bodies, T[:, :3, 3], quaternions, strict=True):
            at = rr.Transform3D(translation=translation, quaternion=quaternion)
            rec.log(f"world/{body}", at)
    for name, image in ({} if frame is None else frame.images).items():
        entity = f"world/{name.split('_')[0]}_eye/{name}"
        bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        encoded = rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
        rec.log(f"{entity}/image", encoded)
        size = (image.shape[1], image.shape[0])
        crosses = [pixel + _CROSS_PX for pixel in _within(detected.get(name), size)]
        strips = np.concatenate(crosses) if crosses else []
        rec.log(f"{entity}/detected", rr.LineStrips2D.from_fields(strips=strips))
        centers = _within(truth.get(name), size)
        radii = np.full_like(centers, _RING_PX)
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
    for k, axis in enumerate(AXIS_COLOURS):
        rec.send_columns(f"estimate/{axis}", times, rr.Scalars.columns(scalars=points[:, k]))
        for kind, mean, std in (
            ("estimate_mean", statistics.mean_m[k], statistics.std_m[k]),
            ("paper", figure.mean_m[k], figure.std_m[k]),
        ):
            levels = np.tile([mean, mean + std, mean - std], (2, 1))
            if len(time_s) and np.isfinite(levels).all():
                ends = _columns(time_s[[0, -1]], index[[0, -1]])
                rec.send_columns(f"{kind}/{axis}", ends, rr.Scalars.columns(scalars=levels))
    rec.log("world/left_base", _at(T_world_lbase), static=True)
    marker = rr.Points3D([object_m], radii=-4.0, colors=_OBJECT)
    rec.log("world/left_base/object", marker, static=True)
    if len(points) > 3:
        rec.log("world/left_base/spread", _ellipsoid(points), static=True)
    for name in ("trail", "recent", "estimate"):
        entity = f"world/left_base/{name}"
        rec.send_columns(entity, times, rr.Points3D.columns(positions=points))
    rays = rr.LineStrips3D.columns(strips=list(_lines_of_sight(head, points, eye_angles[good])))
    rec.send_columns("world/left_base/rays", times, rays)


def _ellipsoid(points: Array) -> rr.Ellipsoids3D:
    """Return the ellipsoid of two standard deviations around the mean of points (N, 3)."""
    variances, axes = np.linalg.eigh(np.cov(points.T))
    axes[:, 0] *= np.linalg.det(axes)  # a rotation, not a reflection
    return rr.Ellipsoids3D(
        centers=[points.mean(axis=0)],
        half_sizes=[2 * np.sqrt(np.maximum(variances, 0))],
        quaternions=[rr.Quaternion(xyzw=_quaternions(axes))],
        colors=_OBJECT,
        fill_mode="majorwireframe",
    )


def _lines_of_sight(head: HeadCalibration, points: Array, eye_angles: Array) -> Array:
    """Return (N, 3, 3): left wide camera, point, right one, in the left eye's base frame."""
    left = T_base_cam(head, "left_wide", eye_angles[:, :2])[:, :3, 3]
    right = T_base_cam(head, "right_wide", eye_angles[:, 2:])[:, :3, 3]
    right = transform(inverse(head.T_rbase_lbase), right)
    return np.stack([left, points, right], axis=1)


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


def read_series(
    path: Path,
    entity: str,
    *,
    component: str = "Scalars:scalars",
    timeline: str = "sim_time",
) -> tuple[Array, Array]:
    """Return times (N,) [s] and values of one series of a recording, in time order.

    Args:
        path: of the `.rrd` file.
        entity: for example `/estimate/x`.
        component: for example `Points3D:positions`.
        timeline: `sim_time`, or `frame`, whose times are sample numbers.

    Returns:
        Values (N, ...); (N, k, ...) where k of them were logged at a time, as in `/paper/x`.

    Raises:
        VergenceError: the recording has no such series.
    """
    times: list[np.ndarray] = []
    rows: list[Any] = []
    stream = RrdReader(path).stream()
    for chunk in stream.filter(content=entity, components=component, has_timeline=timeline):
        batch = chunk.to_record_batch()
        times.append(batch.column(timeline).cast("int64").to_numpy())
        rows += batch.column(component).to_pylist()
    if not times:
        raise VergenceError(f"{path} has no {component} at {entity} on the timeline {timeline}.")
    t, values = np.concatenate(times), np.array(rows)
    order = np.argsort(t, kind="stable")
    seconds = t[order] * (1e-9 if timeline == "sim_time" else 1.0)
    return seconds, (values[:, 0] if values.shape[1] == 1 else values)[order]
