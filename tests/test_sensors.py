"""What the joint sensors read, and which error profiles are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from other_heads import KINDS, other_head
from vergence.errors import VergenceError
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side, eye_pose
from vergence.twin.profile import Joints, load_profile, shipped
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


# Error profiles


@pytest.fixture
def write(tmp_path: Path):
    def write(text: str | bytes) -> str:
        path = tmp_path / "mine.toml"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return str(path)

    return write


@pytest.mark.parametrize("name", shipped())
def test_what_ships_loads_under_its_own_name(name: str):
    profile = load_profile(name)
    assert profile.name == name
    assert profile.description.endswith(".")


def test_values_arrive_where_they_belong(write):
    profile = load_profile(
        write("[joints]\ndelay_ms = -26\ngain_percent = [1, 2, 3, 4]\n[optics]\ndistortion = false")
    )
    assert profile.joints.delay_ms == -26
    assert profile.joints.gain_percent == (1, 2, 3, 4)
    assert profile.optics.distortion is False


WRONG = {
    "[joints]\nnoise_degree = 1": "joints.noise_degree",
    "[sensors]\nnoise_deg = 1": "sensors",
    "[joints]\nnoise_deg = -1": "joints.noise_deg = -1",
    "[joints]\nnoise_deg = 'much'": "joints.noise_deg = 'much'",
    "[joints]\ngain_percent = [1, 2]": "joints.gain_percent",
    "[joints]\ncounts_per_turn = 4096.5": "joints.counts_per_turn = 4096.5",
    "[joints]\nbacklash_deg = 90": "joints.backlash_deg = 90",
    "[joints]\ndelay_ms = 1000": "joints.delay_ms = 1000",
    "[mounting]\nbaseline_mm = 0": "mounting.baseline_mm = 0",
    "[image]\nnoise_grey = 300": "image.noise_grey = 300",
    "[image]\nblur_px = -1": "image.blur_px = -1",
    "[calibration]\nwide_lens = 'mirror'": "calibration.wide_lens = 'mirror'",
    "[[fitted]]\nname = 'x'": "fitted.0.value",
}


@pytest.mark.parametrize("text", WRONG)
def test_an_unknown_or_impossible_value_is_refused_by_name(write, text: str):
    with pytest.raises(VergenceError, match=r"mine\.toml is not an error profile") as caught:
        load_profile(write(text))
    field, _, found = WRONG[text].partition(" = ")
    assert f": {field}" in str(caught.value)
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["perfect", "Ideal", "", "ideal.yaml", "../ideal"])
def test_an_unknown_name_is_answered_with_the_known_ones(name: str):
    with pytest.raises(VergenceError, match=r"there are ideal, noise-only, paper"):
        load_profile(name)
