"""Frames of eyes that move before a drawn room, with readings that have a gain and noise."""

from dataclasses import replace

import numpy as np

from drawn_head import four_cameras
from drawn_room import view
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import boxminus
from vergence.stereo.extrinsics import relative_camera_pose

HEAD = four_cameras()
WIDE = ("left_wide", "right_wide")
GAIN, NOISE_RAD = 1.03, 2.6e-3


def angles_at(time_s: float) -> Array:
    """Return angles (4,) [rad] of eyes whose pan, tilt and vergence change."""
    pan, vergence, tilt = 0.12 * np.sin(1.7 * time_s), 0.05 * np.sin(2.9 * time_s), 0.08
    return np.array([pan - vergence, tilt * np.sin(time_s), pan + vergence, tilt * np.cos(time_s)])


def frame(time_s: float, angles: Array, readings: Array, cameras=WIDE) -> Frame:
    images = {name: view(HEAD, name, angles) for name in cameras}
    return Frame(time_s, time_s, readings, np.zeros(3), images)


def frames(count: int, *, step_s: float = 0.3) -> list[tuple[Array, Frame]]:
    """Return true angles and frames of moving eyes, whose readings have noise and a gain."""
    rng = np.random.default_rng(1)
    found = []
    for time_s in step_s * np.arange(count):
        angles = angles_at(time_s)
        readings = GAIN * angles + rng.normal(0, NOISE_RAD, 4)
        found.append((angles, frame(float(time_s), angles, readings)))
    return found


def turn_error(head: HeadCalibration, joints: Array, angles: Array) -> float:
    """Return by how much a head at readings has the cameras turned to each other wrongly [rad]."""
    T = boxminus(relative_camera_pose(head, joints), relative_camera_pose(HEAD, angles))
    return float(np.linalg.norm(T[:3]))


def one_eyed() -> HeadCalibration:
    return replace(HEAD, cameras={n: c for n, c in HEAD.cameras.items() if c.eye == "left"})
