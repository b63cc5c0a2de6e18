"""Stereo with moving eyes: Eqs. 3-4 and 10-12, and their misprints."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from simulated_head import plain_head, point_in_camera, skewed_head
from vergence.geometry.camera import pinhole, project
from vergence.geometry.head import HeadCalibration, base_pose_in_body, camera_pose_in_base
from vergence.geometry.kinematics import eye_pose
from vergence.geometry.lens import CameraModel
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.extrinsics import base_extrinsics, relative_camera_pose
from vergence.stereo.triangulation import Status, in_body, in_head, triangulate_at
from vergence.stereo.uncertainty import locate

seeds = st.integers(0, 2**32 - 1)


def random_samples(
    head: HeadCalibration, rng: np.random.Generator, n: int, lens: str = "wide"
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return n points (n, 3) before the head, eye angles (n, 4) and pixels (n, 2) of both eyes."""
    points = rng.uniform([0.3, -0.1, -0.1], [1.5, 0.1, 0.1], (n, 3))
    eyes = rng.uniform(-0.25, 0.25, (n, 4))
    left, right = (project_point(head, f"{eye}_{lens}", eyes, points) for eye in ("left", "right"))
    return points, eyes, left, right


@pytest.mark.parametrize("lens", ["wide", "narrow"])
@given(seeds)
@settings(max_examples=25)
def test_exact_pixels_and_readings_give_the_exact_point(lens: str, seed: int):
    """Eqs. 3, 4, 10, 11, 12 together, for heads with every imperfection that is calibrated."""
    rng = np.random.default_rng(seed)
    head, cameras = skewed_head(rng), (f"left_{lens}", f"right_{lens}")
    points, eyes, left, right = random_samples(head, rng, 20, lens)
    located = locate(head, left=left, right=right, joints=eyes, cameras=cameras)
    assert (located.status == Status.OK).all()
    np.testing.assert_allclose(located.xyz, points, atol=1e-9)


def test_one_posture_serves_all_points():
    rng = np.random.default_rng(3)
    head, points = skewed_head(rng), np.array([[0.5, 0.03, 0.02], [0.8, -0.05, 0.1], [1.2, 0, 0]])
    posture = rng.uniform(-0.2, 0.2, 4)
    left, right = (
        project_point(head, name, posture, points) for name in ("left_wide", "right_wide")
    )
    stds = {"pixel_std_px": 0.1, "reading_std": 1e-3}
    one = locate(head, left=left, right=right, joints=posture, **stds)
    tiled = locate(head, left=left, right=right, joints=np.tile(posture, (3, 1)), **stds)
    np.testing.assert_allclose(one.xyz, points, atol=1e-9)
    np.testing.assert_allclose(one.xyz, tiled.xyz, atol=1e-15)
    np.testing.assert_allclose(one.covariance, tiled.covariance, rtol=1e-12)
    nowhere = locate(head, left=left, right=right, joints=posture * [1, 1, np.nan, 1])
    assert (nowhere.status == Status.NOT_SEEN).all()


