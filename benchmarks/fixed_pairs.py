"""Check stated 95 % regions of fixed stereo pairs, with lenses of all models.

Two cameras 60 to 160 mm apart see boards that a hand holds, half of them cut off by one image. The
regions are those of the pose between the cameras, of the projection of each camera at 25 pixels out
to the image's corners (up to a turn of the camera), and of located points. Corners are simulated.

    python benchmarks/fixed_pairs.py --pairs 10
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import numpy as np
import tyro

from head_kinds import NOISE, random_lens, regions, tried
from simulated_head import R_EYE_CAM
from simulated_recording import facing, observe
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.calibrate import CalibrationResult
from vergence.calibration.initial import calibrate_sequentially
from vergence.calibration.lens_map import unit_rays
from vergence.calibration.lenses import LensModel
from vergence.calibration.prepared_views import prepare
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import FIXED_EYES
from vergence.geometry.se3 import inverse, pose, rotation, transform

FITTED: dict[str, LensModel] = {
    "plain": "radial-tangential",
    "k3": "radial-tangential-k3",
    "rational": "rational",
    "fisheye": "fisheye",
}
"""The lens model that is fitted to each kind of lens."""
VIEWS = 24
"""Number of boards before each pair."""


def random_pair(kind: str, rng: np.random.Generator) -> HeadCalibration:
    """Return a fixed pair, verged and rolled by some degrees."""
    cameras = {
        f"{eye}_cam": MountedCamera(eye, random_lens(kind, rng), pose(R_EYE_CAM))
        for eye in ("left", "right")
    }
    shift = [rng.normal(0, 0.01), rng.uniform(0.06, 0.16), rng.normal(0, 0.01)]
    return HeadCalibration(
        cameras, pose(rotation(rng.normal(0, 0.06, 3)), np.array(shift)), FIXED_EYES
    )


def boards(head: HeadCalibration, rng: np.random.Generator) -> Array:
    """Return the poses (V, 4, 4) of boards, each about a pixel of one of the images."""
    places = []
    for k in range(VIEWS):
        mounted = list(head.cameras.values())[k % 2]
        lens = mounted.intrinsics
        pixel = rng.uniform([0, 0], [lens.width - 1, lens.height - 1])
        centre = rng.uniform(0.25, 0.5) * unit_rays(lens, pixel[None])[0] @ R_EYE_CAM.T
        centre = centre if k % 2 == 0 else transform(inverse(head.T_rbase_lbase), centre)
        turn = np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3))
        places.append(facing(centre[None], turn[None])[0])
    return np.array(places)


def pair_regions(kind: str, seed: int) -> dict[str, Array]:
    """Return by kind of region which of those of one pair hold the truth."""
    rng = np.random.default_rng([list(FITTED).index(kind), seed])
    truth = random_pair(kind, rng)
    seen = observe(
        truth,
        rng,
        NOISE,
        placement=np.arange(VIEWS),
        T_lbase_target=boards(truth, rng),
        joints=np.zeros((VIEWS, 0)),
    )
    views = prepare(seen, "bundle", FITTED[kind])
    start = calibrate_sequentially(
        seen, intrinsics=views.intrinsics, T_cam_target=views.T_cam_target
    )
    found = bundle_adjust(start.head, views.observations, T_cam_target=views.T_cam_target)
    head = replace(found.head, accuracy=found.accuracy)
    result = CalibrationResult(head, seen, start, found)
    pose_region, *located = regions(result, truth, rng, NOISE.pixel_px)
    return {
        "pose": np.array([pose_region]),
        "lenses": tried(result, truth).inside.ravel(),
        "points": np.array(located),
    }


def main(pairs: int = 10, kinds: tuple[str, ...] = tuple(FITTED)) -> None:
    """Print the share of regions that hold the truth, for this many pairs of each kind of lens."""
    every = defaultdict(list)
    for kind in kinds:
        own, refused = defaultdict(list), 0
        for seed in range(pairs):
            try:
                found = pair_regions(kind, seed)
            except VergenceError:
                refused += 1
                continue
            for name, held in found.items():
                own[name].append(held)
                every[name].append(held)
        print(f"{kind}: {_shares(own)}; {refused} refused", flush=True)
    print(f"all: {_shares(every)}")


def _shares(held: Mapping[str, list[Array]]) -> str:
    return ", ".join(
        f"{name} {100 * np.concatenate(each).mean():.1f} %" for name, each in held.items()
    )


if __name__ == "__main__":
    tyro.cli(main)
