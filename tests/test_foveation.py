"""Sec. III: Eqs. 13-19, and the eye angles that centre a point in both eyes."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import plain_head, point_in_camera, skewed_head
from vergence.errors import VergenceError
from vergence.gaze.foveation import (
    foveal_miss,
    gaze_angles,
    ideal_wide_pixel,
    solve_fixation,
)
from vergence.geometry.camera import pinhole, project
from vergence.geometry.head import HeadCalibration, wide_pose_in_narrow
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, pose, transform
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.vision.sphere import find_sphere

SEEDS = range(20)
DEPTHS = np.geomspace(0.15, 50, 40)
FINER = np.array([[4.0, 4, 1], [1, 4, 1], [1, 1, 1]])


def head(seed: int, *, distorted: bool = True) -> HeadCalibration:
    """Return a random head whose two cameras of an eye are 30 mm apart."""
    made = skewed_head(np.random.default_rng(seed), distorted=distorted)
    cameras = {
        name: replace(
            mounted,
            T_eye_cam=pose(t=[0, 0, -0.03]) @ mounted.T_eye_cam,
            intrinsics=replace(mounted.intrinsics, matrix=mounted.intrinsics.matrix * FINER),
        )
        if name.endswith("narrow")
        else mounted
        for name, mounted in made.cameras.items()
    }
    return replace(made, cameras=cameras)


def on_axis(depths: np.ndarray) -> np.ndarray:
    return depths[:, None] * np.array([0.0, 0, 1])


@pytest.mark.parametrize("seed", SEEDS)
def test_equation_13_is_the_inverse_of_the_pose_of_the_wide_camera_in_the_narrow_one(seed: int):
    points = np.random.default_rng(seed).normal(size=(50, 3))
    for eye in EYES:
        T = wide_pose_in_narrow(head(seed), eye)
        R_fp, t_fp = T[:3, :3], T[:3, 3]
        printed = (points - t_fp) @ R_fp  # rows: R_fp^T (y_f - t_fp)
        np.testing.assert_allclose(transform(inverse(T), points), printed, atol=1e-14)


def project_both(made: HeadCalibration, eye: Side, in_narrow: np.ndarray) -> list[np.ndarray]:
    """Eqs. 14-17: project points in the narrow camera's frame into both cameras."""
    in_wide = transform(inverse(wide_pose_in_narrow(made, eye)), in_narrow)
    points = {"narrow": in_narrow, "wide": in_wide}
    return [project(made.camera(f"{eye}_{k}").intrinsics, p) for k, p in points.items()]


@pytest.mark.parametrize("seed", SEEDS)
def test_equations_14_to_17_are_the_projections_of_the_head(seed: int):
    made, rng = head(seed), np.random.default_rng(seed)
    points = rng.uniform([0.3, -0.1, -0.1], [1.5, 0.1, 0.1], (50, 3))
    eyes = rng.uniform(-0.1, 0.1, (50, 4))
    for eye in EYES:
        in_narrow = point_in_camera(made, f"{eye}_narrow", eyes, points)
        for name, pixels in zip(
            (f"{eye}_narrow", f"{eye}_wide"), project_both(made, eye, in_narrow), strict=True
        ):
            exact = project_point(made, name, eyes, points)
            np.testing.assert_allclose(pixels, exact, rtol=0, atol=1e-9)


