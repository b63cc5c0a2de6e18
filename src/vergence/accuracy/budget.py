"""The error budget: how much each source of error adds to located points while the eyes move.

White noise is new in every sample. All samples share the errors of the calibration and known ones,
which displace the points as the eyes move. Their mean over the motion shifts all points alike; the
difference from it spreads them. In parallel motion this spread is small in depth, since the eyes
keep their pose relative to each other.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vergence.accuracy.motions import PERIOD_S, eye_readings
from vergence.arrays import Array
from vergence.data.dataset import check_fits
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.head import (
    HeadCalibration,
    pair_names,
    pixel_stds,
    reading_stds,
    stated_covariance,
    states_covariance,
)
from vergence.geometry.kinematics import check_moves
from vergence.geometry.parameters import is_gain, named_columns
from vergence.geometry.projection import project_point
from vergence.stereo.linearised import by_head_parameters, linearised, pair_parameters
from vergence.stereo.triangulation import Sightings, sightings

TIME_OFFSET = "time_offset_s"
CALIBRATION = "the calibration"
GROUPS = (
    ("focal lengths", (".fx", ".fy")),
    ("principal points", (".cx", ".cy")),
    ("distortion", tuple(f".{k}{n}" for k in "kp" for n in range(1, 7))),
    ("mountings", tuple(f".T_eye_cam.{axis}" for axis in ("rx", "ry", "rz", "tx", "ty", "tz"))),
    ("base", tuple(f"T_rbase_lbase.{axis}" for axis in ("rx", "ry", "rz", "tx", "ty", "tz"))),
    ("time offset", (TIME_OFFSET,)),
)
"""Groups of a calibration's parameters, by the ends of their names; others are axes of the eyes."""


@dataclass(frozen=True, eq=False)
class Source:
    """A source of errors: white noise of pixels or joints, or known errors of the head."""

    name: str
    pixel_std_px: float | Array = 0.0
    """Noise of each coordinate, or of left u, left v, right u, right v (4,)."""
    reading_std: float | Array = 0.0
    """Noise of each reading, or of all (r,)."""
    errors: Mapping[str, float] = field(default_factory=dict)
    """Calibration minus truth, by parameter of the head."""

    def __post_init__(self) -> None:
        stds = np.concatenate([np.ravel(self.pixel_std_px), np.ravel(self.reading_std)])
        if not ((stds >= 0) & (stds < np.inf)).all():
            raise VergenceError(f"{self.name} has a standard deviation of 0 or more, found {stds}.")


@dataclass(frozen=True, eq=False)
class Part:
    """Standard deviations of a point by one source, x forward, y left, z up."""

    name: str
    spread_m: Array
    """(3,) of the errors that differ between samples. The common part of correlated sources (see
    Budget) may have a negative variance v, given as sign(v) sqrt(|v|)."""
    shared_m: Array
    """(3,) of the errors that all samples of the motion have in common; zero for white noise."""

    @property
    def std_m(self) -> Array:
        """(3,) standard deviation of one sample."""
        return np.hypot(self.spread_m, self.shared_m)


@dataclass(frozen=True, eq=False)
class Budget:
    """The error of one point by source."""

    point_m: Array
    """(3,) in the left eye's base frame."""
    parts: tuple[Part, ...]
    """By source. Known errors, and the groups of a calibration, are correlated: a part of its own
    holds their correlation, so that the squares add up to the total."""
    total: Part
    halved_m: dict[str, float]
    """Standard deviation of the point, x, y and z together, if a source were half as large. The
    groups of a calibration improve together."""
    samples: int
    """Samples of the motion in which both cameras see the point."""


def budget(
    head: HeadCalibration,
    points: Array,
    *,
    joints: Array,
    rates: Array,
    sources: Sequence[Source],
) -> list[Budget]:
    """Compute the budget of each of K points over a motion of the eyes.

    Args:
        head: if it states a covariance, this is a source too.
        points: (K, 3) [m] in the left eye's base frame.
        joints: (T, r) readings [rad] of the motion.
        rates: (T, r) velocities of the readings [rad/s], for errors of the time offset.
        sources: white noise and known errors.

    Raises:
        VergenceError: a camera or parameter is unknown, or a point is not seen during the motion.
    """
    for each in sources:
        named_columns(head, tuple(each.errors))  # VergenceError: an unknown name
    return [_budget(head, point, joints, rates, sources) for point in points]


