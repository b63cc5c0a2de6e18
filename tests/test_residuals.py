"""The derivatives of every residual of a calibration agree with differences of its errors."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import skewed_head
from simulated_recording import two_boards
from vergence.arrays import Array
from vergence.calibration.bundle_start import BundleProblem, bundle_problem
from vergence.calibration.observations import PoseObservations
from vergence.estimation.residual import Residual
from vergence.estimation.variables import Variables
from vergence.geometry.se3 import boxplus
from vergence.vision.board_pose import board_poses

KINDS = ("corners, readings", "corners, eye poses", "target poses", "moving eyes")


def problem_of(kind: str, rng: np.random.Generator) -> BundleProblem:
    head = skewed_head(rng)
    if kind == "moving eyes":
        return bundle_problem(head, two_boards(head, rng, time_offset_s=0.02), fixed=())
    few = two_boards(head, rng).take(np.array([0, 1, 12, 13, 14, 15]))
    if kind == "corners, readings":
        return bundle_problem(head, few, fixed=())
    noisy = boxplus(few.eye_poses(), rng.normal(0, 0.01, (6, 2, 6)))
    if kind == "corners, eye poses":
        return bundle_problem(head, replace(few, T_base_eye=noisy), fixed=())
    points = None
    poses = {}
    for name, corners in few.corners.items():
        intrinsics = head.cameras[name].intrinsics
        points = bundle_problem(head, few, fixed=()).measured.points  # type: ignore[union-attr]
        T = board_poses(intrinsics, corners, points)
        poses[name] = boxplus(T, rng.normal(0, 0.02, (6, 6)))
    whitening = dict.fromkeys(poses, rng.normal(size=(6, 6, 6)))
    seen = PoseObservations(poses, whitening, few.placement, few.eye_angles, None)
    return bundle_problem(head, seen, fixed=())


def slopes(residual: Residual, x: Variables) -> tuple[Array, Array]:
    """Return derivatives (M, k, G) and (M, k, n) by central differences."""
    G, (B, n) = x.size, (len(x.latent.value), x.latent.size)

    def slope(steps: list[tuple[Array, Array]]) -> Array:
        ends = [
            residual.error(x.retract(s, t)) - residual.error(x.retract(-s, -t)) for s, t in steps
        ]
        return np.stack(ends, axis=-1) / 2e-6

    still = np.zeros((B, n))
    shared = slope([(1e-6 * row, still) for row in np.eye(G)])
    latent = slope([(np.zeros(G), np.tile(1e-6 * row, (B, 1))) for row in np.eye(n)])
    return shared, latent


def assert_derivatives(residual: Residual, x: Variables) -> None:
    rows, (expected_shared, expected_latent) = residual.rows(x), slopes(residual, x)
    dense = np.zeros_like(expected_shared)
    for m, columns in enumerate(rows.columns):
        np.add.at(dense[m].T, columns, rows.by_shared[m].T)
    scale = np.abs(expected_shared).max(axis=(0, 1)) + 1.0
    np.testing.assert_allclose(dense / scale, expected_shared / scale, atol=2e-6)
    if rows.by_latent is not None:
        np.testing.assert_allclose(rows.by_latent, expected_latent, atol=1e-4, rtol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_by_every_unknown_agree_with_differences(kind: str):
    rng = np.random.default_rng(30)
    problem = problem_of(kind, rng)
    start = problem.start
    # Away from the optimum, where the errors of general poses are not small.
    x = start.retract(
        rng.normal(0, 1e-3, start.size),
        rng.normal(0, 0.05, (len(start.latent.value), start.latent.size)),
    )
    for residual in problem.residuals:
        assert_derivatives(residual.follow(x), x)
