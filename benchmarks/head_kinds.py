"""Whether stated regions hold the truth for every kind of head: joints, lenses, resolutions.

Simulated heads with cameras rolled by any angle see boards all over their images. The stated 95 %
regions are those of each camera's place in its eye and of its projection at 25 pixels out to the
image's corners, of the pose between the eyes, of each gain, and of located points. The held-out
error of points is compared with the stated one.

    python benchmarks/head_kinds.py --heads 20 --kinds "shared tilt, pan" fisheye
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lens_monte_carlo import CORNERS, random_lens, recording, tried
from other_heads import KINDS as JOINTS
from other_heads import other_head
from simulated_head import probability
from simulated_recording import inside_image
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.sequential.lens_choice import Lens
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, main_pair
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import Status
from vergence.stereo.uncertainty import locate

LENSES = ("k3", "rational", "fisheye")
KINDS = (*JOINTS, "one eye", "two resolutions", *LENSES)
POINTS = 10
"""Located points of each head."""
PIXEL_PX, JOINT_RAD = 0.1, np.radians(0.05)


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
    result: CalibrationResult, truth: HeadCalibration, rng: np.random.Generator
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
        yield from points(result.head, truth, rng)


def points(
    head: HeadCalibration, truth: HeadCalibration, rng: np.random.Generator
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
        left, right = (uv[None] + rng.normal(0, PIXEL_PX, 2) for uv in seen)
        read = joints + rng.normal(0, JOINT_RAD, r)
        here = locate(head, left=left, right=right, joints=read)
        if here.status[0] != Status.OK:
            continue  # beyond the reach of the estimated lens: no region is stated
        yield bool(probability(here.xyz[0] - point, here.covariance[0]) < 0.95)
        found += 1
        if found == POINTS:
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--heads", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    everything: list[bool] = []
    for kind in given.kinds:
        inside, corners, own, ratios, failed = [], [], [], [], 0
        for seed in range(given.seed, given.seed + given.heads):
            rng = np.random.default_rng([seed, KINDS.index(kind)])
            head = head_of(kind, rng)
            lens: Lens = "rational" if kind == "rational" else "auto"
            try:
                result = calibrate(recording(head, rng), lens=lens)
            except VergenceError as error:
                failed += 1
                print(f"   {kind}, seed {seed}: {error}", flush=True)
                continue
            one = tried(result, head)
            inside += one.inside.ravel().tolist()
            corners += one.inside[:, CORNERS].ravel().tolist()
            own += list(regions(result, head, rng))
            ratios += [one.ratio] if one.ratio else []
            if result.accuracy.void:
                print(f"   {kind}, seed {seed}: VOID {result.accuracy.void}", flush=True)
        everything += inside + own
        ratio = np.sqrt(np.mean(np.square(ratios))) if ratios else np.nan
        shares = (100 * np.mean(each) for each in (own, inside, corners))
        a, b, c = (f"{share:.1f} %" for share in shares)
        print(
            f"{kind:22} {given.heads - failed:3} heads: poses, gains and points {a}, projections "
            f"{b}, at the corners {c}, held-out error {ratio:.2f} of the stated one",
            flush=True,
        )
    print(f"all together: {100 * np.mean(everything):.1f} % of {len(everything)} regions")


if __name__ == "__main__":
    main()
