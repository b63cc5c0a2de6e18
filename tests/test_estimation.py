"""The one solver: exact and robust fits, latent unknowns, noise levels, what data determine."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_head import rough_start, skewed_head
from simulated_recording import Noise, two_boards
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import bundle_adjust, covariance_of
from vergence.estimation.adjustment import adjust
from vergence.estimation.least_squares import least_squares
from vergence.estimation.linear import eliminate, linearise, posterior
from vergence.estimation.noise import Level, row_noise_scales
from vergence.estimation.residual import Residual, Rows
from vergence.estimation.variables import Block, Latent, Variables
from vergence.geometry.parameters import named_columns


@dataclass(frozen=True, eq=False, kw_only=True)
class Sums(Residual):
    """Measurements of A s + l: shared unknowns s, and the latent number of each element."""

    A: Array
    """(B, k, 2)."""
    values: Array
    """(B, k)."""
    level: str = "sums"
    element: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        vars(self).update(element=np.arange(len(self.A)))

    def error(self, x: Variables) -> Array:
        return self.A @ x["s"] + x.latent.value - self.values

    def rows(self, x: Variables) -> Rows:
        B, k, _ = self.A.shape
        return Rows(self.A.copy(), np.tile(x.columns("s"), (B, 1)), np.ones((B, k, 1)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Numbers(Residual):
    """Direct measurements of the latent numbers."""

    values: Array
    """(B, 1)."""
    level: str = "numbers"
    element: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        vars(self).update(element=np.arange(len(self.values)))

    def error(self, x: Variables) -> Array:
        return x.latent.value - self.values

    def rows(self, x: Variables) -> Rows:
        B = len(self.values)
        return Rows(np.zeros((B, 1, 0)), np.zeros((B, 0), np.intp), np.ones((B, 1, 1)))


TRUTH = np.array([2.0, -1.0])
LEVELS = (
    Level("sums", 1.0),
    Level("numbers", 1.0, usual=0.5, latent=(0,)),
)


def simulated(
    rng: np.random.Generator, B: int = 40, k: int = 6, noise: tuple[float, float] = (0.1, 0.3)
) -> tuple[list[Residual], Variables]:
    latent, A = rng.normal(size=(B, 1)), rng.normal(size=(B, k, 2))
    sums = A @ TRUTH + latent + rng.normal(0, noise[0], (B, k))
    numbers = latent + rng.normal(0, noise[1], (B, 1))
    start = Variables({"s": Block(np.zeros(2), np.full(2, 3.0))}, Latent(np.zeros((B, 1)), 1))
    return [Sums(A=A, values=sums), Numbers(values=numbers)], start


def dense(residuals: list[Residual], start: Variables) -> tuple[Array, Array]:
    """Return the solution of the whole system and its covariance, without elimination."""
    sums, numbers = residuals
    assert isinstance(sums, Sums)
    assert isinstance(numbers, Numbers)
    B, k, _ = sums.A.shape
    J = np.zeros((B * k + B, 2 + B))
    J[: B * k, :2] = sums.A.reshape(-1, 2) / 0.1
    J[np.arange(B * k), 2 + np.arange(B * k) // k] = 1 / 0.1
    J[B * k + np.arange(B), 2 + np.arange(B)] = 1 / 0.3
    y = np.concatenate([sums.values.ravel() / 0.1, numbers.values.ravel() / 0.3])
    C: Array = np.asarray(np.linalg.inv(J.T @ J), float)
    return C @ J.T @ y, C[:2, :2]


def test_elimination_gives_the_solution_and_covariance_of_the_whole_system():
    residuals, start = simulated(np.random.default_rng(0))
    expected, covariance = dense(residuals, start)
    found = least_squares(residuals, start, levels={"sums": 0.1, "numbers": 0.3})
    assert found.converged
    np.testing.assert_allclose(found.x["s"], expected[:2], atol=1e-8)
    np.testing.assert_allclose(found.x.latent.value[:, 0], expected[2:], atol=1e-8)
    information = eliminate(found.linear, found.levels).schur
    np.testing.assert_allclose(np.linalg.inv(information), covariance, rtol=1e-8)


def test_outliers_do_little_to_a_robust_fit():
    residuals, start = simulated(np.random.default_rng(3))
    sums = residuals[0]
    assert isinstance(sums, Sums)
    sums.values[::7, 0] += 50
    levels = {"sums": 0.1, "numbers": 0.3}
    plain = least_squares(residuals, start, levels=levels)
    robust = least_squares(residuals, start, levels=levels, outlier=4.0)
    assert np.abs(robust.x["s"] - TRUTH).max() < 0.05
    assert np.abs(plain.x["s"] - TRUTH).max() > 0.5


def test_noise_levels_of_greatest_restricted_likelihood_are_unbiased():
    """With a latent unknown in each element half of the numbers' residuals are absorbed."""
    levels, stated, off = [], [], []
    for seed in range(30):
        residuals, start = simulated(np.random.default_rng(seed), B=15, k=3)
        found = adjust(residuals, start, LEVELS)
        assert found.converged
        levels.append([found.levels["sums"] ** 2, found.levels["numbers"] ** 2])
        stated.append(np.diag(found.observability.covariance))
        off.append((found.x["s"] - TRUTH) ** 2)
    np.testing.assert_allclose(np.mean(levels, axis=0), [0.01, 0.09], rtol=0.15)
    np.testing.assert_allclose(np.mean(off, axis=0), np.mean(stated, axis=0), rtol=0.5)


