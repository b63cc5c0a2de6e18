"""Simulated arms and bodies that carry cameras: lens, mounting and what is said, by measured poses.

Arms of six joints err by links, zeros and encoders; boards have another size than stated.

    python benchmarks/measured_poses.py --count 30 --kinds arm axis
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import numpy as np
import tyro

from one_eye import mount_camera
from vergence.arrays import Array
from vergence.calibration.calibrate import calibrate
from vergence.calibration.intrinsics import calibrate_intrinsics
from vergence.calibration.observations import Observations
from vergence.calibration.target_poses import adjust_target_poses
from vergence.errors import VergenceError
from vergence.findings import select
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, pinhole, project
from vergence.geometry.kinematics import Side
from vergence.geometry.se3 import POSE, boxminus, boxplus, inverse, pose, rotation, transform
from vergence.vision.board_pose import board_poses

LINKS = np.array([
    [0.0, 0.16, np.pi / 2], [-0.43, 0.0, 0.0], [-0.39, 0.0, 0.0],
    [0.0, 0.13, np.pi / 2], [0.0, 0.1, -np.pi / 2], [0.0, 0.1, 0.0],
])  # fmt: skip
"""Length, offset [m] and twist [rad] of each link, as of a usual arm of six joints."""
POSTURE = np.radians([0.0, -100.0, 80.0, -70.0, -90.0, 0.0])
"""Joints about which the arm moves [rad]."""
EYES_OF: dict[str, Side] = {"left_cam": "left", "right_cam": "right"}


def forward(links: Array, joints: Array) -> Array:
    """Compute poses (N, 4, 4) of the hand by links (6, 3) and joints (N, 6)."""
    T = np.tile(np.eye(4), (len(joints), 1, 1))
    for (length, offset, twist), turn in zip(links, joints.T, strict=True):
        about_z = pose(rotation(turn[:, None] * [0, 0, 1.0]), [0, 0, offset])
        T = T @ about_z @ pose(rotation([twist, 0, 0]), [length, 0, 0])
    return T


def simulate(seed: int) -> tuple[Array, Camera, Observations]:
    """Return T_eye_cam and lens on an arm, and its 12 to 30 views of a good or a poor board."""
    rng = np.random.default_rng(seed)
    errs, views = 10 ** rng.uniform(-1.5, 0.3), int(rng.integers(12, 31))
    columns, rows, square_m = [(11, 8, 0.02), (9, 6, 0.025), (7, 5, 0.025)][seed % 3]
    board = Chessboard(columns, rows, square_m)
    f, reach = rng.uniform(500, 1100), rng.uniform(0.25, 0.6)
    lens = Camera(
        1280, 960, np.array([[f, 0, 640], [0, f, 480], [0, 0, 1.0]]),
        np.array([rng.normal(-0.1, 0.05), rng.normal(0.05, 0.05), *rng.normal(0, 3e-4, 2), 0.0])
        * (f / 1000.0) ** np.array([2, 4, 1, 1, 6]),  # no folds at the rim
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
    return mounting, lens, observations


def arm(seed: int, few: bool = False) -> tuple[bool, str]:
    """Keep lenses of images alone and all views, with mountings within their stated deviations.

    Few are eight views of a hand that errs by 0.3 degrees and 3 mm, some numbered from the other
    end.
    """
    T_eye_cam, _, observations = simulate(seed)
    if few:
        rng, T = np.random.default_rng(seed), observations.T_base_eye
        assert T is not None
        T = boxplus(T[:, 0], rng.normal(0, 1, (len(T), 6)) * np.repeat([0.005, 0.003], 3))
        pixels = observations.corners["left_cam"].copy()
        pixels[::3] = pixels[::3, ::-1]
        of_hand = {"corners": {"left_cam": pixels}, "T_base_eye": np.stack([T, T], axis=1)}
        observations = replace(observations, **of_hand).take(np.arange(8))
    found = calibrate(observations, lens="radial-tangential")
    alone = calibrate_intrinsics(observations)["left_cam"]
    mounted, accuracy = found.head.cameras["left_cam"], found.accuracy
    focal = abs(mounted.intrinsics.matrix[0, 0] / alone.camera.matrix[0, 0] - 1)
    off = boxminus(mounted.T_eye_cam, T_eye_cam)
    std = dict(zip(accuracy.parameters, np.sqrt(np.diag(accuracy.covariance)), strict=True))
    ratio = [off[k] / std[f"left_cam.T_eye_cam.{name}"] for k, name in enumerate(POSE)]
    codes = {each.code for each in found.findings}
    worst, held_out = float(np.abs(ratio).max()), accuracy.held_out
    px = held_out.prediction_px if held_out else np.nan
    said = f"off by {1e3 * np.linalg.norm(off[3:]):.2f} mm, {worst:.1f} std, held out {px:.2f} px"
    kept = "wrong-view" not in codes and not accuracy.void
    return focal < 0.003 and worst < 4 and kept, said


def rounded(seed: int) -> tuple[bool, str]:
    """Poses with three to five decimals are used, with a note, wherever poses enter."""
    (_, lens, observations), digits = simulate(seed), 3 + seed % 3
    assert observations.T_base_eye is not None
    T = observations.T_base_eye.copy()
    T[..., :3, :3] = np.round(T[..., :3, :3], digits)
    observations = replace(observations, T_base_eye=T)
    pixels, points = observations.corners["left_cam"], corner_points(observations.board)
    T_cam_target = {"left_cam": board_poses(lens, pixels, points)}
    by_poses = adjust_target_poses(T_cam_target, T, eyes={"left_cam": "left"})
    results = observations.findings, by_poses.findings
    noted = [any(each.code == "rounded-poses" for each in findings) for findings in results]
    return all(noted), f"{digits} digits"


def body(seed: int) -> tuple[bool, str]:
    """Two cameras on one body have no shape that measured poses of the body could contradict."""
    poses, T, mounts = carried(seed, axes=3)
    found = adjust_target_poses(poses, np.stack([T, T], axis=1), eyes=EYES_OF)
    off = boxminus(np.stack([each.T_eye_cam for each in found.head.cameras.values()]), mounts)
    doubts, size = select(found.findings, "void", "warning"), float(np.abs(off).max())
    return not doubts and size < 0.01, f"off by {size:.4f}"


def axis(seed: int) -> tuple[bool, str]:
    """Motion about one axis is refused or voids the result, which says why."""
    poses, T, _ = carried(seed, axes=1)
    rng, lens = np.random.default_rng(seed), pinhole(640, 480, 500.0)
    board = Chessboard(9, 6, 0.025)
    pixels = project(lens, transform(poses["left_cam"][:, None], corner_points(board)))
    pixels += rng.normal(0, 0.1, pixels.shape)
    said = []
    for estimate in (
        lambda: mount_camera(T, pixels, board, lens),
        lambda: adjust_target_poses(poses, np.stack([T, T], axis=1), eyes=EYES_OF),
    ):
        try:
            said.append(" ".join(each.sentence for each in select(estimate().findings, "void")))
        except VergenceError as refusal:
            said.append(str(refusal))
    return all("axis" in each for each in said), said[0]


def carried(seed: int, *, axes: int) -> tuple[dict[str, Array], Array, Array]:
    """Simulate poses of a target by two cameras on a body that turns about some axes."""
    rng = np.random.default_rng(seed)
    views, noise = int(rng.integers(12, 31)), rng.uniform(1e-4, 1e-3)
    turns = rng.uniform(-0.5, 0.5, (views, axes)) @ np.linalg.qr(rng.normal(size=(3, 3)))[0][:axes]
    T = pose(rotation(turns), rng.uniform(-0.1, 0.1, (views, 3)))
    mounts = pose(rotation(rng.normal(0, 0.3, (2, 3))), rng.normal(0, 0.05, (2, 3)))
    target = pose(rotation(rng.normal(0, 0.2, 3)), [-0.1, -0.06, 0.6])
    seen = inverse(T[:, None] @ mounts) @ mounts[0] @ target
    seen = boxplus(seen, rng.normal(0, noise, (views, 2, 6)))
    read = boxplus(T, rng.normal(0, noise, (views, 6)))
    return dict(zip(EYES_OF, np.moveaxis(seen, 1, 0), strict=True)), read, mounts


KINDS = {"arm": arm, "hand": partial(arm, few=True), "rounded": rounded, "body": body, "axis": axis}


def main(count: int = 30, seed: int = 0, kinds: tuple[str, ...] = tuple(KINDS)) -> None:
    """Print each variant, and how many of each kind come out right."""
    for kind in kinds:
        right = 0
        for k in range(seed, seed + count):
            good, said = KINDS[kind](k)
            right += good
            print(f"{kind} {k}: {said}{'' if good else '  WRONG'}", flush=True)
        print(f"{kind}: {right} of {count} right", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
