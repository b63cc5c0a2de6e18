"""Number all boards of a placement from the same end.

A chessboard whose ends look alike may be numbered from either end: half of the images then show it
turned by half a turn about its normal (a square one by a quarter). One image does not show which,
but a wrong turn is far more than any eye moves unseen: within a camera, turns between views of a
board at rest are those of the readings; between cameras, one rotation relates all their views. Only
rotations are used. A turn that all images of a placement share changes the board's pose alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array, nearest_rotation
from vergence.calibration.observations import Observations, camera_eyes, most_seen
from vergence.errors import VergenceError
from vergence.findings import Finding, note, warning
from vergence.geometry.board import AprilGrid, Board, Charuco, CircleGrid, corner_points
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import known_poses, pose, rotation, rotvec

SPREAD_RAD, CAP = 0.05, 50.0
"""Angle between views that are numbered alike (gains of a few percent, joint noise of half a degree
and preliminary lenses stay below), and largest cost of one comparison [nats]."""
PRIOR = float(np.log(2.0))
"""Cost of turning a board [nats]: at most a third of them are turned."""
CLEAR = 10.0
"""Evidence below which a turn is not settled [nats]."""
MOST_TURNED_RAD = np.radians(30.0)
"""Between the bases of two eyes, or of an eye as two of its cameras show it; as built they are
parallel."""
LEAST_SPREAD_RAD = 0.02
"""Minimum root mean square turn about the second axis that places a camera in its eye."""
EXACT_RAD = np.radians(0.1)
"""Misfit below which the L1 fit weighs all turns alike: the noise of a good encoder."""
MOST_PAIRED = 20
"""Number of views with which each view is paired; five times as many propose a rotation."""


@dataclass(frozen=True, eq=False)
class Renumbered:
    """Observations in which all boards of a placement are numbered from the same end."""

    observations: Observations
    T_cam_target: Mapping[str, Array]
    """By camera: (V, 4, 4) poses of the board as it is numbered now."""
    turns: Mapping[str, np.ndarray]
    """By camera: (V,) how often a board was turned: by pi, or by pi / 2 where it is square."""
    unclear: Mapping[str, np.ndarray]
    """By camera: (V,) of bool: images whose turn against other cameras, or views, nothing settles.
    """


@dataclass(eq=False)
class _Camera:
    """What one camera saw in N views; turns and unclear are filled in."""

    e: int
    view: np.ndarray
    placement: np.ndarray
    R_cam_target: Array
    R_base_eye: Array
    turns: np.ndarray
    unclear: np.ndarray
    R_eye_cam: Array | None = None
    """None: the eye moved too little before one board."""


def number_alike(observations: Observations, T_cam_target: Mapping[str, Array]) -> Renumbered:
    """Number all boards of a placement alike; those of one numbering come back as they are.

    T_cam_target has by camera the poses (V, 4, 4) of the board by preliminary lenses, NaN where not
    known. Cameras that it lacks are left as they are.
    """
    V, board = len(observations.placement), observations.board
    turns = {name: np.zeros(V, dtype=int) for name in observations.corners}
    unclear = {name: np.zeros(V, dtype=bool) for name in observations.corners}
    S = symmetries(board)
    if len(S) == 1:
        return Renumbered(observations, T_cam_target, turns, unclear)
    poses, eyes = observations.eye_poses(), camera_eyes(observations)
    cameras = {
        name: _by_readings(observations.placement, T, poses, EYES.index(eyes[name]), S)
        for name, T in T_cam_target.items()
    }
    if observations.eye_motion == "fixed":  # the first camera of an eye stands for its base
        for name in {eyes[name]: name for name in reversed(cameras)}.values():
            cameras[name].R_eye_cam = np.eye(3)
    parallel = observations.eye_motion == "pan-tilt"
    _join(list(cameras.values()), S, MOST_TURNED_RAD if parallel else np.pi)
    _turn_fewest(list(cameras.values()), S)
    for name, camera in cameras.items():
        turns[name][camera.view] = camera.turns
        unclear[name][camera.view] = camera.unclear
    middle = corner_points(board).mean(axis=0)
    T_turn = pose(S, middle - S @ middle)  # about the board's middle
    return Renumbered(
        turn_boards(observations, turns),
        {name: T @ T_turn[turns[name]] for name, T in T_cam_target.items()},
        turns,
        unclear,
    )


def turn_boards(observations: Observations, turns: Mapping[str, np.ndarray]) -> Observations:
    """Turn boards: by camera (V,) times pi, or pi / 2 if they are square."""
    points = corner_points(observations.board)
    away = points - points.mean(axis=0)
    moved = away @ np.swapaxes(symmetries(observations.board), 1, 2)
    # (n, K): which corner takes the place of each when the board is turned.
    order = np.linalg.norm(moved[:, :, None] - away, axis=-1).argmin(axis=2)
    corners = {
        name: np.take_along_axis(observations.corners[name], order[each][..., None], axis=1)
        for name, each in turns.items()
    }
    return replace(observations, corners={**observations.corners, **corners})


def symmetries(board: Board) -> Array:
    """Return the rotations (n, 3, 3) that put a board onto itself: n = 2, or 4 if it is square.

    n = 1 for boards with markers, and for asymmetric grids with an odd number of rows.
    """
    n = 4 if board.columns == board.rows else 2
    if isinstance(board, (Charuco, AprilGrid)):
        n = 1
    elif isinstance(board, CircleGrid) and board.asymmetric:
        n = 1 if board.rows % 2 else 2
    return rotation(2 * np.pi / n * np.arange(n)[:, None] * [0.0, 0.0, 1.0])


def nearest_numbering(R_cam_target: Array, board: Board) -> Array:
    """Turn boards at rest (N, 3, 3) so that they are nearest to each other; readings play no part.

    It holds for motion below half the turn between two numberings.
    """
    S = symmetries(board)
    if len(S) == 1 or len(R_cam_target) < 2:
        return R_cam_target
    off = _angles(np.einsum("iab,nbc,jac->ijn", R_cam_target, S, R_cam_target, optimize=True))
    return R_cam_target @ S[_agreed(off * SPREAD_RAD)[0]]


def fit_turns(R_base_eye: Array, R_cam_target: Array) -> tuple[Array, Array, float]:
    """Fit R_eye_cam (3, 3) to the turns between N views of a board at rest, robustly (L1).

    An eye turns by A, as read, and its camera by B, as the images show: A X = X B (Park and Martin
    1994). Returns X with the median misfit (N,) of each view's turns to the others, and the median
    turn [rad].
    """
    N = len(R_base_eye)
    paired = np.unique(np.linspace(0, N - 1, MOST_PAIRED).astype(int))
    a = rotvec(np.swapaxes(R_base_eye[paired], 1, 2)[:, None] @ R_base_eye)
    b = rotvec(R_cam_target[paired][:, None] @ np.swapaxes(R_cam_target, 1, 2))
    weights = np.ones(a.shape[:2])
    R, off = np.eye(3), weights
    for _ in range(6):
        R = nearest_rotation(np.einsum("mn,mna,mnb->ab", weights, a, b))
        off = np.linalg.norm(a - b @ R.T, axis=-1)
        weights = 1 / np.maximum(off, EXACT_RAD)
    off[np.arange(len(paired)), paired] = np.nan
    return R, np.nanmedian(off, axis=0), float(np.median(np.linalg.norm(b, axis=-1)))


def _by_readings(
    placement: np.ndarray, T_cam_target: Array, T_base_eye: Array, e: int, S: Array
) -> _Camera:
    """Turn the boards of each placement so that one camera's views agree with the readings."""
    view = np.flatnonzero(known_poses(T_cam_target) & known_poses(T_base_eye[:, e]))
    R_cam, R_eye = T_cam_target[view, :3, :3], T_base_eye[view, e, :3, :3]
    turns, unclear, placement = np.zeros(len(view), int), np.zeros(len(view), bool), placement[view]
    for p in np.unique(placement):
        here = np.flatnonzero(placement == p)
        # A rotation's angle is the same in every frame: the mounting is not needed.
        between = np.einsum("iab,nbc,jac->ijn", R_cam[here], S, R_cam[here], optimize=True)
        read = np.einsum("iab,jab->ij", R_eye[here], R_eye[here])
        off = np.abs(_angles(between) - _angles(read)[..., None])
        turns[here], evidence = _agreed(off)
        unclear[here] = (evidence < CLEAR) & (len(here) > 1)
    camera = _Camera(e, view, placement, R_cam, R_eye, turns, unclear)
    chosen = most_seen(placement, ~unclear)
    if len(chosen) > 2:
        motion = rotvec(np.swapaxes(R_eye[chosen[:1]], 1, 2) @ R_eye[chosen])
        spread = np.linalg.svd(motion - motion.mean(axis=0), compute_uv=False)
        if spread[1] >= LEAST_SPREAD_RAD * np.sqrt(len(chosen)):
            camera.R_eye_cam, *_ = fit_turns(R_eye[chosen], R_cam[chosen] @ S[turns[chosen]])
    return camera


