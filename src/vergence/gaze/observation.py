"""From a frame to the position of the object: a ray from each eye, a point and tracks from both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.table import MAX_DELAY_S
from vergence.errors import VergenceError
from vergence.gaze.commands import EYE_READINGS, NECK, commanded, followed
from vergence.gaze.kalman import InnovationRatio, Track, begin, fuse, predict, update_ratio
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.camera import Camera, check_image_fits, unproject
from vergence.geometry.head import T_base_cam, T_body_base
from vergence.geometry.kinematics import EYES, Side, checked_readings
from vergence.geometry.neck import checked_neck_angles
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import locate_with_covariance
from vergence.vision.detector import Detection, Detector

Rays = Mapping[Side, tuple[Array, Array]]
"""By eye that sees the object: origin (3,) [m] and direction (3,) of the ray to it, in the eye's
base frame."""
_OLDEST_S = 10.0
"""Age of a frame from which its time stamp is taken for that of another clock."""


def check_times(frame: Frame, now_s: float) -> None:
    """Raise VergenceError if time stamps are not finite, or not of the clock that now_s is of."""
    image_s, joint_s = frame.time_s, frame.joint_time_s
    if not np.isfinite(np.array([image_s, joint_s, now_s], float)).all():
        raise VergenceError(
            f"Time stamps are finite; found {image_s} s of the images and {joint_s} s of the joint "
            f"readings, at {now_s} s."
        )
    if abs(image_s - joint_s) > MAX_DELAY_S:
        raise VergenceError(
            "Images and joint readings are stamped by one clock, and differ by at most "
            f"{MAX_DELAY_S:g} s; found {image_s:.6f} s of the images and {joint_s:.6f} s of the "
            "readings."
        )
    if not -MAX_DELAY_S <= now_s - image_s <= _OLDEST_S:
        raise VergenceError(
            f"The frame is stamped {abs(image_s - now_s):.3f} s "
            f"{'after' if image_s > now_s else 'before'} now; the driver's clock (`now_s`) is the "
            "one that stamps its frames."
        )


def detect_object(settings: GazeSettings, state: GazeState, frame: Frame) -> GazeState:
    """Return the state with the object's pixels in a new frame, and the joints that are stuck.

    Only requested images are searched, and an eye's wide image only where its narrow one does not
    show the object, or where the geometry is seen by it; none, while a point is looked at.

    Raises:
        VergenceError: the frame's readings are not those of this head, its images are those of
            other cameras, or of another size than the calibration's, or the detector returned
            something else than it may.
    """
    read = _readings(settings, frame)
    detections: dict[str, Detection | None] = {}
    if frame.images and not set(frame.images) & set(settings.cameras):
        raise VergenceError(
            f"The gaze uses the cameras {', '.join(settings.cameras)}, but the frame has images of "
            f"{', '.join(frame.images)} only; the driver must call cameras as the calibration does."
        )
    for name in dict.fromkeys((*settings.narrow, *settings.wide)):
        if not isinstance(state.target, str):
            break
        if name not in frame.images or name not in state.cameras:
            continue
        eye = settings.calibration.camera(name).eye
        if best_view(settings, detections, eye) is None or settings.geometry == "seen":
            before = state.detections.get(name)
            near = None if before is None else before.pixel
            detector = settings.objects[state.target]
            found = detect(settings, detector, frame, name, near, target=state.target)
            detections[name] = found
    sent, earlier = (commanded(state.commands, frame.joint_time_s - ago) for ago in (0, 0.1))
    at_rest = np.abs(sent - earlier) < settings.stuck_rad / 3
    was_stuck = np.isin(settings.joints, state.stuck)
    # A stuck joint is free again once it is at its set point, at rest or not.
    stuck = (at_rest | was_stuck) & (np.abs(read - sent) > settings.stuck_rad)
    return replace(
        state,
        aim=None if _seen_by_another(settings, state.detections, detections) else state.aim,
        detections=detections,
        frame_s=frame.time_s,
        stuck=tuple(
            name for name, is_stuck in zip(settings.joints, stuck, strict=True) if is_stuck
        ),
        measured=None,
        by_joints=None,
    )


def detect(
    settings: GazeSettings,
    detector: Detector,
    frame: Frame,
    camera: str,
    near: Array | None,
    *,
    target: str,
) -> Detection | None:
    """Return what a detector finds in one image of a frame, checked.

    VergenceError if the image is not of the calibration's size, or the detector, which is called
    by the name of its target in the message, returns something else than a `Detector` does.
    """
    image, intrinsics = frame.images[camera], settings.calibration.camera(camera).intrinsics
    if image is None:
        raise VergenceError(f"The image of {camera} is None; leave out cameras that gave none.")
    check_image_fits(camera, intrinsics, image.shape, whose="the frame's")
    found = detector(image, intrinsics, near)
    if found is None:
        return None
    pixel = np.asarray(found.pixel) if isinstance(found, Detection) else np.empty(0)
    if pixel.shape != (2,) or not np.isfinite(pixel).all() or not found.std_px > 0:
        raise VergenceError(
            f"The detector of {target!r} must return None or a Detection with two finite "
            f"coordinates and a standard deviation above 0; in {camera} it returned {found!r}."
        )
    return found


def _seen_by_another(
    settings: GazeSettings,
    before: Mapping[str, Detection | None],
    now: Mapping[str, Detection | None],
) -> bool:
    """Return whether the only eye in use sees the object by another camera than before.

    At an assumed depth two cameras place it differently, which must not be taken for a motion.
    """
    if len(settings.eyes) > 1:
        return False
    views = [best_view(settings, seen, eye) for seen in (before, now) for eye in settings.eyes]
    return len({view[0] for view in views if view is not None}) > 1


def _readings(settings: GazeSettings, frame: Frame) -> Array:
    """Return a frame's readings (j,) [rad]; VergenceError if they are not those of this head."""
    eyes = checked_readings(settings.calibration.kinematics, frame.eye_angles, one_posture=True)
    return np.concatenate([checked_neck_angles(frame.neck_angles), eyes])


