"""The adjustment's analytic derivatives are those that differences give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heads import random_head, random_pose
from refining import BOARD, views_of
from vergence.arrays import Array
from vergence.calibration.bundle.initial_state import whole_head
from vergence.calibration.bundle.jacobians import jacobians
from vergence.calibration.bundle.problem import (
    Problem,
    State,
    advance,
    corner_errors,
    moved,
    pose_difference,
)
from vergence.calibration.sequential.sequential import Views
from vergence.geometry.kinematics import T_base_eye


def numeric(problem: Problem, state: State, step: float = 1e-6) -> tuple[Array, Array]:
    """Return derivatives (M, K, 2, G) and (M, K, 2, n) of corner_errors by central differences."""
    G, (B, n) = len(problem.free), problem.reading.shape

    def slope(shared: Array, latent: Array) -> Array:
        ahead = corner_errors(problem, advance(problem, state, shared, latent))
        behind = corner_errors(problem, advance(problem, state, -shared, -latent))
        return (ahead - behind) / (2 * step)

    by_shared = [slope(step * row, np.zeros((B, n))) for row in np.eye(G)]
    by_latent = [slope(np.zeros(G), np.tile(step * row, (B, 1))) for row in np.eye(n)]
    return np.stack(by_shared, axis=-1), np.stack(by_latent, axis=-1)


@pytest.mark.parametrize("general", [False, True])
def test_analytic_derivatives_agree_with_differences(general: bool):
    rng = np.random.default_rng(30)
    head = random_head(rng)
    views = views_of(head, rng)
    keep = [0, 1, 12, 13, 14, 15]
    few = Views(
        BOARD,
        views.placement[keep],
        views.eye_angles[keep],
        {name: pixels[keep] for name, pixels in views.corners.items()},
        views.sizes,
    )
    poses = None
    if general:
        eyes = np.stack([T_base_eye(few.eye_angles[:, s]) for s in (slice(2), slice(2, 4))], 1)
        poses = moved(eyes, rng.normal(0, 0.01, (6, 2, 6)))
    problem, state, _ = whole_head(head, few, timing=None, poses=poses, hold=())
    # Away from the optimum, where the errors of general poses are not small.
    state = advance(
        problem,
        state,
        rng.normal(0, 1e-3, len(problem.free)),
        rng.normal(0, 0.05, problem.reading.shape),
    )
    expected_shared, expected_latent = numeric(problem, state)
    shared, index, latent = jacobians(problem, state)
    dense = np.zeros_like(expected_shared)
    for m, columns in enumerate(index):
        dense[m][..., columns] = shared[m]
    scale = np.abs(expected_shared).max(axis=(0, 1, 2)) + 1.0
    np.testing.assert_allclose(dense / scale, expected_shared / scale, atol=1e-6)
    np.testing.assert_allclose(latent, expected_latent, atol=1e-4, rtol=1e-6)


@given(st.integers(0, 10**6))
def test_a_difference_of_poses_leads_from_one_to_the_other(seed: int):
    rng = np.random.default_rng(seed)
    a, b = random_pose(rng), random_pose(rng)
    np.testing.assert_allclose(moved(b, pose_difference(a, b)), a, atol=1e-12)