@pytest.mark.parametrize(
    ("model", "k"),
    [
        ("radial-tangential", (-0.12, 0.02, 0.0005, -0.0005, 0.0)),
        ("rational", (0.1, 0.02, 1e-3, -1e-3, 0.01, 0.05, 0.01, 0.002)),
        ("fisheye", (0.02, -0.01, 0.003, 0.0)),
    ],
)
def test_a_point_alone_is_located_as_it_is_among_others(model: CameraModel, k: tuple[float, ...]):
    """Single points are computed in numbers, many on arrays; wrong ones give no exceptions."""
    rng = np.random.default_rng(4)
    lens = pinhole(640, 480, 300.0, k, model=model)
    head = skewed_head(rng)
    cameras = {name: replace(own, intrinsics=lens) for name, own in head.cameras.items()}
    head = replace(head, cameras=cameras)
    _, eyes, left, right = random_samples(head, rng, 8)
    left, right = left + rng.normal(0, 0.2, left.shape), right + rng.normal(0, 0.2, right.shape)
    left[0], left[1], right[2], eyes[3, 1] = np.nan, 1e6, left[2] + [300, 0], np.inf
    stds = {"pixel_std_px": 0.1, "reading_std": 1e-3}
    together = locate(head, left=left, right=right, joints=eyes, **stds)
    expected = [Status.NOT_SEEN, Status.NOT_SEEN, Status.BEHIND, Status.NOT_SEEN, *[Status.OK] * 4]
    assert together.status.tolist() == expected
    for i in range(8):
        alone = locate(head, left=left[i : i + 1], right=right[i : i + 1], joints=eyes[i], **stds)
        assert alone.status[0] == together.status[i]
        np.testing.assert_allclose(alone.xyz[0], together.xyz[i], atol=1e-12)
        np.testing.assert_allclose(alone.covariance[0], together.covariance[i], rtol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_noisy_pixels_give_the_most_likely_point(seed: int):
    """By the noise of each coordinate, through lenses with skew: the least sum of squares."""
    rng = np.random.default_rng(seed)
    head, pixel_std_px = skewed_head(rng), 0.1 * np.array([0.3, 1.0, 0.6, 0.1])
    points, eyes, *exact = random_samples(head, rng, 3)
    noisy = [
        each + rng.normal(0, std, each.shape)
        for each, std in zip(exact, (pixel_std_px[:2], pixel_std_px[2:]), strict=True)
    ]
    left, right = noisy
    found, _ = triangulate_at(head, left=left, right=right, joints=eyes, pixel_std_px=pixel_std_px)

    def misfit(point: np.ndarray, k: int) -> np.ndarray:
        seen = [project_point(head, f"{eye}_wide", eyes[k], point) for eye in ("left", "right")]
        return (np.concatenate(seen) - np.concatenate([left[k], right[k]])) / pixel_std_px

    for k, point in enumerate(found):
        best = least_squares(misfit, point, args=(k,), xtol=1e-15, ftol=1e-15, x_scale=1e-3).x
        # Equal to first order: points differ by the square of the noise.
        assert np.linalg.norm(point - best) < 1e-3 * np.linalg.norm(best - points[k])


# The equations one by one, and their misprints


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


@pytest.fixture
def head(rng: np.random.Generator) -> HeadCalibration:
    return skewed_head(rng, distorted=False)


def stereo_pose(head: HeadCalibration, eyes: np.ndarray) -> np.ndarray:
    """Return T_rcam_lcam (N, 4, 4), straight from the poses of the two cameras."""
    T_lbase_lcam = camera_pose_in_base(head, "left_wide", eyes)
    T_rbase_rcam = camera_pose_in_base(head, "right_wide", eyes)
    return inverse(T_rbase_rcam) @ head.T_rbase_lbase @ T_lbase_lcam


def test_equation_3_needs_the_scale_that_the_printed_form_omits(head, rng):
    """Eq. 3: s u = A y; printed without s, which holds at depth 1 only."""
    points, eyes, left, _ = random_samples(head, rng, 10)
    y_l = point_in_camera(head, "left_wide", eyes, points)
    right_side = y_l @ head.cameras["left_wide"].intrinsics.matrix.T
    homogeneous = np.concatenate([left, np.ones((10, 1))], axis=1)
    np.testing.assert_allclose(y_l[:, 2:] * homogeneous, right_side, atol=1e-9)
    assert (np.abs(homogeneous - right_side).max(axis=1) > 0.1).all()


def test_equation_4_maps_from_the_left_camera_to_the_right_one(head, rng):
    """Eq. 4: s u_r = A_r T_rcam_lcam y_l.

    Printed T_c^l has lost its r, and the prose has it map from right to left, which misses.
    """
    points, eyes, _, right = random_samples(head, rng, 10)
    y_l = point_in_camera(head, "left_wide", eyes, points)
    T_rcam_lcam = stereo_pose(head, eyes)
    camera = head.cameras["right_wide"].intrinsics
    np.testing.assert_allclose(project(camera, transform(T_rcam_lcam, y_l)), right, atol=1e-9)
    printed = project(camera, transform(inverse(T_rcam_lcam), y_l))
    assert (np.abs(printed - right).max(axis=1) > 10).all()


def equation_10_terms(head: HeadCalibration, eyes: np.ndarray) -> dict[str, np.ndarray]:
    """Return what Eqs. 10-11 are made of, at eye angles (N, 4)."""
    return {
        "T_rbase_reye": eye_pose(head.kinematics, "right", eyes),
        "T_reye_rcam": head.cameras["right_wide"].T_eye_cam,
        "T_leye_lcam": head.cameras["left_wide"].T_eye_cam,
        "T_lbase_leye": eye_pose(head.kinematics, "left", eyes),
    }


def test_equation_10_gives_the_same_wherever_the_eyes_look(head, rng):
    """Eq. 10 holds as printed: T_rbase_lbase is constant, whatever theta_0 was."""
    eyes = rng.uniform(-0.25, 0.25, (20, 4))
    T = base_extrinsics(T_rcam_lcam=stereo_pose(head, eyes), **equation_10_terms(head, eyes))
    np.testing.assert_allclose(T, np.broadcast_to(head.T_rbase_lbase, T.shape), atol=1e-14)


def test_equation_10_needs_the_camera_in_the_eye_and_not_the_eye_in_the_camera(head, rng):
    """Eq. 10: with T_ec in the sense that Eqs. 5 and 11 print, nothing is constant."""
    eyes = rng.uniform(-0.25, 0.25, (20, 4))
    terms = equation_10_terms(head, eyes)
    terms |= {name: inverse(terms[name]) for name in ("T_reye_rcam", "T_leye_lcam")}
    T = base_extrinsics(T_rcam_lcam=stereo_pose(head, eyes), **terms)
    assert np.ptp(T[:, :3, :3], axis=0).max() > 0.1


def composes(*chain: tuple[str, str]) -> bool:
    """Return whether T_a_b, T_b_c, ... have adjacent letters that cancel."""
    return all(left[1] == right[0] for left, right in pairwise(chain))


def test_the_printed_order_of_equation_11_cannot_be_composed():
    """Eq. 11: neither sense of each symbol makes the printed order's letters cancel."""
    T_ec_r, T_e_rl, T_ec_l = ("reye", "rcam"), ("rbase", "lbase"), ("leye", "lcam")
    T_er_l, T_er_r = ("lbase", "leye"), ("rbase", "reye")

    def inv(T: tuple[str, str]) -> tuple[str, str]:
        return T[::-1]

    mended = (inv(T_ec_r), inv(T_er_r), T_e_rl, T_er_l, T_ec_l)
    assert composes(*mended)
    assert (mended[0][0], mended[-1][1]) == ("rcam", "lcam")
    assert composes(T_er_r, T_ec_r, ("rcam", "lcam"), inv(T_ec_l), inv(T_er_l))  # Eq. 10
    printed = (T_ec_r, T_e_rl, inv(T_ec_l), T_er_l, inv(T_er_r), T_ec_l)
    assert not composes(*printed)
    for ec, er, e in product((False, True), repeat=3):
        senses = (ec, e, ec, er, er, ec)
        assert not composes(*(inv(T) if s else T for T, s in zip(printed, senses, strict=True)))


def printed_11(T_rbase_lbase: np.ndarray, terms: dict[str, np.ndarray]) -> np.ndarray:
    return (
        terms["T_reye_rcam"]
        @ T_rbase_lbase
        @ inverse(terms["T_leye_lcam"])
        @ terms["T_lbase_leye"]
        @ inverse(terms["T_rbase_reye"])
        @ terms["T_leye_lcam"]
    )


def test_equation_11_gives_the_static_calibration_back_at_theta_0(head, rng):
    """Eqs. 10-11: mended, Eq. 11 undoes Eq. 10; as printed, it does not even at theta = 0."""
    for eyes in (np.zeros((1, 4)), rng.uniform(-0.1, 0.1, (5, 4))):
        terms = equation_10_terms(head, eyes)
        static = stereo_pose(head, eyes)
        T_rbase_lbase = base_extrinsics(T_rcam_lcam=static, **terms)
        mended = relative_camera_pose(replace(head, T_rbase_lbase=T_rbase_lbase[0]), eyes)
        np.testing.assert_allclose(mended, static, atol=1e-14)
        printed = printed_11(T_rbase_lbase, terms)
        assert (np.abs(printed - static).max(axis=(1, 2)) > 0.5).all()


def test_equation_11_follows_the_eyes(head: HeadCalibration, rng: np.random.Generator):
    """Eq. 11: mended, it maps a point from the left to the right camera wherever the eyes look."""
    points, eyes, *_ = random_samples(head, rng, 20)
    terms = equation_10_terms(head, eyes)
    y_l, y_r = (point_in_camera(head, name, eyes, points) for name in ("left_wide", "right_wide"))
    mended = relative_camera_pose(head, eyes)
    np.testing.assert_allclose(transform(mended, y_l), y_r, atol=1e-13)
    misses = np.linalg.norm(transform(printed_11(head.T_rbase_lbase, terms), y_l) - y_r, axis=1)
    assert (misses > 0.1).all()


def test_equation_12_gives_the_same_body_point_wherever_eyes_and_neck_look(head, rng):
    """Eq. 12: y_b = T_be(neck) T_er(theta) T_ec y_l; with T_ec^-1 the point would wander."""
    in_body_m = np.array([1.0, 0.1, 0.2])
    neck = rng.uniform(-0.1, 0.1, (20, 3))
    eyes = rng.uniform(-0.25, 0.25, (20, 4))
    T_body_lbase = base_pose_in_body(head, "left", neck)
    y_l = point_in_camera(head, "left_wide", eyes, transform(inverse(T_body_lbase), in_body_m))
    T_er, T_ec = eye_pose(head.kinematics, "left", eyes), head.cameras["left_wide"].T_eye_cam
    y_b = transform(T_body_lbase @ T_er @ T_ec, y_l)
    np.testing.assert_allclose(y_b, np.tile(in_body_m, (20, 1)), atol=1e-14)
    wandering = transform(T_body_lbase @ T_er @ inverse(T_ec), y_l)
    assert np.ptp(wandering, axis=0).max() > 0.1


@given(seeds)
def test_locating_in_the_body_is_equation_12(seed: int):
    """Eq. 12, from pixels, eye readings and neck readings to the body."""
    rng = np.random.default_rng(seed)
    head = skewed_head(rng)
    points, eyes, left, right = random_samples(head, rng, 10)
    neck = rng.uniform(-0.5, 0.5, (10, 3))
    expected = transform(base_pose_in_body(head, "left", neck), points)
    located = locate(head, left=left, right=right, joints=eyes)
    np.testing.assert_allclose(in_body(head, located.xyz, neck), expected, atol=1e-9)


def test_the_head_frame_lies_half_a_baseline_to_the_right_of_the_left_eye():
    head = plain_head(0.09, 280.0)
    np.testing.assert_allclose(in_head(head, np.array([[1.0, 0, 0]])), [[1.0, 0.045, 0]])


# What is not a point


def test_nan_is_not_seen_and_leaves_the_others_alone(head, rng):
    points, eyes, left, right = random_samples(head, rng, 5)
    left[0, 1], right[1, 0], eyes[2, 3] = np.nan, np.nan, np.nan
    eyes[3, 0] = np.inf
    located = locate(head, left=left, right=right, joints=eyes)
    assert located.status.tolist() == [Status.NOT_SEEN] * 4 + [Status.OK]
    assert np.isnan(located.xyz[:4]).all()
    np.testing.assert_allclose(located.xyz[4], points[4], atol=1e-9)


@pytest.mark.parametrize(
    ("left_u", "status"),
    [(319.5, Status.PARALLEL), (319.5 + 1e-3, Status.OK), (280.0, Status.BEHIND)],
)
def test_rays_are_called_by_where_they_meet(left_u: float, status: Status):
    """Nowhere; far away, 25 km ahead; behind the head."""
    left, right = np.array([[left_u, 239.5]]), np.array([[319.5, 239.5]])
    located = locate(plain_head(0.09, 280.0), left=left, right=right, joints=np.zeros((1, 4)))
    assert located.status[0] == status
    far = 0.09 * 280 / 1e-3 if status == Status.OK else np.nan
    assert located.xyz[0, 0] == pytest.approx(far, rel=1e-6, nan_ok=True)


@pytest.mark.parametrize(
    ("apart_rad", "status"),
    [
        (3e-12, Status.OK),
        (3e-13, Status.PARALLEL),
        (-3e-13, Status.PARALLEL),
        (-3e-12, Status.BEHIND),
    ],
)
@pytest.mark.parametrize("u", [319.5, 0.0])
def test_rays_are_parallel_up_to_the_same_angle_all_over_the_image(apart_rad, status, u: float):
    """By a very wide lens, so that rays at its edge are 16 times as long as in its middle."""
    focal_px = 20.0
    left = u + focal_px * apart_rad * (1 + ((u - 319.5) / focal_px) ** 2)
    located = locate(
        plain_head(0.09, focal_px),
        left=np.array([[left, 239.5]]),
        right=np.array([[u, 239.5]]),
        joints=np.zeros(4),
    )
    assert located.status.tolist() == [status]


@pytest.mark.parametrize("ahead_m", [(0.0, 0.2), (0.2, 0.0)])
def test_a_point_behind_one_of_the_cameras_is_behind(ahead_m: tuple[float, float]):
    """One camera is mounted farther ahead than where the rays meet."""
    places = np.array([[ahead_m[0], 0.0, 0.0], [ahead_m[1], 0.0, 0.0]])
    head = plain_head(0.09, 280.0, camera_m=[tuple(place) for place in places])
    for x, expected in ((0.1, Status.BEHIND), (0.3, Status.OK)):
        seen = np.array([[x, -0.02, 0.01], [x, 0.07, 0.01]]) - places
        left, right = [319.5, 239.5] - 280.0 * seen[:, None, 1:] / seen[:, None, :1]
        located = locate(head, left=left, right=right, joints=np.zeros(4))
        assert located.status.tolist() == [expected]


def test_a_pixel_beyond_the_lens_is_not_seen():
    head = plain_head(0.09, 280.0)
    barrel = pinhole(640, 480, 280.0, (-0.3, 0, 0, 0, 0))
    mounted = replace(head.cameras["left_wide"], intrinsics=barrel)
    head = replace(head, cameras=head.cameras | {"left_wide": mounted})
    left = np.array([[530.0, 239.5], [619.5, 239.5], [330.0, 239.5]])
    located = locate(
        head, left=left, right=np.tile([319.5, 239.5], (3, 1)), joints=np.zeros((3, 4))
    )
    assert located.status.tolist() == [Status.NOT_SEEN] * 2 + [Status.OK]
