"""Poses of a target in place of corners: exact data give no error, noise the stated one."""

from dataclasses import replace

import numpy as np
import pytest

from other_heads import other_head
from simulated_head import as_designed, probability
from simulated_recording import facing
from texts import texts
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, NoiseModel
from vergence.calibration.residuals import TARGET_SHIFTS, TARGET_TURNS
from vergence.calibration.target_poses import adjust_target_poses
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, camera_pose_in_base
from vergence.geometry.kinematics import EYES, Side, eye_pose
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.se3 import boxminus as boxminus_pose
from vergence.geometry.se3 import boxplus, inverse, pose, rotation

POSE_LEVELS = TARGET_TURNS, TARGET_SHIFTS
NOISE = np.diag(np.repeat([0.003, 0.0006], 3) ** 2)
EYES_OF: dict[str, Side] = {"left_wide": "left", "right_wide": "right"}


def head_of(kind: str, rng: np.random.Generator) -> HeadCalibration:
    return without_offsets(other_head(kind, rng, rolled=True))


def measured(
    head: HeadCalibration,
    rng: np.random.Generator,
    *,
    pose_std: tuple[float, float] = (0.0, 0.0),
    joint_std: float = 0.0,
    views: int = 40,
) -> tuple[dict[str, Array], Array]:
    """Return poses of a target at rest by camera, and readings."""
    r = len(head.kinematics.readings)
    joints = rng.uniform(-0.3, 0.3, (views, r))
    T_lbase_target = facing(np.array([0.5, -0.04, 0.0]), rng.normal(0, 0.3, 3))
    noise = np.repeat(pose_std, 3)
    poses = {}
    for name, mounted in head.cameras.items():
        there = T_lbase_target if mounted.eye == "left" else head.T_rbase_lbase @ T_lbase_target
        T = inverse(camera_pose_in_base(head, name, joints)) @ there
        poses[name] = boxplus(T, rng.normal(0, 1, (views, 6)) * noise)
    return poses, joints + rng.normal(0, joint_std, joints.shape)


def estimate(
    head: HeadCalibration, poses: dict[str, Array], readings: Array, covariance: Array | None = None
) -> BundleEstimate:
    """Return the estimate of a head whose design is known; one covariance holds for all poses."""
    return adjust_target_poses(
        poses,
        readings,
        eyes=EYES_OF,
        kinematics=as_designed(head.kinematics),
        covariance=None if covariance is None else dict.fromkeys(poses, covariance),
    )


def off(found: BundleEstimate, truth: HeadCalibration) -> Array:
    """Return (c,) the errors of the parameters; lenses have none."""
    cameras = {
        name: replace(mounted, intrinsics=truth.cameras[name].intrinsics)
        for name, mounted in found.head.cameras.items()
    }
    errors = boxminus(replace(found.head, cameras=cameras), truth)
    return np.array([errors.get(name, 0.0) for name in found.parameters])


@pytest.mark.parametrize("kind", ["tilt, pan", "shared tilt, pan"])
def test_exact_poses_give_the_head_without_error(kind: str):
    rng = np.random.default_rng(1)
    head = head_of(kind, rng)
    poses, readings = measured(head, rng)
    poses["left_wide"][3] = np.nan  # not measured
    found = estimate(head, poses, readings, NOISE)
    assert texts(found.findings, "void") == []
    assert np.abs(off(found, head)).max() < 1e-5
    assert np.isnan(found.residuals_px["left_wide"][3]).all()


def test_poses_that_stay_the_same_while_the_eye_turns_are_void():
    rng = np.random.default_rng(3)
    head = head_of("pan, tilt", rng)
    poses, readings = measured(head, rng)
    poses["right_wide"] = boxplus(poses["right_wide"][0], rng.normal(0, 1e-3, (40, 6)))
    found = adjust_target_poses(poses, readings, eyes=EYES_OF)
    assert "right_wide.T_eye_cam is not observable" in texts(found.findings, "void")[0]


def test_noisy_poses_give_the_stated_error():
    inside = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        head = head_of("pan, tilt", rng)
        poses, readings = measured(head, rng, pose_std=(0.003, 0.0006), joint_std=0.002)
        found = estimate(head, poses, readings, NOISE)
        error = off(found, head)
        for owner in ("left_wide.T_eye_cam", "right_wide.T_eye_cam", "T_rbase_lbase"):
            rows = [k for k, n in enumerate(found.parameters) if n.rpartition(".")[0] == owner]
            inside.append(probability(error[rows], found.covariance[np.ix_(rows, rows)]) < 0.95)
    assert np.mean(inside) > 0.8


@pytest.mark.slow
def test_unknown_noise_of_poses_and_of_readings_is_found():
    rng = np.random.default_rng(0)
    head = head_of("pan, tilt", rng)
    poses, readings = measured(head, rng, pose_std=(0.003, 0.0006), joint_std=0.002)
    found = estimate(head, poses, readings)
    levels = [*(found.levels[name] for name in POSE_LEVELS), found.joint_std[0]]
    np.testing.assert_allclose(levels, [0.003, 0.0006, 0.002], rtol=0.2)


def test_a_stated_covariance_is_used_and_its_factor_found():
    rng = np.random.default_rng(3)
    head = head_of("pan, tilt", rng)
    poses, readings = measured(head, rng, pose_std=(0.002, 0.0004), joint_std=0.001, views=60)
    stated = np.diag(np.repeat([0.001, 0.0002], 3) ** 2)
    found = estimate(head, poses, readings, stated)
    assert found.pixel_std_px == pytest.approx(2, rel=0.15)


