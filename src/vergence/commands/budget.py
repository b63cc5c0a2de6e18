"""`vergence budget`: the error budget of a head and an error profile, as tables, text and JSON."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from vergence.accuracy.budget import TIME_OFFSET, Budget, Part, Source, budget
from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import MAX_M, Array
from vergence.data.reader import load_dataset
from vergence.data.stereo_rows import check_readings_match
from vergence.errors import VergenceError, counted
from vergence.geometry.head import (
    HeadCalibration,
    pair_names,
    pixel_stds,
    reading_stds,
    states_covariance,
)
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.geometry.parameters import boxminus, is_gain

if TYPE_CHECKING:
    from vergence.twin.profile import ErrorProfile, Lens

SAMPLES = 400
"""Samples of a motion: as many as the budget needs to be smooth."""
OBJECT_NOISE_PX = 0.02
"""Noise of the centre of the twin's sphere: RMS of Figs. 6-11 with the profile `ideal`."""
LONG_LENS_PX = 340.0
"""Focal length between those of the twin's lenses of 2.8 mm and 4.0 mm."""
MAX_NOISE_PX = 100.0
FIRST_ORDER = 0.08
"""Share of the distance up to which the spread of sampled points is as predicted, within 2 %."""


@dataclass(frozen=True, eq=False)
class Budgets:
    """The budgets of K points in the motion that was asked for, and in parallel motion."""

    motion: str
    budgets: list[Budget]
    parallel: list[Budget] | None
    """Those of `budgets` if the motion is parallel itself; None: the head has other readings than
    pan and tilt, and no parallel motion."""


def run(
    head: HeadCalibration,
    *,
    points: ArrayLike,
    motion: str,
    profile: ErrorProfile | None,
    pixel_std_px: float | None,
) -> Budgets:
    """Return the budgets of points (K, 3) [m] in the left eye's base frame.

    Args:
        head: the calibration; what it states of noise and covariance is a source of errors.
        motion: parallel, divergent, or the folder of a dataset whose motion is taken.
        profile: whose errors are sources too; its noise replaces the calibration's.
        pixel_std_px: noise of a pixel coordinate; None: the calibration's, or of the twin's object.

    Raises:
        VergenceError: there is nothing that could be wrong, a point is not seen, or so far away
            that the head cannot tell it apart from infinity, the noise is negative, the motion is
            none of this head, or the head was calibrated with measured eye poses.
    """
    if head.accuracy is not None and head.accuracy.eye_motion == "poses":
        raise VergenceError(
            "A budget says what errors of joint readings add; this head was calibrated with "
            "measured eye poses."
        )
    if pixel_std_px is not None and not 0 <= pixel_std_px <= MAX_NOISE_PX:
        raise VergenceError(
            f"--noise is a standard deviation from 0 to {MAX_NOISE_PX:g} px; found "
            f"{pixel_std_px:g}."
        )
    if not np.abs(np.array(points)).max(initial=0.0) <= MAX_M:
        found = ", ".join(
            " ".join(f"{x:g}" for x in point) for point in np.array(points).reshape(-1, 3)
        )
        raise VergenceError(f"--at takes coordinates up to {MAX_M:g} m; found {found}.")
    sources = sources_of(head, profile, pixel_std_px)
    if not sources and not states_covariance(head):
        raise VergenceError(
            "A budget needs sources of errors: give a calibration that states its accuracy, an "
            "error profile (--profile paper), or --noise in pixels."
        )
    motions = [motion] if motion == "parallel" else [motion, "parallel"]
    if (readings := head.kinematics.readings) != EYE_JOINTS:
        if motion in PERIOD_S:
            raise VergenceError(
                f"The motion {motion!r} is of the readings {', '.join(EYE_JOINTS)}; this head has "
                f"{', '.join(readings)}. Give the folder of a dataset of this head as --motion."
            )
        motions = [motion]
    found = {}
    for name in motions:
        joints, rates = motion_of(name, head)
        found[name] = budget(head, np.array(points), joints=joints, rates=rates, sources=sources)
    for own in found[motion]:
        _check_finite_distance(own)
    return Budgets(motion, found[motion], found.get("parallel"))


