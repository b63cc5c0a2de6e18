"""Which geometry the table of reference errors was made in, told from its two baselines alone.

    nice python benchmarks/table_geometry.py

`eye_camera_monte_carlo.py` compares with a table of median errors of T_eye_cam whose board,
distance, lens and motion are not recorded. Its columns for Park and Martin and for exact joints, at
four levels of joint noise, are 16 numbers that depend on the geometry but not on any estimator of
this project. Here they are predicted for many geometries, and these are ranked by the root mean
square of log(predicted / table). The table's last column, which is the bar, is never looked at.

Predictions are to first order: the adjustment with exact joints is linear least squares around the
truth, without robust weights; Park and Martin's own closed form runs on board poses that carry the
covariance of a pose from 0.1 px corners. All geometries are tried with few trials, then the best
with many.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import tyro
from rich.progress import track
from vergence.calibration.bundle.jacobians import jacobians

from vergence.arrays import Array
from vergence.calibration.bundle.initial_state import one_eye
from vergence.calibration.bundle.problem import PER_CAMERA, moved, pose_difference
from vergence.calibration.sequential.hand_eye import park_martin
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import pinhole, project, project_jacobians
from vergence.geometry.kinematics import EyeAxes, T_base_eye
from vergence.geometry.se3 import hat, inverse, pose, rotation, transform

LEVELS_DEG = (0.0, 0.02, 0.1, 0.3)
TABLE = np.array(
    [
        [[0.038, 0.30], [0.012, 0.09]],
        [[0.043, 0.31], [0.111, 0.83]],
        [[0.091, 0.32], [0.554, 4.2]],
        [[0.237, 0.44], [1.69, 13.4]],
    ]
)
"""Median errors [deg, mm] at each level: Park and Martin, and adjustment with exact joints."""
VIEWS, SPREAD_RAD, PIXEL_PX = 20, 0.25, 0.1
"""As the table states."""
DRAWS = 25
"""Of the noise in each trial, for the linear estimate, which costs nothing."""
R_EYE_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
BOARDS = ((9, 6, 25), (9, 6, 30), (8, 6, 25), (8, 6, 30), (7, 5, 30), (7, 5, 40))
"""Columns, rows, millimetres."""


@dataclass(frozen=True)
class Config:
    """How thoroughly to look."""

    trials: int = 6
    """For each geometry."""
    again: int = 60
    """For each of the best."""
    best: int = 15
    seed: int = 0


@dataclass(frozen=True)
class Geometry:
    """What the table does not state."""

    focal_px: float
    distance_m: float
    board: tuple[int, int, int]
    motion: str
    """grid: 5 columns; uniform: at random."""
    lean_rad: float
    """Standard deviation of the board's turn from facing the head, about each axis."""


def geometries() -> list[Geometry]:
    """Return all that are tried: lenses of 2.8 to 8 mm, usual boards, 0.3 to 0.8 m."""
    focal, distance = (280.0, 400.0, 500.0, 600.0, 800.0), (0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.8)
    every = itertools.product(focal, distance, BOARDS, ("grid", "uniform"), (0.0, 0.3, 0.5))
    return [Geometry(*each) for each in every]


def predict(geometry: Geometry, trials: int, seed: int) -> Array:
    """Return (4, 2, 2) like TABLE; NaN where boards are mostly out of the image."""
    rng = np.random.default_rng(seed)
    closed, exact = np.empty((4, trials, 2)), np.empty((4, trials, DRAWS, 2))
    for k in range(trials):
        trial = _trial(geometry, rng)
        if trial is None:
            return np.full_like(TABLE, np.nan)
        for level, joint_std in enumerate(np.radians(LEVELS_DEG)):
            closed[level, k] = trial.closed(joint_std, rng)
            exact[level, k] = trial.exact(joint_std, rng)
    medians = [np.median(closed, axis=1), np.median(exact.reshape(4, -1, 2), axis=1)]
    return np.stack(medians, axis=1)


@dataclass(frozen=True, eq=False)
class _Trial:
    T_eye_cam: Array
    angles: Array
    T_cam_target: Array
    pose_root: Array
    """(N, 6, 6) root of the covariance of a board's pose."""
    pixel_root: Array
    """(6, 6) root of what pixel noise does to the adjustment with exact joints."""
    by_joints: Array
    """(6, 2N) what errors of the readings do to it."""

    def closed(self, joint_std: float, rng: np.random.Generator) -> Array:
        readings = self.angles + rng.normal(0, joint_std, self.angles.shape)
        noise = (self.pose_root @ rng.normal(size=(len(readings), 6, 1)))[..., 0]
        found = park_martin(T_base_eye(readings), moved(self.T_cam_target, noise))
        return _sizes(pose_difference(found, self.T_eye_cam))

    def exact(self, joint_std: float, rng: np.random.Generator) -> Array:
        joints = self.by_joints @ rng.normal(0, joint_std, (self.by_joints.shape[1], DRAWS))
        return _sizes((self.pixel_root @ rng.normal(size=(6, DRAWS)) + joints).T)


