"""Detect the object in a frame, and measure its position for the tracks of the controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.table import MAX_DELAY_S
from vergence.errors import VergenceError
from vergence.gaze.commands import HOLD_S, setpoints_at
from vergence.gaze.kalman import Track, begin, fuse, predict
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.camera import check_image_fits, unproject
from vergence.geometry.head import base_pose_in_body, camera_pose_in_base, without_accuracy
from vergence.geometry.kinematics import EYES, Side, checked_readings
from vergence.geometry.neck import checked_neck_angles
from vergence.geometry.se3 import inverse, transform
from vergence.self_calibration.calibrator import update_geometry
from vergence.self_calibration.frame import locate_in_frame
from vergence.stereo.uncertainty import locate
from vergence.vision.detector import Detection, Detector

Rays = Mapping[Side, tuple[Array, Array]]
"""By eye that sees the object: origin (3,) [m] and direction (3,) of the ray to it, in the eye's
base frame."""
Measurement = tuple[Array, Array]
"""A point (3,) [m] and its covariance (3, 3) [m^2], in frame body."""
_OLDEST_S = 10.0
"""Age of a frame above which its time stamp must be of another clock [s]."""


def detect_object(
    settings: GazeSettings, state: GazeState, frame: Frame, now_s: float
) -> GazeState:
    """Detect the object in a new frame, and the joints that are stuck.

    Of the requested images, the wide one of an eye is searched if the narrow one does not show the
    object, or if the geometry is seen by it. Raises VergenceError if the frame is not one of this
    head and its clock, or the detector returned something invalid.
    """
    late_s, apart_s = now_s - frame.time_s, abs(frame.time_s - frame.joint_time_s)
    if not (apart_s <= MAX_DELAY_S and -MAX_DELAY_S <= late_s <= _OLDEST_S):
        raise VergenceError(
            f"A frame of one clock is stamped at most {_OLDEST_S:g} s before the driver's now_s, "
            f"images and joint readings at most {MAX_DELAY_S:g} s apart; found "
            f"{frame.time_s:.6f} s of the images and {frame.joint_time_s:.6f} s of the readings, "
            f"at {now_s:.6f} s."
        )
    readings = _readings(settings, frame)
    if frame.images and not set(frame.images) & set(settings.cameras):
        raise VergenceError(
            f"The gaze uses the cameras {', '.join(settings.cameras)}, but the frame has images of "
            f"{', '.join(frame.images)} only; the driver must call cameras as the calibration does."
        )
    detections: dict[str, Detection | None] = {}
    for name in dict.fromkeys((*settings.narrow, *settings.wide)):
        requested = name in frame.images and name in state.cameras
        if not requested or not isinstance(state.target, str):
            continue
        eye = settings.calibration.camera(name).eye
        if best_view(settings, detections, eye) is None or settings.geometry == "seen":
            detector, earlier = settings.objects[state.target], state.detections
            detections[name] = detect(settings, detector, frame, name, earlier, target=state.target)
    views = [
        best_view(settings, found, eye)
        for found in (state.detections, detections)
        for eye in settings.eyes
    ]
    # At an assumed depth, two cameras of one eye place the object as if it had moved.
    moves = len(settings.eyes) == 1 and len({view[0] for view in views if view is not None}) > 1
    return replace(
        state,
        aim=None if moves else state.aim,
        detections=detections,
        frame_s=frame.time_s,
        stuck=_stuck_joints(settings, state, frame.joint_time_s, readings),
        measured=None,
    )


def detect(
    settings: GazeSettings,
    detector: Detector,
    frame: Frame,
    camera: str,
    earlier: Mapping[str, Detection | None],
    *,
    target: str,
) -> Detection | None:
    """Run a target's detector on one image of a frame, near the earlier detection of that camera.

    Raises VergenceError for an image of another size, or an invalid detection.
    """
    image, intrinsics = frame.images[camera], settings.calibration.camera(camera).intrinsics
    before = earlier.get(camera)
    if image is None:
        raise VergenceError(f"The image of {camera} is missing: leave such a camera out.")
    check_image_fits(camera, intrinsics, image.shape, whose="the frame's")
    found = detector(image, intrinsics, None if before is None else before.pixel)
    if found is None:
        return None
    pixel = np.asarray(found.pixel) if isinstance(found, Detection) else np.empty(0)
    if pixel.shape != (2,) or not np.isfinite(pixel).all() or not found.std_px > 0:
        raise VergenceError(
            f"The detector of {target!r} must return None or a Detection with two finite "
            f"coordinates and a standard deviation above 0; in {camera} it returned {found!r}."
        )
    return found


def _stuck_joints(
    settings: GazeSettings, state: GazeState, time_s: float, readings: Array
) -> tuple[str, ...]:
    """Name the joints at rest whose readings (j,) [rad] at a time are far from their set points."""
    sent, earlier = (setpoints_at(state.commands, time_s - ago) for ago in (0.0, HOLD_S))
    at_rest = np.abs(sent - earlier) < settings.stuck_rad / 3
    # A stuck joint is free again when it reaches its set point, at rest or not.
    suspect = at_rest | np.isin(settings.joints, state.stuck)
    stuck = suspect & (np.abs(readings - sent) > settings.stuck_rad)
    return tuple(name for name, is_stuck in zip(settings.joints, stuck, strict=True) if is_stuck)


def _readings(settings: GazeSettings, frame: Frame) -> Array:
    """Check a frame's readings (j,) [rad]."""
    eyes = checked_readings(settings.calibration.kinematics, frame.eye_angles, one_posture=True)
    return np.concatenate([checked_neck_angles(settings.calibration.neck, frame.neck_angles), eyes])