def _budget(
    head: HeadCalibration, point: Array, joints: Array, rates: Array, sources: Sequence[Source]
) -> Budget:
    seen, kept = _samples(head, point, joints)
    located, names = linearised(seen), (*pair_parameters(head, seen.cameras), TIME_OFFSET)
    by_time = located.by_readings @ rates[kept][..., None]
    by_head = np.concatenate([by_head_parameters(located, seen), by_time], axis=2)
    by_head = np.moveaxis(by_head, 0, -1)
    white, known, zero = {}, {}, np.zeros((3, 1, len(kept)))
    for each in sources:
        if each.errors:
            sizes = np.array([each.errors.get(name, 0.0) for name in names])
            known[each.name] = (by_head.swapaxes(1, 2) @ sizes)[:, None]
        else:
            noise = located.by_pixels * each.pixel_std_px, located.by_readings * each.reading_std
            white[each.name] = sum((c**2).sum(axis=2).mean(axis=0) for c in noise)
    groups = _by_group(head, names, by_head)
    calibration, together = groups.pop(CALIBRATION, zero), sum(known.values(), zero)
    parts = [Part(name, np.sqrt(variance), np.zeros(3)) for name, variance in white.items()]
    for title, changes, joint_changes in (
        ("correlation of the calibration's errors", groups, calibration),
        ("correlation of the known errors", known, together),
    ):
        moments = [_moments(each) for each in changes.values()]
        parts += [Part(name, *np.sqrt(m)) for name, m in zip(changes, moments, strict=True)]
        if len(changes) > 1:
            remaining = _moments(joint_changes) - sum(moments)
            parts.append(Part(title, *np.sign(remaining) * np.sqrt(np.abs(remaining))))
    spread, shared = _moments(calibration) + _moments(together)
    spread = spread + sum(white.values(), np.zeros(3))
    # Half of a standard deviation is a quarter of its variance.
    less = {name: 0.75 * variance.sum() for name, variance in white.items()}
    if groups:
        less[CALIBRATION] = 0.75 * _moments(calibration).sum()
    for name, changes in known.items():
        less[name] = (_moments(together) - _moments(together - changes / 2)).sum()
    variance = (spread + shared).sum()
    halved = {name: float(np.sqrt(variance - change)) for name, change in less.items()}
    total = Part("total", np.sqrt(spread), np.sqrt(shared))
    return Budget(point, tuple(parts), total, halved, len(kept))


def _samples(head: HeadCalibration, point: Array, joints: Array) -> tuple[Sightings, np.ndarray]:
    """Project the point in the samples (t,) of the motion that show it to both cameras."""
    pair = pair_names(head)
    pixels = [project_point(head, name, joints, point) for name in pair]
    sizes = [np.array(head.camera(name).intrinsics.size) for name in pair]
    inside = [((uv > -0.5) & (uv < size - 0.5)) for uv, size in zip(pixels, sizes, strict=True)]
    kept = np.flatnonzero(np.concatenate(inside, axis=1).all(axis=1))
    if len(kept) < 2:
        raise VergenceError(
            f"A budget needs a point that both cameras see while the eyes move; ({point[0]:g}, "
            f"{point[1]:g}, {point[2]:g}) m is in both images in {len(kept)} of {len(joints)} "
            "samples. Points are in metres from the left eye, x forward, y left, z up."
        )
    left, right = (uv[kept] for uv in pixels)
    seen = sightings(
        head, left=left, right=right, joints=joints[kept], cameras=pair, pixel_std_px=1.0
    )
    return seen, kept


