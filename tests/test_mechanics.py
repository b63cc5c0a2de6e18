"""Servos with play: backlash, and what joints of one reading differ by, beside gains and time."""

from dataclasses import replace

import numpy as np
import pytest

from other_heads import other_head
from simulated_head import as_designed, random_head
from simulated_recording import (
    Noise,
    Recording,
    facing,
    moving_recording,
    observe,
    record,
)
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.calibration.observations import Observations
from vergence.data.timing import taken_up
from vergence.findings import select
from vergence.geometry.head import HeadCalibration, dead_bands
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Kinematics, Side
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.twin.sensors import play

NOISE = Noise(pixel_px=0.1, joint_rad=np.radians(0.05))
TURNED = Recording(orientations=28, reach_rad=(0.3, 0.26), alike=False, noise=NOISE)
WIDTH = np.radians(0.6)


def estimate(seen: Observations) -> BundleEstimate:
    return bundle_adjust(calibrate_sequentially(seen.take(seen.at_rest)).head, seen)


def scores(found: BundleEstimate, truth: HeadCalibration, ending: str) -> list[float]:
    """Return errors of parameters in stated standard deviations."""
    off = boxminus(found.head, truth)
    std = dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)), strict=True))
    return [off[name] / std[name] for name in std if name.endswith(ending)]


def shuffled(seen: Observations, rng: np.random.Generator) -> Observations:
    """Return the postures in a random order, each reached from the one before."""
    turned = np.arange(TURNED.straight, len(seen.placement))
    order = np.concatenate([np.arange(TURNED.straight), rng.permutation(turned)])
    return replace(seen.take(order), last_motion=None)


def test_play_is_taken_up_in_the_sense_of_the_last_motion():
    path = np.array([0, 1, 3, 2.5, 2, 1.5, 1.75, 4.0, np.nan])[:, None]
    expected = [0, 1, 1, 0, -1, -1, -0.5, 1, 0]
    assert taken_up(path, np.array([1.0]))[:, 0] == pytest.approx(expected)


@pytest.mark.parametrize("width", [0.0, WIDTH, -WIDTH])
def test_backlash_does_not_pass_for_a_gain(width: float):
    rng = np.random.default_rng(1)
    truth = without_offsets(random_head(rng, lenses=("wide",)))
    seen = shuffled(record(truth, rng, TURNED), rng)
    found = estimate(replace(seen, eye_angles=seen.eye_angles + width / 2 * seen.last_motions()))
    assert np.abs(scores(found, truth, "_gain")).max() < 3.5
    for value, std in found.backlash_rad.values():
        assert abs(value - width) < 3.5 * std
    notes = select(found.findings, "note", code="backlash")
    assert len(notes) == (width != 0)
    assert not select(found.findings, "void", "warning")
    bands = dead_bands(replace(found.head, accuracy=found.accuracy))
    assert bands == pytest.approx(np.full(4, max(width, 0.0) / 2), abs=np.radians(0.08))
    least = np.hypot(NOISE.joint_rad, width / 2)
    assert found.joint_std == pytest.approx([least] * 2, rel=0.35)


@pytest.mark.parametrize("width", [0.0, WIDTH])
def test_backlash_does_not_pass_for_a_time_offset(width: float):
    rng = np.random.default_rng(2)
    truth = without_offsets(random_head(rng, lenses=("wide",)))
    still = shuffled(record(truth, rng, TURNED), rng)
    still = replace(still, eye_angles=still.eye_angles - width / 2 * still.last_motions())

    def gaze(t: Array) -> Array:
        pan, tilt = 0.24 * np.sin(2.5 * t), 0.2 * np.sin(1.9 * t + 1)
        return np.stack([pan, tilt, pan, tilt], axis=-1)

    times_s = np.arange(0, 5, 1 / 30)
    seen = moving_recording(
        truth, rng, NOISE, still, times_s=times_s, gaze=gaze, time_offset_s=0.045
    )
    fine_s = np.arange(-2, 5, 1e-3)  # the sensor lags behind the eye, as in the twin
    lag = np.zeros_like(gaze(fine_s)) if width == 0 else play(gaze(fine_s), width) - gaze(fine_s)
    lag = np.array([np.interp(times_s, fine_s, each) for each in lag.T]).T
    readings = seen.eye_angles.copy()
    readings[-len(times_s) :] += lag
    found = estimate(replace(seen, eye_angles=readings))
    assert not select(found.findings, "void")
    truth = replace(truth, time_offset_s=0.045)
    assert np.abs(scores(found, truth, "time_offset_s")).max() < 3.5
    assert np.abs(scores(found, truth, "_gain")).max() < 3.5
    for value, std in found.backlash_rad.values():
        assert abs(value + width) < 3.5 * std


@pytest.mark.parametrize("apart", [0.0, np.radians(0.3)])
def test_joints_that_share_a_reading_have_play_between_them(apart: float):
    rng = np.random.default_rng(3)
    truth = without_offsets(other_head("shared tilt, pan", rng))
    names = {eye: {"tilt": f"{eye}_tilt", "pan": f"{eye}_pan"} for eye in EYES}
    own: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(
            replace(joint, readings={names[eye][joint.name]: factor})
            for joint in truth.kinematics.eyes[eye]
            for factor in joint.readings.values()
        )
        for eye in EYES
    }
    straight, turned = 12, 40
    joints = np.zeros((straight + turned, 4))
    joints[straight:] = rng.uniform(-0.28, 0.28, (turned, 4))
    joints[:, 3] = joints[:, 1]
    read = joints[:, [1, 0, 2]]
    joints[straight + rng.permutation(turned)[:15], 3] += apart
    centre = np.array([0.5, -0.04, 0.0]) + rng.uniform(-0.07, 0.07, (straight + 1, 3))
    turns = rng.uniform(-0.5, 0.5, (straight + 1, 3))
    placement = np.minimum(np.arange(straight + turned), straight)
    seen = observe(
        replace(truth, kinematics=Kinematics(own, EYE_JOINTS)),
        rng,
        NOISE,
        placement=placement,
        T_lbase_target=facing(centre, turns)[placement],
        joints=joints,
    )
    noisy = read + rng.normal(0, NOISE.joint_rad, read.shape)
    design = as_designed(truth.kinematics)
    found = estimate(replace(seen, eye_angles=noisy, kinematics=design, last_motion=None))
    # Where the base stands above is left to the drawing: one reading tilts both eyes.
    assert {each.code for each in select(found.findings, "void", "warning")} <= {"unobservable"}
    assert np.abs(scores(found, truth, "_gain")).max() < 3.5
    std = max(std for name, std in found.levels.items() if name.startswith("play"))
    assert std == pytest.approx(apart * np.sqrt(15 / 52), rel=0.35, abs=np.radians(0.05))
    assert len(select(found.findings, "note", code="play")) == (apart > 0)