def _agreed(off: Array) -> tuple[np.ndarray, Array]:
    """Return turns (N,) on which views agree, and the evidence (N,) [nats] for each.

    `off` (N, N, n) is the angle between views i and j if i is turned by k more than j.
    """
    N, n = off.shape[0], off.shape[2]
    cost = _cost(off)
    cost[np.arange(N), np.arange(N)] = 0.0
    reference = cost.min(axis=2).sum(axis=0).argmin()  # the one that agrees with most
    turns, (i, j) = cost[:, reference].argmin(axis=1), np.indices((N, N))
    options = cost[:, reference]
    for _ in range(5):
        options = np.stack([cost[i, j, (k - turns) % n].sum(axis=1) for k in range(n)], axis=1)
        turns = options.argmin(axis=1)
    return turns, np.diff(np.sort(options, axis=1)[:, :2], axis=1)[:, 0]


def _join(cameras: list[_Camera], S: Array, most_turned_rad: float) -> None:
    """Turn the boards of one camera after the other so that they agree with those before.

    The first one's base is the frame in which boards are placed. Cameras that were placed in their
    eye come first; the others then need only their own mounting.
    """
    placed: dict[int, Array] = {}
    bases: dict[int, Array] = {}
    waiting = [camera for camera in cameras if len(camera.view)]
    waiting.sort(key=lambda camera: (camera.R_eye_cam is None, -len(camera.view)))
    while waiting:
        linked = [c for c in waiting if np.isin(c.placement, list(placed)).any()]
        camera = (linked or waiting)[0]
        waiting.remove(camera)
        mounted = camera.R_eye_cam is not None
        common = np.flatnonzero(np.isin(camera.placement, list(placed)) & ~camera.unclear)
        if not mounted and not (len(common) and camera.e in bases):
            # Images that no other camera shares are as good in one numbering as in the other.
            others = [each.placement for each in cameras if each is not camera]
            camera.unclear |= np.isin(camera.placement, np.concatenate([*others, []]))
            continue
        R = camera.R_cam_target @ S[camera.turns]
        if camera.R_eye_cam is not None:
            R = camera.R_base_eye @ camera.R_eye_cam @ R
        Y = np.eye(3)
        if len(common):
            A = np.array([placed[int(p)] for p in camera.placement[common]])
            limit = most_turned_rad
            if camera.e in bases:
                A, limit = bases[camera.e].T @ A, MOST_TURNED_RAD
            if not mounted:
                A, limit = np.swapaxes(camera.R_base_eye[common], 1, 2) @ A, np.pi
            numbers, group = np.unique(camera.placement[common], return_inverse=True)
            Y, costs = _relative(A, R[common], group, S, limit)
            evidence = np.diff(np.sort(costs, axis=1)[:, :2], axis=1)[:, 0]
            for p, k, clear in zip(numbers, costs.argmin(axis=1), evidence >= CLEAR, strict=True):
                here = camera.placement == p
                if clear:
                    camera.turns[here] = (camera.turns[here] + k) % len(S)
                    R[here] = R[here] @ S[k]
                else:
                    camera.unclear[here] = True
        if mounted:
            bases.setdefault(camera.e, Y)
        else:
            R = camera.R_base_eye @ Y @ R
        for p in np.unique(camera.placement[~camera.unclear]):
            here = (camera.placement == p) & ~camera.unclear
            placed.setdefault(int(p), nearest_rotation((bases[camera.e] @ R[here]).sum(axis=0)))


