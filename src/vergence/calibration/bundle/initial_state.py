"""From corners and readings to a BundleProblem and the BundleState to start from."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.measured_poses import PAIRS, MeasuredPoses, PoseObservations
from vergence.calibration.bundle.problem import (
    BundleProblem,
    BundleState,
    corner_errors,
    detection_eye_poses,
)
from vergence.calibration.bundle.read_motion import ReadMotion, read_motion
from vergence.calibration.observations import Observations, missing_reading
from vergence.calibration.sequential.lens_prior import lens_prior
from vergence.data.timing import TRAJECTORY_DEGREE, Stencil, stencil
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, Kinematics, reading_kinds
from vergence.geometry.parameter_names import POSE, joint_names
from vergence.geometry.parameters import parameter_names
from vergence.geometry.se3 import angle, inverse, known_poses
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, determines_pose, seen_corners

_LAST_ASSUMED = {"rational": "k6", "fisheye": "k4"}
"""The last coefficient of the lenses of which `lens_prior` assumes something."""
CANDIDATES = 12
"""Views from which the start of a board's place is chosen."""
FAR_PX = 50.0
"""Reprojection error that says no more than a larger one, when views vote on a board's place."""
MEASURING_M = 0.02
"""Standard deviation of an eye's place from which measured poses, good to a fraction of a
millimetre, know lengths better than a printed board does."""
TURNED_RAD = 0.5
"""A board turned by more than this against the other views of its placement contradicts them; the
start is better than that, and a board numbered from the wrong end is turned by pi."""


def initial_state(
    start: HeadCalibration,
    observations: Observations | PoseObservations,
    *,
    fixed: Collection[str],
    points: Array | None = None,
    T_cam_target: Mapping[str, Array] | None = None,
) -> tuple[BundleProblem, BundleState, np.ndarray]:
    """Return the problem of a head, its start, and the (P,) numbers of its placements.

    The best board pose of each placement is its start; parameters of cameras that see no board keep
    theirs. Arguments and errors are those of `bundle_adjust`.
    """
    cameras = tuple(start.cameras)
    if isinstance(observations, PoseObservations):
        detected = _measured_poses(start, observations)
    else:
        detected = _corners(start, observations, points, T_cam_target)
    seen = detected.seen
    if not seen.any():
        raise VergenceError(f"None of {', '.join(cameras)} sees a board.")
    eye = np.array([EYES.index(each.eye) for each in start.cameras.values()], dtype=np.intp)
    # Without one view that says where it is, a placement is of no use.
    useful = detected.placed.any(axis=0)
    numbers = np.unique(observations.placement[useful])
    camera, view = np.nonzero(seen.any(axis=2) & np.isin(observations.placement, numbers))
    blocks = _blocks(start.kinematics, observations, view, eye[camera])
    around = _neighbours(observations, blocks)
    measured = observations.T_base_eye
    blind = [name for c, name in enumerate(cameras) if c not in camera]
    blind += [side for e, side in enumerate(EYES) if e not in eye[camera]]
    free = _free(start, fixed, blind, angles=measured is None)
    found, whitening = detected.T_cam_target[camera, view], detected.whitening
    measured_poses = None
    if whitening is not None:
        measured_poses = MeasuredPoses(found, whitening[camera, view])
    # Measured poses of a target are in metres, as measured poses of an eye are.
    sized = measured_poses is None and _measures_lengths(measured)
    problem = BundleProblem(
        cameras=cameras,
        parameters=parameter_names(start),
        eye=eye,
        camera=camera,
        block=blocks.of_detection,
        placement=np.searchsorted(numbers, observations.placement[view]),
        pixels=np.where(seen[..., None], detected.pixels, 0.0)[camera, view],
        seen=seen[camera, view],
        points=detected.points,
        noise_scale=np.ones(len(camera)),
        block_view=blocks.view,
        block_columns=blocks.columns,
        reading=blocks.reading,
        around=around,
        trajectory_coefficients=np.zeros((*blocks.reading.shape, TRAJECTORY_DEGREE)),
        read_motion=None if around is None else _read_motion(observations, blocks, around),
        trust_encoder=np.zeros(blocks.reading.shape[1], dtype=bool),
        T_base_eye_read=None if measured is None else measured[blocks.view, blocks.eye],
        systematic_px=observations.systematic_px,
        free=np.array(free + [True] * (len(POSE) * len(numbers)) + [sized]),
        assumed=np.array(
            [
                f"{name}.{_LAST_ASSUMED.get(mounted.intrinsics.model)}" not in fixed
                and bool(np.isfinite(lens_prior(mounted.intrinsics)[0]))
                for name, mounted in start.cameras.items()
            ]
        ),
        measured=measured_poses,
    )
    offset_s = start.time_offset_s if "time_offset_s" in fixed else 0.0
    state = BundleState(
        head=replace(start, time_offset_s=offset_s, accuracy=None),
        T_lbase_target=np.tile(np.eye(4), (len(numbers), 1, 1)),
        latent=blocks.reading,
    )
    return *_place_boards(problem, state, found), numbers


