"""The pinhole camera with five coefficients: Eqs. 1-2, and where a lens folds over.

`test_lens` has what holds for every lens model.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from simulated_head import random_camera
from vergence.geometry.camera import (
    Camera,
    normalise,
    pinhole,
    project,
    project_jacobians,
    undistort,
)
from vergence.geometry.lens import COEFFICIENTS, CameraModel

seeds = st.integers(0, 2**32 - 1)
WIDE = pinhole(640, 480, 280.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
"""The strongest distortion that the twin has."""


@given(seeds)
def test_a_pixel_is_the_intrinsic_matrix_times_the_point_up_to_scale(seed: int):
    """Eqs. 1-2: s u = A [R t] y with R = I, t = 0, skew included, for corrected pixels."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng)
    points = rng.uniform([-0.6, -0.5, 0.8], [0.6, 0.5, 2.0], (20, 3))
    corrected = undistort(camera, project(camera, points))
    homogeneous = points @ camera.matrix.T
    np.testing.assert_allclose(corrected, homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-9)


def test_equation_1_holds_for_corrected_pixels_only():
    """Eq. 1 holds after the distortion has been corrected, not before."""
    point = np.array([[0.5, 0.3, 1.0]])
    as_seen = project(WIDE, point)
    pinhole_pixel = point[:, :2] / point[:, 2:] * 280 + [319.5, 239.5]
    assert np.abs(as_seen - pinhole_pixel).max() > 5
    np.testing.assert_allclose(undistort(WIDE, as_seen), pinhole_pixel, atol=1e-9)


def test_points_that_are_not_in_front_project_to_nan():
    points = np.array([[0.1, 0.2, -1.0], [0.1, 0.2, 0.0], [np.nan, 0, 1], [0, 0, np.nan]])
    assert np.isnan(project(WIDE, points)).any(axis=1).all()
    assert np.isnan(project_jacobians(WIDE, points)[0]).any(axis=1).all()
    assert np.isfinite(project(WIDE, np.array([0.1, 0.2, 1e-9]))).all()


def test_pixels_beyond_the_fold_of_the_distortion_normalise_to_nan():
    camera = pinhole(640, 480, 280.0, (-0.3, 0, 0, 0, 0))
    # r (1 - 0.3 r^2) rises up to r = 1.054, where it is 0.703: 197 px from the centre.
    centre = np.array([319.5, 239.5])
    inside = centre + np.array([[196.0, 0], [0, 190.0]])
    # From 300 px on, the polynomial comes back on the far side of the fold with its sign turned.
    outside = centre + np.array([[198.0, 0], [0, 250.0], [300, 0], [-600, 500]])
    assert np.isfinite(normalise(camera, inside)).all()
    assert np.isnan(normalise(camera, outside)).all()
    assert np.isnan(undistort(camera, outside)).all()


def test_a_polynomial_that_rises_again_beyond_its_fold_is_not_followed_there():
    camera = pinhole(640, 480, 280.0, (-0.6, 0.12, 0, 0, 0))
    # Rises up to r = 0.858, where it is 0.535, falls, and rises again from r = 1.505.
    xy = np.stack([np.linspace(0, 3, 301), np.zeros(301)], axis=-1)
    pixels = project(camera, np.concatenate([xy, np.ones((301, 1))], axis=1))
    found = normalise(camera, pixels)
    np.testing.assert_allclose(found[:85], xy[:85], atol=1e-9)
    reached = np.linalg.norm(found, axis=1)
    assert np.nanmax(reached) < 0.859
    assert np.isnan(reached[pixels[:, 0] > 319.5 + 0.536 * 280]).all()


def test_the_middle_of_the_image_lies_between_the_middle_pixels():
    camera = pinhole(640, 480, (280.0, 300.0))
    np.testing.assert_array_equal(project(camera, np.array([0.0, 0.0, 1.0])), [319.5, 239.5])
    xy = normalise(camera, np.array([319.5 + 28, 239.5 - 30]))
    np.testing.assert_allclose(xy, [0.1, -0.1], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"matrix": np.eye(2)}, "expected 3 x 3 numbers, found 2 x 2"),
        ({"matrix": -np.eye(3)}, "focal lengths are positive"),
        ({"matrix": [[300, 0, 319], [1, 300, 239], [0, 0, 1]]}, "matrix has rows"),
        ({"matrix": [[300, 0, 319], [0, 300, 239], [0, 0, 2]]}, "matrix has rows"),
        ({"matrix": np.full((3, 3), np.nan)}, "NaN"),
        ({"distortion": np.zeros(4)}, "5 coefficients, found 4"),
        ({"distortion": ["a"] * 5}, "expected n numbers"),
        ({"width": 0}, "greater than 0"),
        ({"skew": 1.0}, "skew"),
    ],
)
def test_an_impossible_camera_is_refused(change: dict, says: str):
    valid = {"width": 640, "height": 480, "matrix": np.eye(3) * [280.0, 280.0, 1.0]}
    Camera(**valid)
    with pytest.raises(ValidationError, match=says):
        Camera(**(valid | change))


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_a_lens_without_distortion_need_not_say_so(model: CameraModel):
    camera = Camera(640, 480, np.diag([300.0, 300, 1]), model=model)
    assert camera.distortion.tolist() == [0.0] * len(COEFFICIENTS[model])
    with pytest.raises(ValueError, match="read-only"):
        camera.distortion[0] = 1


def test_a_camera_cannot_be_changed_behind_its_back():
    matrix = np.diag([280.0, 280.0, 1.0])
    camera = Camera(width=640, height=480, matrix=matrix)
    matrix[0, 0] = 1
    assert camera.matrix[0, 0] == 280
    with pytest.raises(ValueError, match="read-only"):
        camera.matrix[0, 0] = 1
