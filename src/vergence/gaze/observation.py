"""From a frame to where the object is: by eye a ray, by both eyes a point and its tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYES_4, HEAD_JOINTS, NECK, commanded
from vergence.gaze.kalman import Track, begin, predict, surprise, update
from vergence.gaze.scatter import observe
from vergence.gaze.state import NARROW, WIDE, Settings, State
from vergence.geometry.camera import normalise
from vergence.geometry.head import T_base_cam, T_body_base
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import locate_with_covariance
from vergence.vision.sphere import find_sphere

EYE_ANGLES: dict[Side, slice] = {"left": slice(0, 2), "right": slice(2, 4)}
"""Pan and tilt of an eye among the four angles of both."""


def chain(settings: Settings, posture: Array) -> Array:
    """Return the neck's angles that the calibration's chain takes: none where it has none."""
    return posture[..., : len(settings.calibration.neck.axes)]


def see(settings: Settings, state: State, frame: Frame) -> State:
    """Find the object in a new frame's images, and the joints that do not follow.

    Args:
        settings: of the controller.
        state: before the frame; images that it did not ask for are left alone, and wide ones of
            an eye whose narrow one shows the object.
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
    stuck = at_rest & (np.abs(read - sent) > settings.stuck_rad)
    # A joint that was stuck is free again when it is where it was sent, at rest or not.
    still = np.isin(HEAD_JOINTS, state.stuck) & (np.abs(read - sent) > settings.stuck_rad)
    names = tuple(name for name, is_so in zip(HEAD_JOINTS, stuck | still, strict=True) if is_so)
    return replace(
        state,
        pixels=pixels,
        frame_s=frame.time_s,
        stuck=names,
        measured=None,
        measured_covariance=None,
    )


def _read_at_image(state: State, frame: Frame) -> Array:
    """Return readings (7,) carried from their own time to that of the image."""
    read = np.concatenate([frame.neck_angles, frame.eye_angles])
    if frame.time_s == frame.joint_time_s:
        return read
    sent = [commanded(state.commands, t) for t in (frame.joint_time_s, frame.time_s)]
    return read + sent[1] - sent[0]


def posture_at_image(settings: Settings, state: State, frame: Frame) -> Array:
    """Return where the joints (7,) were at the image, in the terms of commands.

    That is where they were sent: readings have noise and gains, which a loop that is closed by
    the image need not have. The neck is heavy, and lags; there and where a joint is stuck, the
    reading is the better one.
    """
    read = _read_at_image(state, frame)
    sent = commanded(state.commands, frame.time_s)
    use_reading = np.isin(HEAD_JOINTS, state.stuck)
    use_reading[NECK] = True
    return np.where(use_reading, read, sent)


def best_camera(pixels: Mapping[str, Array], eye: Side) -> str | None:
    """Return the camera of an eye that sees the object best, by where each sees it."""
    for lens in ("narrow", "wide"):
        pixel = pixels.get(f"{eye}_{lens}")
        if pixel is not None and np.isfinite(pixel).all():
            return f"{eye}_{lens}"
    return None


def rays_to(settings: Settings, state: State, posture: Array) -> dict[Side, tuple[Array, Array]]:
    """Return by eye that sees the object a ray in its base frame: from where, and where to."""
    rays: dict[Side, tuple[Array, Array]] = {}
    for eye in EYES:
        name = best_camera(state.pixels, eye)
        if name is None:
            continue
        xy = normalise(settings.calibration.camera(name).intrinsics, state.pixels[name])
        T = T_base_cam(settings.calibration, name, posture[EYES_4][EYE_ANGLES[eye]])
        rays[eye] = T[:3, 3], T[:3, :3] @ np.array([*xy, 1.0])
    return rays


