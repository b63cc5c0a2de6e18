"""What simulated heads would record of boards: corners and readings, without images.

`still_recording` and `moving_recording` are what docs/calibrate.md advises; `record` makes good
and poor ones, and `two_boards` is what bundle adjustment is tested on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.chebyshev import chebval

from simulated_head import HEIGHT, R_EYE_CAM, WIDTH, as_designed
from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.data.timing import Timing
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.kinematics import EYES, eye_pose
from vergence.geometry.projection import camera_pose, project_point
from vergence.geometry.se3 import inverse, pose, rotation, transform

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
POINTS = corner_points(BOARD)


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is recorded."""

    pixel_px: float = 0.0
    """Of a coordinate of a corner."""
    joint_rad: float = 0.0
    """Of a reading."""


EXACT = Noise()


@dataclass(frozen=True)
class Recording:
    """What is recorded of a head; the defaults are a good recording."""

    straight: int = 12
    """Boards at straight gaze."""
    orientations: int = 24
    """Eye angles at which a board at rest is seen."""
    reach_rad: tuple[float, float] = (0.25, 0.22)
    """Of pan and of tilt."""
    together: bool = False
    """Whether tilt does what pan does."""
    alike: bool = True
    """Whether both eyes do the same."""
    apart_rad: float = 0.0
    """If so, but for differences of this standard deviation."""
    gaze_rad: tuple[float, float] = (0.0, 0.0)
    """Pan and tilt of both eyes before the boards of which each stands elsewhere."""
    gaze_spread_rad: float = 0.0
    """By how much the readings before these boards differ from that, at most."""
    slant_rad: tuple[float, float] | None = None
    """One slant for all boards; None: each its own, up to 0.6 rad."""
    noise: Noise = Noise(pixel_px=0.1, joint_rad=np.radians(0.1))


def observe(
    head: HeadCalibration,
    rng: np.random.Generator,
    noise: Noise,
    *,
    placement: np.ndarray,
    T_lbase_target: Array,
    joints: Array,
    readings: Array | None = None,
    cameras: Sequence[Sequence[str]] | None = None,
    whole: bool = False,
) -> Observations:
    """Return V views of boards, with noise.

    Args:
        head: the truth.
        rng: of the noise.
        noise: of corners and readings.
        placement: (V,) numbers of the boards' places.
        T_lbase_target: (V, 4, 4) where the boards stand.
        joints: (V, r) what the joints would read without noise at the moments of the images.
        readings: (V, r) the same at the moments of the readings; None: the eyes stand still.
        cameras: by view, those that take an image; None: all.
        whole: whether an image gives no corners unless it shows them all.
    """
    points = transform(T_lbase_target[:, None], POINTS)
    corners = {}
    for name in head.cameras:
        uv = project_point(head, name, joints[:, None], points)
        held = inside_image(uv, head.cameras[name].intrinsics)[..., None]
        held = held.all(axis=1, keepdims=True) if whole else held
        if cameras is not None:
            held = held & np.array([name in each for each in cameras])[:, None, None]
        corners[name] = np.where(held, uv + rng.normal(0, noise.pixel_px, uv.shape), np.nan)
    readings = joints if readings is None else readings
    return Observations(
        board=BOARD,
        placement=placement,
        eye_angles=readings + rng.normal(0, noise.joint_rad, readings.shape),
        corners=corners,
        sizes={n: m.intrinsics.size for n, m in head.cameras.items()},
        eyes={name: mounted.eye for name, mounted in head.cameras.items()},
        kinematics=as_designed(head.kinematics),
    )


def inside_image(pixels: Array, camera: Camera | None = None) -> np.ndarray:
    """Return (...,) of bool: whether an image, None: 640 x 480, holds pixels (..., 2)."""
    width, height = (WIDTH, HEIGHT) if camera is None else camera.size
    return np.asarray(((pixels > 0) & (pixels < [width - 1, height - 1])).all(axis=-1))


