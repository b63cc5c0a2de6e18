"""Reports of the commands plan and budget, and the checks of their options."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vergence.accuracy.budget import Budget
from vergence.accuracy.motion_budget import MotionBudgets
from vergence.accuracy.plan import Plan, largest_readings
from vergence.accuracy.plan_information import OF_READINGS
from vergence.arrays import MAX_M, Array
from vergence.calibration.calibrate import calibrate
from vergence.cli.report import Report, Table
from vergence.data.dataset import Dataset
from vergence.data.description import MAX_SQUARE_M
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError, check_seed
from vergence.geometry.board import Board, Chessboard, corner_points
from vergence.geometry.head import HeadCalibration, T_head_base, load_head
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import transform
from vergence.progress import Progress

MOST_VIEWS = 100
"""Largest number of planned views; each takes about a second."""
MOST_DEG = 1_000_000
"""Largest limit of a single reading [deg]: motors before a gear turn far."""
MOST_NOISE_PX = 100.0
"""Largest noise of a pixel coordinate [px]."""
FIRST_ORDER = 0.08
"""Std of a point, relative to its distance, up to which sampled points spread within 2 % of it."""


def check_plan(
    views: int, limits_deg: tuple[float, ...], distances_m: tuple[float, ...], seed: int
) -> None:
    """Raise VergenceError for options of `vergence plan` that are out of range."""
    check_seed(seed)
    if not 1 <= views <= MOST_VIEWS:
        raise VergenceError(f"A plan has 1 to {MOST_VIEWS} views, found --views {views}.")
    for name, values, most, unit in (
        ("--limits-deg", limits_deg, 90 if len(limits_deg) == 1 else MOST_DEG, "degrees"),
        ("--distances", distances_m, 100, "m"),
    ):
        if not values or not all(0 < value <= most for value in values):
            found = " ".join(f"{value:g}" for value in values) or "none"
            raise VergenceError(
                f"{name} takes numbers above 0 and up to {most:,} {unit}, found {found}."
            )


def head_and_board(
    source: Path,
    board: tuple[int, int, float] | None,
    limits_rad: ArrayLike,
    progress: Progress,
) -> tuple[HeadCalibration, Board]:
    """Load the calibration of a file, or calibrate a dataset, and find the board to show.

    VergenceError if the source is neither, its calibration is void, or nothing can be planned.
    """
    if os.path.isdir(source):
        data = load_dataset(source)
        _check_dataset(data, limits_rad)
        shown = data.description.board if board is None else _chessboard(*board)
        found = calibrate(data, progress=progress)
        if found.accuracy.void:
            raise VergenceError(f"The calibration from {source} is VOID: {found.accuracy.void[0]}")
        return found.head, shown
    head = load_head(source)
    if board is None:
        raise VergenceError(
            f"{source} does not say which board will be shown; say it with --board COLUMNS ROWS "
            "SQUARE_M, such as --board 9 6 0.03, or name the folder of the dataset."
        )
    return head, _chessboard(*board)


def _check_dataset(data: Dataset, limits_rad: ArrayLike) -> None:
    """Raise VergenceError, before the calibration, if a plan for a dataset is impossible."""
    if data.T_base_eye is not None:
        raise VergenceError(f"{OF_READINGS} {data.folder} has measured eye poses.")
    cameras = data.description.cameras
    if len({camera.eye for camera in cameras.values()}) < len(EYES):
        raise VergenceError(
            f"A plan is for points that both eyes see; {data.folder} has {', '.join(cameras)}."
        )
    largest_readings(data.description.head_kinematics, limits_rad)


def _chessboard(columns: int, rows: int, square_m: float) -> Chessboard:
    if min(columns, rows) < 3 or max(columns, rows) > 100 or not 0 < square_m <= MAX_SQUARE_M:
        raise VergenceError(
            "--board takes 3 to 100 inner corners each way and the side of a square up to 1 m, "
            f"found {columns} {rows} {square_m:g}."
        )
    return Chessboard(columns, rows, square_m)


def plan_report(found: Plan) -> Report:
    """Report a plan: a row for each view, and the accuracy that is predicted."""
    views, readings = found.views, found.head.kinematics.readings
    T_head_target = T_head_base(found.head, "left") @ views.T_lbase_target
    centres = transform(T_head_target, corner_points(found.board).mean(axis=0))
    normals = -T_head_target[:, :3, 2]  # towards the head
    places = np.unique(views.placement, return_inverse=True)[1]
    rows = []
    for k, joints in enumerate(views.joints):
        same = k > 0 and places[k] == places[k - 1]
        rows.append(
            (
                str(k + 1),
                "as before" if same else " ".join(f"{x:z.3f}" for x in centres[k]),
                "" if same else " ".join(f"{x:z.2f}" for x in normals[k]),
                " ".join(f"{angle:z.1f}" for angle in np.degrees(joints)),
                f"{1e3 * found.steps_m[k]:.2f}",
            )
        )
    heading = (
        "view",
        "centre of the board x y z in the head [m]",
        "its normal",
        f"{', '.join(readings)} [deg]",
        "largest std by then [mm]",
    )
    before, after = 1e3 * found.before_m.max(), 1e3 * found.after_m.max()
    sentences = (
        f"Largest standard deviation of a point by the calibration: {before:.2f} mm now, "
        f"{after:.2f} mm after these views (predicted).\n"
        "A place of the board need not be met exactly: calibrate with what was recorded."
    )
    data = {
        "readings": list(readings),
        "views": [
            {
                "place": int(places[k]),
                "board_centre_head_m": centres[k].tolist(),
                "board_normal_head": normals[k].tolist(),
                "T_lbase_target": views.T_lbase_target[k].tolist(),
                "joints_rad": joints.tolist(),
                "largest_std_m": float(found.steps_m[k]),
            }
            for k, joints in enumerate(views.joints)
        ],
        "points_lbase_m": found.workspace.points.tolist(),
        "std_before_m": found.before_m.tolist(),
        "std_after_m": found.after_m.tolist(),
    }
    return Report("Views to record next", (Table(heading, rows), sentences), data)


def check_budget(points: Array, noise_px: float | None) -> None:
    """Raise VergenceError for points or a noise that are out of range."""
    if noise_px is not None and not 0 <= noise_px <= MOST_NOISE_PX:
        raise VergenceError(
            f"--noise is a standard deviation from 0 to {MOST_NOISE_PX:g} px; found {noise_px:g}."
        )
    if not np.abs(points).max() <= MAX_M:
        found = ", ".join(" ".join(f"{x:g}" for x in point) for point in points)
        raise VergenceError(f"--at takes coordinates up to {MAX_M:g} m; found {found}.")


BUDGET_HEADING = ("source", "x", "y", "z", "x, parallel", "shared")
"""Standard deviations [mm]: of what differs between samples, in x, y and z; of the same in x in
parallel motion; of what all samples share, in x, y and z."""


def budget_report(found: MotionBudgets) -> Report:
    """Report the budgets of points: a table and a sentence of advice for each."""
    parts: list[str | Table] = []
    for k, one in enumerate(found.budgets):
        x, y, z = one.point_m
        parts += [
            f"({x:g}, {y:g}, {z:g}) m, {found.motion} motion: 1 std [mm]",
            Table(BUDGET_HEADING, budget_rows(found, k)),
            advice(one),
        ]
    parallel = None if found.parallel is None else [_plain(one) for one in found.parallel]
    data = {
        "motion": found.motion,
        "points": [_plain(one) for one in found.budgets],
        "in_parallel_motion": parallel,
    }
    return Report("Error budget", parts, data)


def budget_rows(found: MotionBudgets, k: int) -> list[tuple[str, ...]]:
    """Return the rows of point k under BUDGET_HEADING; the last one is the total."""

    def mm(value: float) -> str:
        return f"{1e3 * value:z.2f}"

    one = found.budgets[k]
    sources = *one.parts, one.total
    parallel = [""] * len(sources)
    if found.parallel is not None:
        other = found.parallel[k]
        parallel = [mm(part.spread_m[0]) for part in (*other.parts, other.total)]
    return [
        (
            source.name,
            *map(mm, source.spread_m),
            in_parallel,
            " ".join(map(mm, source.shared_m)) if source.shared_m.any() else "",
        )
        for source, in_parallel in zip(sources, parallel, strict=True)
    ]


def advice(one: Budget) -> str:
    """Return a sentence on the sources whose reduction would help most."""
    total = 1e3 * float(np.linalg.norm(one.total.std_m))
    best = sorted(one.halved_m.items(), key=lambda item: item[1])[:2]
    halves = [f"half of {name!r} would give {1e3 * value:.2f} mm" for name, value in best]
    text = f"A point is off by {total:.2f} mm (1 std in space); {', '.join(halves)}."
    if total > 1e3 * FIRST_ORDER * np.linalg.norm(one.point_m):
        text += (
            f" That is more than {100 * FIRST_ORDER:.0f} % of its distance, too much for a budget, "
            "which is of first order: the true error may be larger or smaller."
        )
    return text


def _plain(one: Budget) -> dict[str, object]:
    def moments(part: Any) -> dict[str, object]:
        return {"spread_m": part.spread_m.tolist(), "shared_m": part.shared_m.tolist()}

    return {
        "point_m": one.point_m.tolist(),
        "samples": one.samples,
        "sources": {part.name: moments(part) for part in one.parts},
        "total": moments(one.total),
        "std_m_if_halved": one.halved_m,
    }
