"""Whether stated regions hold the truth out to the corners of the image, for every kind of lens.

Simulated heads whose wide cameras have radial-tangential lenses with k3, rational or fisheye lenses
see boards all over their images; each head is calibrated with lens models chosen as `vergence
calibrate` chooses them, or with one that is stated. At pixels of a grid out to the corners, the
stated 95 % region of where a direction is projected is compared with the truth (up to a turn of the
camera, which its mounting makes up for), and the held-out error with the stated one.

    python benchmarks/lens_monte_carlo.py --lens k3 --heads 25
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from simulated_head import HEIGHT, WIDTH, probability, random_head
from simulated_recording import Noise, facing, observe
from vergence.arrays import Array
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.checks.lens_map import (
    pixel_covariance,
    reference_pixels,
    unit_rays,
    without_turn,
)
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.findings import Finding
from vergence.geometry.camera import Camera, project
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYE_JOINTS, T_base_eye, straight_gaze
from vergence.geometry.parameters import without_offsets
from vergence.geometry.projection import T_lbase_cam
from vergence.geometry.se3 import transform

KINDS = ("plain", "k3", "rational", "fisheye")
NOISE = Noise(pixel_px=0.1, joint_rad=np.radians(0.05))
STRAIGHT, ORIENTATIONS = 36, 24
INSET_PX = 5.0
COORDINATES = np.linspace(0, 1, 5)
GRID = INSET_PX + np.stack(np.meshgrid(COORDINATES, COORDINATES), axis=-1).reshape(-1, 2) * [
    WIDTH - 1 - 2 * INSET_PX,
    HEIGHT - 1 - 2 * INSET_PX,
]
"""(25, 2) pixels, first row at the top; 0, 4, 20 and 24 are the corners."""
CORNERS = [0, 4, 20, 24]


@dataclass(frozen=True)
class Tried:
    """What one calibration gave; one entry for each camera."""

    inside: Array
    """(C, 25) of bool."""
    error_px: Array
    """(C, 25)."""
    models: tuple[str, ...]
    ratio: float | None
    """Held-out error of points over the stated one."""
    findings: tuple[Finding, ...]


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
        T_base_straight = T_base_eye(head.kinematics, mounted.eye, straight)
        T = T_lbase_cam(mounted, head.T_rbase_lbase, T_base_straight)
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
    return Tried(np.array(inside), np.array(size), models, ratio, result.findings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lens", choices=KINDS, default="k3")
    parser.add_argument("--heads", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--model", default="auto", help="lens model of the calibration")
    given = parser.parse_args()
    results: list[Tried] = []
    for seed in range(given.seed, given.seed + given.heads):
        rng = np.random.default_rng([seed, KINDS.index(given.lens)])
        head = lens_head(given.lens, rng)
        try:
            result = calibrate(recording(head, rng), lens=given.model)
        except VergenceError as error:
            print(f"seed {seed}: {error}")
            continue
        results.append(tried(result, head))
        one = results[-1]
        print(
            f"seed {seed}: {one.models}, inside {one.inside.mean():.2f}, corners "
            f"{one.inside[:, CORNERS].mean():.2f}, off {one.error_px.max():.2f} px, held out "
            f"{one.ratio or np.nan:.2f}, {len(one.findings)} warnings",
            flush=True,
        )
        for line in one.findings:
            print("   ", line[:200])
    inside = np.concatenate([one.inside for one in results])
    error = np.concatenate([one.error_px for one in results])
    ratios = [one.ratio for one in results if one.ratio is not None]
    print(f"{given.lens}: {len(results)} heads, {len(inside)} cameras")
    print(f"models: {dict(Counter(model for one in results for model in one.models))}")
    print(f"95 % regions that hold the truth: {100 * inside.mean():.1f} %")
    print(f"at the image's corners: {100 * inside[:, CORNERS].mean():.1f} %")
    print(f"error [px]: all {np.sqrt((error**2).mean()):.3f}, ", end="")
    print(f"corners {np.sqrt((error[:, CORNERS] ** 2).mean()):.3f}")
    print(f"held-out over stated error: median {np.median(ratios):.3f}")


if __name__ == "__main__":
    main()