class _Blocks(NamedTuple):
    """The B blocks of latent unknowns: see `problem`."""

    of_detection: np.ndarray
    """(M,) the block of each detection."""
    view: np.ndarray
    """(B,)."""
    eye: np.ndarray
    """(B,) 0 or 1; 0 where a block is of both eyes."""
    reading: Array
    """(B, n)."""
    columns: np.ndarray
    """(B, n) which of the head's readings these are."""


def _blocks(
    kinematics: Kinematics,
    observations: Observations | PoseObservations,
    view: np.ndarray,
    eye: np.ndarray,
) -> _Blocks:
    """Return the blocks that M detections, in views (M,) and by eyes (M,), belong to.

    VergenceError if a reading that is needed is not finite.
    """
    columns = _latent_columns(kinematics, sorted(set(eye.tolist())))
    alone = observations.T_base_eye is not None or len(columns) == len(EYES)
    whose = eye if alone else np.zeros(len(eye), dtype=np.intp)
    pairs, block = np.unique(np.stack([view, whose], axis=1), axis=0, return_inverse=True)
    reading, block_columns, finite = _readings(observations, pairs, columns)
    if not finite.all():
        v, e = pairs[~finite][0]
        raise missing_reading(EYES[e] if alone else None, int(v))
    return _Blocks(block.ravel(), pairs[:, 0], pairs[:, 1], reading, block_columns)


def _neighbours(observations: Observations | PoseObservations, blocks: _Blocks) -> Stencil | None:
    """Return the neighbours of each block in time; None: the eyes stood still in all views."""
    if observations.timing is None:
        return None
    run = observations.timing.run[blocks.view]  # a motion of one eye, not of both
    time_s = observations.timing.time_s[blocks.view]
    return stencil(time_s, np.where(run > 0, 2 * run - blocks.eye, 0))


def _read_motion(
    observations: Observations | PoseObservations, blocks: _Blocks, around: Stencil
) -> ReadMotion:
    """Return the motion of the readings of each block, or of the measured poses of its eye."""
    assert observations.timing is not None
    poses = observations.T_base_eye
    return read_motion(
        observations.timing,
        observations.eye_angles if poses is None else poses,
        view=blocks.view,
        eye=blocks.eye,
        columns=blocks.columns,
        around=around,
    )


def _readings(
    observations: Observations | PoseObservations, pairs: np.ndarray, columns: list[list[int]]
) -> tuple[Array, np.ndarray, np.ndarray]:
    """Return readings (B, n) of blocks, which of the head's they are, and whether all are finite.

    The pairs (B, 2) are the view and the eye of each block. Of measured poses the readings are
    zeros, and the numbers are of no meaning.
    """
    view, eye = pairs.T
    if observations.T_base_eye is not None:
        finite = known_poses(observations.T_base_eye[view, eye])
        zeros = np.zeros((len(pairs), len(POSE)))
        return zeros, zeros.astype(np.intp), np.asarray(finite)
    block_columns = np.array(columns, dtype=np.intp)[eye]
    reading = observations.eye_angles[view[:, None], block_columns]
    return reading, block_columns, np.asarray(np.isfinite(reading).all(axis=1))


def _free(
    start: HeadCalibration, fixed: Collection[str], blind: list[str], *, angles: bool
) -> list[bool]:
    """Return which parameters of a head may change.

    Not what is fixed by choice, nor what belongs to a blind camera or eye, which saw no board, nor
    the joints where poses were measured in place of their angles.
    """
    joints = () if angles else tuple(n for e in EYES for n in joint_names(start.kinematics, e))
    return [
        name not in fixed and name.partition(".")[0] not in blind and name not in joints
        for name in parameter_names(start)
    ]


class _Detected(NamedTuple):
    """What C cameras found in V views: K corners of a board, or the PAIRS of numbers of a pose."""

    pixels: Array
    """(C, V, K, 2)."""
    seen: np.ndarray
    """(C, V, K)."""
    placed: np.ndarray
    """(C, V) where that is enough to know T_cam_target."""
    T_cam_target: Array
    """(C, V, 4, 4); NaN where it is not."""
    points: Array
    """(K, 3) corners in frame target [m]."""
    whitening: Array | None = None
    """(C, V, 6, 6) of measured poses; None: corners."""


