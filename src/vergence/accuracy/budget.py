"""The error budget: what each source of error adds to located points, while the eyes move.

White sources are new in every sample. What the samples share - errors of the calibration, known
errors - moves the points along with the eyes: its mean over the motion shifts all points alike, and
the rest spreads them. In parallel motion the latter all but vanishes in depth, since the eyes stand
to each other as they do at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, pair_names, stated_covariance, states_covariance
from vergence.geometry.parameters import is_gain, named_columns
from vergence.geometry.projection import project_point
from vergence.stereo.calibration_covariance import covariance_factor
from vergence.stereo.linearised import Linearised, by_head_parameters, linearised, pair_parameters
from vergence.stereo.measurement_noise import noise_of_readings, pixel_noise

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
"""Groups of a calibration's parameters, by how their names end; others are the axes of the eyes."""


@dataclass(frozen=True, eq=False)
class Source:
    """One source of errors: white noise of pixels or joints, or a known error of the head."""

    name: str
    pixel_std_px: float | Array = 0.0
    """Noise of each coordinate, or of left u, left v, right u, right v (4,)."""
    joint_std_rad: float | Array = 0.0
    """Noise of each reading, or of all (r,)."""
    errors: Mapping[str, float] = field(default_factory=dict)
    """By parameter of the head: calibration minus truth."""


@dataclass(frozen=True, eq=False)
class Part:
    """What a source adds to a point's standard deviation, x forward, y left, z up."""

    name: str
    spread_m: Array
    """(3,) what differs from sample to sample. What correlated parts have in common (see Budget)
    may have a negative variance v: sign(v) sqrt(|v|)."""
    shared_m: Array
    """(3,) what all samples of the motion have in common; zero for white noise."""

    @property
    def std_m(self) -> Array:
        """Return the standard deviation of one sample (3,)."""
        return np.hypot(self.spread_m, self.shared_m)


@dataclass(frozen=True, eq=False)
class Budget:
    """The parts of the error of one point."""

    point_m: Array
    """(3,) in the left eye's base frame."""
    parts: tuple[Part, ...]
    """By source. Known errors, and the groups of a calibration, are correlated: what that adds or
    takes away is a part of its own, so that the squares add up to the total."""
    total: Part
    halved_m: dict[str, float]
    """Standard deviation of a point, x, y and z together, if a source were half as large; the
    groups of a calibration only get better together."""
    samples: int
    """Samples of the motion in which both cameras see the point."""


def budget(
    head: HeadCalibration,
    points: Array,
    *,
    joints: Array,
    rates: Array,
    sources: Sequence[Source],
    cameras: tuple[str, str] | None = None,
) -> list[Budget]:
    """Return the budget of each of K points, over a motion of the eyes.

    Args:
        head: whose covariance is a source too, if it states one.
        points: (K, 3) [m] in the left eye's base frame.
        joints: (T, r) readings [rad] of the motion.
        rates: (T, r) how fast these change [rad/s], for errors of the time offset.
        sources: white noise and known errors.
        cameras: names of a camera of the left eye and one of the right; None: the main ones.

    Raises:
        VergenceError: an unknown camera or parameter, or a point that is not seen during the
            motion.
    """
    return [_budget(head, point, joints, rates, sources, cameras) for point in points]