def readings_at_image(settings: GazeSettings, state: GazeState, frame: Frame) -> Array:
    """Extrapolate the joint readings (j,) [rad] to the time of the image by the commands.

    The delay is the calibrated time offset or, without one, the difference of the time stamps.
    """
    readings = _readings(settings, frame)
    earlier_s = settings.calibration.time_offset_s or frame.time_s - frame.joint_time_s
    if earlier_s == 0:
        return readings
    before, at_image = (
        setpoints_at(state.commands, time_s, settings.servo_lag_s)
        for time_s in (frame.time_s - earlier_s, frame.time_s)
    )
    return readings + at_image - before


def posture_at_image(settings: GazeSettings, state: GazeState, frame: Frame) -> Array:
    """Compute the joint angles (j,) [rad] at the time of the image from the commands.

    Those of the heavy neck, which lags, and of stuck joints are readings.
    """
    use_reading = np.isin(settings.joints, state.stuck)
    use_reading[settings.neck] = True
    by_commands = setpoints_at(state.commands, frame.time_s, settings.servo_lag_s)
    return np.where(use_reading, readings_at_image(settings, state, frame), by_commands)


def best_view(
    settings: GazeSettings, detections: Mapping[str, Detection | None], eye: Side
) -> tuple[str, Detection] | None:
    """Select the camera of an eye that shows the object, the narrow one first; None: no camera."""
    cameras = settings.eyes.get(eye)
    for name in (cameras.narrow, cameras.wide) if cameras else ():
        found = detections.get(name)
        if found is not None:
            return name, found
    return None


def object_rays(settings: GazeSettings, state: GazeState, posture: Array) -> Rays:
    """Compute the ray to the object for each eye that sees it, at a posture (j,) [rad]."""
    rays: dict[Side, tuple[Array, Array]] = {}
    for eye in settings.eyes:
        view = best_view(settings, state.detections, eye)
        if view is not None:
            name, found = view
            ray = unproject(settings.calibration.camera(name).intrinsics, found.pixel)
            T = camera_pose_in_base(settings.calibration, name, posture[settings.readings])
            rays[eye] = T[:3, 3], T[:3, :3] @ ray
    return rays


def measure_object(
    settings: GazeSettings, state: GazeState, frame: Frame, posture: Array
) -> GazeState:
    """Update both tracks by stereo: `track` at the readings, `aim` at the posture (j,) [rad].

    A frame that shows the geometry leaves `track` to `update_track`.
    """
    by_sight = settings.geometry == "seen" and set(settings.wide) <= set(frame.images)
    readings = readings_at_image(settings, state, frame)
    by_readings, by_commands = _locate(settings, state, np.stack([readings, posture]))
    state = replace(state, aim=_fuse(settings, state.aim, frame, by_commands))
    if by_sight:
        return replace(state, measured=None if by_readings is None else by_readings[0])
    return _with_measurement(settings, state, frame, by_readings)


