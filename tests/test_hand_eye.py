"""T_eye_cam by Park and Martin: Eqs. 5-9, their misprints, degenerate motion, noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hand_eye_monte_carlo import Config, simulate
from simulated_head import R_EYE_CAM, pan_tilt_pose, random_pose
from simulated_recording import POINTS
from vergence.calibration.hand_eye import motion_pairs, park_martin, solve_rotation
from vergence.errors import VergenceError
from vergence.geometry.camera import pinhole
from vergence.geometry.se3 import angle, boxminus, hat, inverse, pose, rotation, rotvec
from vergence.vision.board_pose import board_poses

seeds = st.integers(0, 2**32 - 1)
T_BASE_TARGET = pose(R_EYE_CAM @ rotation([0.2, -0.3, 0.1]), [0.6, 0.1, 0.05])


def mounted(rng: np.random.Generator) -> np.ndarray:
    """Return a T_eye_cam a few degrees and millimetres off the design."""
    return random_pose(rng, 0.06, 0.003) @ pose(R_EYE_CAM, [0.02, 0, 0.01])


def views(X: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return T_base_eye and T_cam_target (20, 4, 4) of a panning and tilting eye."""
    eyes = pan_tilt_pose(rng.uniform(-0.25, 0.25, (20, 2)))
    return eyes, inverse(eyes @ X) @ T_BASE_TARGET


