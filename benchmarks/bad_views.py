"""Check that wrong views are named and spoil nothing: readings, poses, images, moving boards.

Each variant disturbs the recording of a simulated head at random. It comes out right if every
disturbed view is named, few others are, the verdict is that of the recording before, every pose
and gain lies within its stated region of 99.9 %, and the noise of the readings is stated to 20 %.

    python benchmarks/bad_views.py --count 30 --kinds reading pairs
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import numpy as np
import tyro

from simulated_head import HEIGHT, WIDTH, poses_and_gains, probability, random_head
from simulated_recording import BOARD, POINTS, Noise, Recording, inside_image, record
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.observations import Observations
from vergence.calibration.summary import verdict
from vergence.errors import VergenceError
from vergence.geometry.camera import project
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import boxminus
from vergence.geometry.projection import project_at
from vergence.geometry.se3 import boxplus, known_poses, pose, rotation, transform
from vergence.vision.board_pose import board_poses

STRAIGHT, TURNED = 30, 30
NOISE = Noise(pixel_px=0.1, joint_rad=np.radians(0.03))
HOW = Recording(
    straight=STRAIGHT, orientations=TURNED, reach_rad=(0.35, 0.3), alike=False, noise=NOISE
)

Disturbed = tuple[Observations, Observations, set[int]]
"""The recording before and after, and the views that are wrong."""
Disturbance = Callable[[HeadCalibration, Observations, np.random.Generator], Disturbed]


def _reading(_: HeadCalibration, seen: Observations, rng: np.random.Generator) -> Disturbed:
    """Add a glitch to one reading, repeat a row, or zero the readings of one eye."""
    angles, view = seen.eye_angles.copy(), int(rng.integers(STRAIGHT + TURNED - 1))
    kind, eye = rng.integers(3), slice(*[(0, 2), (2, 4)][rng.integers(2)])
    if kind == 0 or view < STRAIGHT:  # rows of straight gaze are alike
        angles[view, rng.integers(4)] += np.radians(rng.uniform(1, 8)) * rng.choice([-1, 1])
    elif kind == 1:
        angles[view] = angles[view + 1]
    else:
        angles[view, eye] = 0.0
    return seen, replace(seen, eye_angles=angles), {view}


def _pose_row(head: HeadCalibration, _: Observations, rng: np.random.Generator) -> Disturbed:
    """Repeat the row of another pose of an arm, the next one or any, in 16 to 30 views."""
    mounted, V = head.cameras["left_wide"], int(rng.integers(16, 31))
    T = pose(rotation(rng.uniform(-0.35, 0.35, (V, 3))), rng.uniform(-0.1, 0.1, (V, 3)))
    T_base_target = mounted.T_eye_cam @ pose(rotation([0.3, 0.2, 0.0]), [-0.12, -0.08, 0.5])
    pixels = project_at(mounted, np.eye(4), T, transform(T_base_target, POINTS)[None])
    pixels = np.where(inside_image(pixels)[..., None], pixels, np.nan)
    read = boxplus(T, rng.normal(0, 2e-4, (V, 6)))
    view, by = int(rng.integers(V)), 1 if rng.random() < 0.5 else int(rng.integers(1, V))
    seen = Observations(
        board=BOARD,
        placement=np.zeros(V, int),
        eye_angles=np.full((V, 4), np.nan),
        corners={"left_wide": pixels + rng.normal(0, NOISE.pixel_px, pixels.shape)},
        sizes={"left_wide": (WIDTH, HEIGHT)},
        T_base_eye=np.stack([read, read], axis=1),
    )
    read[view] = read[(view + by) % V]
    return seen, replace(seen, T_base_eye=np.stack([read, read], axis=1)), {view}


def _turned_image(_: HeadCalibration, seen: Observations, rng: np.random.Generator) -> Disturbed:
    """Turn one straight image by 180 degrees; the board may be numbered from the other end then."""
    name, view = rng.choice(list(seen.corners)), int(rng.integers(STRAIGHT))
    corners = seen.corners[name].copy()
    corners[view] = ([WIDTH - 1, HEIGHT - 1] - corners[view])[:: rng.choice([1, -1])]
    return seen, replace(seen, corners={**seen.corners, name: corners}), {view}


def _pairs(_: HeadCalibration, seen: Observations, rng: np.random.Generator) -> Disturbed:
    """Exchange the images of a tenth of the straight pairs, or take one from another pair."""
    left, right = (each.copy() for each in seen.corners.values())
    views = rng.choice(STRAIGHT, STRAIGHT // 10, replace=False)
    if rng.random() < 0.5:
        left[views], right[views] = right[views], left[views]
    else:
        right[views] = seen.corners["right_wide"][(views + 1) % STRAIGHT]
    corners = dict(zip(seen.corners, (left, right), strict=True))
    return seen, replace(seen, corners=corners), set(views.tolist())


def _held_board(head: HeadCalibration, seen: Observations, rng: np.random.Generator) -> Disturbed:
    """Move the board by 1 to 3 mm between the images of both eyes, in some or all pairs."""
    share, size_m = rng.choice([0.3, 1.0]), rng.uniform(1e-3, 3e-3)
    camera, right = head.cameras["right_wide"].intrinsics, seen.corners["right_wide"].copy()
    T = board_poses(camera, right[:STRAIGHT], POINTS)
    for view in np.flatnonzero(known_poses(T) & (rng.random(STRAIGHT) < share)):
        points = transform(T[view], POINTS)
        moved = points + rng.normal(0, size_m / np.sqrt(3), 3)
        right[view] += project(camera, moved) - project(camera, points)
    return seen, replace(seen, corners={**seen.corners, "right_wide": right}), set()


def _nothing(_: HeadCalibration, seen: Observations, __: np.random.Generator) -> Disturbed:
    return seen, seen, set()


KINDS: dict[str, Disturbance] = {
    "nothing": _nothing,
    "reading": _reading,
    "pose row": _pose_row,
    "turned image": _turned_image,
    "pairs": _pairs,
    "held board": _held_board,
}


def named_views(result: CalibrationResult) -> set[int]:
    """Collect the views that findings name."""
    return {int(view) for each in result.findings for view in re.findall(r"view (\d+)", each.where)}


def outside(result: CalibrationResult, truth: HeadCalibration) -> list[str]:
    """List poses and gains whose regions of 99.9 % do not hold the truth."""
    cameras = {name: truth.cameras[name] for name in result.head.cameras}
    if result.observations.T_base_eye is not None:  # an offset of tilt is a turn of the camera
        truth = replace(truth, kinematics=result.head.kinematics)
    accuracy, off = result.accuracy, boxminus(result.head, replace(truth, cameras=cameras))
    return [
        name
        for name, rows in poses_and_gains(accuracy).items()
        if probability(
            np.array([off[accuracy.parameters[i]] for i in rows]),
            accuracy.covariance[np.ix_(rows, rows)],
        )
        > 0.999
    ]


def judged(kind: str, seed: int) -> str:
    """Calibrate one variant; empty: it came out right."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    head = random_head(rng, lenses=("wide",))
    before, seen, wrong = KINDS[kind](head, record(head, rng, HOW), rng)
    try:
        result = calibrate(seen, lens="radial-tangential")
    except VergenceError as error:
        return f"refused: {error}"
    word, following = verdict(result.accuracy, result.head)
    said, named = [], named_views(result)
    if word != "GOOD":
        undisturbed = calibrate(before, lens="radial-tangential")
        if word != verdict(undisturbed.accuracy, undisturbed.head)[0]:
            said.append(f"{word}, {following}")
    if not wrong <= named:
        said.append(f"not named: {sorted(wrong - named)}")
    if wrong and len(named - wrong) > 1:
        said.append(f"named: {sorted(named - wrong)}")
    if lost := outside(result, head):
        said.append(f"outside: {lost}")
    noise = max(result.accuracy.joint_std) / NOISE.joint_rad
    if kind != "pose row" and not 0.8 < noise < 1.2:
        said.append(f"noise of readings {noise:.2f} times the true one")
    return "; ".join(said)


def main(kinds: tuple[str, ...] = tuple(KINDS), count: int = 30, seed: int = 0) -> None:
    """Print how many variants come out right.

    Args:
        kinds: of disturbances.
        count: of variants of each.
        seed: of the first one.
    """
    for kind in kinds:
        right = 0
        for k in range(seed, seed + count):
            if wrong := judged(kind, k):
                print(f"   {kind}, seed {k}: {wrong}", flush=True)
            right += not wrong
        print(f"{kind}: {right} of {count} right", flush=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
