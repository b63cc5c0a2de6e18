"""The calibration sequence: poses of the board and directions of the eyes (Sec. II, Fig. 4).

`plan` uses only the nominal head, as an engineer would; `capture_views` carries the plan out on the
as-built twin, and `paper_calibration` calibrates from these views.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from vergence.arrays import Array
from vergence.calibration.initial import SequentialCalibration, calibrate_sequentially
from vergence.calibration.intrinsics import lenses_of_the_paper
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.gaze.commands import JointLimits, usual_limits
from vergence.geometry.board import Board, Charuco, Chessboard, corner_points
from vergence.geometry.head import (
    R_EYE_CAM,
    HeadCalibration,
    camera_pose_in_base,
    cameras_of,
    main_cameras,
)
from vergence.geometry.kinematics import EYES, readings_to_turn, straight_gaze
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, pose, rotation, transform
from vergence.progress import Progress, silent
from vergence.twin.head import Exposure, Twin
from vergence.twin.profile import ErrorProfile
from vergence.vision.board_detection import detect_board

BOARD = Chessboard(columns=9, rows=6, square_m=0.030)
"""The chessboard of the twin's scene."""

WIDE_VIEWS = 18
"""Poses of the board near the eyes, for the wide cameras and static stereo."""
NARROW_VIEWS = 12
"""Poses of the board for each narrow camera, in view of both wide cameras too."""
ORIENTATIONS = 60
"""Eye orientations at which the board at rest is seen, for hand-eye calibration."""
IN_VIEW = 0.6
"""Share of the images of a board at rest that have to show all of it."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One view of the sequence."""

    placement: int
    """Number of the board's pose: views of one pose of the board share it."""
    T_lbase_target: Array
    """(4, 4) pose of the board."""
    eye_angles: Array
    """(r,) commanded readings [rad], in the order of the head's kinematics."""
    cameras: tuple[str, ...]
    """The cameras that take an image."""


def plan(
    head: HeadCalibration,
    seed: int,
    *,
    board: Board = BOARD,
    limits: JointLimits | None = None,
    views: tuple[int, int, int] = (WIDE_VIEWS, NARROW_VIEWS, ORIENTATIONS),
) -> list[Shot]:
    """Plan the views of a calibration sequence for a nominal head within limits of its joints.

    `views` are the numbers for the wide cameras, for each narrow camera, and of the board at rest.
    """
    wide_views, narrow_views, orientations = views
    ranges = (limits or usual_limits(head)).setpoint_range_rad[len(head.neck.axes) :]
    rng = np.random.default_rng([seed, 4])
    shots: list[Shot] = []
    main = main_cameras(head)
    held = [(main, wide_views, (0.28, 0.65), 0.7)]
    held += [((*main, other), narrow_views, (0.72, 1.1), 0.6) for other in other_cameras(head)]
    straight = np.clip(straight_gaze(head.kinematics), *ranges.T)
    for cameras, count, depth_m, lean_rad in held:
        farther = np.array(depth_m)
        for _ in range(count):
            # Depths are those of a usual lens; a board that fits into no image is farther away.
            T = None
            while T is None:
                T = _held_board(head, board, cameras, straight, farther, lean_rad, rng)
                farther = farther if T is not None else 1.25 * farther
            shots.append(Shot(len(shots), T, straight, cameras))
    at_rest = _around_board_at_rest(head, board, main, ranges, orientations)
    return shots + [replace(shot, placement=len(shots)) for shot in at_rest]


