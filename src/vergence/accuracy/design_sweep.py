"""A sweep over designs of a head: the accuracy of each, by distance, and the cheapest one.

A chunk has one baseline, focal length and board, and all values of the other properties; chunks do
not depend on one another, so that they can be computed anywhere and in any order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.accuracy.design import Sensitivity, gaze_at, joint_std_rad, mean_square, sensitivity
from vergence.accuracy.design_effort import calibration_mean_square, designed_head
from vergence.accuracy.design_settings import (
    AXES,
    CHUNK_AXES,
    Designs,
    DesignSettings,
    costs,
)
from vergence.arrays import Array
from vergence.geometry.board import Chessboard
from vergence.geometry.kinematics import looking_along

SOURCES = ("pixels", "readings", "delay", "calibration")


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep found; its arrays have one dimension for each of AXES, then the distances."""

    settings: DesignSettings
    worst_m: Array
    """Root mean square error of a point at a distance, in the worst direction and posture; NaN
    where the images do not hold such points in any."""
    mean_m: Array
    """Root mean square error over all directions and postures."""
    cost: Array
    """Without the dimension of distances."""


def located_points(settings: DesignSettings) -> tuple[Array, Array]:
    """Return points (D, N, 3) [m] from the middle between the eyes, and postures (N, 2) [rad].

    N counts the pairs of a direction and a posture; a posture is by how much eyes look past.
    """
    where = settings.workspace
    pan, tilt, off = np.meshgrid(
        np.radians(where.pan_deg),
        np.radians(where.tilt_deg),
        np.arange(len(where.off_deg)),
        indexing="ij",
    )
    rays = looking_along(pan, tilt).reshape(-1, 3)
    points = np.multiply.outer(np.array(where.distances_m), rays)
    return points, np.radians(where.off_deg)[off.ravel()]


def chunk_shape(settings: DesignSettings) -> tuple[int, ...]:
    """Return the shape of what compute_chunk returns."""
    own = (len(getattr(settings.designs, name)) for name in AXES[len(CHUNK_AXES) :])
    return (2, *own, len(settings.workspace.distances_m))


def compute_chunk(settings: DesignSettings) -> Array:
    """Return (2, views, counts, joint noise, pixel noise, delay, D): worst_m and mean_m of Sweep.

    The settings have one value for each of CHUNK_AXES.
    """
    designs = settings.designs
    baseline, focal, square = (getattr(designs, name)[0] for name in CHUNK_AXES)
    points, off = located_points(settings)
    seen, by_views = _sources(settings, points, off, baseline * 1e-3, focal, square * 1e-3)
    pixel = np.array(designs.pixel_noise_px)[:, None, None]
    width, height = settings.workspace.image_px
    held = (seen.image_x * focal < width / 2) & (seen.image_y * focal < height / 2)
    count = held.sum(axis=1)
    speed = np.radians(settings.workspace.eye_speed_deg_s)
    found = np.empty(chunk_shape(settings))
    shape = found.shape[1:]
    for v, c, j, t in np.ndindex(shape[0], shape[1], shape[2], shape[4]):
        squares = mean_square(
            seen,
            focal_px=focal,
            pixel_std_px=pixel,
            joint_std_rad=joint_std_rad(designs.counts_per_turn[c], designs.joint_noise_deg[j]),
            late_rad=1e-3 * designs.delay_ms[t] * speed,
            correlation=settings.workspace.eye_correlation,
        )
        squares = squares + by_views[c * shape[2] + j] / designs.views[v]
        squares = np.where(held, squares, 0.0)
        found[0, v, c, j, :, t] = squares.max(axis=-1)
        found[1, v, c, j, :, t] = squares.sum(axis=-1) / np.maximum(count, 1)
    return np.sqrt(np.where(count > 0, found, np.nan))


