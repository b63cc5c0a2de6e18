"""How much noisier the corners of single images are, from their residuals."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vergence.estimation.noise import row_noise_scales


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