def _corners(
    start: HeadCalibration,
    observations: Observations,
    points: Array | None,
    T_cam_target: Mapping[str, Array] | None,
) -> _Detected:
    board, given = observations.board, T_cam_target or {}
    nothing = np.full((len(observations.placement), board.columns * board.rows, 2), np.nan)
    corners = np.stack([observations.corners.get(name, nothing) for name in start.cameras])
    seen = seen_corners(corners)
    points = corner_points(board) if points is None else points
    poses = [
        given[name] if name in given else board_poses(mounted.intrinsics, corners[c], points)
        for c, (name, mounted) in enumerate(start.cameras.items())
    ]
    return _Detected(corners, seen, determines_pose(points, seen), np.stack(poses), points)


def _measured_poses(start: HeadCalibration, observations: PoseObservations) -> _Detected:
    """Pixels and points are zeros: the errors of poses are `measured_poses.pose_errors`."""
    V = len(observations.placement)
    nothing = np.full((V, 4, 4), np.nan), np.full((V, 6, 6), np.nan)
    poses, whitening = (
        np.stack([each.get(name, none) for name in start.cameras])
        for each, none in zip(
            (observations.T_cam_target, observations.whitening), nothing, strict=True
        )
    )
    placed = np.asarray(np.isfinite(poses).all(axis=(2, 3)))
    seen = np.repeat(placed[..., None], PAIRS, axis=2)
    pixels = np.zeros((*seen.shape, 2))
    return _Detected(pixels, seen, placed, poses, np.zeros((PAIRS, 3)), whitening)


def _latent_columns(kinematics: Kinematics, eyes: list[int]) -> list[list[int]]:
    """Return which readings are latent in the blocks of the left eye and in those of the right.

    In the order of their kinds, so that those of the two eyes have noise of the same levels. One
    list, for blocks of both eyes, where some reading moves both or their kinds differ.
    """
    kinds = reading_kinds(kinematics)
    own = [sorted(kinematics.used(eye), key=kinds.__getitem__) for eye in EYES]
    if len(eyes) == 1:
        return [own[eyes[0]]] * 2
    if not set(own[0]) & set(own[1]) and [kinds[k] for k in own[0]] == [kinds[k] for k in own[1]]:
        return own
    return [sorted({*own[0], *own[1]})]


def _measures_lengths(T_base_eye: Array | None) -> bool:
    """Return whether measured eye poses say how long a metre is, and with it how large the board.

    Angles do not, nor poses of eyes that turn about a point: the stated board is then the measure.
    """
    if T_base_eye is None:
        return False
    spread = np.nanstd(T_base_eye[..., :3, 3], axis=0)
    return bool(np.linalg.norm(spread, axis=-1).max() > MEASURING_M)


def _place_boards(
    problem: BundleProblem, state: BundleState, T_cam_target: Array
) -> tuple[BundleProblem, BundleState]:
    """Return the state with boards where their best view says; views that disagree lose corners."""
    placements = len(state.T_lbase_target)
    mounts = np.stack([mounted.T_eye_cam for mounted in state.head.cameras.values()])
    right = problem.eye[problem.camera] == 1
    T_base_lbase = np.where(right[:, None, None], state.head.T_rbase_lbase, np.eye(4))
    T_base_cam = detection_eye_poses(problem, state) @ mounts[problem.camera]
    found = inverse(T_base_lbase) @ T_base_cam @ T_cam_target
    known = known_poses(found)
    offers = [np.flatnonzero(known & (problem.placement == p)) for p in range(placements)]
    if not placements or not all(len(offer) for offer in offers):
        raise VergenceError(
            f"A board whose place is to be found needs {LEAST_CORNERS} corners in one image, not "
            "all on one line."
        )
    best, lowest = state.T_lbase_target, np.full(placements, np.inf)
    for k in range(CANDIDATES):
        # Spread over the views, so that one bad stretch cannot be all there is to choose from.
        offered = found[[offer[k * len(offer) // CANDIDATES] for offer in offers]]
        errors = corner_errors(problem, replace(state, T_lbase_target=offered))
        lengths = np.nan_to_num(np.linalg.norm(errors, axis=-1), nan=np.inf)
        total = np.bincount(problem.placement, np.minimum(lengths, FAR_PX).sum(axis=1), placements)
        better = total < lowest
        best = np.where(better[:, None, None], offered, best)
        lowest = np.minimum(lowest, total)
    turn = np.swapaxes(best[problem.placement][:, :3, :3], 1, 2) @ found[:, :3, :3]
    seen = problem.seen.copy()
    seen[known] &= angle(turn[known])[:, None] < TURNED_RAD
    state = replace(state, T_lbase_target=best)
    # A few corners may be too little for a pose, and then lie behind the camera.
    before = np.asarray(np.isfinite(corner_errors(problem, state)).all(axis=(1, 2)))
    seen &= before[:, None]
    pixels = np.where(seen[..., None], problem.pixels, 0.0)
    return replace(problem, seen=seen, pixels=pixels), state
