"""Errors that all images of a camera share are seen in the residuals, and make accuracy humble."""

from dataclasses import replace

import numpy as np
import pytest
from vergence.calibration.bundle.refine import Refined, refine

from test_other_heads import recorded
from vergence.calibration.calibrate import estimate
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES


def bent(corners: np.ndarray, size_px: float) -> np.ndarray:
    """Return corners (..., 2) moved by a field of about so many pixels that no lens model has."""
    x, y = corners[..., 0] / 320 - 1, corners[..., 1] / 240 - 1
    field = np.stack([np.cos(4 * x) * y, np.sin(3 * y) * np.cos(2 * x)], axis=-1)
    return corners + 2 * size_px * field


@pytest.fixture(scope="module")
def heads() -> tuple[HeadCalibration, Refined, Refined, Refined]:
    """A head and three calibrations of it.

    Of the second the left images share an error of 0.4 px; the third is told that all share 1 px.
    """
    truth, seen = recorded(9)
    start = estimate(seen).head
    plain = refine(start, seen.views)
    corners = dict(seen.views.corners)
    corners["left_wide"] = bent(corners["left_wide"], 0.4)
    spoilt = refine(start, replace(seen.views, corners=corners))
    return truth, plain, spoilt, refine(start, replace(seen.views, shared_px=1.0))


def std_of(refined: Refined, name: str) -> float:
    return float(np.sqrt(refined.covariance[(i := refined.parameters.index(name)), i]))


def test_without_them_they_are_hardly_taken_for_there(heads):
    _, plain, _, _ = heads
    assert not any("share errors" in warning for warning in plain.warnings)


def test_they_are_named_by_camera(heads):
    _, _, spoilt, _ = heads
    said = [warning for warning in spoilt.warnings if "share errors" in warning]
    assert len(said) == 1
    assert said[0].startswith("All images of left_wide share errors of ")
    assert "the lens is not as the model says" in said[0]


def test_they_make_the_stated_accuracy_of_that_camera_worse_and_true(heads):
    truth, plain, spoilt, _ = heads
    for name in ("fx", "cx", "k1"):
        assert std_of(spoilt, f"left_wide.{name}") > 2 * std_of(plain, f"left_wide.{name}")
    for eye in EYES:
        camera, true = spoilt.head.cameras[f"{eye}_wide"], truth.cameras[f"{eye}_wide"]
        off = camera.intrinsics.matrix - true.intrinsics.matrix
        for name, error in (("fx", off[0, 0]), ("fy", off[1, 1]), ("cx", off[0, 2])):
            assert abs(error) < 3 * std_of(spoilt, f"{eye}_wide.{name}")


def test_what_is_known_of_them_beforehand_is_stated_even_if_it_cannot_be_seen(heads):
    _, plain, _, told = heads
    np.testing.assert_allclose(told.head.T_rbase_lbase, plain.head.T_rbase_lbase, atol=1e-12)
    for name in ("left_wide.fx", "right_wide.k1", "left_wide.T_eye_cam.tz"):
        assert std_of(told, name) > 2 * std_of(plain, name)