def still_recording(
    head: HeadCalibration,
    rng: np.random.Generator,
    noise: Noise,
    *,
    wide_views: int,
    narrow_views: int,
    orientations: int,
    spread_rad: float,
) -> Observations:
    """Return a recording of eyes at rest, with whole boards only.

    First `wide_views` boards near the head, then `narrow_views` for each narrow camera, seen by
    both wide ones too; last a board at rest, at `orientations` eye angles of up to `spread_rad`.
    """
    wide = ("left_wide", "right_wide")
    places = [_held_board(head, wide, rng, (0.28, 0.65), 0.7) for _ in range(wide_views)]
    cameras: list[tuple[str, ...]] = [wide] * wide_views
    for eye in EYES:
        trio = (*wide, f"{eye}_narrow")
        places += [_held_board(head, trio, rng, (0.7, 1.1), 0.6) for _ in range(narrow_views)]
        cameras += [trio] * narrow_views
    straight = len(places)
    gaze = spread_rad * _sunflower(orientations) * [1.0, 0.85]
    return observe(
        head,
        rng,
        noise,
        placement=np.concatenate([np.arange(straight), np.full(orientations, straight)]),
        T_lbase_target=np.array(places + [_fixed_board(head, rng)] * orientations),
        joints=np.concatenate([np.zeros((straight, 4)), np.tile(gaze, 2)]),
        cameras=cameras + [wide] * orientations,
        whole=True,
    )


def moving_recording(
    head: HeadCalibration,
    rng: np.random.Generator,
    noise: Noise,
    still: Observations,
    *,
    times_s: Array,
    gaze: Callable[[Array], Array],
    time_offset_s: float,
) -> Observations:
    """Return still views, followed by views of a board at rest by the wide cameras of moving eyes.

    `gaze` gives joints (V, 4) by times (V,); an image shows those `time_offset_s` after a reading.
    """
    count = len(times_s)
    moving = observe(
        head,
        rng,
        noise,
        placement=np.zeros(count, dtype=int),
        T_lbase_target=np.tile(_fixed_board(head, rng), (count, 1, 1)),
        joints=gaze(times_s + time_offset_s),
        readings=gaze(times_s),
        cameras=[("left_wide", "right_wide")] * count,
        whole=True,
    )
    at_rest = np.zeros(len(still.placement))
    run = np.repeat([0, 1], [len(at_rest), count])
    timing = Timing(np.concatenate([at_rest, times_s]), run)
    return replace(joined([still, moving]), timing=timing)


def record(
    head: HeadCalibration, rng: np.random.Generator, recording: Recording | None = None
) -> Observations:
    """Return a recording as stated, of eyes at rest: good, or poor in a way of its own."""
    how = Recording() if recording is None else recording
    still, count = how.straight, how.orientations
    gaze = _sunflower(count) * how.reach_rad
    gaze = gaze[:, [0, 0]] if how.together else gaze
    other = gaze if how.alike else rng.permutation(gaze)
    if how.apart_rad:
        other = other + rng.normal(0, how.apart_rad, other.shape)
    ahead = np.tile(how.gaze_rad, (still, 2))
    if how.gaze_spread_rad:
        ahead = ahead + rng.uniform(-how.gaze_spread_rad, how.gaze_spread_rad, ahead.shape)
    slants = rng.uniform(-0.6, 0.6, (still + 1, 2))
    if how.slant_rad is not None:
        slants[:] = how.slant_rad
    turns = np.concatenate([slants, rng.uniform(-0.3, 0.3, (still + 1, 1))], axis=1)
    distance = np.append(rng.uniform(0.35, 0.7, still), 0.55)[:, None]
    aside = rng.uniform(-0.25, 0.25, (still + 1, 2)) * np.append(np.ones(still), 0.2)[:, None]
    centre = distance * np.concatenate([np.ones((still + 1, 1)), aside], axis=1)
    centre[:, 1] -= 0.04  # between the eyes
    placement = np.concatenate([np.arange(still), np.full(count, still)])
    return observe(
        head,
        rng,
        how.noise,
        placement=placement,
        T_lbase_target=facing(centre, turns)[placement],
        joints=np.concatenate([ahead, np.concatenate([gaze, other], axis=1)]),
    )


