"""Whether stated regions hold the truth for every kind of head: joints, lenses, resolutions.

Simulated heads with cameras rolled by any angle see boards all over their images. The stated 95 %
regions are those of each camera's place in its eye and of its projection at 25 pixels out to the
image's corners, of the pose between the eyes, of each gain, and of located points. The held-out
error of points is compared with the stated one. With --images the heads' images are drawn and the
corners sought in them; else the corners are simulated.

    python benchmarks/head_kinds.py --heads 20 --kinds "shared tilt, pan" fisheye
    python benchmarks/head_kinds.py --heads 8 --images --found runs/corners
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import numpy as np

from drawn_boards import CHARUCO, found_corners
from lens_monte_carlo import CORNERS, NOISE, arrangement, random_lens, tried
from other_heads import KINDS as JOINTS
from other_heads import other_head
from simulated_head import probability
from simulated_recording import inside_image, observe
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.detection import SYSTEMATIC_PX
from vergence.calibration.lens_choice import LensOption
from vergence.calibration.observations import Observations
from vergence.calibration.summary import verdict
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, main_pair
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import Status
from vergence.stereo.uncertainty import locate

LENSES = ("k3", "rational", "fisheye")
*_FIRST, _LAST = JOINTS
KINDS = (*_FIRST, "one eye", "two resolutions", *LENSES, _LAST)
"""A kind's place seeds its heads: new ones come last."""
POINTS = 10
"""Located points of each head."""


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
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(accuracy.parameters):
        owner, _, last = name.rpartition(".")
        if owner.endswith("T_eye_cam") or owner == "T_rbase_lbase":
            groups.setdefault(owner, []).append(i)
        elif last.endswith("_gain"):
            groups[name] = [i]
    for rows in groups.values():
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


def recorded(
    head: HeadCalibration, rng: np.random.Generator, *, images: bool, kept: Path | None
) -> Observations:
    """Return simulated corners and readings or, of images, what is found in them.

    Corners that were found before are read from a file, and new ones kept in it.
    """
    arranged = arrangement(head, rng)
    observed = observe(head, rng, NOISE, **vars(arranged))
    if not images:
        return observed
    noise = np.random.default_rng(rng.integers(2**32))
    if kept is not None and kept.exists():
        with np.load(kept) as file:
            corners = dict(file)
    else:
        corners = dict(
            found_corners(
                head, noise, T_lbase_target=arranged.T_lbase_target, joints=arranged.joints
            )
        )
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(kept, **corners)  # pyright: ignore[reportArgumentType]
    return replace(observed, board=CHARUCO, corners=corners, systematic_px=SYSTEMATIC_PX)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--heads", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--images", action="store_true", help="draw images and seek the corners")
    parser.add_argument("--found", type=Path, help="folder that keeps the corners found in images")
    given = parser.parse_args()
    everything: list[bool] = []
    for kind in given.kinds:
        inside, corners, own, ratios = [], [], [], []
        words: Counter[str] = Counter()
        for seed in range(given.seed, given.seed + given.heads):
            rng = np.random.default_rng([seed, KINDS.index(kind)])
            head = head_of(kind, rng)
            lens: LensOption = "rational" if kind == "rational" else "auto"
            kept = None if given.found is None else given.found / f"{kind}, {seed}.npz"
            observed = recorded(head, rng, images=given.images, kept=kept)
            try:
                result = calibrate(observed, lens=lens)
            except VergenceError as error:
                words["refused"] += 1
                print(f"   {kind}, seed {seed}: {error}", flush=True)
                continue
            one = tried(result, head)
            inside += one.inside.ravel().tolist()
            corners += one.inside[:, CORNERS].ravel().tolist()
            # The noise of a point that is located is that of the corners.
            pixel_px = (result.accuracy.pixel_std_px or 0.0) if given.images else NOISE.pixel_px
            of_head = list(regions(result, head, rng, pixel_px))
            own += of_head
            ratios += [one.ratio] if one.ratio else []
            word, why = verdict(result.accuracy, result.head)
            words[word] += 1
            print(
                f"   {kind}, seed {seed}: {np.mean(of_head):.2f}, {one.inside.mean():.2f}, "
                f"{one.inside[:, CORNERS].mean():.2f}, off {one.error_px.max():.2f} px, held out "
                f"{one.ratio or np.nan:.2f}, {' '.join(one.models)}, {word} {why}",
                flush=True,
            )
        everything += inside + own
        ratio = np.sqrt(np.mean(np.square(ratios))) if ratios else np.nan
        shares = (100 * np.mean(each) for each in (own, inside, corners, own + inside))
        a, b, c, d = (f"{share:.1f} %" for share in shares)
        print(
            f"{kind:22} {dict(words)}: poses, gains and points {a}, projections {b}, at corners "
            f"{c}, all {d} of {len(own + inside)}; held-out error {ratio:.2f} of the stated one",
            flush=True,
        )
    print(f"all together: {100 * np.mean(everything):.1f} % of {len(everything)} regions")


if __name__ == "__main__":
    main()
