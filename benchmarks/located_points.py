"""How fast points are located, beside OpenCV with cameras that do not move, and in how much memory.

Prints points a second on one core, in turns so that a busy machine slows all alike: cv2's
undistortPoints and triangulatePoints with one fixed pose; `locate` with a posture for each point,
without covariance, with that of the noise, and with that of noise and calibration; then the memory
that a million points with covariance add, and the time of a single point, as in a control step.
Times are of the processor, the best of the rounds.

    python benchmarks/located_points.py [--points 200000] [--rounds 7]
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import tyro

import vergence as vg
from simulated_head import random_head
from vergence.arrays import Array
from vergence.geometry.head import parameter_names
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.projection import project_point
from vergence.stereo.extrinsics import relative_camera_pose

WIDE = ("left_wide", "right_wide")
NOISE: dict[str, Any] = {"pixel_std_px": 0.1, "reading_std": 1e-3}


def stated(head: vg.HeadCalibration) -> vg.HeadCalibration:
    """Return a head that states a covariance of all its parameters, of plausible size."""
    names = parameter_names(head)
    scale = np.array([1e-4 if name.rpartition(".")[2] in POSE_AND_AXES else 0.1 for name in names])
    A = np.eye(len(names)) + 0.1 * np.random.default_rng(1).normal(size=(len(names),) * 2)
    accuracy = Accuracy(
        method="bundle",
        parameters=names,
        covariance=scale * (A @ A.T) * scale[:, None],
        pixel_std_px=0.1,
        joint_std=(1e-3,),
    )
    return replace(head, accuracy=accuracy)


POSE_AND_AXES = ("rx", "ry", "rz", "tx", "ty", "tz", "pan_gain", "tilt_gain", "time_offset_s")


def fixed_geometry(head: vg.HeadCalibration, left: Array, right: Array) -> Array:
    """Return points (N, 3) by OpenCV, of cameras that do not move."""
    lenses = [head.cameras[name].intrinsics for name in WIDE]
    rays = [
        cv2.undistortPoints(uv.reshape(-1, 1, 2), lens.matrix, lens.distortion).reshape(-1, 2).T
        for uv, lens in zip((left, right), lenses, strict=True)
    ]
    X = cv2.triangulatePoints(np.eye(3, 4), relative_camera_pose(head, np.zeros(4))[:3], *rays)
    return (X[:3] / X[3]).T


def samples(head: vg.HeadCalibration, n: int) -> dict[str, Any]:
    """Return pixels of n points before the head, each in a posture of its own."""
    rng = np.random.default_rng(0)
    points = rng.uniform([0.3, -0.1, -0.1], [1.5, 0.1, 0.1], (n, 3))
    joints = rng.uniform(-0.25, 0.25, (n, 4))
    left, right = (project_point(head, name, joints, points) for name in WIDE)
    return {"left": left, "right": right, "joints": joints}


def seconds(run: Callable[[], object]) -> float:
    """Return the processor time of one call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def main(points: int = 200_000, rounds: int = 7) -> None:
    """Print the figures.

    Args:
        points: in a batch.
        rounds: of each measurement; the best counts.
    """
    cv2.setNumThreads(1)
    head = random_head(np.random.default_rng(0), lenses=("wide",))
    known, seen = stated(head), samples(head, points)
    ways: dict[str, Callable[[], object]] = {
        "OpenCV, fixed geometry": lambda: fixed_geometry(head, seen["left"], seen["right"]),
        "locate": lambda: vg.locate(head, **seen),
        "locate, one posture": lambda: vg.locate(head, **seen | {"joints": seen["joints"][0]}),
        "with covariance of the noise": lambda: vg.locate(head, **seen, **NOISE),
        "and of the calibration": lambda: vg.locate(known, **seen),
    }
    times = {name: min(seconds(run) for _ in range(1)) for name, run in ways.items()}
    for _ in range(rounds - 1):
        times = {name: min(times[name], seconds(run)) for name, run in ways.items()}
    reference = times["OpenCV, fixed geometry"]
    for name, each in times.items():
        print(f"{name:<30} {points / each / 1e6:5.2f} million a second, {reference / each:4.2f}")

    one: dict[str, Any] = {name: each[:1] for name, each in seen.items()} | {
        "joints": seen["joints"][0]
    }
    steps: dict[str, Callable[[], object]] = {
        "one point": lambda: vg.locate(head, **one),
        "one point, noise": lambda: vg.locate(head, **one, **NOISE),
        "one point, noise, calibration": lambda: vg.locate(known, **one),
    }
    for name, run in steps.items():
        hundreds = [seconds(lambda run=run: [run() for _ in range(100)]) for _ in range(5 * rounds)]
        print(f"{name:<30} {min(hundreds) / 100 * 1e3:5.3f} ms")

    many = samples(head, 1_000_000)
    tracemalloc.start()
    located = vg.locate(known, **many)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"a million points with covariance: {most / 1e6:.0f} MB at most, beside the samples")
    assert np.isfinite(located.covariance).all()


if __name__ == "__main__":
    tyro.cli(main)