def _turn_fewest(cameras: list[_Camera], S: Array) -> None:
    """Of the numberings that agree choose for each placement the one that turns fewest images.

    Of several it is the one in which boards are held the same way up as in most images.
    """
    for p in np.unique(np.concatenate([camera.placement for camera in cameras])):
        cost, seeing = np.zeros(len(S)), [camera for camera in cameras if p in camera.placement]
        for camera in seeing:
            R = camera.R_cam_target[camera.placement == p]
            up = camera.R_cam_target[:, :, 0].mean(axis=0)
            for k in range(len(S)):
                turns = (camera.turns[camera.placement == p] + k) % len(S)
                upright = ((R @ S[turns])[:, :, 0] @ up).sum() / len(camera.view)
                cost[k] += np.count_nonzero(turns) - upright / 2
        for camera in seeing:
            here = camera.placement == p
            camera.turns[here] = (camera.turns[here] + int(cost.argmin())) % len(S)


def _relative(
    A: Array, B: Array, group: np.ndarray, S: Array, most_rad: float
) -> tuple[Array, Array]:
    """Find the rotation Y (3, 3) of A = Y B S^k, with one k for each placement.

    Each link proposes a Y for each k, and each Y is judged by all links. Returns Y and the cost
    (P, n) [nats] of each k with the Y that then suits the other placements best.
    A and B (L, 3, 3) are the boards in the frame in which they are placed, and in the sought one;
    group (L,) is their placement, from 0 to P - 1. Y turns by most_rad at most.
    """
    between = np.einsum("lab,nbc,ldc->lnad", A, np.swapaxes(S, 1, 2), B, optimize=True)
    chosen = np.unique(np.linspace(0, len(A) - 1, 5 * MOST_PAIRED).astype(int))
    offers = between[chosen].reshape(-1, 9)
    off = _angles(offers @ between.reshape(-1, 9).T).reshape(len(offers), len(A), len(S))
    members = group == np.arange(group.max() + 1)[:, None]
    cost = np.einsum("pl,olk->opk", members, _cost(off), optimize=True)
    prior = PRIOR * members.sum(axis=1)[:, None] * (np.arange(len(S)) > 0)
    least = (cost + prior).min(axis=2)
    too_far = _cost(np.maximum(_angles(offers @ np.eye(3).ravel()) - most_rad, 0.0))
    total = least.sum(axis=1) + too_far
    return (
        offers[total.argmin()].reshape(3, 3),
        (total[:, None, None] - least[..., None] + cost).min(axis=0),
    )