def test_wrong_arguments_are_refused():
    rng = np.random.default_rng(0)
    head = head_of("pan, tilt", rng)
    poses, readings = measured(head, rng, views=10)
    with pytest.raises(VergenceError, match=r"poses by left_wide of shape \(10, 4, 4\)"):
        adjust_target_poses({"left_wide": poses["left_wide"][:5]}, readings, eyes=EYES_OF)
    with pytest.raises(VergenceError, match="T_cam_target names no camera"):
        adjust_target_poses({}, readings, eyes={})
    with pytest.raises(VergenceError, match="in which eye right_wide"):
        adjust_target_poses(poses, readings, eyes={"left_wide": "left"})
    with pytest.raises(VergenceError, match=r"need eye of shape \(10, 4\)"):
        adjust_target_poses(poses, readings[:, :3], eyes=EYES_OF)
    with pytest.raises(VergenceError, match=r"need placement of shape \(10,\), found \(9,\)"):
        adjust_target_poses(poses, readings, eyes=EYES_OF, placement=np.zeros(9, int))
    for wrong in (-np.eye(6), np.full((6, 6), np.nan), np.eye(6) + np.diag([np.nan], 5)):
        covariance = dict.fromkeys(poses, wrong)
        with pytest.raises(VergenceError, match="positive definite"):
            adjust_target_poses(poses, readings, eyes=EYES_OF, covariance=covariance)
    with pytest.raises(VergenceError, match="in radians; found a joint at 15, more than a turn"):
        adjust_target_poses(poses, np.full((10, 4), 15.0), eyes=EYES_OF)
    with pytest.raises(VergenceError, match="pixel_std_px is above 0, found -1"):
        NoiseModel(pixel_std_px=-1.0)
    with pytest.raises(VergenceError, match="joint_std is a standard deviation"):
        NoiseModel(joint_std=np.nan)
    unread = readings.copy()
    unread[3] = np.nan
    with pytest.raises(VergenceError, match="in view 3, but its joint reading is not finite"):
        adjust_target_poses(poses, unread.tolist(), eyes=EYES_OF)  # pyright: ignore
    for T in poses.values():
        T[:8] = np.nan
    with pytest.raises(VergenceError, match="at least 3 poses"):
        adjust_target_poses(poses, readings, eyes=EYES_OF)


def test_eye_poses_that_are_one_row_late_are_void_and_no_traceback():
    """Hardly a residual of the eyes' poses is left, and the information on their noise is nil.

    So it is where translations have little weight. An estimate of the noise ends there; here it is
    given, which saves the search.
    """
    rng = np.random.default_rng(0)
    head = head_of("pan, tilt", rng)
    poses, readings = measured(head, rng, pose_std=(0.003, 0.0006), joint_std=0.002)
    eyes = np.stack([eye_pose(head.kinematics, each, readings) for each in EYES], axis=1)
    covariance = dict.fromkeys(poses, np.diag(np.repeat([1e-3, 3.65e-3], 3) ** 2))
    found = adjust_target_poses(
        poses, np.roll(eyes, 1, axis=0), eyes=EYES_OF, covariance=covariance
    )
    assert texts(found.findings, "void")


@pytest.mark.parametrize("order", [[1, 0, 2, 3], [2, 3, 0, 1], [1, 0, 3, 2]])
def test_readings_in_another_order_are_void(order):
    rng = np.random.default_rng(0)
    head = head_of("pan, tilt", rng)
    poses, readings = measured(head, rng, pose_std=(0.003, 0.0006), joint_std=0.002)
    found = adjust_target_poses(
        poses, readings[:, order], eyes=EYES_OF, covariance=dict.fromkeys(poses, NOISE)
    )
    assert texts(found.findings, "void")


def by_poses(
    axes: int, seed: int, noise: tuple[float, float] = (1e-3, 3e-4)
) -> tuple[dict[str, Array], Array, Array]:
    """Return poses of a target by two cameras on one body that turns about some axes, its poses,
    and T_eye_cam (2, 4, 4)."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-0.5, 0.5, (20, axes)) @ np.linalg.qr(rng.normal(size=(3, 3)))[0][:axes]
    body = pose(rotation(turns), rng.uniform(-0.1, 0.1, (20, 3)))
    mounts = pose(rotation(rng.normal(0, 0.5, (2, 3))), rng.normal(0, 0.05, (2, 3)))
    T = inverse(body[:, None] @ mounts) @ pose(rotation(rng.normal(0, 0.3, 3)), [0, 0, 0.6])
    T = boxplus(T, rng.normal(0, 1, (20, 2, 6)) * np.repeat(noise, 3))
    return dict(zip(EYES_OF, np.moveaxis(T, 1, 0), strict=True)), body, mounts


def test_two_cameras_on_one_body_of_measured_and_rounded_poses_are_placed():
    poses, body, mounts = by_poses(3, 1)
    T_base_eye = np.round(np.stack([body, body], axis=1), 4)
    found = adjust_target_poses(poses, T_base_eye, eyes=EYES_OF)
    assert texts(found.findings, "void", "warning") == []
    assert [each.code for each in found.findings] == ["rounded-poses"]
    for mounted, T in zip(found.head.cameras.values(), mounts, strict=True):
        assert np.abs(boxminus_pose(mounted.T_eye_cam, T)).max() < 3e-3


def test_a_body_that_turns_about_one_axis_voids_the_result():
    poses, body, _ = by_poses(1, 1)
    body = boxplus(body, np.random.default_rng(2).normal(0, 1e-3, (20, 6)))
    found = adjust_target_poses(poses, np.stack([body, body], axis=1), eyes=EYES_OF)
    assert "turn it by at least 0.1 rad" in texts(found.findings, "void")[0]
