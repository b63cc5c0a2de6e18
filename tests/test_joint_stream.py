"""Readings at a rate of their own give the time offset, whatever the rate of the images."""

from dataclasses import replace

import numpy as np
import pytest

from drawn_bag import JOINT_NS, MAP, START_NS, messages, two_eyes, usual, write_bag
from simulated_head import random_head
from simulated_recording import Noise, moving_recording, still_recording
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.data.reader import load_dataset
from vergence.data.timing import JointStream, Timing, moved_readings
from vergence.geometry.parameters import boxminus
from vergence.recordings.import_recording import import_recording
from vergence.recordings.readings import interpolate
from vergence.recordings.recording_map import load_map
from vergence.recordings.scan import Track

OFFSET_S = 0.045


def stream_of(rng: np.random.Generator, gaze, until_s: float, noise_rad: float) -> JointStream:
    """Return readings at 97 Hz of which a tenth is missing."""
    t = np.arange(0, until_s, 1 / 97)
    t = t[rng.random(len(t)) > 0.1]
    return JointStream(t, gaze(t) + rng.normal(0, noise_rad, (len(t), 4)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_hz", "with_stream", "seed"),
    [(30, False, 1), (5, True, 2)],
)
def test_a_latency_of_45_ms_is_found_among_readings_at_97_hz_with_gaps(
    rate_hz: int, with_stream: bool, seed: int
):
    rng, noise_rad = np.random.default_rng([7, seed]), np.radians(0.1)
    truth = random_head(rng)
    how = {"wide_views": 10, "narrow_views": 8, "orientations": 20, "spread_rad": 0.25}
    still = still_recording(truth, rng, Noise(0.1, noise_rad), **how)
    amplitude, frequency = rng.uniform(0.15, 0.25, 4), 2 * np.pi * rng.uniform(0.3, 1.0, 4)
    phase = rng.uniform(0, 2 * np.pi, 4)

    def gaze(t: Array) -> Array:
        return amplitude * np.cos(frequency * t[:, None] + phase)

    t = 0.5 + np.arange(90) / rate_hz
    stream = stream_of(rng, gaze, t[-1] + 0.5, noise_rad)
    moving = moving_recording(
        truth, rng, Noise(0.1), still, times_s=t, gaze=gaze, time_offset_s=OFFSET_S
    )
    stamp_ns, at_ns = (np.round(each * 1e9).astype(np.int64) for each in (stream.time_s, t))
    readings = moving.eye_angles.copy()
    for k, values in enumerate(stream.readings.T):
        readings[-len(t) :, k] = interpolate(
            Track(stamp_ns, stamp_ns, values), at_ns, max_gap_s=0.1
        )
    assert moving.timing is not None
    timing = replace(moving.timing, stream=stream if with_stream else None)
    seen = replace(moving, eye_angles=readings, timing=timing)
    start = calibrate_sequentially(seen.take(seen.at_rest)).head
    found = bundle_adjust(start, seen)
    error = boxminus(found.head, replace(truth, time_offset_s=OFFSET_S))["time_offset_s"]
    row = found.parameters.index("time_offset_s")
    assert abs(error) < 0.5e-3
    assert abs(error) < 4 * np.sqrt(found.covariance[row, row])


def test_a_recording_is_imported_with_the_readings_around_its_motions(tmp_path):
    session = replace(usual(1, 3), move_ns=10**9)
    write_bag(tmp_path / "bag", messages(session, two_eyes()))
    spans = "rest = [[1.5, 2.0], [3.0, 3.5]]\nmoving = [[2.1, 2.9]]\nplacements = [[1.5, 3.5]]\n"
    (tmp_path / "map.toml").write_text(f"{MAP}\n[frames]\n{spans}")
    import_recording(tmp_path / "bag", load_map(tmp_path / "map.toml"), tmp_path / "set")
    dataset = load_dataset(tmp_path / "set")
    assert dataset.stream is not None
    # Of floats of seconds since 1970 the last digit is 0.2 us.
    at_ns = (dataset.stream.time_s * 1e9).astype(np.int64) - START_NS
    expected = [session.angles_at(max(0, t)) for t in at_ns.tolist()]
    np.testing.assert_allclose(dataset.stream.readings, expected, atol=1e-6)
    near = np.abs(dataset.stream.time_s[:, None] - dataset.time_s[dataset.moving]).min(axis=0)
    assert len(near)
    assert near.max() < JOINT_NS * 1e-9


def test_readings_at_5_hz_are_moved_along_the_samples_of_a_stream():
    def swing(t: Array) -> Array:
        return 0.25 * np.cos(2 * np.pi * t[:, None] + np.arange(4))

    rng = np.random.default_rng(0)
    t, run = 0.5 + np.arange(10) / 5, np.repeat([1, 2, 0], [4, 4, 2])
    timing = Timing(t, run, stream_of(rng, swing, 3.0, 0.0))
    moved = moved_readings(swing(t), timing, OFFSET_S)
    np.testing.assert_allclose(moved[run > 0], swing(t + OFFSET_S)[run > 0], atol=1e-5)
    np.testing.assert_array_equal(moved[run == 0], swing(t)[run == 0])
    some = run != 1
    part = moved_readings(swing(t)[some], timing.take(some), OFFSET_S)
    np.testing.assert_allclose(part, moved[some], atol=1e-6)
