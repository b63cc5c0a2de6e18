"""One camera in its eye: exact data give no error, noise the stated one, poor data words."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from one_eye import CAMERA, mount_camera
from simulated_head import R_EYE_CAM, pan_tilt_pose, probability, random_pose
from simulated_recording import BOARD, POINTS, facing
from texts import texts
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, NoiseModel, covariance_of
from vergence.geometry.camera import pinhole
from vergence.geometry.head import MountedCamera
from vergence.geometry.kinematics import Kinematics, eye_pose, pan_tilt
from vergence.geometry.projection import project_at
from vergence.geometry.se3 import boxminus, boxplus, pose, rotation, transform

LENS = pinhole(640, 480, 280.0)


@dataclass(frozen=True, eq=False)
class Recording:
    T_eye_cam: Array
    readings: Array
    pixels: Array


def record(
    seed: int,
    *,
    joint_std: float = 0.0,
    pixel_std_px: float = 0.0,
    views: int = 20,
    reach: tuple[float, float] = (0.25, 0.25),
    together: bool = False,
) -> Recording:
    """Return a recording of one eye, whose tilt may do what its pan does."""
    rng = np.random.default_rng(seed)
    T_eye_cam = random_pose(rng, 0.04, 0.004) @ pose(R_EYE_CAM, [0.02, 0, 0])
    angles = rng.uniform(-1, 1, (views, 2)) * reach
    angles = angles[:, [0, 0]] if together else angles
    pixels = see(T_eye_cam, pan_tilt_pose(angles), rng)
    return Recording(
        T_eye_cam,
        angles + rng.normal(0, joint_std, angles.shape),
        pixels + rng.normal(0, pixel_std_px, pixels.shape),
    )


def see(T_eye_cam: Array, eye_poses: Array, rng: np.random.Generator) -> Array:
    """Return exact corners (N, K, 2) of a board at 0.4 m, at eye poses (N, 4, 4)."""
    T_base_target = facing(np.array([0.4, 0, 0]), rng.normal(0, 0.3, 3))
    camera = MountedCamera(eye="left", intrinsics=LENS, T_eye_cam=T_eye_cam)
    return project_at(camera, np.eye(4), eye_poses, transform(T_base_target, POINTS))


def solve(recording: Recording, **options) -> BundleEstimate:
    """Find the camera, whose intrinsics are exact."""
    return mount_camera(recording.readings, recording.pixels, BOARD, LENS, **options)


def mounting(found: BundleEstimate) -> Array:
    return found.head.cameras[CAMERA].T_eye_cam


def mounting_covariance(found: BundleEstimate) -> Array:
    return covariance_of(found, f"{CAMERA}.T_eye_cam")


def size(T: Array, truth: Array) -> Array:
    """Return degrees and millimetres."""
    off = boxminus(T, truth)
    return np.array([np.degrees(np.linalg.norm(off[:3])), 1e3 * np.linalg.norm(off[3:])])


def stated_probability(found: BundleEstimate, recording: Recording) -> float:
    """Return the probability of an error smaller than that of T_eye_cam."""
    return probability(boxminus(mounting(found), recording.T_eye_cam), mounting_covariance(found))


def assert_within_stated(found: BundleEstimate, recording: Recording) -> None:
    off = boxminus(mounting(found), recording.T_eye_cam)
    assert (np.abs(off) < 4 * np.sqrt(np.diag(mounting_covariance(found)))).all()


@given(st.integers(0, 10**6))
@settings(max_examples=6)
def test_an_exact_recording_gives_the_mounting_exactly(seed: int):
    recording = record(seed)
    found = solve(recording)
    np.testing.assert_allclose(mounting(found), recording.T_eye_cam, atol=1e-9)
    np.testing.assert_allclose(found.T_base_eye[:, 0], pan_tilt_pose(recording.readings), atol=1e-9)
    assert np.abs(found.residuals_px[CAMERA]).max() < 1e-8
    assert not texts(found.findings)


@pytest.fixture(scope="module")
def trials(slow_setup: None) -> list[tuple[Recording, BundleEstimate, BundleEstimate]]:
    """Recordings with 0.1 degrees and 0.1 px, refined with latent and with exact joints."""
    recordings = [record(k, joint_std=np.radians(0.1), pixel_std_px=0.1) for k in range(30)]
    # Without robustness: exact joints would take half of the views for outliers.
    return [
        (r, solve(r), solve(r, noise=NoiseModel(joint_std=0, outlier=np.inf))) for r in recordings
    ]


def test_latent_joints_err_less_than_a_third_of_what_exact_joints_do(trials):
    latent = np.median([size(mounting(found), r.T_eye_cam) for r, found, _ in trials], axis=0)
    exact = np.median([size(mounting(found), r.T_eye_cam) for r, _, found in trials], axis=0)
    assert (latent < [0.12, 0.5]).all()
    assert (latent < exact / 3.5).all()


def test_stated_regions_hold_the_truth(trials):
    p = [stated_probability(found, r) for r, found, _ in trials]
    # Of 30, between 25 and 30 are expected in the 95 % region, and 6 to 24 in the 50 % one.
    assert np.count_nonzero(np.array(p) < 0.95) >= 25
    assert 6 <= np.count_nonzero(np.array(p) < 0.5) <= 24


def test_both_levels_of_noise_are_found_without_a_warning(trials):
    assert not any(texts(found.findings) for _, found, _ in trials)
    pixel = np.mean([found.pixel_std_px for _, found, _ in trials])
    joint = np.mean([found.joint_std[0] for _, found, _ in trials])
    assert pixel == pytest.approx(0.1, rel=0.02)
    assert joint == pytest.approx(np.radians(0.1), rel=0.1)


@pytest.mark.parametrize("flips", [1, 6])
def test_boards_numbered_from_the_wrong_end_are_left_out_and_named(flips: int):
    recording = record(40, joint_std=0.001, pixel_std_px=0.1)
    recording.pixels[:flips] = recording.pixels[:flips, ::-1]
    found = solve(recording)
    assert_within_stated(found, recording)
    named = [each for each in found.findings if each.code == "wrong-view"]
    assert {each.severity for each in named} == {"note" if flips == 1 else "warning"}
    assert ", ".join(each.where for each in named) == ", ".join(f"view {k}" for k in range(flips))


# Eye poses that are no pan and tilt.


def record_poses(
    seed: int, std: tuple[float, float], pixel_std_px: float, axes: tuple[int, ...] = (1, 1, 1)
) -> Recording:
    """Return a recording of an eye that turns about some axes, and shifts if about all."""
    rng = np.random.default_rng(seed)
    T_eye_cam = random_pose(rng, 0.04, 0.004) @ pose(R_EYE_CAM, [0.02, 0, 0])
    shift = rng.normal(0, 0.02, (25, 3)) * min(axes)
    poses = pose(rotation(rng.uniform(-0.25, 0.25, (25, 3)) * axes), shift)
    pixels = see(T_eye_cam, poses, rng)
    noise = rng.normal(size=(25, 6)) * np.repeat(std, 3)
    pixels = pixels + rng.normal(0, pixel_std_px, pixels.shape)
    return Recording(T_eye_cam, boxplus(poses, noise), pixels)


@pytest.mark.slow
def test_general_eye_poses_have_noise_in_rotation_and_translation():
    recordings = [record_poses(k, (0.002, 0.0005), 0.1) for k in range(6)]
    found = [solve(recording) for recording in recordings]
    levels = np.mean([f.joint_std for f in found], axis=0)
    np.testing.assert_allclose(levels, [0.002, 0.0005], rtol=0.1)
    p = [stated_probability(f, r) for f, r in zip(found, recordings, strict=True)]
    assert max(p) < 0.9999
    assert np.count_nonzero(np.array(p) < 0.95) >= 5


# Recordings that do not determine the mounting.


def test_poses_about_one_axis_void_the_result():
    recording = record_poses(5, (1e-3, 3e-4), 0.1, axes=(1, 0, 0))
    found = solve(recording)
    assert "about two axes" in texts(found.findings, "void")[0]


@pytest.mark.parametrize(
    ("reach", "words"),
    [
        ((0.25, 0), ["T_eye_cam rotation about z and translation along z"]),
        ((0, 0.25), ["T_eye_cam rotation about y and translation along y"]),
        ((0, 0), ["rotation about x", "rotation about z", "translation along y"]),
    ],
)
def test_an_axis_that_does_not_move_is_named_with_what_it_hides(reach, words):
    recording = record(6, joint_std=0.002, pixel_std_px=0.1, reach=reach)
    found = solve(recording, start=recording.T_eye_cam)
    text = " ".join(texts(found.findings))
    assert "not observable" in text
    assert all(word in text for word in words)
    assert "by at least 0.1 rad" in text


def test_two_views_are_too_few_and_said_so():
    recording = record(9, joint_std=0.002, pixel_std_px=0.1, views=2)
    text = " ".join(texts(solve(recording, start=recording.T_eye_cam).findings))
    assert "not observable" in text
    assert "noise of the joint readings cannot be estimated" in text
    assert "0.002 rad was assumed" in text


def test_readings_of_three_kinds_keep_their_noise():
    """Angles of a pan, of a tilt, and of the motor of a roll."""
    pan, tilt = pan_tilt("left")
    roll = replace(pan, name="roll", axis=np.array([1.0, 0, 0]), readings={"motor": 0.01})
    joints = (pan, replace(tilt, readings={"left_tilt": 0.1}), roll)
    rng = np.random.default_rng(3)
    readings = rng.uniform(-0.25, 0.25, (25, 3)) * [1, 10, 100]
    kinematics = Kinematics({"left": joints, "right": ()}, ("left_pan", "left_tilt", "motor"))
    truth = record(3).T_eye_cam
    pixels = see(truth, eye_pose(kinematics, "left", readings), rng)
    seen = readings + rng.normal(0, 1e-3, readings.shape) * [1, 10, 100]
    noisy = pixels + rng.normal(0, 0.1, pixels.shape)
    found = mount_camera(seen, noisy, BOARD, LENS, joints=joints)
    assert len(found.joint_std) == 3
    assert np.array(found.joint_std) * [1, 0.1, 0.01] == pytest.approx(1e-3, rel=0.5)
    assert probability(boxminus(mounting(found), truth), mounting_covariance(found)) < 0.9999