def _angles(trace: Array) -> Array:
    """Return the angles [rad] of rotations of these traces."""
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _cost(off: Array) -> Array:
    """Return the cost [nats] of angles that should be zero."""
    return np.minimum((off / SPREAD_RAD) ** 2 / 2, CAP)


def without_unclear(
    observations: Observations, numbered: Renumbered
) -> tuple[Observations, list[Finding]]:
    """Name the images whose board was turned, and leave out those that nothing settles.

    Of a board whose ends differ in colour the detector's numbering stands. VergenceError if nothing
    settles most images of a camera.
    """
    findings, corners, board = [], dict(observations.corners), observations.board
    for name in corners:
        turned, unclear = (
            np.flatnonzero(each[name]).tolist() for each in (numbered.turns, numbered.unclear)
        )
        if turned:
            where = f"{', '.join(map(observations.name_of_view, turned))} of {name}"
            sentence = f"The board is numbered from the wrong end, and was turned, in {where}."
            findings.append(note("boards-turned", sentence, where))
        if unclear and (board.kind == "circles" or (board.columns + board.rows) % 2 == 0):
            where = f"{', '.join(map(observations.name_of_view, unclear))} of {name}"
            sentence = (
                "Neither readings nor other cameras settle from which end the board is numbered in "
                f"{where}: use a board whose ends differ (ChArUco, or an even number of corners "
                "one way and an odd one the other way)"
            )
            if len(unclear) > np.isfinite(corners[name]).any(axis=(1, 2)).sum() / 2:
                raise VergenceError(f"{sentence}.")
            corners[name] = corners[name].copy()
            corners[name][unclear] = np.nan
            findings.append(warning("boards-unclear", f"{sentence}; they were left out.", where))
    return replace(observations, corners=corners), findings
