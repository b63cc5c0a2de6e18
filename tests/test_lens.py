"""Every lens model: projection, its inverse and derivatives; OpenCV as the yardstick."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vergence.geometry.camera import (
    Camera,
    intrinsics_names,
    normalise,
    pinhole,
    pixel_area,
    project,
    project_jacobians,
    unproject,
)
from vergence.geometry.lens import COEFFICIENTS, CameraModel, reach
from vergence.geometry.parameters import lens_of_vector, lens_vector

seeds = st.integers(0, 2**32 - 1)
models = st.sampled_from(["radial-tangential", "rational", "fisheye"])


def random_lens(model: CameraModel, rng: np.random.Generator, *, skew: bool = True) -> Camera:
    """Return a wide camera."""
    k = {
        "radial-tangential": [-0.1, 0.01, 0, 0, 0.01],
        "rational": [0.3, 0.02, 0, 0, 0.001, 0.45, 0.06, 0.002],
        "fisheye": [0.0, 0.0, 0.0, 0.0],
    }[model]
    std = {"fisheye": [0.02, 0.01, 0.003, 0.001]}.get(model, 5e-4)
    f = rng.uniform(280, 350)
    matrix = np.array([[f, 0, rng.normal(320, 5)], [0, 1.01 * f, rng.normal(240, 5)], [0, 0, 1]])
    matrix[0, 1] = rng.normal() * skew
    return Camera(640, 480, matrix, np.array(k) + rng.normal(0, std, len(k)), model)


def in_view(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Return points (30, 3) in frame cam, spread over the image out to its corners."""
    pixels = rng.uniform([0, 0], [639, 479], (30, 2))
    pixels[:4] = [[0, 0], [639, 0], [0, 479], [639, 479]]
    pixels[4] = camera.matrix[:2, 2]
    points = unproject(camera, pixels)
    points = points[np.isfinite(points).all(axis=1)]
    return points * rng.uniform(0.2, 3, (len(points), 1))


@pytest.mark.parametrize(
    "k", [(-0.28, 0.07, 0, 0, -0.006), (-0.35, 0.15, 1e-3, 0, -0.03), (0.3, 0.1, 0, 0, 0)]
)
def test_a_lens_is_inverted_out_to_where_it_folds_over_or_to_60_degrees(k):
    camera = pinhole(640, 480, 220.0, k)
    farthest = np.sqrt(reach(camera.model, camera.coefficients))
    r = np.linspace(0, 0.998 * farthest if np.isfinite(farthest) else np.tan(np.pi / 3), 200)
    for angle in (0.0, 0.7, 2.0):
        xy = r[:, None] * [np.cos(angle), np.sin(angle)]
        pixels = project(camera, np.column_stack([xy, np.ones(len(r))]))
        np.testing.assert_allclose(normalise(camera, pixels), xy, rtol=1e-9, atol=1e-12)


@given(seeds, models)
def test_normalise_undoes_project_out_to_the_corners(seed: int, model: CameraModel):
    rng = np.random.default_rng(seed)
    camera = random_lens(model, rng)
    points = in_view(camera, rng)
    assert len(points) > 25
    pixels = project(camera, points)
    xy = normalise(camera, pixels)
    expected = points[:, :2] / points[:, 2:]
    np.testing.assert_allclose(xy, expected, rtol=1e-9, atol=1e-12)


@given(seeds, models)
def test_every_lens_agrees_with_opencv(seed: int, model: CameraModel):
    rng = np.random.default_rng(seed)
    camera = random_lens(model, rng, skew=False)  # OpenCV knows none
    points = in_view(camera, rng)
    if model == "fisheye":
        expected, _ = cv2.fisheye.projectPoints(
            points[:, None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
        )
    else:
        expected, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
        )
    np.testing.assert_allclose(project(camera, points), expected.reshape(-1, 2), atol=1e-9)


