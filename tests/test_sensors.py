"""What the joint sensors read."""

from dataclasses import replace

import numpy as np
import pytest

from other_heads import KINDS, other_head
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side, eye_pose
from vergence.twin.profile import Joints
from vergence.twin.sensors import play, read, with_sensor_errors


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2)


ANGLES = np.random.default_rng(0).uniform(-0.25, 0.25, (2000, 4))


def test_gain_and_offset_belong_to_each_joint(rng: np.random.Generator):
    joints = Joints(gain_percent=(1, 0, -2, 0), offset_deg=(0, 0.5, 0, -1))
    expected = ANGLES * [1.01, 1, 0.98, 1] + np.radians([0, 0.5, 0, -1])
    np.testing.assert_allclose(read(ANGLES, joints, rng), expected, atol=1e-15)


def test_noise_is_white_and_of_the_stated_size(rng: np.random.Generator):
    error = np.degrees(read(ANGLES, Joints(noise_deg=0.1), rng) - ANGLES)
    np.testing.assert_allclose(error.std(axis=0), 0.1, rtol=0.06)
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.01)
    correlations = np.corrcoef(np.concatenate([error[1:].T, error[:-1].T]))
    assert np.abs(correlations - np.eye(8)).max() < 0.1


def test_readings_are_whole_counts(rng: np.random.Generator):
    readings = read(ANGLES, Joints(counts_per_turn=4096), rng)
    counts = readings * 4096 / (2 * np.pi)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    step = 2 * np.pi / 4096
    assert np.abs(readings - ANGLES).max() <= step / 2 + 1e-15
    assert (readings - ANGLES).std() == pytest.approx(step / np.sqrt(12), rel=0.03)


@pytest.mark.parametrize("kind", KINDS)
def test_joints_that_undo_the_sensors_give_the_true_poses(kind: str, rng: np.random.Generator):
    kinematics = other_head(kind, rng).kinematics
    angles, gain, offset = rng.normal([[0.0], [1.0], [0.0]], 0.1, (3, len(kinematics.readings)))
    known = with_sensor_errors(kinematics, 1 / gain, -offset / gain)
    for eye in EYES:
        expected = eye_pose(kinematics, eye, angles)
        np.testing.assert_allclose(eye_pose(known, eye, gain * angles + offset), expected)


def test_errors_of_readings_before_a_gear_are_those_of_the_joints_behind_it():
    """Noise, steps, offset and gain; and the play."""
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(replace(joint, readings={f"{eye}_{joint.name}": 0.01}) for joint in own)
        for eye, own in Kinematics().eyes.items()
    }
    joints = Joints(
        noise_deg=0.1, counts_per_turn=4096, gain_percent=(1, 0, -2, 0), offset_deg=(0, 0.5, 0, -1)
    )
    direct = read(ANGLES, joints, np.random.default_rng(0))
    motors = read(100 * ANGLES, joints, np.random.default_rng(0), Kinematics(eyes))
    np.testing.assert_allclose(motors, 100 * direct, rtol=1e-9)
    widths = np.array([0.01, 1.0])
    turned = np.cumsum(np.random.default_rng(1).normal(0, 0.01, (50, 2)), axis=0) * [1, 100]
    one, other = play(turned, widths).T
    np.testing.assert_allclose(one, play(turned[:, :1], 0.01)[:, 0])
    np.testing.assert_allclose(other, play(turned[:, 1:], 1.0)[:, 0])


def test_the_sensor_follows_only_after_the_play_is_crossed():
    eye = np.array([[0.0], [0.4], [1.0], [0.7], [0.2], [0.0], [0.1]])
    sensed = play(eye, 1.0)  # half of it to either side
    np.testing.assert_allclose(sensed[:, 0], [0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5])
    # From 1.0 the eye must go back to 0.0, the whole width, before the sensor moves.
    np.testing.assert_allclose(
        play(np.array([[1.0], [0.0], [-0.1]]), 1.0, np.array([0.5]))[-1], 0.4
    )


def test_play_goes_on_from_where_it_was_left():
    eye = np.cumsum(np.random.default_rng(5).normal(0, 0.1, (100, 4)), axis=0)
    first = play(eye[:40], 0.3)
    np.testing.assert_array_equal(play(eye[40:], 0.3, first[-1]), play(eye, 0.3)[40:])
