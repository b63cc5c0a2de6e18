"""One camera from views of a flat board."""

from dataclasses import replace

import numpy as np
import pytest

from vergence.calibration.intrinsics import (
    calibrate_camera,
    jackknife_covariance,
)
from vergence.calibration.lens_choice import best_lens, choose_lenses
from vergence.calibration.lenses import fit_lens, fit_model, free_intrinsics
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, normalise, pinhole, pixel_grid, project, unproject
from vergence.geometry.parameters import lens_vector
from vergence.geometry.se3 import pose, rotation, transform
from vergence.vision.board_pose import (
    refined_poses,
    seen_from_the_other_side,
)

POINTS = corner_points(Chessboard(9, 6, 0.03))
SIZE = (640, 480)
FISHEYE = (-0.02, 0.01, -0.004, 0.001)
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


@pytest.mark.parametrize("usable", [0, 2])
def test_too_few_views_are_refused(usable: int):
    rng = np.random.default_rng(8)
    corners = views(lens(rng), boards(5, rng))
    corners[usable:, 3:] = np.nan
    with pytest.raises(VergenceError, match=f"at least 3 views of the board, found {usable}"):
        calibrate_camera(corners, POINTS, size=SIZE, lens_model="none")


@pytest.mark.parametrize("model", ["none", "radial-tangential"])
def test_the_residual_is_the_noise_and_the_stated_deviations_are_true(model):
    rng = np.random.default_rng(13)
    camera = lens(rng) if model == "none" else lens(rng, 0, 1, 2, 3)
    exact = views(camera, boards(12, rng))
    grid = pixel_grid(camera)
    rays = unproject(camera, grid)
    off, stated = [], []
    for _ in range(20):
        noisy = exact + rng.normal(0, 0.2, exact.shape)
        found = calibrate_camera(noisy, POINTS, size=SIZE, lens_model=model)
        assert found.rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
        bent = project(replace(camera, distortion=found.camera.distortion), rays) - grid
        wrong, says = found.camera.matrix - camera.matrix, found.accuracy
        focal, centre = wrong[[0, 1], [0, 1]], wrong[:2, 2]
        relative = focal[0] / camera.matrix[0, 0]
        displaced = np.sqrt((bent**2).sum(axis=1).mean())
        off.append([*focal, relative, np.hypot(*centre), displaced])
        of_centre = np.sqrt(2) * says.centre_px
        stated.append([*found.focal_std_px, says.focal, of_centre, says.distortion_px])
    # The deviation of twenty is known to a sixth.
    np.testing.assert_allclose(
        np.sqrt(np.mean(np.square(off), axis=0)), np.mean(stated, 0), rtol=0.5, atol=1e-9
    )


def test_the_jackknife_is_what_fits_without_each_view_say():
    """To two hundredths: of leaving out a view it takes the first Gauss-Newton step."""
    rng = np.random.default_rng(16)
    camera, T = lens(rng, 0, 1), boards(10, rng)
    corners = views(camera, T) + rng.normal(0, 0.05, (10, len(POINTS), 2))
    free = free_intrinsics("k1k2")
    whole = fit_lens(camera, free, T, corners, POINTS)
    without = []
    for k in range(10):
        rest = np.delete(np.arange(10), k)
        fit = fit_lens(whole.camera, free, whole.T_cam_target[rest], corners[rest], POINTS)
        without.append(lens_vector(fit.camera)[free])
    expected = 9 * np.cov(np.transpose(without), bias=True)
    found = jackknife_covariance(whole.errors, whole.rest)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.02
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


