"""The centre of a square marker, from antialiased pictures made here."""

import cv2
import numpy as np
import pytest

from drawn_card import WIDE, at, draw_card
from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import pinhole, project
from vergence.geometry.se3 import pose, rotation
from vergence.vision.marker import marker_detector

PLAIN = pinhole(640, 480, 400.0)
SIDE_M = 0.1
DETECT = marker_detector("DICT_4X4_50", 7)


def picture(marker_id: int = 7, dictionary: str = "DICT_4X4_50") -> np.ndarray:
    """Return a marker (h, w) uint8 of 100 px a module or less, with a margin of a sixth."""
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    drawn = cv2.aruco.generateImageMarker(family, marker_id, 600)
    return np.pad(np.where(drawn > 0, 235, 25), 100, constant_values=235).astype(np.uint8)


def shown(camera, T: Array, **options) -> np.ndarray:
    return draw_card(camera, picture(), T, SIDE_M * 8 / 6, **options)


@pytest.mark.parametrize("camera", [WIDE, PLAIN], ids=["distorted", "pinhole"])
@pytest.mark.parametrize("slant", [(0.0, 0.0, 0.0), (0.5, 0.0, 0.2), (0.0, -0.6, 1.0)])
def test_the_centre_of_a_slanted_marker_is_where_its_diagonals_meet(camera, slant):
    """Within 0.1 px off the middle of the image, where the mean of the corners is off by more."""
    point = at(camera, (210.3, 170.8), 0.35)
    found = DETECT(shown(camera, pose(rotation(np.array(slant)), point)), camera, None)
    assert found is not None
    assert np.abs(found.pixel - project(camera, point)).max() < 0.1
    if any(slant[:2]):
        corners = SIDE_M / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        seen = project(camera, corners @ rotation(np.array(slant)).T + point)
        assert np.linalg.norm(seen.mean(axis=0) - project(camera, point)) > 0.2


@pytest.mark.parametrize("depth", [0.3, 0.6, 1.0, 1.4])
def test_the_stated_standard_deviation_covers_the_errors(depth: float):
    rng = np.random.default_rng(int(10 * depth))
    ratios = []
    for _ in range(25):
        point = at(WIDE, tuple(rng.uniform([150, 120], [490, 360])), depth)
        image = shown(WIDE, pose(rotation(rng.normal(0, 0.2, 3)), point), noise=rng)
        found = DETECT(image, WIDE, None)
        if found is not None:
            ratios.append((found.pixel - project(WIDE, point)) / found.std_px)
    assert len(ratios) >= 23
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.2


def test_other_markers_and_empty_images_are_not_taken_for_it():
    image = draw_card(WIDE, picture(8), pose(t=[0, 0, 0.4]), SIDE_M * 8 / 6)
    assert DETECT(image, WIDE, None) is None
    assert DETECT(np.full((480, 640, 3), 90, np.uint8), WIDE, None) is None


def test_apriltags_are_markers_too():
    image = draw_card(
        WIDE, picture(3, "DICT_APRILTAG_36H11"), pose(t=[0.02, 0, 0.3]), SIDE_M * 8 / 6
    )
    found = marker_detector("DICT_APRILTAG_36H11", 3)(image, WIDE, None)
    assert found is not None
    assert np.abs(found.pixel - project(WIDE, np.array([0.02, 0, 0.3]))).max() < 0.1


@pytest.mark.parametrize(
    ("dictionary", "marker_id", "words"),
    [
        ("DICT_9X9", 0, "'DICT_9X9'.* DICT_4X4_50"),
        ("DICT_4X4_50", 50, "marker 50 .* 0 to 49"),
        ("DICT_4X4_50", -1, "marker -1"),
    ],
)
def test_markers_that_do_not_exist_are_refused(dictionary: str, marker_id: int, words: str):
    with pytest.raises(VergenceError, match=words):
        marker_detector(dictionary, marker_id)
