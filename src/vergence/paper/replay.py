"""Replay one of the paper's figures: the eyes move, a fixed object is located all the while.

The same estimation runs on rendered images and, for studies of many error sources, on projected
points without images.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.geometry.camera import project
from vergence.geometry.head import HeadCalibration, T_base_cam
from vergence.geometry.kinematics import NECK_JOINTS
from vergence.geometry.se3 import inverse, transform
from vergence.paper.figures import Figure
from vergence.paper.statistics import Statistics, describe
from vergence.paper.trajectories import PERIOD_S, default_duration_s, eye_angles
from vergence.stereo.triangulation import Located, locate
from vergence.twin.head import Exposure, Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.sensors import play, read
from vergence.vision.sphere import find_sphere

SAMPLES = 640
"""Samples of a figure, evenly over its duration; at 600 the spreads vary by 2-3 % with the seed."""
WIDE = ("left_wide", "right_wide")
_LEAD_S = 1.0  # the eyes reach the trajectory before the first sample


@dataclass(frozen=True, eq=False)
class Observations:
    """What was measured in N samples."""

    time_s: Array
    """(N,)."""
    eye_angles: Array
    """(N, 4) joint readings."""
    pixels_l: Array
    """(N, 2) the object's centre in the left wide image; NaN: not found."""
    pixels_r: Array
    """(N, 2) in the right one."""


@dataclass(frozen=True, eq=False)
class Replay:
    """One figure, replayed."""

    figure: Figure
    object_m: Array
    """(3,) where the object truly is."""
    observations: Observations
    located: Located
    statistics: Statistics


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample with its truth, for those who look on."""

    index: int
    time_s: float
    frame: Frame
    detected: dict[str, Array]
    """By camera: (2,) px."""
    truth: dict[str, Array]
    """By camera: (2,) px, where the object's centre truly is; NaN: behind the camera."""
    body_poses: dict[str, Array]


def sample_times(figure: Figure, duration_s: float | None, rate_hz: float | None) -> Array:
    """Return the times (N,) of a figure's samples; left out: its duration and SAMPLES samples."""
    duration = default_duration_s(figure.motion) if duration_s is None else duration_s
    count = SAMPLES if rate_hz is None else max(2, round(duration * rate_hz))
    # Whole milliseconds, since the physics steps in them.
    return np.round(np.arange(count) * duration / count, 3)


def replay(
    twin: Twin,
    calibration: HeadCalibration,
    figure: Figure,
    times_s: Array,
    *,
    watch: Callable[[Sample], None] | None = None,
    pictures_every: int = 1,
    done: Callable[[], None] = lambda: None,
) -> Replay:
    """Replay a figure on rendered images.

    Args:
        twin: the head, with the figure's lens.
        calibration: what is believed of the head.
        figure: which one.
        times_s: (N,) of the samples, rising.
        watch: is shown the samples in their order, from another thread.
        pictures_every: every so manieth sample has the pictures of all cameras; the others are
            rendered only where they are needed, by the wide ones.
        done: called after each sample.
    """
    start = _LEAD_S
    twin.restart(figure.number)
    twin.place_object(np.array(figure.mean_m))

    def command(time_s: float) -> Array:
        angles = eye_angles(figure.motion, np.array(time_s - start))
        return np.concatenate([np.zeros(len(NECK_JOINTS)), angles])

    twin.advance(start / 2, command(start))  # to the first posture
    pending: list[Future[tuple[Array, dict[str, Array]]]] = []
    # One worker: pictures are developed and searched while the next ones render.
    with ThreadPoolExecutor(max_workers=1) as worker:
        try:
            for index, time_s in enumerate(times_s):
                twin.advance(start + time_s, command)
                pictured = watch is not None and index % pictures_every == 0
                exposure = twin.expose(tuple(twin.truth.cameras) if pictured else WIDE)
                if len(pending) > index - 3 >= 0:
                    pending[index - 3].result()  # keeps few pictures in memory, shows errors early
                truth = (twin.true_angles(), twin.true_object(), twin.body_poses())
                pending.append(
                    worker.submit(
                        _observe, twin, calibration, exposure, index, time_s, watch, truth
                    )
                )
                done()
        except BaseException:
            worker.shutdown(cancel_futures=True)
            raise
        results = [future.result() for future in pending]
    observations = Observations(
        time_s=times_s,
        eye_angles=np.array([angles for angles, _ in results]),
        pixels_l=np.array([pixels[WIDE[0]] for _, pixels in results]),
        pixels_r=np.array([pixels[WIDE[1]] for _, pixels in results]),
    )
    return estimate(calibration, figure, np.array(figure.mean_m), observations)