def _check_finite_distance(found: Budget) -> None:
    """Raise VergenceError for a point as uncertain as it is far away.

    Within one standard deviation its rays may be parallel then, so that any distance would do.
    """
    distance, std = np.linalg.norm(found.point_m), np.linalg.norm(found.total.std_m)
    if not std < distance:
        # The error of depth grows with the square of the distance.
        x, y, z = found.point_m
        raise VergenceError(
            f"--at {x:g} {y:g} {z:g} is too far away: with these errors the head cannot tell "
            f"points beyond about {distance**2 / std:.2g} m apart from ones at infinity."
        )


def motion_of(name: str, head: HeadCalibration) -> tuple[Array, Array]:
    """Return joints (T, r) [rad] of a head's motion, and their rates (T, r) [rad/s].

    VergenceError if there is no such motion or dataset, or it is of other joints.
    """
    if name in PERIOD_S:
        time_s = np.arange(SAMPLES) * PERIOD_S[name] / SAMPLES
        turns = eye_angles("parallel" if name == "parallel" else "divergent", time_s)
        joints = turns / head.kinematics.factors  # readings, which may be those before a gear
        return joints, np.gradient(joints, time_s, axis=0)
    if not os.path.isdir(name):
        raise VergenceError(
            f"There is no motion {name!r}; there are parallel, divergent, and the folders of "
            "datasets."
        )
    data = load_dataset(name)
    if data.T_base_eye is not None or len(data.eye_angles) < 2:
        raise VergenceError(
            f"The motion of {name} is not one of joints: it has "
            + counted(len(data.eye_angles), "row")
            + (" of measured eye poses." if data.T_base_eye is not None else ".")
        )
    check_readings_match(data, head)
    rates = np.gradient(data.eye_angles, data.joint_time_s, axis=0)
    every = -(-len(rates) // (4 * SAMPLES))
    return data.eye_angles[::every], np.where(data.moving[:, None], rates, 0.0)[::every]


def sources_of(
    head: HeadCalibration, profile: ErrorProfile | None, pixel_std_px: float | Array | None
) -> list[Source]:
    """Return white noise, and the errors that a profile is known to make."""
    accuracy = head.accuracy
    if pixel_std_px is None:
        pixel_std_px = OBJECT_NOISE_PX if profile else pixel_stds(head, None)
    sources = [Source("pixel noise", pixel_std_px=pixel_std_px)] * bool(np.any(pixel_std_px))
    if profile is None:
        stds = reading_stds(head)
        return sources + [Source("joint noise", joint_std_rad=stds)] * bool(stds.any())
    joints = profile.joints
    step = 2 * np.pi / joints.counts_per_turn if joints.counts_per_turn else 0.0
    for name, std in (
        ("joint noise", np.radians(joints.noise_deg)),
        ("steps of the encoders", step / np.sqrt(12)),
        ("backlash", np.radians(joints.backlash_deg) / 2),  # the sensor lags by half of it
    ):
        if std:  # of a joint, as the twin's are; readings may be those before a gear
            sources.append(Source(name, joint_std_rad=std / head.kinematics.factors))
    # The twin needs OpenGL, which a real head's budget can do without.
    from vergence.twin.calibration_errors import inject_calibration_error

    known = _known_of_the_board(head, profile)
    estimated = accuracy.parameters if accuracy else ()
    gains, delay = _known_of_sensors(head, profile)
    if not any(map(is_gain, estimated)):
        known["gains of the joints"] = gains
    if TIME_OFFSET not in estimated:
        known["delay"] = delay
    focal = head.camera(pair_names(head)[0]).intrinsics.matrix[0, 0]
    lens: Lens = "4.0mm" if focal > LONG_LENS_PX else "2.8mm"
    of_lens = "focal_percent_40" if lens == "4.0mm" else "focal_percent_28"
    for name, source in (
        (of_lens, "focal lengths, by hand"),
        ("roll_deg", "roll of the mountings, by hand"),
        ("axial_mm", "shift of the mountings, by hand"),
    ):
        if value := getattr(profile.by_hand, name):
            alone = type(profile.by_hand)(**{name: value})
            known[source] = boxminus(inject_calibration_error(head, alone, lens), head)
    return sources + [Source(name, errors=_nonzero(e)) for name, e in known.items() if _nonzero(e)]


def _known_of_sensors(
    head: HeadCalibration, profile: ErrorProfile
) -> tuple[dict[str, float], dict[str, float]]:
    """Return errors of the gains, and of the time, by parameter of the head.

    Offsets of joints are none: calibration takes them for turns of the mountings.
    """
    from vergence.twin.sensors import with_sensors

    without = profile.joints.model_copy(update={"offset_deg": (0.0,) * 4})
    gains = boxminus(replace(head, accuracy=None), with_sensors(head, without))
    delay = {TIME_OFFSET: -1e-3 * profile.joints.delay_ms}
    return {n: e for n, e in gains.items() if is_gain(n)}, delay


def _known_of_the_board(
    head: HeadCalibration, profile: ErrorProfile
) -> dict[str, dict[str, float]]:
    """Return what a wrong side of the squares makes, which no method finds, as sources_of does."""
    larger = 1 / (1 + profile.calibration.square_percent / 100) - 1
    shift = larger * head.T_rbase_lbase[:3, 3]
    of_axes = zip("xyz", shift.tolist(), strict=True)
    return {"size of the board": {f"T_rbase_lbase.t{axis}": value for axis, value in of_axes}}


def _nonzero(errors: dict[str, float]) -> dict[str, float]:
    return {name: error for name, error in errors.items() if abs(error) > 1e-15}


HEADING = ("source", "x", "y", "z", "x, parallel", "shared")
"""Standard deviations [mm]: of what differs between samples, in x, y and z; of the same in x in
parallel motion, blank for a head that has no such motion; of what all samples share, in x, y and z.
"""


def table(found: Budgets, k: int) -> list[tuple[str, ...]]:
    """Return the rows of the table of point k, as HEADING says; the last one is the total."""
    own = found.budgets[k]
    parts = *own.parts, own.total
    beside = [""] * len(parts)
    if found.parallel is not None:
        other = found.parallel[k]
        beside = [_mm(part.spread_m[0]) for part in (*other.parts, other.total)]
    return [
        (
            one.name,
            *map(_mm, one.spread_m),
            in_parallel,
            " ".join(map(_mm, one.shared_m)) if one.shared_m.any() else "",
        )
        for one, in_parallel in zip(parts, beside, strict=True)
    ]


def _mm(value: float) -> str:
    return f"{1e3 * value:z.2f}"


def advice(found: Budgets, k: int) -> str:
    """Return what would help most at point k, in a sentence."""
    own = found.budgets[k]
    total = 1e3 * float(np.linalg.norm(own.total.std_m))
    best = sorted(own.halved_m.items(), key=lambda item: item[1])[:2]
    parts = [f"half of {name!r} would give {1e3 * value:.2f} mm" for name, value in best]
    said = f"A point is off by {total:.2f} mm (1 std in space); {', '.join(parts)}."
    if total > 1e3 * FIRST_ORDER * np.linalg.norm(own.point_m):
        said += (
            f" That is more than {100 * FIRST_ORDER:.0f} % of its distance, too much for a budget, "
            "which is of first order: the true error may be larger or smaller."
        )
    return said


def as_plain(found: Budgets) -> dict[str, object]:
    """Return everything as plain values for JSON [m]."""

    def part(each: Part) -> dict[str, object]:
        return {
            "spread_m": each.spread_m.tolist(),
            "shared_m": each.shared_m.tolist(),
        }

    def each_of(budgets: Sequence[Budget]) -> list[dict[str, object]]:
        return [
            {
                "point_m": one.point_m.tolist(),
                "samples": one.samples,
                "sources": {p.name: part(p) for p in one.parts},
                "total": part(one.total),
                "std_m_if_halved": one.halved_m,
            }
            for one in budgets
        ]

    return {
        "motion": found.motion,
        "points": each_of(found.budgets),
        "in_parallel_motion": None if found.parallel is None else each_of(found.parallel),
    }