def _trial(geometry: Geometry, rng: np.random.Generator) -> _Trial | None:
    columns, rows, square_mm = geometry.board
    points = corner_points(Chessboard(columns=columns, rows=rows, square_m=square_mm * 1e-3))
    camera = pinhole(640, 480, geometry.focal_px)
    T_eye_cam = pose(
        rotation(rng.normal(0, np.radians(1.5), 3)) @ R_EYE_CAM, rng.normal([0.02, 0, 0], 0.003)
    )
    if geometry.motion == "grid":
        grid = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, VIEWS // 5))
        angles = SPREAD_RAD * np.stack(grid, axis=-1).reshape(-1, 2)
    else:
        angles = rng.uniform(-SPREAD_RAD, SPREAD_RAD, (VIEWS, 2))
    R = R_EYE_CAM @ rotation(rng.normal(0, geometry.lean_rad, 3))
    T_base_target = pose(R, [geometry.distance_m, 0, 0] - R @ points.mean(axis=0))
    T_cam_target = inverse(T_base_eye(angles) @ T_eye_cam) @ T_base_target
    in_cam = transform(T_cam_target[:, None], points)
    pixels = project(camera, in_cam)
    seen = np.asarray(((pixels > 0) & (pixels < [639, 479])).all(axis=-1, keepdims=True))
    if seen.sum(axis=1).min() < 8:
        return None
    _, by_point, _ = project_jacobians(camera, in_cam)
    turned = in_cam - T_cam_target[:, None, :3, 3]
    by_pose = np.where(
        seen[..., None], np.concatenate([-by_point @ hat(turned), by_point], axis=-1), 0.0
    ).reshape(len(angles), -1, 6)
    information = np.swapaxes(by_pose, 1, 2) @ by_pose / PIXEL_PX**2
    problem, state = one_eye(
        camera, T_eye_cam, EyeAxes(), angles, None, np.where(seen, pixels, np.nan), points
    )
    shared, _, latent = jacobians(problem, replace(state, T_lbase_target=T_base_target[None]))
    free = [*range(9, PER_CAMERA), *range(shared.shape[-1] - 6, shared.shape[-1])]
    J = shared[..., free].reshape(-1, 12)
    L = latent.reshape(len(angles), -1, 2)
    solve = np.linalg.solve(J.T @ J, J.T)[:6]
    by_joints = np.einsum("jnp,npa->jna", solve.reshape(6, len(angles), -1), L)
    return _Trial(
        T_eye_cam,
        angles,
        T_cam_target,
        np.linalg.cholesky(np.linalg.inv(information)).astype(float),
        PIXEL_PX * np.linalg.cholesky(solve @ solve.T).astype(float),
        by_joints.reshape(6, -1),
    )


def _sizes(off: Array) -> Array:
    """Return (..., 2) degrees and millimetres of (..., 6)."""
    lengths = np.linalg.norm(off.reshape(*off.shape[:-1], 2, 3), axis=-1)
    return lengths * [np.degrees(1), 1e3]


def misfit(predicted: Array) -> float:
    """Return the root mean square of log(predicted / table)."""
    return float(np.sqrt(np.mean(np.log(predicted / TABLE) ** 2)))


def ranked(
    tried: list[Geometry], trials: int, seed: int, what: str
) -> list[tuple[float, Geometry, Array]]:
    """Return the misfit, the geometry and its predictions, the best first."""
    found = []
    for geometry in track(tried, description=what):
        predicted = predict(geometry, trials, seed)
        if np.isfinite(predicted).all():
            found.append((misfit(predicted), geometry, predicted))
    return sorted(found, key=lambda each: each[0])


def main(config: Config) -> None:
    """Print the ranking."""
    coarse = ranked(geometries(), config.trials, config.seed, "all geometries")
    best = [geometry for _, geometry, _ in coarse[: config.best]]
    print("| misfit | focal [px] | distance [m] | board | motion | lean [rad] ", end="")
    print("| Park-Martin at 0, 0.02, 0.1, 0.3° [deg / mm] | exact joints |\n" + "|---" * 8 + "|")
    for off, geometry, predicted in ranked(best, config.again, config.seed + 1, "the best"):
        columns, rows, square = geometry.board
        cells = [
            ", ".join(f"{deg:.3f} / {mm:.2f}" for deg, mm in predicted[:, method])
            for method in range(2)
        ]
        print(
            f"| {off:.3f} | {geometry.focal_px:.0f} | {geometry.distance_m} "
            f"| {columns} x {rows}, {square} mm | {geometry.motion} | {geometry.lean_rad} "
            f"| {' | '.join(cells)} |"
        )


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