def _observe(
    twin: Twin,
    calibration: HeadCalibration,
    exposure: Exposure,
    index: int,
    time_s: float,
    watch: Callable[[Sample], None] | None,
    truth: tuple[Array, Array, dict[str, Array]],
) -> tuple[Array, dict[str, Array]]:
    """Develop and search the pictures of one exposure; show them to who watches."""
    frame = twin.develop(exposure)
    detected = {
        name: find_sphere(image, calibration.camera(name).intrinsics)
        for name, image in frame.images.items()
    }
    if watch is not None:
        angles, where, body_poses = truth
        eyes = angles[len(NECK_JOINTS) :]
        shown = {name: see(twin.truth, name, eyes[None], where)[0] for name in frame.images}
        watch(Sample(index, time_s, frame, detected, shown, body_poses))
    return frame.eye_angles, detected


def estimate(
    calibration: HeadCalibration, figure: Figure, object_m: Array, observations: Observations
) -> Replay:
    """Locate all samples and describe them: the part that rendered and point runs share."""
    located = locate(
        calibration, observations.pixels_l, observations.pixels_r, observations.eye_angles
    )
    return Replay(figure, object_m, observations, located, describe(located.points))


def see(head: HeadCalibration, camera: str, eyes: Array, point: Array) -> Array:
    """Return the pixels (N, 2) of a point (3,) in the left base frame at eye angles (N, 4)."""
    mounted = head.camera(camera)
    left = mounted.eye == "left"
    in_base = point if left else transform(head.T_rbase_lbase, point)
    T = inverse(T_base_cam(head, camera, eyes[:, :2] if left else eyes[:, 2:]))
    return project(mounted.intrinsics, transform(T, in_base))


def observe_points(
    truth: HeadCalibration,
    profile: ErrorProfile,
    figure: Figure,
    times_s: Array,
    *,
    pixel_noise: float = 0.0,
    rng: np.random.Generator,
) -> Observations:
    """Return what a run would measure, without images and physics: for studies of many cases.

    Args:
        truth: the true head.
        profile: for its joint sensors.
        figure: which motion and object.
        times_s: (N,).
        pixel_noise: standard deviation of the object's position in the images [px].
        rng: of both noises.
    """
    delay = profile.joints.delay_ms * 1e-3
    at_image = eye_angles(figure.motion, times_s - max(0.0, -delay))
    at_reading = eye_angles(figure.motion, times_s - max(0.0, delay))
    if profile.joints.backlash_deg:  # wound through one whole period before
        lead = np.linspace(-PERIOD_S[figure.motion], 0, 4000)[:-1]
        width = np.radians(profile.joints.backlash_deg)
        wound = np.concatenate([eye_angles(figure.motion, lead), at_reading])
        at_reading = play(wound, width)[len(lead) :]
    readings = read(at_reading, profile.joints, rng)
    point = np.array(figure.mean_m)
    pixels = [see(truth, name, at_image, point) for name in WIDE]
    noisy = [uv + rng.normal(0, pixel_noise, uv.shape) for uv in pixels]
    return Observations(times_s, readings, noisy[0], noisy[1])