def test_a_direction_that_nothing_measures_keeps_its_start():
    residuals, start = simulated(np.random.default_rng(6))
    sums = residuals[0]
    assert isinstance(sums, Sums)
    sums.A[..., 1] = sums.A[..., 0]  # only the sum of both is measured
    found = adjust(residuals, start, LEVELS)
    assert len(found.observability.fixed) == 1
    s = found.x["s"]
    assert s[0] == pytest.approx(s[1], abs=1e-6)  # the start's difference, zero
    weak = np.abs(found.observability.fixed[0])
    np.testing.assert_allclose(weak, weak[0])


@pytest.mark.parametrize("std", [0.0, 0.5])
def test_a_filter_s_update_takes_a_singular_prior(std: float):
    residuals, start = simulated(np.random.default_rng(7))
    errors = [residual.error(start) for residual in residuals]
    linear = linearise(residuals, start, errors, [np.ones_like(e) for e in errors])
    reduced = eliminate(linear, {"sums": 0.1, "numbers": 0.3})
    prior = np.diag([4.0, std**2])
    step, covariance = posterior(reduced.schur, reduced.vector, prior)
    if std:
        expected = np.linalg.inv(reduced.schur + np.linalg.inv(prior))
        np.testing.assert_allclose(covariance, expected, rtol=1e-9)
        np.testing.assert_allclose(step, expected @ reduced.vector, rtol=1e-9)
    else:
        assert step[1] == 0
        np.testing.assert_array_equal(covariance[1], 0)


# A new measurement is one residual, and one word where the residuals are listed.


@dataclass(frozen=True, eq=False, kw_only=True)
class EyeDistance(Residual):
    """The distance between the eyes, measured by hand."""

    distance_m: float
    std_m: float
    robust: bool = False

    def error(self, x: Variables) -> Array:
        distance_m = float(np.linalg.norm(x["head"].T_rbase_lbase[:3, 3]))
        return np.array([[(distance_m - self.distance_m) / self.std_m]])

    def rows(self, x: Variables) -> Rows:
        t = x["head"].T_rbase_lbase[:3, 3]
        shift = named_columns(x["head"], [f"T_rbase_lbase.t{axis}" for axis in "xyz"])
        by_t = t / np.linalg.norm(t) / self.std_m
        return Rows(by_t[None, None], x.columns("head")[shift][None])


def test_a_measured_distance_between_the_eyes_sharpens_the_scale_of_a_head():
    rng = np.random.default_rng(8)
    head = skewed_head(rng)
    observed = two_boards(head, rng, noise=Noise(pixel_px=0.1, joint_rad=1e-3))
    observed, start = observed.take(np.arange(0, 40, 3)), rough_start(head, rng)
    true_m = float(np.linalg.norm(head.T_rbase_lbase[:3, 3]))
    plain = bundle_adjust(start, observed)
    distance = EyeDistance(distance_m=true_m, std_m=1e-6)
    found = bundle_adjust(start, observed, priors=[distance])
    t = found.head.T_rbase_lbase[:3, 3]
    assert np.linalg.norm(t) == pytest.approx(true_m, abs=5e-6)
    across = t / np.linalg.norm(t)
    before, after = (
        float(across @ covariance_of(each, "T_rbase_lbase")[3:, 3:] @ across)
        for each in (plain, found)
    )
    assert after < 1.1e-6**2 < before


# Noise of single images


def image_noise_scales(squares: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return row_noise_scales(squares, counts, 1e-3)


def residual_squares(std: np.ndarray, count: int, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(len(std), count))
    return ((std[:, None] * noise) ** 2).sum(axis=1)


def test_images_of_equal_noise_have_equal_scales():
    squares = residual_squares(np.full(60, 0.1), 100, 0)
    scales = image_noise_scales(squares, np.full(60, 100.0))
    np.testing.assert_allclose(scales, 1.0, atol=0.06)  # against 0.2 if each went by its own


def test_images_of_different_noise_have_their_own_scales():
    std = 0.02 * np.exp(np.random.default_rng(1).normal(0, 0.4, 60))
    scales = image_noise_scales(residual_squares(std, 100, 2), np.full(60, 100.0))
    ratio = scales / std
    assert np.std(np.log(ratio)) < 0.08


def test_the_scales_of_images_with_few_corners_are_shrunk_more():
    std = 0.02 * np.exp(np.random.default_rng(1).normal(0, 0.4, 60))
    counts = np.where(np.arange(60) < 30, 10.0, 100.0)
    squares = np.where(counts == 10, residual_squares(std, 10, 3), residual_squares(std, 100, 3))
    scales = np.abs(np.log(image_noise_scales(squares, counts)))
    raw = np.abs(np.log(squares / counts) - np.log(np.median(squares / counts))) / 2
    assert scales[:30].mean() / raw[:30].mean() < scales[30:].mean() / raw[30:].mean()


@given(st.lists(st.floats(0, 6), max_size=5))
def test_images_without_redundancy_count_as_typical_and_exact_corners_have_finite_scales(counts):
    scales = image_noise_scales(np.zeros(len(counts)), np.array(counts))
    np.testing.assert_array_equal(scales, 1.0)
    assert np.isfinite(image_noise_scales(np.zeros(5), np.full(5, 100.0))).all()