def assert_same(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


# The equations one by one


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def X(rng: np.random.Generator) -> np.ndarray:
    return mounted(rng)


def test_the_printed_equation_5_says_that_the_board_never_moves(X, rng):
    """Eq. 5: printed with j where 0 belongs, its right side is the identity for every X."""
    T_er, T_co = views(X, rng)
    printed_right = X @ T_er @ inverse(T_er) @ inverse(X)
    assert_same(printed_right, np.broadcast_to(np.eye(4), printed_right.shape))
    printed_left = inverse(T_co[0]) @ T_co
    assert (angle(printed_left[1:, :3, :3]) > 0.01).all()


@pytest.mark.parametrize("sense", ["camera in eye", "eye in camera"])
def test_equation_5_fails_with_the_index_mended_alone(X, rng, sense):
    """Eq. 5: with 0 for j, it still fails for both senses of T_ec: the board's poses, too, stand
    in the opposite sense."""
    T_er, T_co = views(X, rng)
    T_ec = X if sense == "camera in eye" else inverse(X)
    left = inverse(T_co[0]) @ T_co
    right = T_ec @ T_er[0] @ inverse(T_er) @ inverse(T_ec)
    assert (np.abs(left - right)[1:].max(axis=(1, 2)) > 0.01).all()


@given(seeds)
def test_equations_5_and_6_hold_in_the_consistent_form(seed: int):
    """Eqs. 5-6: A X = X B with X = T_eye_cam, A of the eye and B of the camera, all pairs."""
    rng = np.random.default_rng(seed)
    X = mounted(rng)
    A, B = motion_pairs(*views(X, rng))
    assert A.shape == (190, 4, 4)
    assert_same(A @ X, X @ B)


def test_equations_5_and_6_fail_with_the_eye_in_the_camera(X: np.ndarray, rng: np.random.Generator):
    """Eq. 6: with X = T_cam_eye, the sense that Eq. 5 prints, A X = X B fails."""
    A, B = motion_pairs(*views(X, rng))
    wrong = inverse(X)
    assert np.median(np.abs(A @ wrong - wrong @ B).max(axis=(1, 2))) > 0.1


@given(seeds)
def test_equation_7_holds_the_other_way_round(seed: int):
    """Eq. 7: a = R_X b, where the printed form has R_X a = b."""
    rng = np.random.default_rng(seed)
    X = mounted(rng)
    A, B = motion_pairs(*views(X, rng))
    a, b, R_X = rotvec(A[:, :3, :3]), rotvec(B[:, :3, :3]), X[:3, :3]
    assert_same(b @ R_X.T, a)
    assert np.median(np.linalg.norm(a @ R_X.T - b, axis=1)) > 0.1
    # The relation of the logarithms that leads to it, likewise: [a] = R_X [b] R_X^T.
    assert_same(R_X @ hat(b) @ R_X.T, hat(a))


@given(seeds)
def test_equation_8_holds_as_printed(seed: int):
    """Eq. 8: (I - R_A) t_X = t_A - R_X t_B."""
    rng = np.random.default_rng(seed)
    X = random_pose(rng)
    A = np.array([random_pose(rng) for _ in range(5)])
    B = inverse(X) @ A @ X
    left = (np.eye(3) - A[:, :3, :3]) @ X[:3, 3]
    assert_same(left, A[:, :3, 3] - B[:, :3, 3] @ X[:3, :3].T)


def equation_9(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (M^T M)^(-1/2) M^T with M = sum b a^T, letter by letter."""
    M = sum(np.outer(b_j, a_j) for a_j, b_j in zip(a, b, strict=True))
    values, vectors = np.linalg.eigh(M.T @ M)
    return vectors @ np.diag(values**-0.5) @ vectors.T @ M.T


@given(seeds)
def test_equation_9_solves_the_consistent_equation_7_and_not_the_printed_one(seed: int):
    """Eq. 9 is right for a = R_X b; where R_X a = b, as printed, it returns the transpose."""
    rng = np.random.default_rng(seed)
    R_X = random_pose(rng)[:3, :3]
    b = rng.normal(size=(10, 3))
    assert_same(equation_9(b @ R_X.T, b), R_X, 1e-10)
    assert_same(equation_9(b, b @ R_X.T), R_X.T, 1e-10)


@given(seeds)
def test_our_rotation_is_that_of_equation_9(seed: int):
    """Eq. 9: the singular value decomposition gives the same, also from noisy vectors."""
    rng = np.random.default_rng(seed)
    R_X = random_pose(rng)[:3, :3]
    b = rng.normal(size=(10, 3))
    a = b @ R_X.T + rng.normal(0, 0.05, b.shape)
    assert_same(solve_rotation(a, b), equation_9(a, b), 1e-9)


def test_equation_9_minimises_the_errors_of_equation_7(rng: np.random.Generator):
    """Eq. 9: no small turn of its solution has a smaller sum of squares."""
    b = rng.normal(size=(30, 3))
    a = b @ random_pose(rng)[:3, :3].T + rng.normal(0, 0.1, b.shape)

    def cost(R: np.ndarray) -> float:
        return float(((a - b @ R.T) ** 2).sum())

    R_X = solve_rotation(a, b)
    assert all(cost(R_X) < cost(R_X @ rotation(d)) for d in 0.01 * rng.normal(size=(50, 3)))


def test_two_axes_determine_the_rotation(rng: np.random.Generator):
    """Eq. 9 as printed is singular for exactly two axes; handedness supplies the third."""
    R_X = random_pose(rng)[:3, :3]
    b = np.array([[0.3, 0, 0], [0, 0.2, 0], [-0.1, 0.1, 0]])
    assert_same(solve_rotation(b @ R_X.T, b), R_X)


# The estimator


@given(seeds)
def test_exact_views_give_the_exact_pose(seed: int):
    """Eqs. 5-9 on exact data."""
    rng = np.random.default_rng(seed)
    X = mounted(rng)
    assert_same(park_martin(*views(X, rng)), X)


@pytest.mark.parametrize("moving", [(1, 0), (0, 1), (0, 0)])
def test_turning_about_one_axis_or_none_is_refused(X: np.ndarray, moving: tuple[int, int]):
    eyes = pan_tilt_pose(np.linspace(-0.25, 0.25, 10)[:, None] * moving)
    with pytest.raises(VergenceError, match=r"share one axis.*both pans and tilts"):
        park_martin(eyes, inverse(eyes @ X) @ T_BASE_TARGET)


def test_two_views_are_refused():
    with pytest.raises(VergenceError, match=r"at least 3 views.*found 2"):
        park_martin(np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (2, 1, 1)))


@pytest.mark.parametrize(
    ("joint_deg", "expected_deg", "expected_mm"),
    [(0.0, 0.038, 0.30), (0.3, 0.237, 0.44)],
)
def test_noise_leaves_the_errors_that_the_method_is_known_for_and_no_bias(
    joint_deg: float, expected_deg: float, expected_mm: float
):
    """Median errors of 20 views within 0.25 rad, corners with 0.1 px, a board at 0.4 m.

    A factor of two, since those figures do not state how far away the board was.
    """
    config = Config(focal_px=280, distance_m=0.4, columns=9, square_m=0.03)
    rng, camera = np.random.default_rng(17), pinhole(640, 480, config.focal_px)
    errors = []
    for _ in range(40):
        X, readings, corners = simulate(config, POINTS, np.radians(joint_deg), rng)
        found = park_martin(pan_tilt_pose(readings), board_poses(camera, corners, POINTS))
        errors.append(boxminus(found, X))
    turn = np.degrees(np.linalg.norm(np.array(errors)[:, :3], axis=1))
    shift = 1e3 * np.linalg.norm(np.array(errors)[:, 3:], axis=1)
    assert expected_deg / 2 < np.median(turn) < 2 * expected_deg
    assert expected_mm / 2 < np.median(shift) < 2 * expected_mm
    standard_error = np.std(errors, axis=0) / np.sqrt(len(errors))
    assert (np.abs(np.mean(errors, axis=0)) < 3.5 * standard_error).all(), "biased"
