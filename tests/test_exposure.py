"""Images of one scene that were exposed differently."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.vision.exposure import gain_and_offset, with_exposure


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(120, 25, (40, 50)).clip(60, 180).astype(np.uint8)


EVERYWHERE = np.ones((40, 50), bool)


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 1.3), st.floats(-10, 10))
def test_an_image_of_another_exposure_becomes_the_one_it_was_made_of(seed, gain, offset):
    first = picture(seed)
    second = with_exposure(first, gain, offset)
    again = with_exposure(second, *gain_and_offset(first, second, EVERYWHERE))
    np.testing.assert_allclose(
        again.astype(float), first.astype(float), atol=1 + 0.5 / gain
    )  # both are rounded


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 1.3), st.floats(-10, 10))
def test_what_one_image_alone_shows_does_not_count(seed, gain, offset):
    first = picture(seed)
    second = with_exposure(first, gain, offset)
    seen_by_both = gain_and_offset(first[:, :16], second[:, :16], EVERYWHERE[:, :16])
    first[:, 16:] = 128
    assert gain_and_offset(first, second, EVERYWHERE) == pytest.approx(seen_by_both)


def test_an_image_without_contrast_is_made_as_bright_only():
    first, plain = picture(0), np.full((40, 50), 30, np.uint8)
    for one, other in ((first, plain), (plain, first)):
        gain, offset = gain_and_offset(one, other, EVERYWHERE)
        assert gain == 1
        assert offset == pytest.approx(float(one.mean()) - float(other.mean()), abs=2)


def test_where_nothing_is_seen_by_both_nothing_changes():
    assert gain_and_offset(picture(0), picture(1), ~EVERYWHERE) == (1, 0)
    assert gain_and_offset(picture(0)[:5, :5], picture(1)[:5, :5], EVERYWHERE[:5, :5]) == (1, 0)
    np.testing.assert_array_equal(with_exposure(picture(0), 1, 0), picture(0))


def test_greys_beyond_the_range_are_cut():
    grey = np.array([[0, 100, 255]], np.uint8)
    assert with_exposure(grey, 3, -200).tolist() == [[0, 100, 255]]
