"""Simulated arms that carry a camera: lens, mounting and held-out error by measured poses.

Arms of six joints err by their links, their zeros and their encoders; boards are larger or smaller
than stated. Prints a row for each arm and how many come out right.

    python benchmarks/measured_poses.py --count 30 --seed 0
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.calibrate import calibrate
from vergence.calibration.intrinsics import calibrate_intrinsics
from vergence.calibration.observations import Observations
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, project
from vergence.geometry.se3 import boxminus, inverse, pose, rotation, transform

LINKS = np.array([
    [0.0, 0.16, np.pi / 2],
    [-0.43, 0.0, 0.0],
    [-0.39, 0.0, 0.0],
    [0.0, 0.13, np.pi / 2],
    [0.0, 0.1, -np.pi / 2],
    [0.0, 0.1, 0.0],
])  # fmt: skip
"""Length, offset [m] and twist [rad] of each link, as of a usual arm of six joints."""
POSTURE = np.radians([0.0, -100.0, 80.0, -70.0, -90.0, 0.0])
"""Joints about which the arm moves [rad]."""
FOCAL_SHARE = 0.003
"""Relative error of a focal length up to which it counts as that of the images alone."""


@dataclass(frozen=True)
class Arm:
    """An arm with a camera, and what it saw of a board at rest."""

    T_eye_cam: Array
    lens: Camera
    observations: Observations
    size: float
    """Of the board, relative to the stated one."""


def forward(links: Array, joints: Array) -> Array:
    """Compute poses (N, 4, 4) of the hand by links (6, 3) and joints (N, 6)."""
    T = np.tile(np.eye(4), (len(joints), 1, 1))
    for (length, offset, twist), turn in zip(links, joints.T, strict=True):
        about_z = pose(rotation(turn[:, None] * [0, 0, 1.0]), [0, 0, offset])
        T = T @ about_z @ pose(rotation([twist, 0, 0]), [length, 0, 0])
    return T


def simulate(seed: int) -> Arm:
    """Record 12 to 30 views of a good or a poor board by an arm that errs little or much."""
    rng = np.random.default_rng(seed)
    errs, views = 10 ** rng.uniform(-1.5, 0.3), int(rng.integers(12, 31))
    columns, rows, square_m = [(11, 8, 0.02), (9, 6, 0.025), (7, 5, 0.025)][seed % 3]
    board = Chessboard(columns, rows, square_m)
    f, reach = rng.uniform(500, 1100), rng.uniform(0.25, 0.6)
    lens = Camera(
        1280, 960, np.array([[f, 0, 640], [0, f, 480], [0, 0, 1.0]]),
        np.array([rng.normal(-0.1, 0.05), rng.normal(0.05, 0.05), *rng.normal(0, 3e-4, 2), 0.0]),
    )  # fmt: skip
    size = 1 + float(rng.normal(0, 0.01))
    mounting = pose(rotation(rng.normal(0, 0.4, 3)), rng.normal(0, 0.06, 3))
    # The last link and zero are part of the mounting.
    links = LINKS + errs * rng.normal(0, 1e-3, (6, 3)) * (np.arange(6) < 5)[:, None]
    zeros, encoder = errs * rng.normal(0, 1e-3, 6) * (np.arange(6) < 5), errs * 2e-4
    points = size * (corner_points(board) - corner_points(board).mean(axis=0))
    away = rng.uniform(0.9, 1.6) * f * square_m * columns / 900
    tilt = rotation([*rng.normal(0, 0.3, 2), rng.uniform(0, 6)])
    T_base_target = forward(LINKS, POSTURE[None])[0] @ mounting @ pose(tilt, [0, 0, away])
    joints, pixels = np.zeros((0, 6)), np.zeros((0, len(points), 2))
    spread = reach * np.array([0.5, 0.5, 0.7, 1.0, 1.0, 2.0])
    while len(joints) < views:
        tried = POSTURE + rng.uniform(-1, 1, (4000, 6)) * spread
        T = inverse(forward(links, tried + zeros) @ mounting) @ T_base_target
        seen = project(lens, transform(T[:, None], points))
        inside = ((seen > 5) & (seen < [1275, 955])).all(axis=2).mean(axis=1) > 0.7
        inside &= (T[:, 2, 2] > 0.6) & (np.abs(T[:, 2, 3] / away - 1) < 0.4)
        joints = np.concatenate([joints, tried[inside]])[:views]
        pixels = np.concatenate([pixels, seen[inside]])[:views]
    pixels = pixels + rng.normal(0, rng.uniform(0.05, 0.3), pixels.shape)
    inside = ((pixels > 0) & (pixels < [1279, 959])).all(axis=2, keepdims=True)
    read = forward(LINKS, joints + rng.normal(0, encoder, joints.shape))
    observations = Observations(
        board=board,
        placement=np.zeros(views, int),
        eye_angles=np.full((views, 4), np.nan),
        corners={"left_cam": np.where(inside, pixels, np.nan)},
        sizes={"left_cam": (1280, 960)},
        T_base_eye=np.stack([read, read], axis=1),
    )
    return Arm(mounting, lens, observations, size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    right = 0
    for seed in range(options.seed, options.seed + options.count):
        arm = simulate(seed)
        found = calibrate(arm.observations, lens="radial-tangential")
        alone = calibrate_intrinsics(arm.observations)["left_cam"]
        mounted, accuracy = found.head.cameras["left_cam"], found.accuracy
        focal = abs(mounted.intrinsics.matrix[0, 0] / alone.camera.matrix[0, 0] - 1)
        off = boxminus(mounted.T_eye_cam, arm.T_eye_cam)
        std = dict(zip(accuracy.parameters, np.sqrt(np.diag(accuracy.covariance)), strict=True))
        ratio = [off[k] / std[f"left_cam.T_eye_cam.{n}"] for k, n in enumerate(NAMES)]
        good = focal < FOCAL_SHARE and np.abs(ratio).max() < 4
        right += good
        assert accuracy.held_out is not None
        print(
            f"{seed:3d} views {len(arm.observations.placement):2d}  focal {100 * focal:.3f} %  "
            f"T_eye_cam {np.degrees(np.linalg.norm(off[:3])):.3f} degrees "
            f"{1e3 * np.linalg.norm(off[3:]):.2f} mm, {np.abs(ratio).max():.1f} std  held out "
            f"{accuracy.held_out.prediction_px:.2f} px  {'right' if good else 'WRONG'}"
        )
    print(f"{right} of {options.count} right")


NAMES = ("rx", "ry", "rz", "tx", "ty", "tz")

if __name__ == "__main__":
    main()
