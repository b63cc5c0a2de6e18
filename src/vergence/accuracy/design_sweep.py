"""A sweep over designs of a head: the accuracy of each, by distance, and the cheapest one.

A chunk has one baseline, focal length and board, and all values of the other properties.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from vergence.accuracy.design import (
    Sensitivity,
    designed_head,
    fixating_joints,
    noise_mean_square,
    reading_std,
    sensitivity,
)
from vergence.accuracy.design_settings import (
    AXES,
    CHUNK_AXES,
    Designs,
    DesignSettings,
    chunks,
    costs,
)
from vergence.arrays import Array
from vergence.geometry.board import Chessboard
from vergence.geometry.kinematics import looking_along
from vergence.parallel import run_tasks
from vergence.progress import Progress, silent

SOURCES = ("pixels", "readings", "delay", "calibration")


@dataclass(frozen=True, eq=False)
class Sweep:
    """Result of a sweep; its arrays have one dimension for each of AXES, then the distances."""

    settings: DesignSettings
    worst_m: Array
    """Root mean square error of a point at a distance, in the worst direction and posture; NaN if
    no image shows such a point, or views of the board do not determine the head."""
    mean_m: Array
    """Root mean square error over all directions and postures."""
    cost: Array
    """Cost of each design, without the dimension of distances."""


def located_points(settings: DesignSettings) -> tuple[Array, Array]:
    """Make points (D, N, 3) [m] from the middle between the eyes, and postures (N, 2) [rad].

    N counts the pairs of a direction and a posture, the angles by which the eyes look past a point.
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


def compute_chunk(settings: DesignSettings) -> Array:
    """Compute worst_m and mean_m of Sweep: (2, views, counts, joint noise, pixel noise, delay, D).

    The settings have one value for each of CHUNK_AXES.
    """
    designs, where = settings.designs, settings.workspace
    points, off = located_points(settings)
    seen = _sensitivity(settings, points.reshape(-1, 3), np.tile(off, (len(points), 1)))
    held = (seen.offset_px < np.array(where.image_px) / 2).all(axis=1).reshape(points.shape[:2])
    count = held.sum(axis=1)
    shape = [len(getattr(designs, name)) for name in AXES[len(CHUNK_AXES) :]]
    found = np.empty((2, *shape, len(points)))
    for v, c, j, t in np.ndindex(shape[0], shape[1], shape[2], shape[4]):
        noise = noise_mean_square(
            seen,
            pixel_std_px=np.array(designs.pixel_noise_px)[:, None],
            reading_std=reading_std(designs.counts_per_turn[c], designs.joint_noise_deg[j]),
            late_rad=_late_rad(settings, designs.delay_ms[t]),
            correlation=where.eye_correlation,
        )
        squares = noise + seen.calibration[c * shape[2] + j] / designs.views[v]
        squares = np.where(held, squares.reshape(-1, *held.shape), 0.0)
        found[0, v, c, j, :, t] = squares.max(axis=-1)
        found[1, v, c, j, :, t] = squares.sum(axis=-1) / np.maximum(count, 1)
    return np.sqrt(np.where((count > 0) & np.isfinite(found), found, np.nan))


def _late_rad(settings: DesignSettings, delay_ms: float) -> float:
    return 1e-3 * delay_ms * np.radians(settings.workspace.eye_speed_deg_s)


def _sensitivity(settings: DesignSettings, points: Array, off: Array) -> Sensitivity:
    """Compute the sensitivity of points (N, 3) from the middle between the eyes.

    The eyes look past each point by off (N, 2) [rad]. The settings are those of a chunk.
    """
    where, designs = settings.workspace, settings.designs
    baseline_m, square_m = 1e-3 * designs.baseline_mm[0], 1e-3 * designs.square_mm[0]
    points = points - [0.0, baseline_m / 2, 0.0]
    stds = reading_std(np.array(designs.counts_per_turn)[:, None], designs.joint_noise_deg)
    return sensitivity(
        designed_head(
            baseline_m, designs.focal_px[0], 1e-3 * where.camera_ahead_mm, where.image_px
        ),
        Chessboard(*where.board, square_m),
        points=points,
        joints=fixating_joints(baseline_m, points) + np.tile(off, 2),
        corner_std_px=where.corner_noise_px,
        reading_std=stds.ravel(),
    )


