"""What a recording of a session would show, at the level of points and readings: no images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import interp1d

from board_sessions import Mistakes, Session, mistakes
from simulated_recording import BOARD, POINTS, inside_image
from vergence.arrays import Array
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, eye_pose
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import transform
from vergence.recordings.board_placements import number_placements
from vergence.recordings.frame_choice import choose_frames
from vergence.recordings.moments import SAMPLES, WINDOW_NS, Moments
from vergence.recordings.recording_map import FrameChoice
from vergence.recordings.scan import LAG_NS
from vergence.twin.sensors import play


@dataclass(frozen=True)
class Imperfections:
    """Errors of what is recorded."""

    noise_rad: float = np.radians(0.05)
    gains: float = 0.03
    """Largest error of a gain."""
    backlash_rad: float = 0.0
    latency_s: float = 0.0
    """Age of readings."""
    signs: tuple[float, ...] = ()
    """Of the readings; empty: as described."""
    corner_px: float = 0.1
    change_px: float = 0.15
    """Noise of images, as an apparent motion."""
    rate_hz: float = 30.0


def observe_moments(
    head: HeadCalibration,
    session: Session,
    rng: np.random.Generator,
    how: Imperfections,
    *,
    poses: bool = False,
) -> Moments:
    """Simulate the moments of a recording; images of all cameras are taken at once."""
    time_s = np.arange(0, session.end_s, 1 / how.rate_hz)
    joints = np.array([session.joints_at(t) for t in time_s])
    late = np.array([session.joints_at(t - how.latency_s) for t in time_s])
    boards = np.array([session.board_at(t) for t in time_s])
    r, ratios = joints.shape[1], head.kinematics.gear_ratios
    sensed = play(late, how.backlash_rad / ratios) if how.backlash_rad else late
    gains = 1 + rng.uniform(-how.gains, how.gains, r)
    readings = sensed * gains * (how.signs or 1.0)
    readings = readings + rng.normal(0, how.noise_rad, readings.shape) / ratios
    scene = rng.uniform([1.0, -1.5, -1.2], [3.0, 1.5, 1.2], (60, 3))
    change, lag = {}, max(1, round(LAG_NS * 1e-9 * how.rate_hz))
    for name in head.cameras:
        flows = []
        for each in (scene[None], transform(boards[:, None], POINTS[::9])):
            pixels = project_point(head, name, joints[:, None], each)
            before = pixels[np.maximum(np.arange(len(pixels)) - lag, 0)]
            flow = np.minimum(np.linalg.norm(pixels - before, axis=-1), 4.0)
            shown = np.isfinite(flow)
            squares = np.where(shown, flow, 0.0) ** 2
            flows.append(np.sqrt(squares.sum(axis=1) / np.maximum(shown.sum(axis=1), 1)))
        moved = np.maximum(*flows)
        noise = how.change_px * rng.uniform(0.9, 1.1, len(moved))
        change[name] = np.where(np.arange(len(moved)) > 0, np.hypot(moved, noise), np.nan)
    T = np.stack([eye_pose(head.kinematics, eye, readings) for eye in EYES], axis=1)
    elements = T[:, :, :3].reshape(len(T), -1) if poses else readings
    elements = np.hstack([elements, np.zeros((len(time_s), 3))])
    parts = np.linspace(-WINDOW_NS, WINDOW_NS, SAMPLES) * 1e-9
    around = interp1d(time_s, elements, axis=0, bounds_error=False)(time_s + parts[:, None])
    return Moments(
        time_ns=np.round(time_s * 1e9).astype(int) + 1_700_000_000_000_000_000,
        images={name: np.arange(len(time_s)) for name in head.cameras},
        change=change,
        eye_angles=np.full_like(readings, np.nan) if poses else readings,
        neck_angles=np.zeros((len(time_s), 3)),
        around=around,
        T_base_eye=T if poses else None,
    )


def description(head: HeadCalibration, *, poses: bool = False) -> Description:
    """Describe a head that pans and tilts, or measures poses, as a map does."""
    cameras = {
        name: DatasetCamera(eye=m.eye, width=m.intrinsics.width, height=m.intrinsics.height)
        for name, m in head.cameras.items()
    }
    if poses:
        return Description(cameras=cameras, board=BOARD, eye_motion="poses")
    joints = {name: DatasetJoint(name, "rad") for name in head.kinematics.readings}
    return Description(cameras=cameras, board=BOARD, joints=joints)


def find_corners(
    head: HeadCalibration,
    session: Session,
    time_s: Array,
    rng: np.random.Generator,
    noise_px: float,
) -> dict[str, Array]:
    """Simulate the corners (F, K, 2) by camera at some times; NaN where a board is cut off."""
    joints = np.array([session.joints_at(t) for t in time_s])
    points = transform(np.array([session.board_at(t) for t in time_s])[:, None], POINTS)
    found = {}
    for name, mounted in head.cameras.items():
        uv = project_point(head, name, joints[:, None], points)
        whole = np.asarray(inside_image(uv, mounted.intrinsics).all(axis=1))
        found[name] = np.where(whole[:, None, None], uv + rng.normal(0, noise_px, uv.shape), np.nan)
    return found


@dataclass(frozen=True, eq=False)
class Found:
    """Frames that were chosen of a session, and their placements."""

    time_s: Array
    moving: np.ndarray
    number: np.ndarray
    corners: Mapping[str, Array]
    mistakes: Mistakes


def find_frames(
    head: HeadCalibration,
    session: Session,
    rng: np.random.Generator,
    how: Imperfections,
    *,
    described: Description | None = None,
    poses: bool = False,
) -> Found:
    """Choose frames of a simulated recording, number its placements, and judge them."""
    moments = observe_moments(head, session, rng, how, poses=poses)
    described = described or description(head, poses=poses)
    rows, moving = choose_frames(moments, FrameChoice())
    time_s = (moments.time_ns[rows] - moments.time_ns[0]) * 1e-9
    corners = find_corners(head, session, time_s, rng, how.corner_px)
    number = number_placements(
        described, moments, rows, moving, corners=corners, stated=FrameChoice()
    )

    def sees(t: float) -> bool:
        found = find_corners(head, session, np.array([t]), rng, 0.0)
        return any(np.isfinite(each).all() for each in found.values())

    judged = mistakes(session, time_s, moving=moving, number=number, sees=sees)
    return Found(time_s, moving, number, corners, judged)
