"""Check stated 95 % regions for every kind of head: joints, lenses, resolutions.

Simulated heads with cameras rolled by any angle see boards all over their images. The regions are
those of each camera's pose in its eye and of its projection at 25 pixels out to the image's
corners (up to a turn of the camera, which its mounting makes up for), of the pose between the eyes,
of each gain, and of located points. The held-out error of points is compared with the stated one.
With --images the heads' images are drawn and the corners detected; else corners are simulated.

    python benchmarks/head_kinds.py --heads 20 --kinds "shared tilt, pan" fisheye
    python benchmarks/head_kinds.py --heads 8 --images
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import numpy as np
import tyro

from drawn_boards import CHARUCO, found_corners
from other_heads import KINDS as JOINTS
from other_heads import other_head
from simulated_head import HEIGHT, WIDTH, poses_and_gains, probability, random_head
from simulated_recording import Noise, facing, inside_image, observe
from vergence.arrays import Array
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.detection import SYSTEMATIC_PX
from vergence.calibration.lens_choice import LensOption
from vergence.calibration.lens_map import (
    pixel_covariance,
    reference_pixels,
    unit_rays,
    without_turn,
)
from vergence.calibration.observations import Observations
from vergence.calibration.summary import verdict
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, project
from vergence.geometry.head import HeadCalibration, main_pair
from vergence.geometry.kinematics import EYE_JOINTS, eye_pose, straight_gaze
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.projection import camera_pose, project_point
from vergence.geometry.se3 import transform
from vergence.stereo.triangulation import Status
from vergence.stereo.uncertainty import locate

LENSES = ("k3", "rational", "fisheye")
*_FIRST, _LAST = JOINTS
KINDS = (*_FIRST, "one eye", "two resolutions", *LENSES, _LAST)
"""The position of a kind seeds its heads: append new ones."""
NOISE = Noise(pixel_px=0.1, joint_rad=np.radians(0.05))
STRAIGHT, ORIENTATIONS = 36, 24
"""Numbers of views at straight gaze and of eye orientations."""
POINTS = 10
"""Number of located points of each head."""
INSET_PX = 5.0
GRID = INSET_PX + np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 5)]), axis=-1).reshape(-1, 2) * [
    WIDTH - 1 - 2 * INSET_PX,
    HEIGHT - 1 - 2 * INSET_PX,
]
"""(25, 2) pixels, first row at the top; 0, 4, 20 and 24 are the corners."""
CORNERS = [0, 4, 20, 24]


@dataclass(frozen=True)
class Tried:
    """Regions of one calibration; one entry for each camera."""

    inside: Array
    """(C, 25) of bool."""
    error_px: Array
    """(C, 25)."""
    models: tuple[str, ...]
    ratio: float | None
    """Held-out error of points over the stated one."""


def random_lens(kind: str, rng: np.random.Generator) -> Camera:
    """Return a wide camera of 640 x 480 pixels whose image has a direction everywhere."""
    f = rng.uniform(250, 380)
    tangential = rng.normal(0, 5e-4, 2)
    if kind == "plain":
        k, model = [-0.08, 0.005, *tangential, 0.0], "radial-tangential"
    elif kind == "k3":
        k = [rng.uniform(-0.16, -0.08), rng.uniform(0.0, 0.04), *tangential]
        k, model = [*k, rng.uniform(0.005, 0.02)], "radial-tangential"
    elif kind == "rational":
        f = rng.uniform(280, 340)
        k = [rng.uniform(0.2, 0.5), rng.uniform(0.01, 0.05), *tangential, 0.001]
        k, model = [*k, k[0] + rng.uniform(0.12, 0.2), rng.uniform(0.05, 0.07), 0.002], "rational"
    else:
        f = rng.uniform(290, 380)  # up to 80 degrees from the axis
        k, model = rng.normal(0, [0.02, 0.008, 0.003, 0.001]), "fisheye"
    fy = f * rng.uniform(0.99, 1.01)
    centre = np.array([WIDTH - 1, HEIGHT - 1]) / 2 + rng.normal(0, 5, 2)
    matrix = np.array([[f, 0, centre[0]], [0, fy, centre[1]], [0, 0, 1]])
    return Camera(WIDTH, HEIGHT, matrix, np.array(k), model)


def lens_head(kind: str, rng: np.random.Generator) -> HeadCalibration:
    """Return a head of two wide cameras with lenses of a kind."""
    head = without_offsets(random_head(rng, lenses=("wide",)))
    cameras = {
        name: replace(mounted, intrinsics=random_lens(kind, rng))
        for name, mounted in head.cameras.items()
    }
    return replace(head, cameras=cameras)


def head_of(kind: str, rng: np.random.Generator) -> HeadCalibration:
    """Return a head of a kind, whose cameras are rolled by any angle."""
    joints = kind if kind in JOINTS else "pan, tilt"
    head = without_offsets(other_head(joints, rng, rolled=True))
    cameras = dict(head.cameras)
    for name, mounted in head.cameras.items():
        lens = random_lens(kind if kind in LENSES else "plain", rng)
        if kind == "two resolutions" and mounted.eye == "right":
            lens = resized(lens, 2)
        cameras[name] = replace(mounted, intrinsics=lens)
    if kind == "one eye":
        return replace(head, cameras={"left_wide": cameras["left_wide"]}, T_rbase_lbase=np.eye(4))
    return replace(head, cameras=cameras)


def resized(lens: Camera, factor: int) -> Camera:
    """Return a lens on a sensor with `factor` times the pixels across."""
    matrix = lens.matrix * np.array([[factor], [factor], [1]])
    return replace(lens, width=factor * lens.width, height=factor * lens.height, matrix=matrix)


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where V boards stand, and what the joints truly read before them."""

    placement: np.ndarray
    """(V,)."""
    T_lbase_target: Array
    """(V, 4, 4)."""
    joints: Array
    """(V, r) [rad]."""