def readings_at_image(settings: GazeSettings, state: GazeState, frame: Frame) -> Array:
    """Return the joint readings (j,) [rad], moved from their own time to that of the image.

    By as much as the servos have followed the commands meanwhile. How much earlier a reading shows
    the joints than the image does is the calibrated time offset or, without one, what the time
    stamps say.
    """
    read = _readings(settings, frame)
    earlier_s = settings.calibration.time_offset_s or frame.time_s - frame.joint_time_s
    if earlier_s == 0:
        return read
    moments, lag_s = (frame.time_s - earlier_s, frame.time_s), settings.servo_lag_s
    before, then = (followed(state.commands, time_s, lag_s) for time_s in moments)
    return read + then - before


def posture_at_image(settings: GazeSettings, state: GazeState, frame: Frame) -> Array:
    """Return the joint angles (j,) [rad] at the time of the image, as the commands had them.

    The set points are used because readings have noise and gains, which do not matter to a loop
    that is closed by the image. The heavy neck lags behind its set points: for the neck, and for
    joints that are stuck, the reading is the better one.
    """
    use_reading = np.isin(settings.joints, state.stuck)
    use_reading[NECK] = True
    by_set_points = followed(state.commands, frame.time_s, settings.servo_lag_s)
    return np.where(use_reading, readings_at_image(settings, state, frame), by_set_points)


def best_view(
    settings: GazeSettings, detections: Mapping[str, Detection | None], eye: Side
) -> tuple[str, Detection] | None:
    """Return the camera of an eye that shows the object best, and where; None: no camera does."""
    cameras = settings.eyes.get(eye)
    for name in (cameras.narrow, cameras.wide) if cameras else ():
        found = detections.get(name)
        if found is not None:
            return name, found
    return None


def is_central(camera: Camera, pixel: Array, share: float) -> bool:
    """Return whether a pixel (2,) is in an image's central part: a share of width and height."""
    size = np.array(camera.size)
    return bool((np.abs(2 * pixel + 1 - size) / size < share).all())


def rays_to(settings: GazeSettings, state: GazeState, posture: Array) -> Rays:
    """Return the ray to the object for each eye that sees it, at a posture (j,) [rad]."""
    rays: dict[Side, tuple[Array, Array]] = {}
    for eye in settings.eyes:
        view = best_view(settings, state.detections, eye)
        if view is None:
            continue
        name, seen = view
        ray = unproject(settings.calibration.camera(name).intrinsics, seen.pixel)
        T = T_base_cam(settings.calibration, name, posture[EYE_READINGS])
        rays[eye] = T[:3, 3], T[:3, :3] @ ray
    return rays


def measure(settings: GazeSettings, state: GazeState, frame: Frame, posture: Array) -> GazeState:
    """Return the state with both tracks at a frame: `track` by readings, `aim` by commands.

    The posture (j,) [rad] by commands is from `posture_at_image`. Where the frame shows the
    geometry, `track` is left to `seen_position.see_position`.
    """
    motion, time_s = settings.motion, frame.time_s
    by_sight = settings.geometry == "seen" and set(settings.wide) <= set(frame.images)
    found = _locate(settings, state, np.stack([readings_at_image(settings, state, frame), posture]))
    if found is None:
        aim = state.aim
        aim = None if aim is None else predict(aim, time_s, jerk_density=motion.jerk_density)
        state = replace(state, aim=aim)
        return state if by_sight else predict_track(settings, state, frame)
    by_readings, by_commands = found
    aim, aim_ratio = _fused(settings, state.aim, state.aim_innovation_ratio, time_s, *by_commands)
    state = replace(state, aim=aim, aim_innovation_ratio=aim_ratio)
    if by_sight:
        return replace(state, by_joints=by_readings[0])
    return fuse_measurement(settings, state, frame, *by_readings)


