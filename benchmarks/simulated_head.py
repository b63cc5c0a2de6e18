"""Heads that nobody built, and what they would record: corners and readings, without images.

Shared by the Monte Carlo scripts. A head is drawn with another baseline, other lenses with
distortion, mountings, gains, offsets and axes each time; its recording is the one that
docs/calibration.md advises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.sequential import Views
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, project
from vergence.geometry.head import HeadCalibration, MountedCamera, T_base_cam
from vergence.geometry.kinematics import EYES, EyeAxes
from vergence.geometry.se3 import inverse, pose, rotation, transform

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
WIDTH, HEIGHT = 640, 480
R_EYE_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera, and a board, that look along x and against it: z is the head's x, x its -y."""
WIDE_PX, NARROW_PX = (250.0, 420.0), (900.0, 1300.0)
"""Focal lengths: 2.5 to 4.2 mm and 9 to 13 mm on the sensors of this project's head."""


@dataclass(frozen=True)
class Noise:
    """Of a recording."""

    pixel_px: float
    """Standard deviation of a coordinate of a corner."""
    joint_rad: float
    """Standard deviation of a reading."""


@dataclass(frozen=True, eq=False)
class Motion:
    """How the eyes move before the board at rest: each joint swings at its own frequency."""

    frames: int
    rate_hz: float
    amplitude_rad: Array
    """(4,)."""
    frequency_hz: Array
    """(4,)."""
    phase_rad: Array
    """(4,)."""
    time_offset_s: float
    """An image shows the joints this much later than their reading."""


def random_head(rng: np.random.Generator) -> HeadCalibration:
    """Return a head within the model of `refine`: no skew, and no distortion of narrow lenses."""
    cameras = {}
    for eye in EYES:
        for lens, range_px in (("wide", WIDE_PX), ("narrow", NARROW_PX)):
            focal = rng.uniform(*range_px) * np.array([1.0, rng.uniform(0.99, 1.01)])
            middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2 + rng.normal(0, 5, 2)
            # Barrel distortion of 4 to 12 % at the image's edge, as such lenses have.
            barrel = -rng.uniform(0.04, 0.12) / (WIDTH / 2 / focal[0]) ** 2
            distortion = [barrel, 0.15 * barrel**2, *rng.normal(0, 5e-4, 2), 0.0]
            cameras[f"{eye}_{lens}"] = MountedCamera(
                eye=eye,
                intrinsics=Camera(
                    width=WIDTH,
                    height=HEIGHT,
                    matrix=np.array(
                        [[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1]]
                    ),
                    distortion=np.array(distortion) * (lens == "wide"),
                ),
                T_eye_cam=pose(
                    rotation(rng.normal(0, np.radians(1.5), 3)) @ R_EYE_CAM,
                    np.array([0.02, 0, 0.01 if lens == "wide" else -0.02])
                    + rng.normal(0, 0.004, 3),
                ),
            )
    return HeadCalibration(
        cameras=cameras,
        T_rbase_lbase=pose(
            rotation(rng.normal(0, np.radians(0.5), 3)),
            np.array([0, rng.uniform(0.055, 0.12), 0]) + rng.normal(0, 0.001, 3),
        ),
        axes={
            eye: EyeAxes(
                *map(float, rng.uniform(0.96, 1.04, 2)),
                *map(float, rng.normal(0, np.radians(0.4), 2)),
                nonorthogonality_rad=rng.normal(0, np.radians(0.3)),
                axis_distance_m=rng.normal(0, 0.001),
            )
            for eye in EYES
        },
    )


def still_recording(
    head: HeadCalibration,
    rng: np.random.Generator,
    noise: Noise,
    *,
    wide_views: int,
    narrow_views: int,
    orientations: int,
    spread_rad: float,
) -> Views:
    """Return a recording of eyes at rest.

    Args:
        head: the truth.
        rng: of everything random.
        noise: of corners and readings.
        wide_views: boards near the head, at straight gaze.
        narrow_views: boards for each narrow camera, seen by both wide ones too.
        orientations: eye angles at which a board at rest is seen.
        spread_rad: how far the eyes turn for them.
    """
    wide = ("left_wide", "right_wide")
    places = [_held_board(head, wide, rng, (0.28, 0.65), 0.7) for _ in range(wide_views)]
    cameras: list[tuple[str, ...]] = [wide] * wide_views
    for eye in EYES:
        trio = (*wide, f"{eye}_narrow")
        places += [_held_board(head, trio, rng, (0.7, 1.1), 0.6) for _ in range(narrow_views)]
        cameras += [trio] * narrow_views
    straight = len(places)
    # Directions spread evenly over an ellipse (a sunflower), all clear of straight gaze.
    k = np.arange(3, orientations + 3) + 0.5
    radius, turn = np.sqrt(k / (orientations + 3)), k * np.pi * (3 - np.sqrt(5))
    gaze = spread_rad * radius[:, None] * np.stack([np.cos(turn), 0.85 * np.sin(turn)], axis=-1)
    exact = np.concatenate([np.zeros((straight, 4)), np.tile(gaze, 2)])
    return _views(
        head,
        rng,
        noise,
        placement=np.concatenate([np.arange(straight), np.full(orientations, straight)]),
        T_lbase_target=np.array(places + [_fixed_board(head, rng)] * orientations),
        seen_at=exact,
        read_at=exact,
        cameras=cameras + [wide] * orientations,
    )