def measure(settings: Settings, state: State, frame: Frame, posture: Array) -> State:
    """Bring both tracks up to a frame: the one to report by readings, the other by commands.

    Args:
        settings: of the controller.
        state: with the pixels of the frame.
        frame: the frame.
        posture: (7,) by commands, from `posture_at_image`.
    """
    found = _locate(settings, state, np.stack([_read_at_image(state, frame), posture]))
    if found is None:
        return replace(
            state,
            track=_ahead(settings, state.track, frame.time_s),
            aim=_ahead(settings, state.aim, frame.time_s),
        )
    read, sent = found
    scatter = observe(state.scatter, frame.time_s, *read)
    aim_scatter = observe(state.aim_scatter, frame.time_s, *sent)
    return replace(
        state,
        measured=read[0],
        measured_covariance=read[1],
        scatter=scatter,
        aim_scatter=aim_scatter,
        track=_fuse(settings, state.track, frame.time_s, *read, scatter.share),
        aim=_fuse(settings, state.aim, frame.time_s, *sent, aim_scatter.share),
    )


def aim_by_one_eye(
    settings: Settings, state: State, posture: Array, rays: Mapping[Side, tuple[Array, Array]]
) -> State:
    """Return the state with an aim on the ray of the only eye that sees the object.

    Unless the aim that there is lies near that ray: then it is the better one, as it knows the
    depth. Once both eyes see the object, the measurement takes over from the guess.

    Args:
        settings: of the controller.
        state: after `measure`.
        posture: (7,) at the frame.
        rays: by eye, from `rays_to`.
    """
    if len(rays) != 1:
        return state
    ((eye, (centre, ray)),) = rays.items()
    T_body_eye = T_body_base(settings.calibration, eye, chain(settings, posture))
    ray = ray / np.linalg.norm(ray)
    if state.aim is not None:
        away = transform(inverse(T_body_eye), state.aim.position) - centre
        if ray @ away > np.cos(settings.astray_rad) * np.linalg.norm(away):
            return state
    point = transform(T_body_eye, centre + settings.first_depth_m * ray)
    guess = (settings.first_depth_m / 3) ** 2 * np.eye(3)
    aim = _begin(settings, state.frame_s, point, guess)
    return replace(state, aim=aim, track=None)


def _locate(settings: Settings, state: State, postures: Array) -> list[tuple[Array, Array]] | None:
    """Return the object (3,) and its covariance (3, 3) in frame body, at postures (2, 7).

    The first posture is by readings, the second by commands.
    """
    left, right = (best_camera(state.pixels, eye) for eye in EYES)
    if left is None or right is None:
        return None
    pixels_l, pixels_r = (np.tile(state.pixels[name], (2, 1)) for name in (left, right))
    eyes, neck = postures[:, EYES_4], chain(settings, postures)
    points, covariances = locate_with_covariance(
        settings.calibration,
        pixels_l,
        pixels_r,
        eyes,
        pixel_std_px=settings.pixel_std_px,
        joint_std_rad=np.repeat([[settings.joint_std_rad], [settings.sent_std_rad]], 4, axis=1),
        cameras=(left, right),
    )
    if not np.isfinite(covariances).all():
        return None
    T = T_body_base(settings.calibration, "left", neck)
    R = T[:, :3, :3]
    covariances = R @ covariances @ np.swapaxes(R, 1, 2)
    return list(zip(transform(T, points), covariances, strict=True))


def _begin(settings: Settings, time_s: float, point: Array, covariance: Array) -> Track:
    return begin(
        time_s,
        point,
        covariance,
        speed_std_m_s=settings.speed_std_m_s,
        acceleration_std_m_s2=settings.acceleration_std_m_s2,
    )


def _ahead(settings: Settings, track: Track | None, time_s: float) -> Track | None:
    """Return a track at a time, if there is one."""
    return None if track is None else predict(track, time_s, jerk_density=settings.jerk_density)


def _fuse(
    settings: Settings,
    track: Track | None,
    time_s: float,
    point: Array,
    covariance: Array,
    share: float,
) -> Track:
    """Return a track at a time, after a measurement.

    Whether the measurement belongs to the track is judged by how wrong it may be; what it
    weighs, by how much measurements scatter: by its `share` of the covariance.
    """
    track = _ahead(settings, track, time_s)
    if track is None or surprise(track, point, covariance) > settings.surprise_limit:
        return _begin(settings, time_s, point, covariance)
    return update(track, point, share * covariance)
