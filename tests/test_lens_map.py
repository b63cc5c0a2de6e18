"""What is known of a lens in each part of the image, and whole calibrations with every lens."""

import numpy as np
import pytest

import head_kinds
from head_kinds import lens_head, recording, tried
from simulated_recording import EXACT
from texts import texts
from vergence.calibration import cross_validation
from vergence.calibration.bundle_adjustment import NoiseModel, bundle_adjust
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.lens_map import (
    COLUMNS,
    ROWS,
    lens_maps,
)
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, parameter_names
from vergence.geometry.parameters import boxminus


@pytest.fixture(scope="module")
def fisheye() -> tuple[HeadCalibration, CalibrationResult]:
    rng = np.random.default_rng(1)
    head = lens_head("fisheye", rng)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cross_validation, "FOLDS", 2)
        return head, calibrate(recording(head, rng))


def test_a_calibration_chooses_the_lens_and_its_regions_reach_the_corners(fisheye):
    head, result = fisheye
    assert {choice.model for choice in result.lenses.values()} == {"fisheye"}
    assert {m.intrinsics.model for m in result.head.cameras.values()} == {"fisheye"}
    assert not [line for line in texts(result.findings) if "edge" in line]
    assert tried(result, head).inside.mean() > 0.7  # the pixels of a camera err together
    assert "left_wide.k4" in result.accuracy.parameters
    assert "left_wide.p1" not in parameter_names(result.head)


def test_the_map_shows_what_was_covered_and_how_well_it_is_known(fisheye):
    _, result = fisheye
    maps = lens_maps(result.head, result.observations.corners, result.estimate.residuals_px)
    for name, own in maps.items():
        assert own.std_px.shape == own.corners.shape == (ROWS, COLUMNS)
        used = np.isfinite(result.estimate.residuals_px[name]).all(axis=-1)
        assert own.corners.sum() == used.sum()
        assert own.std_px[0, 0] > own.std_px[ROWS // 2, COLUMNS // 2]
        assert 0.5 < own.covered <= 1
        well = own.corners > 50
        assert np.abs(own.residual_px[well]).max() < 0.1


@pytest.mark.usefixtures("two_folds")  # a lens that does not fit converges slowly
def test_a_lens_that_is_too_simple_is_named_with_its_camera(monkeypatch):
    monkeypatch.setattr(head_kinds, "STRAIGHT", 16)
    monkeypatch.setattr(head_kinds, "ORIENTATIONS", 8)
    rng = np.random.default_rng(3)
    head = lens_head("k3", rng)
    seen = recording(head, rng)
    simple = calibrate(seen, lens="radial-tangential")
    right = calibrate(seen, lens="radial-tangential-k3")
    said = [each for each in texts(simple.findings) if "the lens departs from its model" in each]
    assert len(said) == 1
    assert "_wide have a systematic error" in said[0]
    assert not any("departs from its model" in each for each in texts(right.findings))


@pytest.mark.parametrize("kind", ["k3", "fisheye"])
def test_bundle_adjustment_is_exact_with_every_lens(kind):
    rng = np.random.default_rng(4)
    head = lens_head(kind, rng)
    seen = recording(head, rng, EXACT)
    # With 0.1 px of noise the prior of a fisheye lens would count for some 1e-5 px.
    found = bundle_adjust(head, seen, noise=NoiseModel(1e-3, 1e-5))
    lens = {
        name: value
        for name, value in boxminus(found.head, head).items()
        if "T_" not in name and "_wide." in name
    }
    assert max(map(abs, lens.values())) < 1e-6


def test_lenses_of_different_models_cannot_be_compared():
    rng = np.random.default_rng(5)
    head, other = lens_head("k3", rng), lens_head("fisheye", rng)
    with pytest.raises(
        VergenceError, match="left_wide has a radial-tangential lens here and a fish"
    ):
        boxminus(head, other)
