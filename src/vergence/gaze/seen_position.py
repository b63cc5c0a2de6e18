"""The object's position by the geometry that both eyes see, once a frame's command is on its way.

It takes longer than the rest of a step, and steering does not need it: whoever runs the loop calls
`see_position` after the command was sent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.data.dataset import Frame
from vergence.gaze.commands import EYE_READINGS
from vergence.gaze.observation import best_view, fuse_measurement, predict_track, readings_at_image
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.head import T_body_base
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import transform
from vergence.self_calibration.frame import locate_seen
from vergence.self_calibration.sequence import update_geometry
from vergence.vision.detector import Detection


def see_position(settings: GazeSettings, state: GazeState, frame: Frame | None) -> GazeState:
    """Return the state with geometry and `track` by what both eyes see in the frame of a step.

    The state is that after the step. It is returned as it is where the settings have the joints
    tell the geometry, and for frames that the step did not use: during a saccade, or without the
    object.

    Raises:
        VergenceError: see `self_calibration.sequence.update_geometry`.
    """
    if state.geometry is None or frame is None or state.seen_s != frame.time_s:
        return state
    if state.geometry.time_s == frame.time_s or not set(settings.wide) <= set(frame.images):
        return state
    readings = readings_at_image(settings, state, frame)
    geometry = update_geometry(state.geometry, frame, readings[EYE_READINGS])
    state, seen = replace(state, geometry=geometry), geometry.latest
    if seen is None or not isinstance(state.target, str):
        return state
    found = _seen_pair(settings, state)
    if found is None:
        return predict_track(settings, state, frame)
    cameras, left, right = found
    where = locate_seen(
        seen,
        left=left.pixel[None],
        right=right.pixel[None],
        pixel_std_px=np.repeat([left.std_px, right.std_px], 2),
        cameras=cameras,
    )
    if not np.isfinite(where.covariance).all():
        return predict_track(settings, state, frame)
    T = T_body_base(seen.head, "left", readings)
    R = T[:3, :3]
    point, covariance = transform(T, where.xyz[0]), R @ where.covariance[0] @ R.T
    return fuse_measurement(settings, state, frame, point, covariance)


def _seen_pair(
    settings: GazeSettings, state: GazeState
) -> tuple[tuple[str, str], Detection, Detection] | None:
    """Return the cameras that show the object, and where: those that see the geometry, if both do.

    What was learned of their mountings does not hold for the others.
    """
    wide = [state.detections.get(name) for name in settings.wide]
    if wide[0] is not None and wide[1] is not None:
        return (settings.wide[0], settings.wide[1]), wide[0], wide[1]
    views = [best_view(settings, state.detections, eye) for eye in EYES]
    if views[0] is None or views[1] is None:
        return None
    return (views[0][0], views[1][0]), views[0][1], views[1][1]