def moving_recording(
    head: HeadCalibration, rng: np.random.Generator, noise: Noise, motion: Motion, still: Views
) -> tuple[Views, Array]:
    """Return still views, followed by a motion before a board at rest.

    Args:
        head: the truth.
        rng: of the noise and the board's place.
        noise: of corners and readings.
        motion: of the eyes.
        still: views to put before it.

    Returns:
        All views, and (V,) the times of their readings [s]; NaN where the eyes stood still.
    """
    times = np.arange(motion.frames) / motion.rate_hz

    def gaze(t: Array) -> Array:
        phase = 2 * np.pi * motion.frequency_hz * t[:, None] + motion.phase_rad
        return motion.amplitude_rad * np.cos(phase)

    views = _views(
        head,
        rng,
        noise,
        placement=np.full(motion.frames, still.placement.max() + 1),
        T_lbase_target=np.tile(_fixed_board(head, rng), (motion.frames, 1, 1)),
        seen_at=gaze(times + motion.time_offset_s),
        read_at=gaze(times),
        cameras=[("left_wide", "right_wide")] * motion.frames,
    )
    joined = Views(
        board=still.board,
        placement=np.concatenate([still.placement, views.placement]),
        eye_angles=np.concatenate([still.eye_angles, views.eye_angles]),
        corners={n: np.concatenate([still.corners[n], views.corners[n]]) for n in views.corners},
        sizes=still.sizes,
    )
    return joined, np.concatenate([np.full(len(still.placement), np.nan), times])


def corners_seen(head: HeadCalibration, name: str, T_lbase_target: Array, readings: Array) -> Array:
    """Return exact corners (V, K, 2) in a camera; NaN where its image does not hold the board.

    Args:
        head: the truth.
        name: of the camera.
        T_lbase_target: (V, 4, 4) where the board stands.
        readings: (V, 4) without noise [rad].
    """
    uv = pixels_seen(head, name, transform(T_lbase_target[:, None], corner_points(BOARD)), readings)
    inside = np.asarray(((uv > 0) & (uv < [WIDTH - 1, HEIGHT - 1])).all(axis=(1, 2)))
    return np.where(inside[:, None, None], uv, np.nan)


def pixels_seen(head: HeadCalibration, name: str, points: Array, readings: Array) -> Array:
    """Return exact pixels (V, K, 2) of points (V, K, 3) of the left base, at readings (V, 4)."""
    mounted = head.cameras[name]
    left = mounted.eye == "left"
    T_base_camera = T_base_cam(head, name, readings[:, :2] if left else readings[:, 2:])
    T_cam_lbase = inverse(T_base_camera) @ (np.eye(4) if left else head.T_rbase_lbase)
    return project(mounted.intrinsics, transform(T_cam_lbase[:, None], points))


def _views(
    head: HeadCalibration,
    rng: np.random.Generator,
    noise: Noise,
    *,
    placement: np.ndarray,
    T_lbase_target: Array,
    seen_at: Array,
    read_at: Array,
    cameras: Sequence[tuple[str, ...]],
) -> Views:
    """Return views of boards (V, 4, 4) with noise, at noise-free readings (V, 4)."""
    corners = {}
    for name in head.cameras:
        uv = corners_seen(head, name, T_lbase_target, seen_at)
        looks = np.array([name in each for each in cameras])[:, None, None]
        corners[name] = np.where(looks, uv + rng.normal(0, noise.pixel_px, uv.shape), np.nan)
    return Views(
        board=BOARD,
        placement=placement,
        eye_angles=read_at + rng.normal(0, noise.joint_rad, read_at.shape),
        corners=corners,
        sizes=dict.fromkeys(corners, (WIDTH, HEIGHT)),
    )


def _held_board(
    head: HeadCalibration,
    cameras: tuple[str, ...],
    rng: np.random.Generator,
    depth_m: tuple[float, float],
    lean_rad: float,
) -> Array:
    """Return a random T_lbase_target at which all the cameras see the whole board."""
    mounted = head.camera(cameras[-1])
    T_base_camera = T_base_cam(head, cameras[-1], np.zeros(2))
    slope = WIDTH / 2 / mounted.intrinsics.matrix[0, 0]
    for _ in range(10_000):
        depth = rng.uniform(*depth_m)
        at = transform(T_base_camera, np.array([*rng.uniform(-slope, slope, 2) * depth, depth]))
        if mounted.eye == "right":
            at = transform(inverse(head.T_rbase_lbase), at)
        T = _facing(at, rng.uniform(-1, 1, 3) * [lean_rad, lean_rad, 0.3])
        seen = [corners_seen(head, name, T[None], np.zeros((1, 4))) for name in cameras]
        if np.isfinite(seen).all():
            return T
    raise AssertionError("the board fits into no image at these depths")


def _fixed_board(head: HeadCalibration, rng: np.random.Generator) -> Array:
    between = inverse(head.T_rbase_lbase)[:3, 3] / 2
    ahead = np.array([rng.uniform(0.5, 0.7), *rng.normal(0, 0.02, 2)])
    return _facing(between + ahead, rng.normal(0, 0.25, 3))


def _facing(centre: Array, turn: Array) -> Array:
    """Return T_lbase_target of a board around a centre, turned from facing the head [rad]."""
    middle = corner_points(BOARD).mean(axis=0)
    return pose(R_EYE_CAM @ rotation(turn), centre) @ pose(t=-middle)
