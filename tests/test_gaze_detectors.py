"""The gaze on the twin with wide cameras alone, by marker: few of the benchmark's.

The benchmark is benchmarks/detectors.py.
"""

import numpy as np
import pytest

from cards import Card, marker_card
from described_heads import described_head
from detectors import CARD_M, DICTIONARY, KINDS, MARKER, final_errors
from drawn_card import smooth_picture
from vergence.gaze.state import GazeSettings
from vergence.geometry.projection import project_point
from vergence.twin.head import Twin
from vergence.twin.head_model import HeadModel, load_head_model
from vergence.twin.model import as_built_head
from vergence.twin.profile import load_profile
from vergence.vision.marker import marker_detector


def true_settings(profile: str, head: HeadModel | None = None) -> GazeSettings:
    head = load_head_model() if head is None else head
    truth = as_built_head(head.designed.head, load_profile(profile), 0)
    return GazeSettings(calibration=truth, limits=head.limits, reading_std=2.6e-3)


@pytest.mark.render
@pytest.mark.usefixtures("coarse_images")
@pytest.mark.parametrize("kind", [kind for kind in KINDS if "alone" in kind])
def test_a_head_with_wide_cameras_alone_centres_what_it_is_told_to_look_at(kind: str):
    found, lost = final_errors(
        kind, trials=2, profile="paper", seed=0, calibration=true_settings("paper")
    )
    assert lost == 0
    assert max(found) < 3


@pytest.mark.render
@pytest.mark.usefixtures("coarse_images")
def test_eyes_that_tilt_before_they_pan_centre_an_object(tmp_path):
    head = described_head("tilt before pan", tmp_path)
    settings = true_settings("paper", head)
    kind = "four cameras, sphere"
    found, lost = final_errors(
        kind, trials=2, profile="paper", seed=0, calibration=settings, head=head
    )
    assert lost == 0
    assert max(found) < 8


@pytest.mark.render
def test_a_card_shows_its_picture_upright_at_the_place_of_the_object():
    card = Card(np.dstack([smooth_picture(400, seed) for seed in (1, 2, 3)]), CARD_M)
    with Twin(load_profile("ideal"), furnish=card.put) as twin:
        place = np.array([0.3, -0.046, 0.0])
        twin.place_object(place)
        image = twin.capture(("left_wide",)).images["left_wide"]
        half = CARD_M / 2 * 0.6
        angles = twin.true_angles()[3:]
        for y, z, down, right in ((1, 1, 0.2, 0.2), (1, -1, 0.8, 0.2), (-1, 1, 0.2, 0.8)):
            corner = place + half * np.array([0.0, y, z])
            u, v = project_point(twin.truth, "left_wide", angles, corner).round().astype(int)
            side = len(card.picture)
            expected = card.picture[round(down * side), round(right * side)].astype(int)
            assert np.abs(image[v, u] - expected).max() < 45


@pytest.mark.render
def test_the_marker_of_a_card_is_centred_on_the_object():
    with Twin(load_profile("ideal"), furnish=marker_card(DICTIONARY, MARKER, CARD_M).put) as twin:
        place = np.array([0.5, -0.1, 0.08])
        twin.place_object(place)
        image = twin.capture(("right_wide",)).images["right_wide"]
        camera = twin.truth.camera("right_wide").intrinsics
        found = marker_detector(DICTIONARY, MARKER)(image, camera, None)
        truth = project_point(twin.truth, "right_wide", twin.true_angles()[3:], twin.true_object())
    assert found is not None
    assert np.linalg.norm(found.pixel - truth) < 0.3