def fuse_measurement(
    settings: GazeSettings, state: GazeState, frame: Frame, point: Array, covariance: Array
) -> GazeState:
    """Return the state whose `track` has a frame's measurement, (3,) and (3, 3) in frame body."""
    track, ratio = _fused(
        settings, state.track, state.innovation_ratio, frame.time_s, point, covariance
    )
    return replace(state, measured=point, track=track, innovation_ratio=ratio)


def predict_track(settings: GazeSettings, state: GazeState, frame: Frame) -> GazeState:
    """Return the state whose `track` is predicted to the time of a frame without a measurement."""
    if state.track is None:
        return state
    track = predict(state.track, frame.time_s, jerk_density=settings.motion.jerk_density)
    return replace(state, track=track)


def _fused(
    settings: GazeSettings,
    before: Track | None,
    ratio: InnovationRatio,
    time_s: float,
    point: Array,
    covariance: Array,
) -> tuple[Track, InnovationRatio]:
    motion, ratio = settings.motion, update_ratio(ratio, time_s, point, covariance)
    track = fuse(before, time_s, point, covariance, motion=motion, innovation_ratio=ratio.value)
    return track, ratio


def aim_at_assumed_depth(
    settings: GazeSettings, state: GazeState, posture: Array, rays: Rays
) -> GazeState:
    """Return the state with an aim at an assumed depth, where the frame gave no measurement.

    Only one eye sees the object, or the rays of both do not meet, as to a thing that is far away,
    or to two things: then the first eye tells. An aim that lies near its ray is kept, because its
    depth is known better. A measurement replaces the assumption. On a head that uses one eye the
    assumption is all there is: its direction is fused over time, so that a motion is followed.
    """
    if state.measured is not None or state.by_joints is not None:
        return state
    eye, (centre, ray) = next(iter(rays.items()))
    T_body_eye = T_body_base(settings.calibration, eye, posture)
    ray = ray / np.linalg.norm(ray)
    point = transform(T_body_eye, centre + settings.initial_depth_m * ray)
    if len(settings.eyes) == 1:
        covariance = _at_assumed_depth(settings, state, eye, T_body_eye[:3, :3] @ ray)
        aim = fuse(state.aim, state.frame_s, point, covariance, motion=settings.motion)
        return replace(state, aim=aim)
    if state.aim is not None:
        away = transform(inverse(T_body_eye), state.aim.position) - centre
        if ray @ away > np.cos(settings.aim_gate_rad) * np.linalg.norm(away):
            return state
    covariance = (settings.initial_depth_m / 3) ** 2 * np.eye(3)
    aim = begin(state.frame_s, point, covariance, settings.motion)
    return replace(state, aim=aim, track=None)


def _at_assumed_depth(settings: GazeSettings, state: GazeState, eye: Side, ray: Array) -> Array:
    """Return the covariance (3, 3) [m^2] of a point at the assumed depth along a unit ray (3,).

    The eye sees the object.
    """
    view = best_view(settings, state.detections, eye)
    assert view is not None
    name, seen = view
    focal_px = settings.calibration.camera(name).intrinsics.matrix[0, 0]
    depth = settings.initial_depth_m
    across = depth * np.hypot(seen.std_px / focal_px, settings.command_std_rad)
    return across**2 * np.eye(3) + ((depth / 3) ** 2 - across**2) * np.outer(ray, ray)


def _locate(
    settings: GazeSettings, state: GazeState, postures: Array
) -> list[tuple[Array, Array]] | None:
    """Return by posture (2, j) the object (3,) [m] and its covariance (3, 3) in frame body."""
    left, right = (best_view(settings, state.detections, eye) for eye in EYES)
    if left is None or right is None:
        return None
    readings = postures[:, EYE_READINGS]
    joint_stds = [[settings.joint_std_rad], [settings.command_std_rad]]
    points, covariances = locate_with_covariance(
        settings.calibration,
        left=np.tile(left[1].pixel, (2, 1)),
        right=np.tile(right[1].pixel, (2, 1)),
        joints=readings,
        pixel_std_px=np.repeat([left[1].std_px, right[1].std_px], 2),
        joint_std_rad=np.repeat(joint_stds, readings.shape[1], axis=1),
        cameras=(left[0], right[0]),
    )
    if not np.isfinite(covariances).all():
        return None
    T = T_body_base(settings.calibration, "left", postures)
    R = T[:, :3, :3]
    covariances = R @ covariances @ np.swapaxes(R, 1, 2)
    return list(zip(transform(T, points), covariances, strict=True))