def _around_board_at_rest(
    head: HeadCalibration, board: Board, cameras: tuple[str, ...], ranges: Array, count: int
) -> list[Shot]:
    """Turn the eyes about a board at rest: farther away, and less, where lenses are narrow."""
    straight = np.clip(straight_gaze(head.kinematics), *ranges.T)
    turned = np.array([0.25, -0.2, 0.05])  # [rad]
    # Directions spread evenly over an ellipse (sunflower): pan and tilt vary independently. The
    # innermost three are left out: the calibration would take them for straight gaze.
    k = np.arange(3, count + 3) + 0.5
    radius, turn = np.sqrt(k / (count + 3)), k * np.pi * (3 - np.sqrt(5))
    best, shots = -1.0, []
    for smaller, depth_m in product((1.0, 0.75, 0.5, 0.35), (0.60, 0.75, 0.95, 1.2)):
        pan, tilt = 0.30 * radius * np.cos(turn) * smaller, 0.26 * radius * np.sin(turn) * smaller
        # Eyes that can roll do, by the product, which resembles neither of the others; so does a
        # reading that stays the same when both eyes turn alike, such as vergence.
        product_rad = pan * tilt / (0.26 * smaller)
        turns = np.stack([product_rad, tilt, pan], axis=-1)
        gaze = readings_to_turn(head.kinematics, turns)
        gaze[:, np.ptp(gaze, axis=0) < 1e-6] = product_rad[:, None]
        gaze = within(ranges, gaze, np.abs(gaze).max(axis=0, initial=0.0))
        T = _facing(board, _view(head, cameras[0], straight), (depth_m, 0.0, 0.0), turned)
        tried = [Shot(0, T, readings, cameras) for readings in gaze]
        seen = [[visible(head, board, n, shot).all() for n in cameras] for shot in tried]
        if (share := float(np.mean(seen))) > best + 0.05:
            best, shots = share, tried
        if best > IN_VIEW:
            break
    return shots


def other_cameras(head: HeadCalibration) -> list[str]:
    """List the cameras that are not their eye's main one, those of the left eye first."""
    every = [name for eye in EYES for name in cameras_of(head, eye)]
    return [name for name in every if name not in main_cameras(head)]


def within(ranges: Array, readings: Array, amplitude: Array) -> Array:
    """Move and scale readings (..., r) that swing about zero into ranges (r, 2) [rad].

    `amplitude` (r,) is that of the swing [rad]. Readings that fit are left as they are.
    """
    lower, upper = ranges.T
    fits = np.minimum(amplitude, (upper - lower) / 2)
    centre = np.clip(0.0, lower + fits, upper - fits)
    scale = np.divide(fits, amplitude, out=np.ones_like(fits), where=amplitude > 0)
    return readings * scale + centre


def _view(head: HeadCalibration, camera: str, readings: Array) -> Array:
    """Compute T_lbase_view (4, 4): at the base of a camera's eye, x along the camera's axis."""
    eye = head.camera(camera).eye
    T_lbase_base = np.eye(4) if eye == "left" else inverse(head.T_rbase_lbase)
    R_base_cam = camera_pose_in_base(head, camera, readings)[:3, :3]
    return T_lbase_base @ pose(R_base_cam @ R_EYE_CAM.T)


def _facing(board: Board, T_view: Array, centre: Sequence[float], turn: Array) -> Array:
    """Place a board with its middle at a centre in a view, turned from facing it."""
    middle = corner_points(board).mean(axis=0)
    R, t = T_view[:3, :3], T_view[:3, 3]
    return pose(R @ (R_EYE_CAM @ rotation(turn)), R @ centre + t) @ pose(t=-middle)


def visible(head: HeadCalibration, board: Board, name: str, shot: Shot) -> np.ndarray:
    """Select the corners (K,) that a camera sees well inside its image."""
    camera = head.camera(name).intrinsics
    uv = project_board(head, board, name, shot)
    # [rad]: for the board's white margin, and for cameras that sit a few degrees off.
    margin = 0.055 * camera.matrix[0, 0]
    return ((uv > margin) & (uv < np.array(camera.size) - 1 - margin)).all(axis=1)


def project_board(head: HeadCalibration, board: Board, name: str, shot: Shot) -> Array:
    """Project the board's corners (K, 2) into a camera at a shot's pose and angles."""
    corners = transform(shot.T_lbase_target, corner_points(board))
    return project_point(head, name, shot.eye_angles, corners)


