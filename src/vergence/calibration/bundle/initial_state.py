"""From corners and readings to a Problem and the State to start from."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.problem import (
    AXES,
    INTRINSICS,
    PER_CAMERA,
    POSE,
    Problem,
    State,
    axes_row,
    calibration_names,
    corner_errors,
    eye_poses,
)
from vergence.calibration.sequential.intrinsics import target_poses
from vergence.calibration.sequential.sequential import Views
from vergence.data.timing import DEGREE, Timing, stencil
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, EyeAxes
from vergence.geometry.se3 import angle, inverse

LEAST_CORNERS = 6
"""Of a board in an image, for it to say where the board is."""
CANDIDATES = 12
"""Views from which the start of a board's place is chosen."""
FAR_PX = 50.0
"""Reprojection error that says no more than a larger one, when views vote on a board's place."""
TURNED_RAD = 0.5
"""A board turned by more than this against the other views of its placement contradicts them; the
start is better than that, and a board numbered from the wrong end is turned by pi."""


def one_eye(
    camera: Camera,
    T_eye_cam: Array,
    axes: EyeAxes,
    angles: Array | None,
    poses: Array | None,
    pixels: Array,
    points: Array,
) -> tuple[Problem, State]:
    """Return the problem of one camera of known intrinsics before a board at rest, and its start.

    Args:
        camera: intrinsics.
        T_eye_cam: (4, 4) to start from.
        axes: of the eye.
        angles: (N, 2) readings, or None where there are poses.
        poses: (N, 4, 4) T_base_eye as read, or None where there are angles.
        pixels: (N, K, 2); NaN where not seen. Views without corners are left out.
        points: (K, 3) in frame target.
    """
    seen = np.asarray(np.isfinite(pixels).all(axis=-1))
    used = np.flatnonzero(seen.any(axis=1))
    if not len(used):
        raise VergenceError("The camera sees no corner of the board.")
    zeros = np.zeros(len(used), dtype=np.intp)
    reading = np.zeros((len(used), len(POSE))) if angles is None else angles[used]
    free = np.zeros(len(calibration_names(("camera",))) + len(POSE), dtype=bool)
    free[len(INTRINSICS) : PER_CAMERA] = free[-len(POSE) :] = True
    problem = Problem(
        cameras=("camera",),
        eye=zeros[:1],
        camera=zeros,
        block=np.arange(len(used)),
        placement=zeros,
        pixels=np.where(seen[..., None], pixels, 0.0)[used],
        seen=seen[used],
        points=np.broadcast_to(points, (len(used), *points.shape)),
        spread=np.ones(len(used)),
        block_view=used,
        block_eye=zeros,
        reading=reading,
        around=None,
        course=np.zeros((*reading.shape, DEGREE)),
        read_well=np.zeros(reading.shape[1], dtype=bool),
        poses=None if poses is None else poses[used],
        shared_px=0.0,
        free=free,
    )
    state = State(
        lenses=(camera,),
        T_eye_cam=T_eye_cam[None],
        T_rbase_lbase=np.eye(4),
        axes=np.array([axes_row(axes)] * 2),
        time_offset_s=0.0,
        T_lbase_target=np.eye(4)[None],
        latent=reading,
    )
    return _placed(problem, state)