def recording(
    head: HeadCalibration, rng: np.random.Generator, noise: Noise = NOISE
) -> Observations:
    """Return corners and readings of boards arranged at random."""
    return observe(head, rng, noise, **vars(arrangement(head, rng)))


def arrangement(head: HeadCalibration, rng: np.random.Generator) -> Arrangement:
    """Return boards in all parts of the images, cut off at the edges, and one for moving eyes.

    Each stands where one of the cameras has a pixel drawn evenly from its image.
    """
    places, straight = [], straight_gaze(head.kinematics)
    for k in range(STRAIGHT):
        name = list(head.cameras)[k % len(head.cameras)]
        mounted = head.cameras[name]
        lens = mounted.intrinsics
        pixel = rng.uniform([0, 0], [lens.width - 1, lens.height - 1])
        ray = unit_rays(mounted.intrinsics, pixel[None])[0]
        T_base_straight = eye_pose(head.kinematics, mounted.eye, straight)
        T = camera_pose(mounted, head.T_rbase_lbase, T_base_straight)
        centre = transform(T, rng.uniform(0.25, 0.5) * ray)
        places.append(_facing(centre, rng))
    fixed = facing(np.array([[0.5, -0.04, 0.0]]), rng.uniform(-0.4, 0.4, (1, 3)))[0]
    phase = np.arange(ORIENTATIONS) * 2.399963
    spread = 0.3 * np.sqrt((np.arange(ORIENTATIONS) + 0.5) / ORIENTATIONS)
    gaze = spread[:, None] * np.stack([np.cos(phase), 0.85 * np.sin(phase)], axis=1)
    readings = np.tile(gaze, 2)
    if head.kinematics.readings != EYE_JOINTS:  # each for itself
        readings = rng.uniform(-0.25, 0.25, (ORIENTATIONS, len(straight)))
    return Arrangement(
        placement=np.concatenate([np.arange(STRAIGHT), np.full(ORIENTATIONS, STRAIGHT)]),
        T_lbase_target=np.array(places + [fixed] * ORIENTATIONS),
        joints=np.concatenate([np.tile(straight, (STRAIGHT, 1)), readings]),
    )


def _facing(centre: Array, rng: np.random.Generator) -> Array:
    """Return a board (4, 4) about a point, facing the head and slanted at random."""
    turn = np.concatenate([rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3, 1)])
    return facing(centre[None], turn[None])[0]


def tried(result: CalibrationResult, truth: HeadCalibration) -> Tried:
    """Compare a calibration with the truth."""
    inside, size = [], []
    for name, mounted in truth.cameras.items():
        found = result.head.cameras[name]
        lens, true = found.intrinsics, mounted.intrinsics
        middle = reference_pixels(true)
        grid = GRID * [true.width / WIDTH, true.height / HEIGHT]
        off, there = (project(lens, unit_rays(true, each)) - each for each in (grid, middle))
        error = without_turn(true, grid, off[..., None], there[..., None])[..., 0]
        covariance = pixel_covariance(result.head, name, grid + off)
        # A direction that a calibration does not reach counts as outside.
        p = [
            probability(*each) if np.isfinite(each[1]).all() else 1.0
            for each in zip(error, covariance, strict=True)
        ]
        inside.append(np.array(p) < 0.95)
        size.append(np.linalg.norm(error, axis=1))
    checked = result.accuracy.held_out
    ratio = None
    if checked is not None and checked.point_mm and checked.expected_mm:
        ratio = checked.point_mm / checked.expected_mm
    models = tuple(choice.model for choice in result.lenses.values())
    return Tried(np.array(inside), np.array(size), models, ratio)