def _budget(
    head: HeadCalibration,
    point: Array,
    joints: Array,
    rates: Array,
    sources: Sequence[Source],
    cameras: tuple[str, str] | None,
) -> Budget:
    seen, kept = _samples(head, point, joints, cameras)
    names = (*pair_parameters(head, cameras), TIME_OFFSET)
    by_time = np.einsum("irt,tr->it", seen.by_readings, rates[kept])
    by_head = np.concatenate([by_head_parameters(head, cameras, seen), by_time[:, None]], axis=1)

    def of_errors(source: Source) -> Array:
        """Return the changes (3, T) that known errors make."""
        named_columns(head, tuple(source.errors))  # VergenceError: an unknown name
        return by_head.swapaxes(1, 2) @ [source.errors.get(name, 0.0) for name in names]

    white = {s.name: _white(seen, s) for s in sources if not s.errors}
    known = {s.name: of_errors(s) for s in sources if s.errors}
    parts = [Part(name, np.sqrt(variance), np.zeros(3)) for name, variance in white.items()]
    zero = np.zeros((3, 1, len(kept)))
    groups = _of_calibration(head, names, by_head)
    calibration = groups.pop(CALIBRATION, zero)
    together = sum(known.values(), zero[:, 0])[:, None]
    for title, own, whole in (
        ("correlation of the calibration's errors", groups, calibration),
        ("correlation of the known errors", {n: e[:, None] for n, e in known.items()}, together),
    ):
        moments = [_moments(each) for each in own.values()]
        parts += [Part(n, *np.sqrt(m)) for n, m in zip(own, moments, strict=True)]
        if len(own) > 1:
            rest = _moments(whole) - sum(moments)
            parts.append(Part(title, *np.sign(rest) * np.sqrt(np.abs(rest))))
    spread, shared = _moments(calibration) + _moments(together)
    spread = spread + sum(white.values(), np.zeros(3))
    total = Part("total", np.sqrt(spread), np.sqrt(shared))
    variance = float((spread + shared).sum())
    less = {name: 0.75 * float(own.sum()) for name, own in white.items()}
    if groups:
        less[CALIBRATION] = 0.75 * float(_moments(calibration).sum())
    for name, own in known.items():
        half = _moments(together - own[:, None] / 2)
        less[name] = float((_moments(together) - half).sum())
    halved = {name: float(np.sqrt(variance - change)) for name, change in less.items()}
    return Budget(point, tuple(parts), total, halved, len(kept))


def _samples(
    head: HeadCalibration, point: Array, joints: Array, cameras: tuple[str, str] | None
) -> tuple[Linearised, np.ndarray]:
    """Return the point as it is located, and which samples (t,) of the motion see it."""
    pixels, kept = [], np.ones(len(joints), dtype=bool)
    for name in pair_names(head, cameras):
        lens, uv = head.camera(name).intrinsics, project_point(head, name, joints, point)
        size = lens.size
        kept &= ((uv > -0.5) & (uv < np.array(size) - 0.5)).all(axis=1)
        pixels.append(uv)
    if kept.sum() < 2:
        raise VergenceError(
            f"A budget needs a point that both cameras see while the eyes move; ({point[0]:g}, "
            f"{point[1]:g}, {point[2]:g}) m is in both images in {kept.sum()} of {len(kept)} "
            "samples. Points are in metres from the left eye, x forward, y left, z up."
        )
    left, right = (uv[kept] for uv in pixels)
    seen = linearised(head, left=left, right=right, joints=joints[kept], cameras=cameras)
    return seen, np.flatnonzero(kept)


def _white(seen: Linearised, source: Source) -> Array:
    """Return the variance (3,) [m^2] that white noise makes, in the mean over the motion."""
    _, r, n = seen.by_readings.shape
    stds = noise_of_readings(source.joint_std_rad, r, n)
    pixels = (seen.by_pixels * pixel_noise(source.pixel_std_px, n)) ** 2
    readings = (seen.by_readings * stds) ** 2
    return pixels.sum(axis=1).mean(axis=1) + readings.sum(axis=1).mean(axis=1)


def _of_calibration(
    head: HeadCalibration, names: tuple[str, ...], by_head: Array
) -> dict[str, Array]:
    """Return by group of parameters changes (3, q, T) of the point by q independent unit errors.

    All parameters together are the group CALIBRATION. Empty where no covariance is stated.
    """
    if not states_covariance(head):
        return {}
    rows, C = stated_covariance(head, names)
    groups = [group_of(names[k]) for k in rows]
    found = {}
    for group in (*dict.fromkeys(groups), CALIBRATION):
        own = np.flatnonzero([group in (each, CALIBRATION) for each in groups])
        factor = covariance_factor(C[np.ix_(own, own)])
        found[group] = factor.T @ by_head[:, rows[own]]
    return found


def group_of(parameter: str) -> str:
    """Return the group of sources that a parameter of a head belongs to."""
    if is_gain(parameter):
        return "gains"
    return next((group for group, ends in GROUPS if parameter.endswith(ends)), "axes of the eyes")


def _moments(changes: Array) -> Array:
    """Return the variance over the motion, and the square of its mean (2, 3), of (3, q, T)."""
    mean = changes.mean(axis=2)
    return np.stack([changes.var(axis=2).sum(axis=1), (mean**2).sum(axis=1)])