def test_equations_14_to_19_are_those_printed_once_principal_point_and_distortion_are_off():
    made = head(3, distorted=False)
    x, y, z = 0.05, -0.02, 0.6
    for eye in EYES:
        A_f, A_p = (made.camera(f"{eye}_{c}").intrinsics.matrix for c in ("narrow", "wide"))
        T = wide_pose_in_narrow(made, eye)
        (r1, r2, r3), t = T[:3, :3].T, T[:3, 3]
        d = np.array([x, y, z]) - t
        u_f, v_f = (A_f[0, 0] * x + A_f[0, 1] * y) / z, A_f[1, 1] * y / z
        u_p = (A_p[0, 0] * r1 @ d + A_p[0, 1] * r2 @ d) / (r3 @ d)
        v_p = A_p[1, 1] * r2 @ d / (r3 @ d)
        narrow, wide = project_both(made, eye, np.array([x, y, z]))
        np.testing.assert_allclose(narrow - A_f[:2, 2], [u_f, v_f], atol=1e-10)
        np.testing.assert_allclose(wide - A_p[:2, 2], [u_p, v_p], atol=1e-10)
        below = r3 @ t - r3[2] * z
        slope = A_p[0, 0] * r1[2] + A_p[0, 1] * r2[2]
        u_hat = (A_p[0, 0] * r1 @ t + A_p[0, 1] * r2 @ t - slope * z) / below
        v_hat = (A_p[1, 1] * r2 @ t - A_p[1, 1] * r2[2] * z) / below
        ideal = ideal_wide_pixel(made, eye, z) - A_p[:2, 2]
        np.testing.assert_allclose(ideal, [u_hat, v_hat], atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_point_held_at_the_ideal_position_falls_on_the_principal_point_of_the_fovea(seed: int):
    made = head(seed)
    for eye in EYES:
        narrow, wide = project_both(made, eye, on_axis(DEPTHS))
        centre = made.camera(f"{eye}_narrow").intrinsics.matrix[:2, 2]
        np.testing.assert_allclose(narrow, np.tile(centre, (len(DEPTHS), 1)), rtol=0, atol=1e-9)
        ideal = ideal_wide_pixel(made, eye, DEPTHS)
        np.testing.assert_allclose(ideal, wide, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_ideal_position_converges_to_its_limit_as_one_over_depth(seed: int):
    made = head(seed)
    for eye in EYES:
        limit = ideal_wide_pixel(made, eye, np.inf)
        gaps = np.linalg.norm(ideal_wide_pixel(made, eye, [1e2, 1e3, 1e6]) - limit, axis=1)
        assert gaps[0] < 1
        np.testing.assert_allclose(gaps[1] / gaps[0], 0.1, rtol=1e-2)
        assert gaps[2] < 1e-4


def test_equations_18_and_19_do_not_depend_on_the_foveal_intrinsics():
    made = head(0)
    other = pinhole(320, 200, 2000.0, (-0.3, 0.1, 0.01, 0, 0))
    other = replace(other, matrix=other.matrix * [[1, 1, 0.6], [1, 0.45, 0.5], [1, 1, 1]])
    for eye in EYES:
        name = f"{eye}_narrow"
        cameras = made.cameras | {name: replace(made.camera(name), intrinsics=other)}
        changed = ideal_wide_pixel(replace(made, cameras=cameras), eye, DEPTHS)
        np.testing.assert_array_equal(changed, ideal_wide_pixel(made, eye, DEPTHS))


def test_an_error_in_depth_costs_less_the_farther_the_point():
    made = head(1)
    near, far = (np.linalg.norm(foveal_miss(made, "left", z, 1.1 * z)) for z in (0.3, 1.5))
    assert 4 < near / far < 6  # as 1 / z for an error of 10 %
    np.testing.assert_allclose(foveal_miss(made, "left", np.inf, np.inf), 0, atol=1e-9)
    assert np.linalg.norm(foveal_miss(made, "left", 1e6, 1e5)) < 0.01


@pytest.mark.parametrize("depth", [0.0, -1.0, np.nan])
def test_a_depth_that_is_not_positive_is_refused(depth: float):
    with pytest.raises(VergenceError, match="above 0 m"):
        ideal_wide_pixel(head(0), "left", [1.0, depth])


@pytest.mark.parametrize("lens", ["narrow", "wide"])
@pytest.mark.parametrize("seed", SEEDS)
def test_gaze_angles_centre_a_point_in_both_eyes_exactly(seed: int, lens):
    made = head(seed)
    points = np.random.default_rng(seed).uniform([0.25, -0.8, -0.6], [3, 0.8, 0.6], (200, 3))
    points[:, 1:] *= points[:, :1]
    angles = gaze_angles(made, points, cameras=[f"{eye}_{lens}" for eye in EYES])
    assert angles.shape == (200, 4)
    for eye in EYES:
        in_cam = point_in_camera(made, f"{eye}_{lens}", angles, points)
        assert (in_cam[:, 2] > 0).all()
        assert np.abs(in_cam[:, :2] / in_cam[:, 2:]).max() < 1e-12


def test_a_point_is_centred_though_the_error_before_the_last_step_was_not_small_yet():
    """A camera ahead of its axes comes nearer to a point by more than it turns."""
    mounted = {"camera_m": ((0.02, 0.01, 0.01),) * 2, "mounting_deg": ((2.0, 1.0, -3.0),) * 2}
    made = plain_head(0.1, 300.0, **mounted)
    for point in ([0.108, 0.031, 0.041], [0.103, 0.022, 0.018], [0.1, -0.002, 0.011]):
        angles = solve_fixation(made, {"left_wide": np.array(point)})
        assert np.isfinite(angles[:2]).all()


def test_motors_before_a_gear_turn_as_often_as_the_gear_asks():
    made = head(0)
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(
            replace(joint, readings={name: 0.005 for name in joint.readings}) for joint in joints
        )
        for eye, joints in made.kinematics.eyes.items()
    }
    geared = replace(made, kinematics=replace(made.kinematics, eyes=eyes))
    points = np.array([[0.5, 0.2, 0.3], [0.4, -0.3, -0.1], [2.0, 0.0, 0.1]])
    turns = gaze_angles(geared, points)
    np.testing.assert_allclose(turns, gaze_angles(made, points) / 0.005, rtol=1e-6)


def test_points_that_no_gaze_centres_are_nan_and_leave_the_others_alone():
    points = np.array([[np.nan, 0, 1], [0, 0, 1], [0.001, 0, 0], [0.5, 0, 0], [0, 0, 0]])
    angles = solve_fixation(head(0), {"left_narrow": points})[..., :2]
    np.testing.assert_array_equal(np.isfinite(angles).all(axis=1), [False] * 3 + [True, False])
    alone = solve_fixation(head(0), {"left_narrow": points[3]})[..., :2]
    np.testing.assert_allclose(alone, angles[3], atol=1e-14)


@pytest.mark.render
def test_a_rendered_object_held_at_the_ideal_position_is_in_the_middle_of_the_fovea():
    """On the twin's own pictures, and with its truth: 0.3 px in all four images."""
    with Twin(load_profile("ideal"), seed=3) as twin:
        for point in (np.array([0.35, 0.05, -0.06]), np.array([0.9, -0.2, 0.1])):
            twin.place_object(point)
            twin.settle(np.concatenate([np.zeros(3), gaze_angles(twin.truth, point)]))
            frame = twin.capture()
            for eye in EYES:
                narrow = twin.truth.camera(f"{eye}_narrow").intrinsics
                seen = find_sphere(frame.images[f"{eye}_narrow"], narrow)
                assert np.linalg.norm(seen - narrow.matrix[:2, 2]) < 0.3
                eyes = twin.true_angles()[None, 3:]
                depth = point_in_camera(twin.truth, f"{eye}_narrow", eyes, point[None])[0, 2]
                wide = twin.truth.camera(f"{eye}_wide").intrinsics
                seen = find_sphere(frame.images[f"{eye}_wide"], wide)
                ideal = ideal_wide_pixel(twin.truth, eye, depth)
                assert np.linalg.norm(seen - ideal) < 0.3
