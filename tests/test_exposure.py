"""Images of one scene that were exposed differently."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.vision.exposure import gain_and_offset, with_exposure


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(120, 25, (40, 50)).clip(60, 180).astype(np.uint8)


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 1.3), st.floats(-10, 10))
def test_an_image_of_another_exposure_becomes_the_one_it_was_made_of(seed, gain, offset):
    first = picture(seed)
    second = with_exposure(first, gain, offset)
    again = with_exposure(second, *gain_and_offset(first.ravel(), second.ravel()))
    np.testing.assert_allclose(
        again.astype(float), first.astype(float), atol=1 + 0.5 / gain
    )  # both are rounded


def test_an_image_without_contrast_is_made_as_bright_only():
    first, plain = picture(0).ravel(), np.full(100, 30, np.uint8)
    for one, other in ((first, plain), (plain, first)):
        assert gain_and_offset(one, other) == pytest.approx((1, one.mean() - other.mean()))


def test_where_nothing_is_seen_by_both_nothing_changes():
    empty = np.empty(0, np.uint8)
    assert gain_and_offset(empty, empty) == (1, 0)
    np.testing.assert_array_equal(with_exposure(picture(0), 1, 0), picture(0))


def test_greys_beyond_the_range_are_cut():
    grey = np.array([[0, 100, 255]], np.uint8)
    assert with_exposure(grey, 3, -200).tolist() == [[0, 100, 255]]
