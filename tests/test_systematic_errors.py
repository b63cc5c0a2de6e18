"""Systematic errors of corners are seen in the residuals, and make the stated accuracy larger."""

from dataclasses import replace

import numpy as np
import pytest

from test_other_heads import recorded
from texts import texts
from vergence.calibration.bundle_adjustment import BundleEstimate as Estimate
from vergence.calibration.bundle_adjustment import bundle_adjust, covariance_of
from vergence.calibration.initial import calibrate_sequentially
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES


def bent(corners: np.ndarray, size_px: float) -> np.ndarray:
    """Return corners (..., 2) moved by a field of about so many pixels that no lens model has."""
    x, y = corners[..., 0] / 320 - 1, corners[..., 1] / 240 - 1
    field = np.stack([np.cos(4 * x) * y, np.sin(3 * y) * np.cos(2 * x)], axis=-1)
    return corners + 2 * size_px * field


@pytest.fixture(scope="module")
def heads(slow_setup: None) -> tuple[HeadCalibration, Estimate, Estimate, Estimate]:
    """A head and three estimates of it.

    In the second the left images have a systematic error of 0.4 px; in the third all are assumed to
    have one of 1 px.
    """
    truth, observed = recorded(9)
    start = calibrate_sequentially(observed).head
    plain = bundle_adjust(start, observed)
    corners = {**observed.corners, "left_wide": bent(observed.corners["left_wide"], 0.4)}
    spoilt = bundle_adjust(start, replace(observed, corners=corners))
    return truth, plain, spoilt, bundle_adjust(start, replace(observed, systematic_px=1.0))


def std_of(estimate: Estimate, name: str) -> float:
    return float(np.sqrt(covariance_of(estimate, name)[0, 0]))


def test_systematic_errors_are_named_by_camera_and_independent_ones_are_not(heads):
    _, plain, spoilt, _ = heads
    assert not any("systematic error" in warning for warning in texts(plain.findings))
    (said,) = (warning for warning in texts(spoilt.findings) if "systematic error" in warning)
    assert said.startswith("All images of left_wide have a systematic error of ")
    assert "the lens departs from its model" in said
    assert plain.systematic_px == {}
    assert 0.2 < spoilt.systematic_px["left_wide"] < 1.0
    assert spoilt.accuracy.systematic_px == spoilt.systematic_px


def test_systematic_errors_make_the_stated_accuracy_of_that_camera_worse_and_true(heads):
    truth, plain, spoilt, _ = heads
    for name in ("fx", "cx", "k1"):
        assert std_of(spoilt, f"left_wide.{name}") > 2 * std_of(plain, f"left_wide.{name}")
    for eye in EYES:
        camera, true = spoilt.head.cameras[f"{eye}_wide"], truth.cameras[f"{eye}_wide"]
        off = camera.intrinsics.matrix - true.intrinsics.matrix
        for name, error in (("fx", off[0, 0]), ("fy", off[1, 1]), ("cx", off[0, 2])):
            assert abs(error) < 3 * std_of(spoilt, f"{eye}_wide.{name}")


def test_an_assumed_systematic_error_is_stated_even_if_it_cannot_be_seen(heads):
    _, plain, _, assumed = heads
    np.testing.assert_allclose(assumed.head.T_rbase_lbase, plain.head.T_rbase_lbase, atol=1e-12)
    for name in ("left_wide.fx", "right_wide.k1", "left_wide.T_eye_cam.tz"):
        assert std_of(assumed, name) > 2 * std_of(plain, name)