def whole_head(
    start: HeadCalibration,
    views: Views,
    *,
    timing: Timing | None,
    poses: Array | None,
    hold: Collection[str],
) -> tuple[Problem, State, np.ndarray]:
    """Return the problem of a head, its start, and the (P,) numbers of its placements.

    Args:
        start: calibration to start from; cameras that see no board are left out.
        views: corners and readings.
        timing: when the readings were taken, or None where the eyes stood still.
        poses: (V, 2, 4, 4) poses of the eyes as read, or None for pan and tilt.
        hold: names of parameters that keep their start.
    """
    cameras = tuple(
        name
        for name in start.cameras
        if name in views.corners and np.isfinite(views.corners[name]).all(axis=-1).any()
    )
    if not cameras:
        raise VergenceError(f"None of {', '.join(start.cameras)} sees a board.")
    mounted = [start.cameras[name] for name in cameras]
    eye = np.array([EYES.index(each.eye) for each in mounted], dtype=np.intp)
    corners = np.stack([views.corners[name] for name in cameras])
    seen = np.asarray(np.isfinite(corners).all(axis=-1))
    # Without one view that says where it is, a placement is of no use.
    points = corner_points(views.board)
    numbers = np.unique(views.placement[_telling(points, seen).any(axis=0)])
    camera, view = np.nonzero(seen.any(axis=2) & np.isin(views.placement, numbers))
    pairs, block = np.unique(np.stack([view, eye[camera]], axis=1), axis=0, return_inverse=True)
    block_view, block_eye = pairs.T
    if poses is None:
        reading = views.eye_angles.reshape(-1, 2, 2)[block_view, block_eye]
        finite = np.isfinite(reading).all(axis=1)
    else:
        poses = poses[block_view, block_eye]
        finite = np.isfinite(poses).all(axis=(1, 2))
        reading, timing = np.zeros((len(pairs), len(POSE))), None
    if not finite.all():
        v, e = pairs[~finite][0]
        raise VergenceError(
            f"The {EYES[e]} eye sees a board in view {v}, but its joint reading is not finite; "
            "leave the view out."
        )
    around = None
    if timing is not None:
        run = timing.run[block_view]  # a motion of one eye, not of both
        around = stencil(timing.time_s[block_view], np.where(run > 0, 2 * run - block_eye, 0))
    names = calibration_names(cameras)
    blind = [f"{side}.{name}" for e, side in enumerate(EYES) if e not in eye for name in AXES]
    without_joints = () if poses is None else (*AXES, "time_offset_s")
    free = [
        n not in hold and n not in blind and n.rpartition(".")[2] not in without_joints
        for n in names
    ]
    problem = Problem(
        cameras=cameras,
        eye=eye,
        camera=camera,
        block=block.ravel(),
        placement=np.searchsorted(numbers, views.placement[view]),
        pixels=np.where(seen[..., None], corners, 0.0)[camera, view],
        seen=seen[camera, view],
        points=np.broadcast_to(points, (len(camera), *points.shape)),
        spread=np.ones(len(camera)),
        block_view=block_view,
        block_eye=block_eye,
        reading=reading,
        around=around,
        course=np.zeros((*reading.shape, DEGREE)),
        read_well=np.zeros(reading.shape[1], dtype=bool),
        poses=poses,
        shared_px=views.shared_px,
        free=np.array(free + [True] * (len(POSE) * len(numbers))),
    )
    state = State(
        lenses=tuple(each.intrinsics for each in mounted),
        T_eye_cam=np.stack([each.T_eye_cam for each in mounted]),
        T_rbase_lbase=start.T_rbase_lbase,
        axes=np.array([axes_row(start.axes["left"]), axes_row(start.axes["right"])]),
        time_offset_s=0.0,
        T_lbase_target=np.broadcast_to(np.eye(4), (len(numbers), 4, 4)),
        latent=reading,
    )
    return *_placed(problem, state), numbers


def _telling(points: Array, seen: np.ndarray) -> np.ndarray:
    """Return (...,) where the seen (..., K) corners say where the board is: enough, not in line."""
    count = seen.sum(axis=-1)
    weight = seen / np.maximum(count, 1)[..., None]
    mean = weight @ points
    second = np.einsum("...k,ki,kj->...ij", weight, points, points, optimize=True)
    spread = np.linalg.eigvalsh(second - mean[..., :, None] * mean[..., None, :])
    return (count >= LEAST_CORNERS) & (spread[..., 1] > 1e-3 * np.maximum(spread[..., 2], 1e-30))


def _placed(problem: Problem, state: State) -> tuple[Problem, State]:
    """Return the state with each placement where the view says that explains the others best.

    Views that contradict it lose their corners.
    """
    placements = len(state.T_lbase_target)
    T_cam_target = np.full((len(problem.camera), 4, 4), np.nan)
    for c, lens in enumerate(state.lenses):
        chosen = (problem.camera == c) & _telling(problem.points[0], problem.seen)
        pixels = np.where(problem.seen[..., None], problem.pixels, np.nan)[chosen]
        T_cam_target[chosen] = target_poses(lens, pixels, problem.points[0])
    right = problem.eye[problem.camera] == 1
    T_base_lbase = np.where(right[:, None, None], state.T_rbase_lbase, np.eye(4))
    T_base_cam = eye_poses(problem, state)[problem.block] @ state.T_eye_cam[problem.camera]
    found = inverse(T_base_lbase) @ T_base_cam @ T_cam_target
    known = np.isfinite(found).all(axis=(1, 2))
    offers = [np.flatnonzero(known & (problem.placement == p)) for p in range(placements)]
    if not all(len(offer) for offer in offers):
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
    pixels = np.where(seen[..., None], problem.pixels, 0.0)
    return replace(problem, seen=seen, pixels=pixels), replace(state, T_lbase_target=best)
