"""Readings are moved in time along what their neighbours say, and offsets are found to a part."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import plain_head, random_head
from simulated_recording import (
    BOARD,
    POINTS,
    Noise,
    facing,
    inside_image,
    moving_recording,
    still_recording,
)
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.calibration.observations import Observations
from vergence.data.timing import Timing, change, coefficients, moved_readings, rate, stencil
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import boxminus as head_difference
from vergence.geometry.projection import project_at
from vergence.geometry.se3 import boxminus, boxplus, pose, rotation, transform

SWING = 2 * np.pi  # 1 Hz
GAINS = [f"{eye}.{joint}_gain" for eye in ("left", "right") for joint in ("pan", "tilt")]


def swing(t: Array) -> Array:
    return 0.25 * np.cos(SWING * t[:, None] + np.arange(2))


def calibrated_motion(
    seed: int, noise: Noise, offset_s: float
) -> tuple[HeadCalibration, BundleEstimate]:
    """Return a random head and its calibration from eyes at rest and in motion for 3 s."""
    rng = np.random.default_rng([0, seed])
    truth = random_head(rng)
    how = {"wide_views": 10, "narrow_views": 8, "orientations": 20, "spread_rad": 0.25}
    still = still_recording(truth, rng, noise, **how)
    amplitude, frequency = rng.uniform(0.15, 0.25, 4), 2 * np.pi * rng.uniform(0.3, 1.0, 4)
    phase = rng.uniform(0, 2 * np.pi, 4)
    observed = moving_recording(
        truth,
        rng,
        noise,
        still,
        times_s=np.arange(90) / 30,
        gaze=lambda t: amplitude * np.cos(frequency * t[:, None] + phase),
        time_offset_s=offset_s,
    )
    start = calibrate_sequentially(observed.take(observed.at_rest)).head
    return replace(truth, time_offset_s=offset_s), bundle_adjust(start, observed)


@pytest.mark.parametrize("late_s", [-0.04, 0.04])
def test_motion_of_1_hz_at_30_hz_is_moved_by_40_ms_to_a_few_hundred_thousandths(late_s: float):
    t = np.arange(60) / 30
    moved = moved_readings(swing(t), Timing(t, np.ones(60, dtype=int)), late_s)
    np.testing.assert_allclose(moved[3:-3], swing(t + late_s)[3:-3], atol=3e-5 * 0.25)
    np.testing.assert_allclose(moved, swing(t + late_s), atol=1e-3 * 0.25)  # at the ends


@pytest.mark.parametrize("seconds", [-0.1, 0.0, 0.03])
def test_cubics_are_followed_exactly_even_with_gaps(seconds: float):
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 1, 40))
    powers = np.polynomial.Polynomial(rng.normal(size=4))
    course = coefficients(stencil(t, np.ones(40, dtype=int)), powers(t)[:, None])
    there = powers(t + seconds) - powers(t)
    np.testing.assert_allclose(change(course, seconds)[:, 0], there, atol=1e-6)
    np.testing.assert_allclose(rate(course, seconds)[:, 0], powers.deriv()(t + seconds), atol=1e-6)


def test_eyes_at_rest_and_other_motions_have_no_part_in_it():
    t = np.concatenate([np.zeros(5), np.arange(20) / 30, 0.7 + np.arange(20) / 30])
    run = np.repeat([0, 2, 5], [5, 20, 20])
    values = np.where(run[:, None] == 2, swing(t), 1e6)
    moved = moved_readings(values, Timing(t, run), 0.03) - values
    assert (moved[run == 0] == 0).all()
    np.testing.assert_allclose(moved[run == 5], 0, atol=1e-6)
    assert np.abs(moved[run == 2]).max() < 0.1


def test_a_view_at_rest_without_a_reading_leaves_the_others_as_they_are():
    t = np.concatenate([np.zeros(2), np.arange(20) / 30])
    run = np.repeat([0, 1], [2, 20])
    values = swing(t)
    expected = moved_readings(values, Timing(t, run), 0.03)
    values[0] = np.nan
    moved = moved_readings(values, Timing(t, run), 0.03)
    np.testing.assert_array_equal(moved[1:], expected[1:])


@pytest.mark.slow
@pytest.mark.parametrize("offset_ms", [-40, 40])
def test_offsets_are_found_to_half_a_millisecond_and_gains_to_a_thousandth(offset_ms: int):
    noise = Noise(pixel_px=0.05, joint_rad=np.radians(0.02))
    truth, found = calibrated_motion(0, noise, 1e-3 * offset_ms)
    error = head_difference(found.head, truth)
    stated = dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)), strict=True))
    assert abs(error["time_offset_s"]) < 0.5e-3
    assert max(abs(error[name]) for name in GAINS) < 1e-3
    assert all(abs(error[name]) < 4 * stated[name] for name in ("time_offset_s", *GAINS))
    # Nor are the readings at the ends of the motion held against a course through readings.
    assert not any(each.code == "wrong-view" for each in found.findings)


def turning(t: Array) -> Array:
    """Return poses (V, 2, 4, 4) of eyes on arms that swing and move."""
    phase = np.arange(6.0).reshape(2, 3)
    angles = 0.3 * np.cos(2.0 * t[:, None, None] + phase)
    return pose(rotation(angles), 0.1 * np.sin(1.5 * t[:, None, None] + phase))


@pytest.mark.parametrize("late_s", [-0.04, 0.04])
def test_poses_are_moved_in_time_as_angles_are(late_s: float):
    t = np.arange(60) / 30
    moved = moved_readings(turning(t), Timing(t, np.ones(60, dtype=int)), late_s)
    off = boxminus(moved, turning(t + late_s))
    assert np.abs(off[8:-8]).max() < 1e-7


@pytest.mark.slow
def test_the_offset_of_measured_poses_is_found():
    rng = np.random.default_rng(4)
    truth = plain_head(0.08, 300.0)
    still, moving, late_s = 30, 90, 0.04
    t = np.concatenate([np.zeros(still), np.arange(moving) / 30])
    run = np.repeat([0, 1], [still, moving])
    at_rest = pose(rotation(rng.uniform(-0.3, 0.3, (still, 3))), rng.uniform(-0.1, 0.1, (still, 3)))
    at_image = np.concatenate([at_rest, turning(t[still:] + late_s)[:, 0]])
    at_reading = np.concatenate([at_rest, turning(t[still:])[:, 0]])
    board = facing(np.array([0.55, 0.0, 0.0]), np.array([0.3, -0.3, 0.1]))
    corners = {}
    for name, mounted in truth.cameras.items():
        uv = project_at(mounted, truth.T_rbase_lbase, at_image, transform(board, POINTS)[None])
        seen = inside_image(uv)[..., None]
        corners[name] = np.where(seen, uv + rng.normal(0, 0.1, uv.shape), np.nan)
    noise = rng.normal(0, 2e-4, (len(t), 2, 6))
    seen = Observations(
        board=BOARD,
        placement=np.zeros(len(t), dtype=int),
        eye_angles=np.full((len(t), 4), np.nan),
        corners=corners,
        sizes=dict.fromkeys(corners, (640, 480)),
        timing=Timing(t, run),
        T_base_eye=boxplus(np.stack([at_reading, at_reading], axis=1), noise),
    )
    found = bundle_adjust(truth, seen)
    row = found.parameters.index("time_offset_s")
    std = np.sqrt(found.covariance[row, row])
    assert std < 1e-3
    assert abs(found.head.time_offset_s - late_s) < 4 * std