def two_boards(
    head: HeadCalibration,
    rng: np.random.Generator,
    *,
    noise: Noise = EXACT,
    time_offset_s: float | None = None,
) -> Observations:
    """Return 12 boards before eyes at rest, then two boards before eyes at 28 other angles.

    With a time offset the eyes move along cubics, read at 30 Hz; images show them this much later.
    """
    time_s, run = np.arange(40) / 30, (np.arange(40) >= 12).astype(int)
    coefficients = rng.permuted(np.tile([0.05, 0.1, -0.2, 0.15], (4, 1)), axis=1).T

    def along(t: Array) -> Array:
        return run[:, None] * chebval((t - time_s[26]) / 0.45, coefficients).T

    random = run[:, None] * rng.uniform(-0.25, 0.25, (40, 4))
    timed = time_offset_s is not None
    distance = np.concatenate([rng.uniform(0.35, 0.9, 12), [0.5, 0.8]])[:, None]
    centre = distance * np.concatenate([np.ones((14, 1)), rng.uniform(-0.2, 0.2, (14, 2))], axis=1)
    placement = np.concatenate([np.arange(12), 12 + np.arange(28) % 2])
    observed = observe(
        head,
        rng,
        noise,
        placement=placement,
        T_lbase_target=facing(centre, rng.uniform(-0.5, 0.5, (14, 3)))[placement],
        joints=along(time_s + time_offset_s) if timed else random,
        readings=along(time_s) if timed else None,
    )
    return replace(observed, timing=Timing(time_s, run) if timed else None)


def joined(parts: Sequence[Observations]) -> Observations:
    """Return recordings of eyes at rest one after the other, their placements told apart."""
    first = np.cumsum([0] + [part.placement.max() + 1 for part in parts[:-1]])
    return replace(
        parts[0],
        placement=np.concatenate([p.placement + k for p, k in zip(parts, first, strict=True)]),
        eye_angles=np.concatenate([part.eye_angles for part in parts]),
        corners={
            name: np.concatenate([part.corners[name] for part in parts])
            for name in parts[0].corners
        },
    )


def as_poses(observations: Observations) -> Observations:
    """Return the same with measured eye poses in place of angles."""
    nothing = np.full_like(observations.eye_angles, np.nan)
    return replace(observations, T_base_eye=observations.eye_poses(), eye_angles=nothing)


def facing(centre: Array, turn: Array) -> Array:
    """Return T_lbase_target (..., 4, 4) of boards around centres, turned from facing the head."""
    R = R_EYE_CAM @ rotation(turn)
    return pose(R, centre - R @ POINTS.mean(axis=0))


def _sunflower(count: int) -> Array:
    """Return directions (count, 2) spread evenly over the unit disc, all clear of its middle."""
    k = np.arange(3, count + 3) + 0.5
    radius, turn = np.sqrt(k / (count + 3)), k * np.pi * (3 - np.sqrt(5))
    return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)


def _held_board(
    head: HeadCalibration,
    cameras: tuple[str, ...],
    rng: np.random.Generator,
    depth_m: tuple[float, float],
    lean_rad: float,
) -> Array:
    """Return a random T_lbase_target at which all the cameras see the whole board."""
    mounted = head.camera(cameras[-1])
    T_base_straight = eye_pose(head.kinematics, mounted.eye, np.zeros(4))
    T = camera_pose(mounted, head.T_rbase_lbase, T_base_straight)
    slope = WIDTH / 2 / mounted.intrinsics.matrix[0, 0]
    for _ in range(10_000):
        depth = rng.uniform(*depth_m)
        at = transform(T, np.array([*rng.uniform(-slope, slope, 2) * depth, depth]))
        T_lbase_target = facing(at, rng.uniform(-1, 1, 3) * [lean_rad, lean_rad, 0.3])
        points = transform(T_lbase_target, POINTS)
        seen = (project_point(head, name, np.zeros(4), points) for name in cameras)
        if all(inside_image(uv).all() for uv in seen):
            return T_lbase_target
    raise AssertionError("the board fits into no image at these depths")


def _fixed_board(head: HeadCalibration, rng: np.random.Generator) -> Array:
    between = inverse(base_pose(head, "left"))[:3, 3]
    ahead = np.array([rng.uniform(0.5, 0.7), *rng.normal(0, 0.02, 2)])
    return facing(between + ahead, rng.normal(0, 0.25, 3))