def cheapest(
    sweep: Sweep, accuracy_m: float, distance_m: float, most: int = 10
) -> list[tuple[int, ...]]:
    """Find the places in the sweep's arrays of the cheapest designs that are accurate enough.

    Of equal cost the more accurate one comes first. The distance is one of the sweep's.
    """
    worst = at_distance(sweep, distance_m).ravel()
    good = np.flatnonzero(worst <= accuracy_m)
    cost = sweep.cost.ravel()
    order = good[np.lexsort((worst[good], cost[good]))][:most]
    return [_place(sweep, each) for each in order]


def most_accurate(sweep: Sweep, distance_m: float) -> tuple[int, ...]:
    """Find the place of the most accurate design at a distance, at any cost."""
    return _place(sweep, at_distance(sweep, distance_m).argmin())


def at_distance(sweep: Sweep, distance_m: float) -> Array:
    """Select worst_m at one of the sweep's distances; infinite where no image shows a point."""
    k = sweep.settings.workspace.distances_m.index(distance_m)
    return np.nan_to_num(sweep.worst_m[..., k], nan=np.inf)


def _place(sweep: Sweep, index: np.intp) -> tuple[int, ...]:
    return tuple(int(k) for k in np.unravel_index(index, sweep.cost.shape))


def values_of(settings: DesignSettings, place: tuple[int, ...]) -> dict[str, float]:
    """List the values of a design by the names of AXES."""
    designs = settings.designs
    return {name: getattr(designs, name)[k] for name, k in zip(AXES, place, strict=True)}


def by_source(settings: DesignSettings, values: dict[str, float], points: Array) -> Array:
    """Compute what each of SOURCES adds to the mean square error of a design: (4, N) [m^2].

    For points (N, 3) [m] from the middle between the eyes, which fixate them.
    """
    designs = Designs.model_validate({name: (value,) for name, value in values.items()})
    chunk = settings.model_copy(update={"designs": designs})
    seen = _sensitivity(chunk, points, np.zeros((len(points), 2)))
    joint_rad = float(reading_std(values["counts_per_turn"], values["joint_noise_deg"]))
    stds = np.diag([values["pixel_noise_px"], joint_rad, _late_rad(chunk, values["delay_ms"])])
    by_noise = noise_mean_square(
        seen,
        pixel_std_px=stds[:, :1],
        reading_std=stds[:, 1:2],
        late_rad=stds[:, 2:],
        correlation=settings.workspace.eye_correlation,
    )
    return np.concatenate([by_noise, seen.calibration / values["views"]])


def sweep(settings: DesignSettings, *, jobs: int = 1, progress: Progress = silent) -> Sweep:
    """Sweep designs, in a number of processes."""
    tasks = [partial(_numbered, k, chunk) for k, chunk in enumerate(chunks(settings))]
    found: dict[int, Array] = {}

    def keep(result: tuple[int, Array]) -> None:
        found.update([result])
        progress("sweeping designs", len(found), len(tasks))

    run_tasks(tasks, keep, jobs=jobs)
    designs = settings.designs
    shape = [len(getattr(designs, name)) for name in AXES]
    arrays = np.stack([found[k] for k in range(len(tasks))], axis=1)
    worst_m, mean_m = arrays.reshape(2, *shape, -1)
    return Sweep(settings, worst_m, mean_m, costs(settings))


def _numbered(k: int, chunk: DesignSettings, progress: Progress) -> tuple[int, Array]:
    return k, compute_chunk(chunk)