def scattered(camera: Camera, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return corners of boards in all parts of the image, cut off at its edges."""
    pixels = rng.uniform([0, 0], [639, 479], (n, 2))
    xy = normalise(camera, pixels)
    ray = np.concatenate([xy, np.ones((n, 1))], axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    where = pose(t=rng.uniform(0.25, 0.45, (n, 1)) * ray)
    turn = pose(rotation(rng.uniform(-0.6, 0.6, (n, 3))))
    seen = views(camera, where @ turn @ pose(t=-POINTS.mean(axis=0)))
    inside = ((seen > 0) & (seen < [639, 479])).all(axis=-1, keepdims=True)
    return np.where(inside, seen, np.nan)


LENSES = {
    "radial-tangential-k3": pinhole(640, 480, 300.0, (-0.1, 0.02, 1e-3, -1e-3, 0.01)),
    "rational": pinhole(
        640, 480, 300.0, (0.3, 0.02, 5e-4, -5e-4, 0.001, 0.45, 0.06, 0.002), model="rational"
    ),
    "fisheye": pinhole(640, 480, 300.0, (-0.02, 0.01, -0.004, 0.001), model="fisheye"),
}


@pytest.mark.parametrize("model", LENSES)
def test_richer_lenses_are_found_to_double_precision(model):
    camera = LENSES[model]
    corners = scattered(camera, 25, np.random.default_rng(3))
    found = calibrate_camera(corners, POINTS, size=SIZE, lens_model=model)
    assert found.camera.model == camera.model
    # Numerator and denominator of a rational lens nearly cancel.
    atol = 1e-4 if model == "rational" else 1e-7
    np.testing.assert_allclose(found.camera.matrix, camera.matrix, atol=atol)
    np.testing.assert_allclose(found.camera.distortion, camera.distortion, atol=atol)
    assert found.rms_px < 1e-6


def test_a_narrow_camera_is_calibrated_from_views_that_show_parts_of_the_board():
    """Zhang's closed form has its focal length short by a factor of two to four."""
    rng, narrow = np.random.default_rng(22), pinhole(640, 480, 1200.0)
    found: list[np.ndarray] = []
    while len(found) < 25:
        turn, where = (
            rng.uniform(-0.5, 0.5, 3),
            rng.uniform([-0.22, -0.22, 0.35], [0.22, 0.22, 0.9]),
        )
        T = pose(rotation(turn), where) @ pose(t=-POINTS.mean(axis=0))
        pixels = project(narrow, transform(T, POINTS)) + rng.normal(0, 0.5, (len(POINTS), 2))
        pixels[((pixels < 0) | (pixels > [639, 479])).any(axis=1)] = np.nan
        if np.isfinite(pixels[:, 0]).sum() >= 6:
            found.append(pixels)
    lens = calibrate_camera(np.array(found), POINTS, size=SIZE, lens_model="none")
    assert abs(lens.camera.matrix[0, 0] - 1200) < 4 * lens.focal_std_px[0]


@pytest.mark.parametrize("model", ["none", "radial-tangential", *LENSES])
def test_the_lens_that_is_true_is_chosen(model):
    rng = np.random.default_rng(6)
    plain = {"none": (), "radial-tangential": (-0.1, 0.01, 1e-3, -1e-3, 0.0)}
    camera = LENSES.get(model) or pinhole(640, 480, 400.0, plain[model] or None)
    corners = scattered(camera, 30, rng)
    corners += rng.normal(0, 0.1, corners.shape)
    choice = best_lens(corners, POINTS, size=SIZE, otherwise="k1")
    assert choice.model == model
    assert choice.runner_up not in (None, model)
    assert choice.held_out_px[model] == pytest.approx(0.1, rel=0.07)
    again = best_lens(corners, POINTS, size=SIZE, otherwise="k1")
    assert again == choice


def test_a_bent_board_makes_no_fisheye_of_a_lens_without_distortion():
    """By 0.5 mm; by held-out views alone 9 of these 16 were taken for fisheyes."""
    rng, found = np.random.default_rng(13), []
    away = ((POINTS - POINTS.mean(axis=0)) ** 2).sum(axis=1)
    bent = POINTS + np.outer(0.5e-3 * away / away.max(), [0, 0, 1])
    for _ in range(16):
        camera = pinhole(*SIZE, rng.uniform(350, 900))
        seen = project(camera, transform(boards(20, rng)[:, None], bent))
        noisy = seen + rng.normal(0, 0.05, seen.shape)
        found.append(best_lens(noisy, POINTS, size=SIZE, otherwise="k1").model)
    assert set(found) <= {"none", "radial-tangential"}


def observed(corners: dict[str, np.ndarray]) -> Observations:
    V = len(next(iter(corners.values())))
    return Observations(
        board=Chessboard(9, 6, 0.03),
        placement=np.arange(V),
        eye_angles=np.zeros((V, 4)),
        corners=corners,
        sizes=dict.fromkeys(corners, SIZE),
    )


def test_a_lens_is_stated_for_all_cameras_or_by_camera():
    rng = np.random.default_rng(9)
    seen = observed({name: scattered(LENSES["fisheye"], 15, rng) for name in ("one", "two")})
    assert {c.model for c in choose_lenses(seen, "k1").values()} == {"k1"}
    found = choose_lenses(seen, {"one": "rational"})
    assert (found["one"].model, found["one"].held_out_px) == ("rational", {})
    assert found["two"].model == "fisheye"
    with pytest.raises(VergenceError, match="'middle'; the cameras are one, two"):
        choose_lenses(seen, {"middle": "fisheye"})
    with pytest.raises(VergenceError, match="no lens model 'mirror'; there are auto, none"):
        choose_lenses(seen, "mirror")  # pyright: ignore[reportArgumentType]


def test_a_board_found_slanted_the_other_way_is_turned_back():
    rng = np.random.default_rng(10)
    camera = LENSES["radial-tangential-k3"]
    T = boards(12, rng)
    corners = views(camera, T)
    wrong = T.copy()
    wrong[5] = seen_from_the_other_side(T[5:6], POINTS)[0]
    start = camera, refined_poses(camera, corners, POINTS, wrong)[0]
    found = fit_model("radial-tangential-k3", start, corners, POINTS, SIZE)
    np.testing.assert_allclose(found.T_cam_target, T, atol=1e-9)