def regions(
    result: CalibrationResult, truth: HeadCalibration, rng: np.random.Generator, pixel_px: float
) -> Iterator[bool]:
    """Yield for each stated region, but those of projections, whether it holds the truth."""
    # With the true lenses: coefficients of a model that is not the true one cannot be compared.
    cameras = {
        name: replace(mounted, intrinsics=truth.cameras[name].intrinsics)
        for name, mounted in result.head.cameras.items()
    }
    accuracy, off = result.accuracy, boxminus(replace(result.head, cameras=cameras), truth)
    for rows in poses_and_gains(accuracy).values():
        error = np.array([off[accuracy.parameters[i]] for i in rows])
        yield bool(probability(error, accuracy.covariance[np.ix_(rows, rows)]) < 0.95)
    if main_pair(truth) is not None:
        yield from points(result.head, truth, rng, pixel_px)


def points(
    head: HeadCalibration,
    truth: HeadCalibration,
    rng: np.random.Generator,
    pixel_px: float = NOISE.pixel_px,
) -> Iterator[bool]:
    """Yield for each located point whether its region holds the truth."""
    pair, r, found = main_pair(truth), len(truth.kinematics.readings), 0
    assert pair is not None
    for _ in range(10_000):
        joints = rng.uniform(-0.2, 0.2, r)
        point = rng.uniform([0.3, -0.4, -0.3], [0.8, 0.4, 0.3])
        seen = [project_point(truth, name, joints, point) for name in pair]
        if not all(
            inside_image(uv, truth.cameras[n].intrinsics) for n, uv in zip(pair, seen, strict=True)
        ):
            continue
        left, right = (uv[None] + rng.normal(0, pixel_px, 2) for uv in seen)
        read = joints + rng.normal(0, NOISE.joint_rad, r)
        here = locate(head, left=left, right=right, joints=read)
        if here.status[0] != Status.OK:
            continue  # beyond the reach of the estimated lens: no region is stated
        yield bool(probability(here.xyz[0] - point, here.covariance[0]) < 0.95)
        found += 1
        if found == POINTS:
            return


def recorded(head: HeadCalibration, rng: np.random.Generator, *, images: bool) -> Observations:
    """Simulate corners and readings, or detect corners in drawn images."""
    arranged = arrangement(head, rng)
    observed = observe(head, rng, NOISE, **vars(arranged))
    if not images:
        return observed
    noise = np.random.default_rng(rng.integers(2**32))
    corners = found_corners(
        head, noise, T_lbase_target=arranged.T_lbase_target, joints=arranged.joints
    )
    return replace(observed, board=CHARUCO, corners=corners, systematic_px=SYSTEMATIC_PX)


def main(
    kinds: tuple[str, ...] = KINDS,
    heads: int = 20,
    seed: int = 0,
    images: bool = False,
    model: LensOption = "auto",
) -> None:
    """Print how many regions hold the truth.

    Args:
        kinds: of heads.
        heads: of each kind.
        seed: of the first one.
        images: draw images and detect the corners.
        model: lens model of the calibration.
    """
    everything: list[bool] = []
    for kind in kinds:
        inside, at_corners, others, ratios = [], [], [], []
        verdicts: Counter[str] = Counter()
        for k in range(seed, seed + heads):
            rng = np.random.default_rng([k, KINDS.index(kind)])
            head = head_of(kind, rng)
            lens: LensOption = "rational" if kind == "rational" else model
            try:
                result = calibrate(recorded(head, rng, images=images), lens=lens)
            except VergenceError as error:
                verdicts["refused"] += 1
                print(f"   {kind}, seed {k}: {error}", flush=True)
                continue
            one = tried(result, head)
            inside += one.inside.ravel().tolist()
            at_corners += one.inside[:, CORNERS].ravel().tolist()
            # The noise of a located point is that of the corners.
            pixel_px = (result.accuracy.pixel_std_px or 0.0) if images else NOISE.pixel_px
            others += regions(result, head, rng, pixel_px)
            ratios += [one.ratio] if one.ratio else []
            word, why = verdict(result.accuracy, result.head)
            verdicts[word] += 1
            print(
                f"   {kind}, seed {k}: {one.inside.mean():.2f}, error {one.error_px.max():.2f} px, "
                f"held out {one.ratio or np.nan:.2f}, {' '.join(one.models)}, {word} {why}",
                flush=True,
            )
        everything += inside + others
        ratio = np.sqrt(np.mean(np.square(ratios))) if ratios else np.nan
        groups = others, inside, at_corners, inside + others
        a, b, c, d = (f"{100 * np.mean(group):.1f} %" for group in groups)
        print(
            f"{kind:22} {dict(verdicts)}: poses, gains and points {a}, projections {b}, at corners "
            f"{c}, all {d} of {len(inside + others)}; held-out error {ratio:.2f} of the stated one",
            flush=True,
        )
    print(f"all together: {100 * np.mean(everything):.1f} % of {len(everything)} regions")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
