"""From a frame to the position of the object: a ray from each eye, a point and tracks from both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYES_4, HEAD_JOINTS, NECK, commanded, neck_chain
from vergence.gaze.kalman import Track, begin, fuse, predict, update_ratio
from vergence.gaze.state import NARROW, WIDE, GazeSettings, GazeState
from vergence.geometry.camera import normalise
from vergence.geometry.head import T_base_cam, T_body_base
from vergence.geometry.kinematics import EYE_COLUMNS, EYES, Side
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import locate_with_covariance
from vergence.vision.sphere import find_sphere


def detect_object(settings: GazeSettings, state: GazeState, frame: Frame) -> GazeState:
    """Return the state with the object's pixels in a new frame, and the joints that are stuck.

    Only requested images are searched, and an eye's wide image only where its narrow one does not
    show the object.

    Args:
        settings: of the controller.
        state: before the frame.
        frame: the frame.
    """
    pixels: dict[str, Array] = {}
    for name in (*NARROW, *WIDE):
        if name not in frame.images or name not in state.cameras:
            continue
        mounted = settings.calibration.camera(name)
        if best_camera(pixels, mounted.eye) is None:
            before = state.pixels.get(name)
            pixels[name] = find_sphere(frame.images[name], mounted.intrinsics, near=before)
    sent, earlier = (commanded(state.commands, frame.joint_time_s - ago) for ago in (0, 0.1))
    read = np.concatenate([frame.neck_angles, frame.eye_angles])
    at_rest = np.abs(sent - earlier) < settings.stuck_rad / 3
    was_stuck = np.isin(HEAD_JOINTS, state.stuck)
    # A stuck joint is free again once it is at its set point, at rest or not.
    stuck = (at_rest | was_stuck) & (np.abs(read - sent) > settings.stuck_rad)
    return replace(
        state,
        pixels=pixels,
        frame_s=frame.time_s,
        stuck=tuple(name for name, is_stuck in zip(HEAD_JOINTS, stuck, strict=True) if is_stuck),
        measured=None,
    )


def _readings_at_image(state: GazeState, frame: Frame) -> Array:
    """Return the joint readings (7,) [rad], moved from their own time to that of the image."""
    read = np.concatenate([frame.neck_angles, frame.eye_angles])
    if frame.time_s == frame.joint_time_s:
        return read
    sent = [commanded(state.commands, t) for t in (frame.joint_time_s, frame.time_s)]
    return read + sent[1] - sent[0]


def posture_at_image(state: GazeState, frame: Frame) -> Array:
    """Return the joint angles (7,) [rad] at the time of the image, as the commands had them.

    The set points are used because readings have noise and gains, which do not matter to a loop
    that is closed by the image. The heavy neck lags behind its set points: for the neck, and for
    joints that are stuck, the reading is the better one.
    """
    read = _readings_at_image(state, frame)
    sent = commanded(state.commands, frame.time_s)
    use_reading = np.isin(HEAD_JOINTS, state.stuck)
    use_reading[NECK] = True
    return np.where(use_reading, read, sent)


def best_camera(pixels: Mapping[str, Array], eye: Side) -> str | None:
    """Return the camera of an eye that shows the object best; None where neither shows it.

    Args:
        pixels: (2,) by camera, NaN where the object was not found.
        eye: which eye.
    """
    for lens in ("narrow", "wide"):
        pixel = pixels.get(f"{eye}_{lens}")
        if pixel is not None and np.isfinite(pixel).all():
            return f"{eye}_{lens}"
    return None


def rays_to(
    settings: GazeSettings, state: GazeState, posture: Array
) -> dict[Side, tuple[Array, Array]]:
    """Return the ray to the object for each eye that sees it.

    Args:
        settings: of the controller.
        state: with the pixels of a frame.
        posture: (7,) [rad] at the frame.

    Returns:
        By eye the origin (3,) [m] and the direction (3,) of the ray, in the eye's base frame.
    """
    rays: dict[Side, tuple[Array, Array]] = {}
    for eye in EYES:
        name = best_camera(state.pixels, eye)
        if name is None:
            continue
        xy = normalise(settings.calibration.camera(name).intrinsics, state.pixels[name])
        T = T_base_cam(settings.calibration, name, posture[EYES_4][EYE_COLUMNS[eye]])
        rays[eye] = T[:3, 3], T[:3, :3] @ np.array([*xy, 1.0])
    return rays


def measure(settings: GazeSettings, state: GazeState, frame: Frame, posture: Array) -> GazeState:
    """Return the state with both tracks at a frame: `track` by readings, `aim` by commands.

    Args:
        settings: of the controller.
        state: with the pixels of the frame.
        frame: the frame.
        posture: (7,) [rad] by commands, from `posture_at_image`.
    """
    found = _locate(settings, state, np.stack([_readings_at_image(state, frame), posture]))
    if found is None:
        return replace(
            state,
            track=_predicted(settings, state.track, frame.time_s),
            aim=_predicted(settings, state.aim, frame.time_s),
        )
    by_readings, by_commands = found
    ratio = update_ratio(state.innovation_ratio, frame.time_s, *by_readings)
    aim_ratio = update_ratio(state.aim_innovation_ratio, frame.time_s, *by_commands)
    track, aim = (
        fuse(
            before,
            frame.time_s,
            *measurement,
            motion=settings.motion,
            gate_chi2=settings.gate_chi2,
            innovation_ratio=ratio_now.value,
        )
        for before, measurement, ratio_now in (
            (state.track, by_readings, ratio),
            (state.aim, by_commands, aim_ratio),
        )
    )
    return replace(
        state,
        measured=by_readings[0],
        innovation_ratio=ratio,
        aim_innovation_ratio=aim_ratio,
        track=track,
        aim=aim,
    )


def aim_by_one_eye(
    settings: GazeSettings,
    state: GazeState,
    posture: Array,
    rays: Mapping[Side, tuple[Array, Array]],
) -> GazeState:
    """Return the state with an aim at an assumed depth, where only one eye sees the object.

    An aim that lies near that eye's ray is kept, because its depth is known better. Once both
    eyes see the object, the measurement replaces the assumption.

    Args:
        settings: of the controller.
        state: after `measure`.
        posture: (7,) [rad] at the frame.
        rays: by eye, from `rays_to`.
    """
    if len(rays) != 1:
        return state
    ((eye, (centre, ray)),) = rays.items()
    T_body_eye = T_body_base(settings.calibration, eye, neck_chain(settings.calibration, posture))
    ray = ray / np.linalg.norm(ray)
    if state.aim is not None:
        away = transform(inverse(T_body_eye), state.aim.position) - centre
        if ray @ away > np.cos(settings.aim_gate_rad) * np.linalg.norm(away):
            return state
    point = transform(T_body_eye, centre + settings.initial_depth_m * ray)
    covariance = (settings.initial_depth_m / 3) ** 2 * np.eye(3)
    aim = begin(state.frame_s, point, covariance, settings.motion)
    return replace(state, aim=aim, track=None)


def _locate(
    settings: GazeSettings, state: GazeState, postures: Array
) -> list[tuple[Array, Array]] | None:
    """Return the object (3,) [m] and its covariance (3, 3) [m^2] in frame body, by posture.

    None unless both eyes see the object and it can be located.

    Args:
        settings: of the controller.
        state: with the pixels of a frame.
        postures: (2, 7) [rad], the first by readings, the second by commands.
    """
    left, right = (best_camera(state.pixels, eye) for eye in EYES)
    if left is None or right is None:
        return None
    pixels_l, pixels_r = (np.tile(state.pixels[name], (2, 1)) for name in (left, right))
    joint_stds = [[settings.joint_std_rad], [settings.command_std_rad]]
    points, covariances = locate_with_covariance(
        settings.calibration,
        left=pixels_l,
        right=pixels_r,
        joints=postures[:, EYES_4],
        pixel_std_px=settings.pixel_std_px,
        joint_std_rad=np.repeat(joint_stds, 4, axis=1),
        cameras=(left, right),
    )
    if not np.isfinite(covariances).all():
        return None
    T = T_body_base(settings.calibration, "left", neck_chain(settings.calibration, postures))
    R = T[:, :3, :3]
    covariances = R @ covariances @ np.swapaxes(R, 1, 2)
    return list(zip(transform(T, points), covariances, strict=True))


def _predicted(settings: GazeSettings, track: Track | None, time_s: float) -> Track | None:
    """Return a track at a later time, if there is one."""
    if track is None:
        return None
    return predict(track, time_s, jerk_density=settings.motion.jerk_density)
