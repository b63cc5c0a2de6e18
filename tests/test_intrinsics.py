"""One camera from views of a flat board."""

import numpy as np
import pytest

from vergence.calibration.sequential.intrinsics import calibrate_camera
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, project
from vergence.geometry.se3 import pose, rotation, transform

POINTS = corner_points(Chessboard(9, 6, 0.03))
SIZE = (640, 480)
SINGLE_PRECISION_PX = 3e-5
"""OpenCV calibrates from corners in single precision, which steps by 6e-5 px beyond 512 px: root
mean square residuals of exact corners stay below this, and what follows errs accordingly."""
SINGLE_PRECISION_LENS = 10 * SINGLE_PRECISION_PX
"""Of focal lengths and principal points [px]."""
SINGLE_PRECISION_POSE = 1e-6
"""Of poses [rad, m]: such residuals at focal lengths of some hundred pixels."""


def boards(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return T_cam_target (n, 4, 4) of boards before a camera."""
    turn = pose(rotation(rng.uniform(-0.6, 0.6, (n, 3))))
    where = pose(t=rng.uniform([-0.12, -0.08, 0.3], [0.12, 0.08, 0.6], (n, 3)))
    return where @ turn @ pose(t=-POINTS.mean(axis=0))


def lens(rng: np.random.Generator, *free: int) -> Camera:
    """Return a camera with the given distortion coefficients, others zero."""
    f = rng.uniform(250, 450)
    matrix = np.array([[f, 0, rng.normal(320, 8)], [0, f * 1.01, rng.normal(240, 8)], [0, 0, 1]])
    distortion = np.zeros(5)
    distortion[list(free)] = np.array([-0.12, 0.02, 5e-4, -5e-4, 0])[list(free)]
    return Camera(*SIZE, matrix, distortion)


def views(camera: Camera, T_cam_target: np.ndarray) -> np.ndarray:
    return project(camera, transform(T_cam_target[:, None], POINTS))


@pytest.mark.parametrize(
    ("model", "free"),
    [("none", ()), ("k1", (0,)), ("k1k2", (0, 1)), ("radial-tangential", (0, 1, 2, 3))],
)
def test_exact_corners_give_the_exact_camera(model, free: tuple[int, ...]):
    """Eqs. 1-2, with each lens model."""
    rng = np.random.default_rng(4)
    camera = lens(rng, *free)
    found = calibrate_camera(views(camera, boards(10, rng)), POINTS, size=SIZE, lens_model=model)
    np.testing.assert_allclose(found.camera.matrix, camera.matrix, atol=SINGLE_PRECISION_LENS)
    np.testing.assert_allclose(found.camera.distortion, camera.distortion, atol=1e-5)
    assert found.rms_px < SINGLE_PRECISION_PX
    assert found.views == 10


def test_corners_that_were_not_seen_are_left_out():
    rng = np.random.default_rng(5)
    camera = lens(rng, 0, 1, 2, 3)
    corners = views(camera, boards(12, rng))
    corners[rng.uniform(size=corners.shape[:2]) < 0.3] = np.nan
    corners[3], corners[7, 3:] = np.nan, np.nan
    found = calibrate_camera(corners, POINTS, size=SIZE, lens_model="radial-tangential")
    np.testing.assert_allclose(found.camera.matrix, camera.matrix, atol=SINGLE_PRECISION_LENS)
    assert found.views == 10


@pytest.mark.parametrize("usable", [0, 2])
def test_too_few_views_are_refused(usable: int):
    rng = np.random.default_rng(8)
    corners = views(lens(rng), boards(5, rng))
    corners[usable:, 3:] = np.nan
    with pytest.raises(VergenceError, match=f"at least 3 views of the board, found {usable}"):
        calibrate_camera(corners, POINTS, size=SIZE, lens_model="none")


def test_the_residual_is_the_noise_and_the_stated_deviation_of_the_focal_length_is_true():
    rng = np.random.default_rng(13)
    camera = lens(rng)
    exact = views(camera, boards(8, rng))
    off, stated = [], []
    for _ in range(20):
        noisy = exact + rng.normal(0, 0.2, exact.shape)
        found = calibrate_camera(noisy, POINTS, size=SIZE, lens_model="none")
        assert found.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
        off.append(found.camera.matrix[[0, 1], [0, 1]] - camera.matrix[[0, 1], [0, 1]])
        stated.append(found.focal_std_px)
    # The deviation of twenty is known to a sixth.
    np.testing.assert_allclose(
        np.sqrt(np.mean(np.square(off), axis=0)), np.mean(stated, 0), rtol=0.5
    )


@pytest.mark.parametrize("model", ["none", "radial-tangential"])
def test_boards_that_all_face_the_camera_tell_no_focal_length(model):
    rng = np.random.default_rng(14)
    camera = lens(rng)
    facing = pose(rotation(rng.uniform(-1, 1, (8, 1)) * [0, 0, 1.0]))
    facing[:, :3, 3] = rng.uniform([-0.1, -0.1, 0.4], [0.0, 0.0, 0.8], (8, 3))
    corners = views(camera, facing) + rng.normal(0, 0.1, (8, len(POINTS), 2))
    with pytest.raises(VergenceError, match=r"fx and fy are not observable.*slant the board by 20"):
        calibrate_camera(corners, POINTS, size=SIZE, lens_model=model)