def _held_board(
    head: HeadCalibration,
    board: Board,
    cameras: Sequence[str],
    readings: Array,
    depth_m: Array,
    lean_rad: float,
    rng: np.random.Generator,
) -> Array | None:
    """Draw a T_lbase_target at which all cameras see the whole board; None: at no such depth [m].

    VergenceError if that is so beyond the room.
    """
    if depth_m[0] > 3.0:
        raise VergenceError(
            f"The board fits into no image of {' and '.join(cameras)} at once; a head for the twin "
            "has eyes that look at one place with every joint at zero."
        )
    intrinsics, T_view = head.camera(cameras[-1]).intrinsics, _view(head, cameras[-1], readings)
    slope = intrinsics.width / 2 / intrinsics.matrix[0, 0]
    for _ in range(2_000):
        depth = rng.uniform(*depth_m)
        y, z = rng.uniform(-slope, slope, 2) * depth
        turn = rng.uniform(-1, 1, 3) * [lean_rad, lean_rad, 0.3]
        T = _facing(board, T_view, (depth, y, z), turn)
        shot = Shot(0, T, readings, ())
        # The last camera, which sees least, is asked first.
        if all(visible(head, board, camera, shot).all() for camera in reversed(cameras)):
            return T
    return None


def board_as_given(profile: ErrorProfile, board: Board = BOARD) -> Board:
    """Make the board with the dimensions that the calibration is given."""
    printed = 1 + profile.calibration.square_percent / 100
    if isinstance(board, Charuco):
        board = replace(board, marker_m=board.marker_m / printed)
    return replace(board, square_m=board.square_m / printed)


def carry_out(twin: Twin, shots: Sequence[Shot], *, interval_s: float = 0.0) -> Iterator[Shot]:
    """Move board and eyes of the twin as each shot has them, and yield the shot.

    Between two shots with the same eye angles `interval_s` of simulated time passes; otherwise the
    twin advances until the eyes have settled.
    """
    posture: Array | None = None
    for shot in shots:
        twin.place_board(shot.T_lbase_target)
        command = twin.posture(shot.eye_angles)
        if posture is None or (shot.eye_angles != posture).any():
            posture = shot.eye_angles
            twin.settle(command)
        else:
            twin.advance(twin.time_s + interval_s, command)
        yield shot


def capture_views(
    twin: Twin, shots: Sequence[Shot], *, progress: Progress = silent
) -> Observations:
    """Carry out a sequence on the twin and find the board in its images."""
    task = "calibration views"
    progress(task, 0, len(shots))
    with ThreadPoolExecutor(max_workers=2) as pool:
        detections = []
        for shot in carry_out(twin, shots):
            detections.append(pool.submit(_detect, twin, twin.expose(shot.cameras)))
            progress(task, len(detections), len(shots))
        seen = [detection.result() for detection in detections]
    twin.place_board(None)
    angles = np.array([eye_angles for eye_angles, _ in seen])
    return observations(twin.nominal, twin.profile, shots, angles, [corners for _, corners in seen])


def paper_calibration(
    twin: Twin, seed: int, *, progress: Progress = silent
) -> SequentialCalibration:
    """Plan a sequence, carry it out on the twin, and calibrate by the paper's method.

    The wide lenses are modelled as the twin's profile says. The seed is that of the board's poses.
    """
    views = capture_views(twin, plan(twin.nominal, seed, limits=twin.limits), progress=progress)
    lenses = lenses_of_the_paper(views, twin.profile.calibration.wide_lens)
    return calibrate_sequentially(views, lenses=lenses, neck=twin.nominal.neck)


def _detect(twin: Twin, exposure: Exposure) -> tuple[Array, dict[str, Array | None]]:
    frame = twin.develop(exposure)
    found = {name: detect_board(image, BOARD) for name, image in frame.images.items()}
    return frame.eye_angles, found


def observations(
    head: HeadCalibration,
    profile: ErrorProfile,
    shots: Sequence[Shot],
    eye_angles: Array,
    found: Sequence[Mapping[str, Array | None]],
) -> Observations:
    """Collect the corners of each shot by camera and the readings (V, r)."""
    nothing = np.full((BOARD.columns * BOARD.rows, 2), np.nan)
    corners = {}
    for name in head.cameras:
        seen = [view.get(name) for view in found]
        corners[name] = np.array([nothing if c is None else c for c in seen])
    return Observations(
        board=board_as_given(profile),
        placement=np.array([shot.placement for shot in shots]),
        eye_angles=eye_angles,
        corners=corners,
        sizes={n: m.intrinsics.size for n, m in head.cameras.items()},
        kinematics=head.kinematics,
        eyes={n: m.eye for n, m in head.cameras.items()},
    )