def _sources(
    settings: DesignSettings,
    points: Array,
    off: Array,
    baseline_m: float,
    focal_px: float,
    square_m: float,
) -> tuple[Sensitivity, Array]:
    """Return sensitivities (D, N), and what one view's worth of calibration adds (C x J, D, N)."""
    where, designs = settings.workspace, settings.designs
    ahead_m = 1e-3 * where.camera_ahead_mm
    seen = sensitivity(baseline_m, points, camera_ahead_m=ahead_m, off_rad=off)
    joints = np.stack(gaze_at(np.array(baseline_m), points), axis=-1) + np.tile(off, 2)
    stds = joint_std_rad(np.array(designs.counts_per_turn)[:, None], designs.joint_noise_deg)
    by_views = calibration_mean_square(
        designed_head(baseline_m, focal_px, ahead_m, where.image_px),
        Chessboard(*where.board, square_m),
        points_m=(points - [0.0, baseline_m / 2, 0.0]).reshape(-1, 3),
        joints=joints.reshape(-1, 4),
        corner_std_px=where.corner_noise_px,
        joint_std_rad=stds.ravel(),
    )
    return seen, by_views.reshape(-1, *points.shape[:2])


def assemble(settings: DesignSettings, found: list[Array]) -> Sweep:
    """Return the sweep of its chunks, in their order."""
    designs = settings.designs
    shape = [len(getattr(designs, name)) for name in AXES]
    whole = np.moveaxis(np.array(found), 1, 0).reshape(2, *shape, -1)
    return Sweep(settings, whole[0], whole[1], costs(settings))


def cheapest(
    sweep: Sweep, accuracy_m: float, distance_m: float, most: int = 10
) -> list[tuple[int, ...]]:
    """Return where in the sweep's arrays the cheapest designs stand that are accurate enough.

    Of equal cost the more accurate one first. Empty where none is as accurate at that distance,
    which is one of the sweep's.
    """
    worst = at_distance(sweep, distance_m).ravel()
    good = np.flatnonzero(worst <= accuracy_m)
    cost = sweep.cost.ravel()
    order = good[np.lexsort((worst[good], cost[good]))][:most]
    return [_place(sweep, each) for each in order]


def most_accurate(sweep: Sweep, distance_m: float) -> tuple[int, ...]:
    """Return where the most accurate design at a distance stands, whatever it costs."""
    return _place(sweep, at_distance(sweep, distance_m).argmin())


def at_distance(sweep: Sweep, distance_m: float) -> Array:
    """Return worst_m at one of the sweep's distances; infinite where no image holds a point."""
    k = sweep.settings.workspace.distances_m.index(distance_m)
    return np.nan_to_num(sweep.worst_m[..., k], nan=np.inf)


def _place(sweep: Sweep, index: np.intp) -> tuple[int, ...]:
    return tuple(int(k) for k in np.unravel_index(index, sweep.cost.shape))


def values_of(settings: DesignSettings, place: tuple[int, ...]) -> dict[str, float]:
    """Return by name of AXES the values of a design."""
    designs = settings.designs
    return {name: getattr(designs, name)[k] for name, k in zip(AXES, place, strict=True)}


def by_source(settings: DesignSettings, values: dict[str, float], points: Array) -> Array:
    """Return (4, N) [m^2]: what each of SOURCES adds to the mean square error of a design.

    For points (N, 3) [m] from the middle between the eyes, which fixate them.
    """
    designs = Designs.model_validate({name: (value,) for name, value in values.items()})
    one = settings.model_copy(update={"designs": designs})
    baseline_m, focal_px = 1e-3 * values["baseline_mm"], values["focal_px"]
    off = np.zeros((len(points), 2))
    seen, by_views = _sources(
        one, points[None], off, baseline_m, focal_px, 1e-3 * values["square_mm"]
    )
    joint = joint_std_rad(values["counts_per_turn"], values["joint_noise_deg"])
    late = 1e-3 * values["delay_ms"] * np.radians(settings.workspace.eye_speed_deg_s)
    stds = np.diag([values["pixel_noise_px"], float(joint), float(late)])
    by_noise = [
        mean_square(
            seen,
            focal_px=focal_px,
            pixel_std_px=pixel_px,
            joint_std_rad=joint_rad,
            late_rad=late_rad,
            correlation=settings.workspace.eye_correlation,
        )[0]
        for pixel_px, joint_rad, late_rad in stds
    ]
    return np.array([*by_noise, by_views[0, 0] / values["views"]])
