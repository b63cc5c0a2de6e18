"""Measurements of the twin by projection, without images and physics: thousands of times faster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.geometry.head import HeadCalibration
from vergence.geometry.projection import project_point
from vergence.paper.figures import WIDE, Figure
from vergence.paper.replay import Measurements
from vergence.twin.calibration_sequence import BOARD, Shot, observations, project_board
from vergence.twin.profile import ErrorProfile
from vergence.twin.sensors import play, read


def simulate_views(
    truth: HeadCalibration,
    profile: ErrorProfile,
    shots: Sequence[Shot],
    *,
    pixel_noise: float,
    rng: np.random.Generator,
) -> Observations:
    """Return what `capture_views` would, with projected corners instead of rendered images.

    Of the profile only the joint sensors and the board are used. The noise of the corners is a
    standard deviation [px].
    """
    true_angles = np.array([shot.eye_angles for shot in shots])
    found = []
    for shot in shots:
        seen = {name: project_board(truth, BOARD, name, shot) for name in shot.cameras}
        found.append({n: uv + rng.normal(0, pixel_noise, uv.shape) for n, uv in seen.items()})
    return observations(truth, profile, shots, read(true_angles, profile.joints, rng), found)


def observe_points(
    truth: HeadCalibration,
    profile: ErrorProfile,
    figure: Figure,
    times_s: Array,
    *,
    pixel_noise: float = 0.0,
    rng: np.random.Generator,
) -> Measurements:
    """Simulate the measurements of a replay by projection, without images and physics.

    Only the joint sensors of the profile are used; times are (N,) [s], noise is a std [px].
    """
    delay = profile.joints.delay_ms * 1e-3
    at_image = eye_angles(figure.motion, times_s - max(0.0, -delay))
    at_reading = eye_angles(figure.motion, times_s - max(0.0, delay))
    if profile.joints.backlash_deg:  # taken up over one whole period beforehand
        lead = np.linspace(-PERIOD_S[figure.motion], 0, 4000)[:-1]
        width = np.radians(profile.joints.backlash_deg)
        wound = np.concatenate([eye_angles(figure.motion, lead), at_reading])
        at_reading = play(wound, width)[len(lead) :]
    readings = read(at_reading, profile.joints, rng)
    point = np.array(figure.mean_m)
    pixels = [project_point(truth, name, at_image, point) for name in WIDE]
    noisy = [uv + rng.normal(0, pixel_noise, uv.shape) for uv in pixels]
    return Measurements(times_s, readings, noisy[0], noisy[1])