def update_track(settings: GazeSettings, state: GazeState, frame: Frame | None) -> GazeState:
    """Update the head geometry and `track` by what both wide images of a step's frame show.

    Call it after the step's command was sent: it takes longer than the step, and steering does not
    need it. Raises VergenceError as `self_calibration.calibrator.update_geometry` does.
    """
    if state.geometry is None or frame is None or state.seen_s != frame.time_s:
        return state
    if state.geometry.time_s == frame.time_s or not set(settings.wide) <= set(frame.images):
        return state
    readings = readings_at_image(settings, state, frame)
    geometry = update_geometry(state.geometry, frame, readings[settings.readings])
    state, seen = replace(state, geometry=geometry), geometry.latest
    if seen is None or not isinstance(state.target, str):
        return state
    measurement = None
    # What was learned holds for the mountings of the wide cameras, which therefore come first.
    for cameras in (settings.wide, settings.narrow):
        left, right = (state.detections.get(name) for name in cameras)
        if left is None or right is None:
            continue
        where = locate_in_frame(
            seen,
            left=left.pixel[None],
            right=right.pixel[None],
            pixel_std_px=np.repeat([left.std_px, right.std_px], 2),
            cameras=(cameras[0], cameras[1]),
        )
        if np.isfinite(where.covariance).all():
            T = base_pose_in_body(seen.head, "left", readings)
            covariance = T[:3, :3] @ where.covariance[0] @ T[:3, :3].T
            measurement = transform(T, where.xyz[0]), covariance
        break
    return _with_measurement(settings, state, frame, measurement)


def _with_measurement(
    settings: GazeSettings, state: GazeState, frame: Frame, measurement: Measurement | None
) -> GazeState:
    """Update or, without a measurement, predict `track` at the time of a frame."""
    track = _fuse(settings, state.track, frame, measurement)
    return replace(state, measured=None if measurement is None else measurement[0], track=track)


def _fuse(
    settings: GazeSettings, track: Track | None, frame: Frame, measurement: Measurement | None
) -> Track | None:
    if measurement is not None:
        return fuse(track, frame.time_s, *measurement, motion=settings.motion)
    if track is not None:
        return predict(track, frame.time_s, jerk_density=settings.motion.jerk_density)
    return None


def _locate(
    settings: GazeSettings, state: GazeState, postures: Array
) -> tuple[Measurement | None, Measurement | None]:
    """Locate the object by stereo at the readings and at the commands: postures (2, j) [rad]."""
    left, right = (best_view(settings, state.detections, eye) for eye in EYES)
    if left is None or right is None:
        return None, None
    readings = postures[:, settings.readings]
    joint_stds = [[settings.reading_std], [settings.command_std_rad]]
    located = locate(
        without_accuracy(settings.calibration),
        left=np.tile(left[1].pixel, (2, 1)),
        right=np.tile(right[1].pixel, (2, 1)),
        joints=readings,
        pixel_std_px=np.repeat([left[1].std_px, right[1].std_px], 2),
        reading_std=np.repeat(joint_stds, readings.shape[1], axis=1),
        cameras=(left[0], right[0]),
    )
    if not np.isfinite(located.covariance).all():
        return None, None
    T = base_pose_in_body(settings.calibration, "left", postures)
    R = T[:, :3, :3]
    points, covariances = transform(T, located.xyz), R @ located.covariance @ np.swapaxes(R, 1, 2)
    return (points[0], covariances[0]), (points[1], covariances[1])


def aim_at_assumed_depth(
    settings: GazeSettings, state: GazeState, posture: Array, rays: Rays
) -> GazeState:
    """Aim along one eye's ray at an assumed depth, where the frame gave no measurement.

    An aim near the ray is kept, since its depth is known better. On a head with one eye the points
    at the assumed depth are fused over time to follow a motion.
    """
    if state.measured is not None:
        return state
    eye, (centre, ray) = next(iter(rays.items()))
    T_body_eye = base_pose_in_body(settings.calibration, eye, posture)
    ray = ray / np.linalg.norm(ray)
    depth_m = settings.initial_depth_m
    point = transform(T_body_eye, centre + depth_m * ray)
    depth_variance = (depth_m / 3) ** 2
    if len(settings.eyes) == 1:
        view = best_view(settings, state.detections, eye)
        assert view is not None  # the eye has a ray
        focal_px = settings.calibration.camera(view[0]).intrinsics.matrix[0, 0]
        across = (depth_m * np.hypot(view[1].std_px / focal_px, settings.command_std_rad)) ** 2
        ray_body = T_body_eye[:3, :3] @ ray
        covariance = across * np.eye(3) + (depth_variance - across) * np.outer(ray_body, ray_body)
        aim = fuse(state.aim, state.frame_s, point, covariance, motion=settings.motion)
        return replace(state, aim=aim)
    if state.aim is not None:
        away = transform(inverse(T_body_eye), state.aim.position) - centre
        if ray @ away > np.cos(settings.aim_gate_rad) * np.linalg.norm(away):
            return state
    aim = begin(state.frame_s, point, depth_variance * np.eye(3), settings.motion)
    return replace(state, aim=aim, track=None)