def _by_group(head: HeadCalibration, names: tuple[str, ...], by_head: Array) -> dict[str, Array]:
    """Compute changes (3, q, T) of the point by q independent unit errors of each group.

    All parameters together are the group CALIBRATION. Empty if no covariance is stated.
    """
    if not states_covariance(head):
        return {}
    rows, C = stated_covariance(head, names)
    groups = [group_of(names[k]) for k in rows]
    found = {}
    for group in (*dict.fromkeys(groups), CALIBRATION):
        members = np.flatnonzero([group in (each, CALIBRATION) for each in groups])
        own = C[np.ix_(members, members)]
        std = np.sqrt(np.maximum(np.diag(own), 1e-300))  # the parameters have different units
        values, vectors = np.linalg.eigh(own / std / std[:, None])
        factor = std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        found[group] = factor.T @ by_head[:, rows[members]]
    return found


def group_of(parameter: str) -> str:
    """Find the group of sources that a parameter of a head belongs to."""
    if is_gain(parameter):
        return "gains"
    return next((group for group, ends in GROUPS if parameter.endswith(ends)), "axes of the eyes")


def _moments(changes: Array) -> Array:
    """Compute the variance over the motion, and the square of its mean (2, 3), of (3, q, T)."""
    mean = changes.mean(axis=2)
    return np.stack([changes.var(axis=2).sum(axis=1), (mean**2).sum(axis=1)])


SAMPLES = 400
"""Samples of a motion; budgets of more samples differ by less than a printed digit."""


@dataclass(frozen=True, eq=False)
class MotionBudgets:
    """Budgets of K points in one motion, and in parallel motion for comparison."""

    motion: str
    budgets: list[Budget]
    parallel: list[Budget]


def stated_sources(head: HeadCalibration, pixel_std_px: float | None) -> list[Source]:
    """Collect the noise that a calibration states; `pixel_std_px` replaces that of pixels."""
    pixels = pixel_stds(head, None) if pixel_std_px is None else pixel_std_px
    joints = reading_stds(head)
    sources = [Source("pixel noise", pixel_std_px=pixels)] if np.any(pixels) else []
    return sources + [Source("joint noise", reading_std=joints)] * bool(joints.any())


def motion_budgets(
    head: HeadCalibration, points: Array, *, motion: str, sources: Sequence[Source]
) -> MotionBudgets:
    """Compute the budgets of points (K, 3) [m] in the left eye's base frame; see `budget`.

    The motion is parallel, divergent, or the folder of a dataset. VergenceError also if there is
    no source, or the head was calibrated with measured poses.
    """
    if head.accuracy is not None and head.accuracy.eye_motion == "poses":
        raise VergenceError(
            "A budget says what errors of joint readings add; this head was calibrated with "
            "measured eye poses."
        )
    check_moves(head.kinematics, "A budget over a motion")
    if not sources and not states_covariance(head):
        raise VergenceError(
            "A budget needs sources of errors: give a calibration that states its accuracy, an "
            "error profile (--profile paper), or --noise in pixels."
        )
    found: dict[str, list[Budget]] = {}
    for name in (motion, "parallel"):
        joints, rates = motion_of(name, head)
        found[name] = budget(head, points, joints=joints, rates=rates, sources=sources)
    return MotionBudgets(motion, found[motion], found["parallel"])


def motion_of(name: str, head: HeadCalibration) -> tuple[Array, Array]:
    """Make the readings (T, r) [rad] of a motion and their rates (T, r) [rad/s].

    VergenceError if the motion or dataset does not exist, or has other readings than the head.
    """
    if name in PERIOD_S:
        time_s = np.arange(SAMPLES) * PERIOD_S[name] / SAMPLES
        motion = "parallel" if name == "parallel" else "divergent"
        readings = eye_readings(head.kinematics, motion, time_s)
        return readings, np.gradient(readings, time_s, axis=0)
    if not os.path.isdir(name):
        raise VergenceError(
            f"There is no motion {name!r}; there are parallel, divergent, and the folders of "
            "datasets."
        )
    data = load_dataset(name)
    if data.T_base_eye is not None or len(data.eye_angles) < 2:
        raise VergenceError(f"A motion needs two or more rows of joint readings; {name} has none.")
    check_fits(data.description, head, data.folder, cameras=())
    rates = np.gradient(data.eye_angles, data.joint_time_s, axis=0)
    step = -(-len(rates) // (4 * SAMPLES))
    return data.eye_angles[::step], np.where(data.moving[:, None], rates, 0.0)[::step]
