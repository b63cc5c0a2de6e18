"""The place of a picture in an image, by correlation, on pictures made here."""

import cv2
import numpy as np
import pytest

from drawn_card import WIDE, at, draw_card, smooth_picture
from vergence.errors import VergenceError
from vergence.geometry.camera import pinhole, project
from vergence.geometry.se3 import pose, rotation
from vergence.vision.template import template_detector

PLAIN = pinhole(640, 480, 400.0)
PICTURE = smooth_picture(240)
SMALL = cv2.resize(PICTURE, (60, 60), interpolation=cv2.INTER_AREA)
WIDTH_M = 0.06
SAME_SIZE_M = 400.0 * WIDTH_M / 60
"""Depth at which the plain camera sees the picture as large as the template."""
SCALES = tuple(np.geomspace(0.2, 1.3, 12).tolist())


def test_the_position_is_found_to_a_fraction_of_a_pixel():
    """It varies by 0.06 px over the pixel grid; the grey around the picture draws it by 0.1 px."""
    detect = template_detector(SMALL)
    errors = []
    for shift in np.linspace(0, 1, 11):
        point = at(PLAIN, (300.0 + shift, 200.0 + 0.7 * shift), SAME_SIZE_M)
        found = detect(draw_card(PLAIN, PICTURE, pose(t=point), WIDTH_M), PLAIN, None)
        assert found is not None
        errors.append(found.pixel - project(PLAIN, point))
    assert np.abs(errors).max() < 0.2
    assert np.std(errors, axis=0).max() < 0.06


@pytest.mark.parametrize("depth", [0.3, 0.5, 0.8, 1.2])
def test_near_and_far_objects_are_found_and_the_stated_deviation_covers_the_errors(depth: float):
    detect, rng = template_detector(SMALL, scales=SCALES), np.random.default_rng(int(10 * depth))
    ratios = []
    for _ in range(12):
        point = at(PLAIN, tuple(rng.uniform([150, 120], [490, 360])), depth)
        T = pose(rotation(rng.uniform(-0.05, 0.05, 3)), point)
        found = detect(draw_card(PLAIN, PICTURE, T, WIDTH_M, noise=rng), PLAIN, None)
        assert found is not None
        ratios.append((found.pixel - project(PLAIN, point)) / found.std_px)
    assert 0.1 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_brightness_contrast_and_colour_do_not_matter():
    point = at(PLAIN, (340.6, 222.3), SAME_SIZE_M)
    image = draw_card(PLAIN, PICTURE, pose(t=point), WIDTH_M)
    dim = (40 + 0.4 * image).round().astype(np.uint8)
    coloured = np.repeat(SMALL[..., None], 3, axis=-1)
    for picture in (SMALL, coloured):
        found = template_detector(picture)(dim, PLAIN, None)
        assert found is not None
        assert np.abs(found.pixel - project(PLAIN, point)).max() < 0.2


def test_it_is_found_near_its_last_place_and_elsewhere_alike():
    detect = template_detector(SMALL, scales=SCALES)
    point = at(WIDE, (300.4, 200.9), 0.5)
    image = draw_card(WIDE, PICTURE, pose(t=point), WIDTH_M)
    everywhere = detect(image, WIDE, None)
    assert everywhere is not None
    for near in ((302.0, 198.0), (60.0, 440.0), (np.nan, np.nan), (9000.0, -5.0)):
        found = detect(image, WIDE, np.array(near))
        assert found is not None
        np.testing.assert_allclose(found.pixel, everywhere.pixel, atol=1e-6)


def test_the_place_near_the_last_one_comes_first():
    """Of two objects alike, the one that was looked at."""
    image = draw_card(PLAIN, PICTURE, pose(t=at(PLAIN, (150.0, 200.0), SAME_SIZE_M)), WIDTH_M)
    other = draw_card(PLAIN, PICTURE, pose(t=at(PLAIN, (500.0, 300.0), SAME_SIZE_M)), WIDTH_M)
    image[:, 320:] = other[:, 320:]
    detect = template_detector(SMALL)
    for pixel in ((150.0, 200.0), (500.0, 300.0)):
        found = detect(image, PLAIN, np.array(pixel) + 10)
        assert found is not None
        assert np.abs(found.pixel - pixel).max() < 0.2


def test_what_does_not_resemble_it_is_not_taken_for_it():
    detect = template_detector(SMALL, scales=SCALES)
    assert detect(np.full((480, 640, 3), 90, np.uint8), PLAIN, None) is None
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    assert detect(noise, PLAIN, None) is None
    other = smooth_picture(240, seed=1)
    image = draw_card(PLAIN, other, pose(t=[0, 0, SAME_SIZE_M]), WIDTH_M)
    assert detect(image, PLAIN, None) is None


def test_an_image_that_is_smaller_than_the_template_does_not_show_it():
    assert template_detector(SMALL)(np.zeros((40, 40, 3), np.uint8), PLAIN, None) is None


@pytest.mark.parametrize(
    ("picture", "options", "words"),
    [
        (SMALL // 40, {}, "60 x 60 px has .* and a contrast of 5 grey levels"),
        (SMALL[:6], {}, "60 x 6 px has sides of 8 px"),
        (SMALL.astype(float), {}, "float64"),
        (np.tile(SMALL[:1], (60, 1)), {}, "the same all along"),
        (SMALL, {"scales": (0.05,)}, "none of the scales .0.05."),
        (SMALL, {"scales": ()}, "none of the scales"),
        (SMALL, {"least_score": 1.5}, "between 0 and 1, found 1.5"),
    ],
)
def test_pictures_that_cannot_be_recognised_are_refused(picture, options, words: str):
    with pytest.raises(VergenceError, match=words):
        template_detector(picture, **options)
