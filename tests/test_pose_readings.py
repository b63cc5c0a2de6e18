"""Measured eye poses that are not what they should be are refused with their cause."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulated_recording import BOARD, POINTS, as_poses
from test_other_heads import LENS, assert_near, on_an_arm, recorded
from texts import texts
from vergence.calibration.calibrate import calibrate
from vergence.calibration.checks.pose_readings import check_pose_readings
from vergence.calibration.observations import Observations
from vergence.data.timing import Timing
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import project_at
from vergence.geometry.se3 import inverse, pose, rotation, transform

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("two_folds")]


@pytest.fixture(scope="module")
def seen() -> Observations:
    return on_an_arm(8)[1]


def changed(seen: Observations, change: Callable[[np.ndarray], np.ndarray]) -> Observations:
    assert seen.T_base_eye is not None
    return replace(seen, T_base_eye=change(seen.T_base_eye.copy()))


def scaled(metre: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(T: np.ndarray) -> np.ndarray:
        T[..., :3, 3] *= metre
        return T

    return change


def quaternions(T: np.ndarray, shift: int) -> np.ndarray:
    """Return poses made of quaternions that are read in another order."""
    numbers = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    turned = Rotation.from_quat(np.roll(numbers, shift, axis=1)).as_matrix()
    return pose(turned.reshape(T[..., :3, :3].shape), T[..., :3, 3])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (inverse, "they are inverted"),
        (lambda T: np.roll(T, 1, axis=0), "they stand one row too late"),
        (lambda T: np.roll(T, -1, axis=0), "they stand one row too early"),
        (lambda T: np.random.default_rng(0).permutation(T), "not of this eye or not of these"),
        (scaled(1e3), "they are in millimetres; give metres"),
        (scaled(100), "they are in centimetres"),
        (scaled(-1), "left-handed, or their translations point the other way"),
        (lambda T: quaternions(T, 1), "quaternions in another order"),
        (lambda T: quaternions(T, -1), "quaternions in another order"),
        (scaled(1.5), "measures 0.66.* m: check their unit, and board.square_m"),
    ],
)
def test_poses_that_are_something_else_are_refused_with_what_they_are(seen, change, says):
    with pytest.raises(VergenceError, match=says):
        calibrate(changed(seen, change), lens=LENS)


@pytest.mark.parametrize("shift", [1, -1])
def test_rows_of_eyes_that_turn_about_a_point_are_compared_too(shift):
    poses = as_poses(recorded(1)[1])
    with pytest.raises(VergenceError, match=r"one row too|not of this eye"):
        calibrate(changed(poses, lambda T: np.roll(T, shift, axis=0)), lens=LENS)


def test_poses_in_millimetres_of_eyes_that_turn_about_a_point_are_refused():
    poses = as_poses(recorded(1)[1])

    def from_a_base_in_the_neck(T: np.ndarray) -> np.ndarray:
        T[..., :3, 3] = 1e3 * (T[..., :3, 3] + [0.03, 0.0, 0.12])
        return T

    with pytest.raises(
        VergenceError, match=r"about a point 12\d\.\d* m from its base: give poses in m"
    ):
        calibrate(changed(poses, from_a_base_in_the_neck), lens=LENS)


def test_exchanged_rows_are_named_and_left_out(seen):
    rows = np.arange(24)
    rows[[4, 9]] = [9, 4]
    found = calibrate(changed(seen, lambda T: T[rows]), lens=LENS)
    for view in (4, 9):
        assert any(
            said.startswith(f"View {view}: the pose of the left") for said in texts(found.findings)
        )
        assert np.isnan(found.observations.corners["left_wide"][view]).all()
    checked = found.accuracy.held_out
    assert checked is not None
    assert checked.prediction_px is not None
    assert checked.prediction_px < 0.5


def test_a_time_offset_of_moving_eyes_is_not_taken_for_another_row(seen):
    """It is estimated; and a row at rest that contradicts the others keeps its number."""
    assert seen.T_base_eye is not None
    phase = np.linspace(0, 6 * np.pi, 60)[:, None]
    turns = 0.3 * np.sin(phase + np.arange(3))
    late = pose(rotation(turns), 0.1 * turns)
    true = np.concatenate([np.roll(late, -1, axis=0), seen.T_base_eye[:, 0]])
    read = np.concatenate([late, seen.T_base_eye[:, 0]])
    read[70] = read[65]
    V, K = len(read), len(POINTS)
    moving = Observations(
        board=BOARD,
        placement=np.zeros(V, int),
        eye_angles=np.full((V, 4), np.nan),
        corners={"left_wide": np.zeros((V, K, 2))},
        sizes={"left_wide": (640, 480)},
        timing=Timing(np.arange(V) / 30, (np.arange(V) < 60).astype(int)),
        T_base_eye=np.stack([read, read], axis=1),
    )
    T_base_target = pose(rotation([0.3, 0.2, 0.0]), [-0.12, -0.08, 0.5])
    found = check_pose_readings(moving, {"left_wide": inverse(true) @ T_base_target})
    (said,) = texts(found.findings)
    assert said.startswith("View 70: the pose of the left eye")
    lost = np.isnan(found.observations.corners["left_wide"]).all(axis=(1, 2))
    assert np.flatnonzero(lost).tolist() == [70]


@pytest.mark.parametrize("shared", [False, True], ids=["each its own", "common tilt"])
def test_tilt_before_pan_is_refused_with_the_order_that_the_images_show(shared):
    """And the same images with the poses of the eyes instead are calibrated."""
    rng = np.random.default_rng(5)
    truth, _ = recorded(1)
    V = 30
    angles = rng.uniform(-0.3, 0.3, (V, 4))
    if shared:
        angles[:, 3] = angles[:, 1]
    pan, tilt = (rotation(angles[:, k::2, None] * axis) for k, axis in enumerate(np.eye(3)[[2, 1]]))
    T_base_eye = pose(tilt @ pan)
    T_lbase_target = truth.cameras["left_wide"].T_eye_cam @ pose(
        rotation([0.3, 0.2, 0.0]), [-0.15, -0.08, 0.6]
    )
    corners = {}
    for name, mounted in truth.cameras.items():
        T = T_base_eye[:, EYES.index(mounted.eye)]
        points = transform(T_lbase_target, POINTS)[None]
        pixels = project_at(mounted, truth.T_rbase_lbase, T, points)
        corners[name] = pixels + rng.normal(0, 0.1, pixels.shape)
    seen = Observations(
        board=BOARD,
        placement=np.zeros(V, dtype=int),
        eye_angles=angles + rng.normal(0, 1e-3, (V, 4)),
        corners=corners,
        sizes=dict.fromkeys(corners, (640, 480)),
    )
    with pytest.raises(VergenceError, match="fit tilt before pan"):
        calibrate(seen, lens=LENS)
    left = {name: each for name, each in corners.items() if name.startswith("left")}
    missing = np.where([True, True, False, False], seen.eye_angles, np.nan)
    alone = replace(seen, corners=left, sizes=dict.fromkeys(left, (640, 480)), eye_angles=missing)
    with pytest.raises(VergenceError, match="fit tilt before pan"):
        calibrate(alone, lens=LENS)
    found = calibrate(replace(seen, T_base_eye=T_base_eye), lens=LENS)
    assert_near(found, truth)


def mirrored(T: np.ndarray) -> np.ndarray:
    T[..., :3, 1] *= -1
    return T


def longer(T: np.ndarray) -> np.ndarray:
    T[..., :3, :3] *= 1.02
    return T


@pytest.mark.parametrize("change", [mirrored, longer])
def test_what_is_no_rotation_is_refused_when_observations_are_made(seen, change):
    with pytest.raises(VergenceError, match="left-handed axes"):
        changed(seen, change)
