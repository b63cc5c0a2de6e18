"""Images of one scene that were exposed differently."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.vision.exposure import of_equal_contrast

SHAPE = (96, 160)
EVERYWHERE = np.ones((48, 80), bool)
SEEDS = st.integers(0, 2**32 - 1)


def picture(seed: int) -> np.ndarray:
    rough = np.random.default_rng(seed).normal(0, 1, SHAPE).astype(np.float32)
    smooth = cv2.GaussianBlur(rough, (0, 0), 1.5)
    return np.clip(120 + 25 * smooth / smooth.std(), 30, 210).round().astype(np.uint8)


def exposed(image: np.ndarray, gain: float, offset: float | np.ndarray = 0.0) -> np.ndarray:
    return np.clip(np.round(gain * image + offset), 0, 255).astype(np.uint8)


@given(SEEDS, st.floats(0.3, 1.1), st.floats(-5, 20))
def test_an_image_of_another_exposure_becomes_the_one_it_was_made_of(seed, gain, offset):
    image = picture(seed)
    first, second = of_equal_contrast(image, exposed(image, gain, offset), EVERYWHERE)
    apart = np.abs(first.astype(float) - second)
    assert apart.max() <= 1 + 1.5 / gain  # each, and both means, are rounded
    assert first.std() == pytest.approx(25, rel=0.2)


@given(SEEDS, st.floats(0.4, 1.0))
def test_what_one_image_alone_shows_does_not_count(seed, gain):
    image = picture(seed)
    part = image.copy()
    part[:, 80:] = 128
    for pair in ((part, exposed(image, gain)), (image, exposed(part, gain))):
        first, second = of_equal_contrast(*pair, EVERYWHERE)
        apart = np.abs(first.astype(float) - second)[:, : 80 - 16]
        assert apart.max() <= 1 + 1.5 / gain


def test_without_contrast_in_both_each_keeps_its_own():
    image, plain = picture(0), np.full(SHAPE, 30, np.uint8)
    for pair in ((image, plain), (plain, image)):
        alike = of_equal_contrast(*pair, EVERYWHERE)
        for before, after in zip(pair, alike, strict=True):
            assert after.std() == pytest.approx(before.std(), rel=0.1)
    faint = exposed(image, 0.5)
    for both in (~EVERYWHERE, np.zeros((48, 80), bool)):
        first, second = of_equal_contrast(image, faint, both)
        assert second.std() == pytest.approx(first.std() / 2, rel=0.05)
