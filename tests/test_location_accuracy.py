"""Stated accuracies against 100,000 samples at the places of the paper's figures."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from closed_form import predicted_depth_std
from simulated_head import plain_head, skewed_head
from test_triangulation import random_samples
from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.calibration.summary import DISTANCES_M, point_accuracy
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, parameter_names, stated_covariance
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import boxplus as moved
from vergence.geometry.se3 import inverse
from vergence.paper.figures import FIGURES, Figure
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import (
    combination,
    depth_error,
    disparity_error,
    locate,
    locate_jointly,
)

N = 100_000
FOCAL_PX = {"2.8mm": 280.0, "4.0mm": 400.0}
WIDE = ("left_wide", "right_wide")


def sampled(head: HeadCalibration, point: Array, joints: Array, pixel: float, joint: float):
    """Return N estimates of a point from noisy pixels and readings."""
    rng = np.random.default_rng(3)
    left, right = (
        project_point(head, name, joints, point) + rng.normal(0, pixel, (N, 2)) for name in WIDE
    )
    readings = joints + rng.normal(0, joint, (N, 4))
    return triangulate_at(head, left=left, right=right, joints=readings)[0]


@pytest.mark.parametrize("figure", FIGURES.values(), ids=lambda each: each.number)
@pytest.mark.parametrize(("joint_deg", "pixel"), [(0.1, 0.0), (0.0, 0.5), (0.1, 0.3)])
def test_the_formula_off_the_axis_agrees_with_samples_at_the_places_of_the_figures(
    figure: Figure, joint_deg: float, pixel: float
):
    """Eqs. 20-21, generalised."""
    ahead, baseline, focal = 0.02, 0.092, FOCAL_PX[figure.lens]
    head = plain_head(baseline, focal, camera_m=((ahead, 0, 0),) * 2)
    noise = {"reading_std": np.radians(joint_deg), "pixel_std_px": pixel}
    found = sampled(head, np.array(figure.mean_m), np.zeros(4), pixel, np.radians(joint_deg))
    predicted = predicted_depth_std(figure.mean_m, baseline, focal, camera_ahead_m=ahead, **noise)
    assert found[:, 0].std() == pytest.approx(predicted, rel=0.03)


@pytest.mark.parametrize("depth", [0.46, 0.7, 1.1])
def test_the_formula_on_the_axis_agrees_with_samples(depth: float):
    """Eqs. 20-21, for a standard deviation below 8 % of the depth."""
    baseline, noise = 0.092, {"reading_std": np.radians(0.1), "pixel_std_px": 0.3}
    head = plain_head(baseline, 280.0)
    point = np.array([depth, -baseline / 2, 0.0])
    found = sampled(head, point, np.zeros(4), noise["pixel_std_px"], noise["reading_std"])
    predicted = predicted_depth_std(point, baseline, 280.0, **noise)
    assert predicted < 0.08 * depth
    assert found[:, 0].std() == pytest.approx(predicted, rel=0.02)
    turned = disparity_error(280.0, np.sqrt(2) * noise["reading_std"])
    plain = depth_error(
        depth, baseline, 280.0, np.hypot(turned, np.sqrt(2) * noise["pixel_std_px"])
    )
    assert predicted == pytest.approx(plain, rel=0.012)


STD = {"f": 0.5, "c": 0.5, "r": 4e-4, "t": 3e-4, "pan_gain": 2e-3, "tilt_gain": 2e-3}
"""Of the parameters of a calibration, by the beginning of the last part of their names."""


def stated(head: HeadCalibration) -> HeadCalibration:
    """Return a head that states a correlated covariance of everything but distortion."""
    last = {name: name.rpartition(".")[2] for name in parameter_names(head)}
    unlikely = ("nonorthogonality_rad", "axis_distance_m", "offset_rad", "time_offset_s")
    lens = COEFFICIENTS["radial-tangential"]
    names = tuple(n for n in last if last[n] not in lens and not n.endswith(unlikely))
    std = np.array([STD.get(last[n], STD.get(last[n][0], 0.0)) for n in names])
    A = np.eye(len(names)) + 0.15 * np.random.default_rng(4).normal(size=(len(names),) * 2)
    C = A @ A.T
    C /= np.sqrt(np.outer(np.diag(C), np.diag(C)))
    accuracy = Accuracy(
        method="bundle",
        parameters=names,
        covariance=std * C * std[:, None],
        pixel_std_px=0.1,
        joint_std=(4e-4,),
    )
    return replace(head, accuracy=accuracy)


def with_wrong_calibration(
    head: HeadCalibration, seen: dict[str, Array], rng: np.random.Generator
) -> Array:
    """Return estimates of one point from N samples, each with a calibration drawn anew.

    Errors of the calibration are put into what `locate` takes for each sample: those of lenses
    into its pixels, those of gains into its readings, and those of mountings and base into poses of
    the eyes.
    """
    accuracy = head.accuracy
    assert accuracy is not None
    names = accuracy.parameters
    drawn = rng.multivariate_normal(np.zeros(len(names)), accuracy.covariance, N, method="cholesky")
    error = {name: drawn[:, k] for k, name in enumerate(names)}
    gains = [error[f"{e}.{j}_gain"] for e in ("left", "right") for j in ("pan", "tilt")]
    joints = seen["joints"] + rng.normal(0, 4e-4, (N, 4))
    poses = eye_poses(head, joints * (1 + np.array(gains).T)).copy()
    pixels = []

    def six(name: str) -> Array:
        return np.array([error[f"{name}.{a}"] for a in ("rx", "ry", "rz", "tx", "ty", "tz")]).T

    for k, (name, eye) in enumerate(zip(WIDE, ("left", "right"), strict=True)):
        mounted = head.cameras[name]
        K = mounted.intrinsics.matrix
        uv = seen[eye] + rng.normal(0, 0.1, (N, 2))
        f = K[[0, 1], [0, 1]] + np.array([error[f"{name}.fx"], error[f"{name}.fy"]]).T
        c = K[:2, 2] + np.array([error[f"{name}.cx"], error[f"{name}.cy"]]).T
        pixels.append((uv - c) / f * K[[0, 1], [0, 1]] + K[:2, 2])
        X = np.broadcast_to(mounted.T_eye_cam, (N, 4, 4))
        poses[:, k] = poses[:, k] @ moved(X, six(f"{name}.T_eye_cam")) @ inverse(X)
    B = np.broadcast_to(head.T_rbase_lbase, (N, 4, 4))
    poses[:, 1] = B @ inverse(moved(B, six("T_rbase_lbase"))) @ poses[:, 1]
    return triangulate_at(head, left=pixels[0], right=pixels[1], joints=poses)[0]


@pytest.mark.parametrize("figure", FIGURES.values(), ids=lambda each: each.number)
def test_the_whole_covariance_agrees_with_samples_at_the_figures(figure: Figure):
    """Noise of pixels and readings, and a calibration drawn anew for each sample; every component
    within 2 %."""
    head = stated(
        plain_head(
            0.092,
            FOCAL_PX[figure.lens],
            camera_m=((0.02, 0.001, 0.01), (0.021, -0.001, 0.009)),
            mounting_deg=((0.8, -0.5, 0.7), (-0.6, 0.9, -0.5)),
        )
    )
    joints = eye_angles(figure.motion, np.array(5.0))
    left, right = (
        project_point(head, name, joints, np.array(figure.mean_m))[None] for name in WIDE
    )
    (covariance,) = locate(head, left=left, right=right, joints=joints).covariance
    seen = {"left": left, "right": right, "joints": joints}
    observed = np.cov(with_wrong_calibration(head, seen, np.random.default_rng(5)).T)
    scale = np.sqrt(np.outer(np.diag(observed), np.diag(observed)))
    np.testing.assert_allclose(covariance / scale, observed / scale, atol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance) / np.diag(observed)), 1, atol=0.02)


def test_an_average_keeps_the_error_of_the_calibration_and_a_difference_loses_most_of_it():
    rng = np.random.default_rng(1)
    head = stated(plain_head(0.092, 280.0, camera_m=((0.02, 0, 0),) * 2))
    point, n = np.array([0.6, -0.03, 0.02]), 500
    joints = rng.uniform(-0.1, 0.1, (n, 4))
    left, right = (project_point(head, name, joints, point) for name in WIDE)
    noise = {"pixel_std_px": 0.1, "reading_std": 1e-3}
    seen = {"left": left, "right": right, "joints": joints}
    each = locate(head, **seen, **noise)
    mean, covariance = combination(head, weights=np.full(n, 1 / n), **seen, **noise)
    np.testing.assert_allclose(mean, point, atol=1e-9)
    assert 0.5 < np.trace(covariance) / np.trace(each.calibration_covariance.mean(axis=0)) <= 1
    near = point + np.array([0.0, 0.01, 0.0])
    pair = {
        eye: np.stack([seen[eye][0], project_point(head, name, joints[0], near)])
        for eye, name in zip(("left", "right"), WIDE, strict=True)
    }
    apart, of_pair = combination(
        head, weights=np.array([-1.0, 1.0]), **pair, joints=joints[0], **noise
    )
    np.testing.assert_allclose(apart, near - point, atol=1e-9)
    alone = locate(head, **pair, joints=joints[0], pixel_std_px=0.1, reading_std=0.0)
    white = alone.covariance - alone.calibration_covariance
    # The noise of two points remains, and of all that they share a few percent.
    assert np.trace(of_pair) < 1.1 * np.trace(white.sum(axis=0))
    independent = locate(head, **pair, joints=joints[0], **noise).covariance
    assert np.trace(of_pair) < 0.2 * np.trace(independent.sum(axis=0))


def test_a_combination_assumes_the_stated_noise_as_locate_does():
    head, point = stated(plain_head(0.092, 280.0)), np.array([0.6, -0.03, 0.02])
    seen = {
        eye: project_point(head, name, np.zeros(4), point)[None]
        for eye, name in zip(("left", "right"), WIDE, strict=True)
    }
    each = locate(head, **seen, joints=np.zeros(4))
    _, covariance = combination(head, weights=np.ones(1), **seen, joints=np.zeros(4))
    np.testing.assert_allclose(covariance, each.covariance[0], rtol=1e-9)


def test_pixels_are_weighted_by_their_noise():
    """A left image ten times as noisy counts little in height, and the covariance says so."""
    rng = np.random.default_rng(2)
    head, point = plain_head(0.092, 280.0), np.array([0.6, -0.03, 0.02])
    stds = np.array([0.1, 1.0, 0.1, 0.1])
    seen = [project_point(head, name, np.zeros(4), point) for name in WIDE]
    noise = rng.normal(size=(N, 4)) * stds
    left, right = seen[0] + noise[:, :2], seen[1] + noise[:, 2:]
    found = locate(head, left=left, right=right, joints=np.zeros(4), pixel_std_px=stds)
    plain = triangulate_at(head, left=left, right=right, joints=np.zeros(4))[0]
    assert found.xyz[:, 2].std() < 0.25 * plain[:, 2].std()
    predicted = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2).mean(axis=0))
    np.testing.assert_allclose(found.xyz.std(axis=0), predicted, rtol=0.02)


def test_chunks_of_points_are_located_as_all_at_once():
    rng = np.random.default_rng(6)
    head = stated(skewed_head(rng))
    points, joints, left, right = random_samples(head, rng, 4100)
    whole = locate(head, left=left, right=right, joints=joints)
    last = locate(head, left=left[-9:], right=right[-9:], joints=joints[-9:])
    np.testing.assert_allclose(whole.xyz, points, atol=1e-9)
    np.testing.assert_allclose(whole.xyz[-9:], last.xyz, atol=1e-13)
    np.testing.assert_allclose(whole.covariance[-9:], last.covariance, rtol=1e-9)


def test_the_accuracy_of_points_that_both_eyes_do_not_see_is_not_stated():
    """A lens of radial distortion -0.35 reaches to 44 degrees from its axis."""
    lists = []
    for baseline in (0.09, 0.9):
        head = stated(plain_head(baseline, 280.0))
        barrel = np.array([-0.35, 0.0, 0.0, 0.0, 0.0])
        cameras = {
            name: replace(each, intrinsics=replace(each.intrinsics, distortion=barrel))
            for name, each in head.cameras.items()
        }
        lists.append(point_accuracy(replace(head, cameras=cameras)))
    near, far = lists
    assert [distance for distance, *_ in near] == list(DISTANCES_M)
    assert [distance for distance, *_ in far] == list(DISTANCES_M[2:])
    assert np.isfinite(far).all()


def test_points_that_are_not_seen_do_not_count_with_weight_zero():
    rng = np.random.default_rng(0)
    head = stated(skewed_head(rng))
    _, eyes, left, right = random_samples(head, rng, 3)
    lost = left.copy()
    lost[1] = np.nan
    weights = np.array([0.5, 0.0, 0.5])
    found, expected = (
        combination(head, weights=weights, left=each, right=right, joints=eyes)
        for each in (lost, left)
    )
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("estimated", [False, True])
def test_the_part_of_the_calibration_is_that_of_all_its_parameters(estimated):
    """Whether they were estimated with the readings, or beside them."""
    rng = np.random.default_rng(0)
    head = stated(skewed_head(rng))
    _, eyes, left, right = random_samples(head, rng, 5)
    seen: dict[str, Any] = {"left": left, "right": right, "joints": eyes[0], "pixel_std_px": 0.1}
    names = head.accuracy.parameters if estimated else ()
    _, own = stated_covariance(head, names)
    C = np.zeros((len(names) + 4,) * 2)
    C[: len(names), : len(names)] = own
    jointly = locate_jointly(head, **seen, estimate=(names, C))
    alone = locate(head, **seen, reading_std=0.0)
    scale = np.abs(alone.calibration_covariance).max()
    np.testing.assert_allclose(
        jointly.calibration_covariance, alone.calibration_covariance, atol=1e-9 * scale
    )