@given(seeds, models)
def test_the_jacobians_of_every_lens_agree_with_differences(seed: int, model: CameraModel):
    rng = np.random.default_rng(seed)
    camera = random_lens(model, rng)
    points = in_view(camera, rng)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    pixels, by_point, by_lens = project_jacobians(camera, points)
    np.testing.assert_allclose(pixels, project(camera, points), atol=1e-12)
    h = 1e-6
    for axis, step in enumerate(np.eye(3) * h):
        slope = (project(camera, points + step) - project(camera, points - step)) / (2 * h)
        np.testing.assert_allclose(by_point[..., axis], slope, rtol=1e-5, atol=1e-4)
    n = len(intrinsics_names(camera))
    assert by_lens.shape[-1] == n
    for k, step in enumerate(np.eye(n) * h):
        ahead, behind = (lens_of_vector(camera, lens_vector(camera) + s * step) for s in (1, -1))
        slope = (project(ahead, points) - project(behind, points)) / (2 * h)
        np.testing.assert_allclose(by_lens[..., k], slope, rtol=1e-5, atol=1e-4)


@given(seeds, models)
def test_the_area_of_a_pixel_is_the_determinant_of_normalise(seed: int, model: CameraModel):
    rng = np.random.default_rng(seed)
    camera = random_lens(model, rng)
    pixels = rng.uniform([150, 100], [490, 380], (10, 2))
    h = 1e-3
    sides = [
        (normalise(camera, pixels + step) - normalise(camera, pixels - step)) / (2 * h)
        for step in np.eye(2) * h
    ]
    area = np.linalg.det(np.stack(sides, axis=-1))
    np.testing.assert_allclose(pixel_area(camera, normalise(camera, pixels)), area, rtol=1e-6)


def test_directions_beyond_90_degrees_are_not_supported():
    camera = pinhole(1000, 1000, 200.0, model="fisheye")
    assert np.isnan(project(camera, np.array([1.0, 0.0, -0.1]))).all()
    beyond = np.array([499.5 + 200 * np.pi / 2 + 0.01, 499.5])
    assert np.isnan(normalise(camera, beyond)).all()
    assert np.isfinite(normalise(camera, beyond - [0.02, 0])).all()


def test_a_fisheye_lens_that_folds_has_no_direction_beyond():
    camera = pinhole(640, 480, 300.0, (-0.3, 0.0, 0.0, 0.0), model="fisheye")
    turn = np.sqrt(1 / 0.9)  # where 1 - 0.9 t^2 is zero
    assert reach("fisheye", (-0.3, 0.0, 0.0, 0.0)) == pytest.approx(np.tan(turn) ** 2)
    largest = 300 * turn * (1 - 0.3 * turn**2)
    across = np.array([[319.5 + largest + s, 239.5] for s in (-0.1, 0.1)])
    assert np.isfinite(normalise(camera, across)).all(axis=1).tolist() == [True, False]


def test_a_rational_lens_ends_where_it_folds_or_has_a_pole():
    fold = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)  # r / (1 + r^2) rises up to r = 1
    assert reach("rational", fold) == pytest.approx(1)
    pole = (0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0)  # 1 - r^2 / 4 is zero at r = 2
    assert reach("rational", pole) == pytest.approx(4)
    camera = pinhole(640, 480, 400.0, fold, model="rational")
    across = np.array([[319.5 + 400 * s, 239.5] for s in (0.49, 0.51)])
    assert np.isfinite(normalise(camera, across)).all(axis=1).tolist() == [True, False]


@pytest.mark.parametrize("model", COEFFICIENTS)
@pytest.mark.parametrize("count", [3, 6, 9])
def test_another_number_of_coefficients_is_refused(model: CameraModel, count: int):
    n = len(COEFFICIENTS[model])
    with pytest.raises(ValidationError, match=f"has {n} coefficients, found {count}; those of a"):
        Camera(640, 480, np.diag([280.0, 280.0, 1.0]), np.zeros(count), model)


def test_an_unknown_lens_model_is_refused():
    with pytest.raises(ValidationError, match="fisheye"):
        Camera(640, 480, np.diag([280.0, 280.0, 1.0]), np.zeros(5), "mirror")
