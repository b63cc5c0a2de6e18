"""What `vergence plan` runs: from a calibration or a dataset to the views to record next."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vergence.accuracy.plan import LIMIT_RAD, Plan, largest_readings, plan
from vergence.accuracy.plan_information import OF_READINGS
from vergence.arrays import Array
from vergence.calibration.calibrate import calibrate
from vergence.data.dataset import Dataset
from vergence.data.description import MAX_SQUARE_M
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError, check_seed
from vergence.geometry.board import Board, Chessboard, corner_points
from vergence.geometry.head import HeadCalibration, T_head_base, load_head
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import transform
from vergence.progress import Progress, silent
from vergence.writing import markdown_table

MOST_VIEWS = 100
MOST_DEG = 1_000_000
"""Largest limit of a reading: motors before a gear turn far."""


def run(
    source: Path,
    *,
    board: tuple[int, int, float] | None,
    views: int,
    limits_deg: tuple[float, ...],
    distances_m: tuple[float, ...],
    seed: int,
    progress: Progress = silent,
) -> Plan:
    """Return the plan for a calibration file, or for a dataset, which is calibrated first.

    Arguments are those of the command. VergenceError if the source is neither file nor folder of
    that kind, its calibration is void, or an option is not possible.
    """
    _check(views, limits_deg, distances_m, seed)
    limits_rad = np.radians(limits_deg[0] if len(limits_deg) == 1 else limits_deg)
    head, shown = head_and_board(source, board, progress, limits_rad=limits_rad)
    return plan(
        head,
        shown,
        views=views,
        limits_rad=limits_rad,
        distances_m=distances_m,
        seed=seed,
        progress=progress,
    )


def _check(
    views: int, limits_deg: tuple[float, ...], distances_m: tuple[float, ...], seed: int
) -> None:
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
    stated: tuple[int, int, float] | None,
    progress: Progress,
    *,
    limits_rad: ArrayLike = LIMIT_RAD,
) -> tuple[HeadCalibration, Board]:
    """Return the calibration and the board of a source; arguments and errors are those of `run`."""
    if os.path.isdir(source):
        data = load_dataset(source)
        _check_before_the_work(data, limits_rad)
        board = data.description.board if stated is None else _chessboard(stated)
        found = calibrate(data, progress=progress)
        if found.accuracy.void:
            raise VergenceError(f"The calibration from {source} is VOID: {found.accuracy.void[0]}")
        return found.head, board
    head = load_head(source)
    if stated is None:
        raise VergenceError(
            f"{source} does not say which board will be shown; say it with --board COLUMNS ROWS "
            "SQUARE_M, such as --board 9 6 0.03, or name the folder of the dataset."
        )
    return head, _chessboard(stated)


def _check_before_the_work(data: Dataset, limits_rad: ArrayLike) -> None:
    """Raise a VergenceError if no calibration of a dataset could be planned for."""
    if data.T_base_eye is not None:
        raise VergenceError(f"{OF_READINGS} {data.folder} has measured eye poses.")
    cameras = data.description.cameras
    if len({camera.eye for camera in cameras.values()}) < len(EYES):
        raise VergenceError(
            f"A plan is for points that both eyes see; {data.folder} has {', '.join(cameras)}."
        )
    largest_readings(data.description.head_kinematics, limits_rad)


def _chessboard(stated: tuple[int, int, float]) -> Chessboard:
    columns, rows, square_m = stated
    if min(columns, rows) < 3 or max(columns, rows) > 100 or not 0 < square_m <= MAX_SQUARE_M:
        raise VergenceError(
            "--board takes 3 to 100 inner corners each way and the side of a square up to 1 m, "
            f"found {columns} {rows} {square_m:g}."
        )
    return Chessboard(columns, rows, square_m)


def as_text(found: Plan) -> str:
    """Return a plan as tables: the views, and what they bring."""
    centres, normals = board_places(found)
    rows = []
    for k, joints in enumerate(found.views.joints):
        same = k > 0 and found.views.placement[k] == found.views.placement[k - 1]
        rows.append(
            (
                str(k + 1),
                "as before" if same else " ".join(f"{x:z.3f}" for x in centres[k]),
                "" if same else " ".join(f"{x:z.2f}" for x in normals[k]),
                " ".join(f"{angle:z.1f}" for angle in np.degrees(joints)),
                f"{1e3 * found.steps_m[k]:.2f}",
            )
        )
    before, after = 1e3 * found.before_m.max(), 1e3 * found.after_m.max()
    return "\n".join(
        [
            markdown_table(
                "view | centre of the board x y z in the head [m] | its normal "
                f"| {', '.join(found.head.kinematics.readings)} [deg] | largest std by then [mm]",
                rows,
            ),
            "",
            f"Largest standard deviation of a point by the calibration: {before:.2f} mm now, "
            f"{after:.2f} mm after these views (predicted).",
            "A place of the board need not be met exactly: calibrate with what was recorded.",
        ]
    )


def board_places(found: Plan) -> tuple[Array, Array]:
    """Return the board's centre (N, 3) [m] and its normal (N, 3), towards the head, in the head."""
    T = T_head_base(found.head, "left") @ found.views.T_lbase_target
    return transform(T, corner_points(found.board).mean(axis=0)), -T[:, :3, 2]


def as_plain(found: Plan) -> dict[str, Any]:
    """Return a plan as plain values, for JSON."""
    centres, normals = board_places(found)
    return {
        "readings": list(found.head.kinematics.readings),
        "views": [
            {
                "place": int(place),
                "board_centre_head_m": centre.tolist(),
                "board_normal_head": normal.tolist(),
                "T_lbase_target": T.tolist(),
                "joints_rad": joints.tolist(),
                "largest_std_m": float(std),
            }
            for place, centre, normal, T, joints, std in zip(
                np.unique(found.views.placement, return_inverse=True)[1],
                centres,
                normals,
                found.views.T_lbase_target,
                found.views.joints,
                found.steps_m,
                strict=True,
            )
        ],
        "points_lbase_m": found.workspace.points.tolist(),
        "std_before_m": found.before_m.tolist(),
        "std_after_m": found.after_m.tolist(),
    }
