"""Boards numbered from the wrong end: which they are, by the joint readings and the other cameras.

A chessboard whose ends look alike may be numbered from either: then the image shows it turned by
half a turn about its normal (a square one by any quarter). One image cannot tell. But

- the eye's turn between two views of a board at rest is known from the joint readings, and a wrong
  half turn is far more than that;
- cameras that see the board at the same moment, or at the same place, are related by a rotation
  that all views share, and a wrong half turn does not fit it;
- where the readings tell how two cameras are mounted, that rotation is the one between the bases of
  their eyes, which is far less than a half turn. So one placement suffices.

Only the board's rotation is used, and of the lenses only preliminary intrinsics, for which a turn
of a whole view is no matter. How the cameras are mounted need not be known. If all images of one
placement are turned alike, nothing depends on it: the board's pose absorbs it. So the fewest that
make a placement consistent are turned.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.checks.axes_and_eyes import MOST_TURNED_DEG
from vergence.calibration.checks.flip_evidence import (
    PRIOR,
    SPREAD_RAD,
    agreed_shifts,
    angles_apart,
    apart,
    costs_of_turns,
    synchronised,
)
from vergence.calibration.hand_eye import robust_park_martin
from vergence.calibration.observations import Observations, camera_eyes
from vergence.errors import VergenceError
from vergence.findings import Finding, note, warning
from vergence.geometry.board import Board, Charuco, corner_points
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import angle, known_poses, nearest_rotation, pose, rotation, rotvec

CLEAR = 10.0
"""Evidence [nats] below which a view is left as it is, and named."""
MOST_TURNED_RAD = np.radians(MOST_TURNED_DEG)
"""Between the bases of the eyes, by the joint readings, and between the base of one eye as two of
its cameras put it: farther than bases are apart, and half as far as the least turn of a board."""
LEAST_MOUNTING_VIEWS = 3
"""Of a board at rest, from which the eye's camera can be placed: two turns about two axes."""
LEAST_SPREAD_RAD = 0.03
"""Root mean square motion about the second axis, from which the eye's camera can be placed."""


@dataclass(frozen=True, eq=False)
class Renumbered:
    """Observations in which all boards of a placement are numbered from the same end."""

    observations: Observations
    T_cam_target: Mapping[str, Array]
    """By camera: (V, 4, 4) poses of the board as it is numbered now."""
    turns: Mapping[str, np.ndarray]
    """By camera: (V,) how often a board was turned: by pi, or by pi / 2 where it is square."""
    unclear: Mapping[str, np.ndarray]
    """By camera: (V,) of bool: views that could not be decided, and were left as they are."""


@dataclass(frozen=True, eq=False)
class _CameraViews:
    """What one camera saw of the board, in N views; turns and unclear are filled in."""

    view: np.ndarray
    """(N,)."""
    placement: np.ndarray
    """(N,)."""
    R_cam_target: Array
    """(N, 3, 3)."""
    R_base_eye: Array
    """(N, 3, 3)."""
    R_base_cam: Array | None
    """(N, 3, 3); None: the eye moved too little to determine how its camera is mounted."""
    turns: np.ndarray
    """(N,)."""
    unclear: np.ndarray
    """(N,) of bool."""


def number_alike(observations: Observations, T_cam_target: Mapping[str, Array]) -> Renumbered:
    """Number all boards of a placement from the same end.

    ChArUco boards are numbered by their markers and come back as they are.

    Of the poses T_cam_target (V, 4, 4) by camera, NaN where not known, those by preliminary
    intrinsics will do. Cameras that are not there are left as they are.
    """
    V = len(observations.placement)
    turns = {name: np.zeros(V, dtype=int) for name in observations.corners}
    unclear = {name: np.zeros(V, dtype=bool) for name in observations.corners}
    if isinstance(observations.board, Charuco):
        return Renumbered(observations, T_cam_target, turns, unclear)
    eyes, R = camera_eyes(observations), _turns(observations.board)
    T_base_eye = observations.eye_poses()
    cameras = {
        name: _consistent(observations.placement, T, T_base_eye[:, EYES.index(eyes[name])], R)
        for name, T in T_cam_target.items()
    }
    _together(cameras, eyes, R, parallel_bases=observations.T_base_eye is None)
    for name, seen in cameras.items():
        turns[name][seen.view] = np.where(seen.unclear, 0, seen.turns)
        unclear[name][seen.view] = seen.unclear
    middle = corner_points(observations.board).mean(axis=0)
    T_turn = pose(R, middle - R @ middle)  # about the board's middle
    return Renumbered(
        turn_boards(observations, turns),
        {name: T @ T_turn[turns[name]] for name, T in T_cam_target.items()},
        turns,
        unclear,
    )


def turn_boards(observations: Observations, turns: Mapping[str, np.ndarray]) -> Observations:
    """Return observations with boards turned: by camera (V,) times pi, or pi / 2 if square."""
    points = corner_points(observations.board)
    away = points - points.mean(axis=0)
    moved = away @ np.swapaxes(_turns(observations.board), 1, 2)
    # (n, K): which corner takes the place of each when the board is turned.
    order = np.linalg.norm(moved[:, :, None] - away, axis=-1).argmin(axis=2)
    corners = {
        name: np.take_along_axis(observations.corners[name], order[each][..., None], axis=1)
        for name, each in turns.items()
    }
    return replace(observations, corners={**observations.corners, **corners})


def nearest(R_cam_target: Array, board: Board) -> Array:
    """Return rotations (N, 3, 3) of a board at rest, turned so that they are nearest each other.

    For motion well below half a right angle; readings are not needed.
    """
    R = _turns(board)
    if isinstance(board, Charuco) or len(R_cam_target) < 2:
        return R_cam_target
    off = apart(R_cam_target[:, None], R_cam_target[None], R)
    return R_cam_target @ R[synchronised(off * SPREAD_RAD)[0]]


def findings(found: Renumbered) -> list[Finding]:
    """Name the views that were turned, and those that could not be decided."""
    said = []
    if where := _views(found.turns):
        said.append(
            note("boards-turned", f"Numbered from the wrong end, and turned: {where}.", where)
        )
    if where := _views(found.unclear):
        sentence = (
            "Whether these boards are numbered from the wrong end is not clear, and they were left "
            f"as they are: {where}; the joint readings and the other cameras do not agree on them."
        )
        said.append(warning("boards-unclear", sentence, where))
    return said


def _views(chosen: Mapping[str, np.ndarray]) -> str:
    """Name the views that are not zero, by camera (V,); empty: there are none."""
    parts = []
    for name, mask in chosen.items():
        rows = np.flatnonzero(mask)
        if len(rows):
            views = "view" if len(rows) == 1 else "views"
            parts.append(f"{views} {', '.join(map(str, rows))} of {name}")
    return "; ".join(parts)


def _turns(board: Board) -> Array:
    """Return the rotations (n, 3, 3) that put a board onto itself: n = 2, or 4 if it is square."""
    n = 4 if board.columns == board.rows else 2
    return rotation(2 * np.pi / n * np.arange(n)[:, None] * [0.0, 0.0, 1.0])


def _consistent(
    placement: np.ndarray, T_cam_target: Array, T_base_eye: Array, R: Array
) -> _CameraViews:
    """Return a camera's views with turns that make each placement agree with the readings."""
    usable = known_poses(T_cam_target) & known_poses(T_base_eye)
    view = np.flatnonzero(usable)
    R_cam_target, R_base_eye = T_cam_target[view, :3, :3], T_base_eye[view, :3, :3]
    groups = [np.flatnonzero(placement[view] == p) for p in np.unique(placement[view])]
    several = [group for group in groups if len(group) > 1]
    turns, unclear = np.zeros(len(view), dtype=int), np.zeros(len(view), dtype=bool)
    for group in several:
        off = angles_apart(R_cam_target[group], R_base_eye[group], R)
        turns[group], evidence = synchronised(off)
        unclear[group] = evidence < CLEAR
    chosen = max(groups, key=len, default=np.arange(0))
    chosen = chosen[~unclear[chosen]]
    R_eye_cam = _mounting(R_base_eye[chosen], R_cam_target[chosen] @ R[turns[chosen]])
    R_base_cam = None if R_eye_cam is None else R_base_eye @ R_eye_cam
    if R_base_cam is not None:
        # With the mounting known not only angles can be compared, but rotations.
        R_base_target = R_base_cam @ R_cam_target
        for group in several:
            off = apart(R_base_target[group][:, None], R_base_target[group][None], R)
            better, evidence = synchronised(off)
            clear = evidence >= CLEAR
            if clear.sum() >= (~unclear[group]).sum():
                turns[group], unclear[group] = better, ~clear
    return _CameraViews(view, placement[view], R_cam_target, R_base_eye, R_base_cam, turns, unclear)


def _mounting(R_base_eye: Array, R_cam_target: Array) -> Array | None:
    """Return R_eye_cam (3, 3) by views of one placement, or None where they move too little."""
    if len(R_base_eye) < LEAST_MOUNTING_VIEWS:
        return None
    motion = rotvec(np.swapaxes(R_base_eye[:1], 1, 2) @ R_base_eye)
    spread = np.linalg.svd(motion - motion.mean(axis=0), compute_uv=False) / np.sqrt(len(motion))
    if spread[1] < LEAST_SPREAD_RAD:
        return None
    try:
        return robust_park_martin(pose(R_base_eye), pose(R_cam_target))[:3, :3]
    except VergenceError:
        return None


def _together(
    cameras: Mapping[str, _CameraViews],
    eyes: Mapping[str, str],
    R: Array,
    *,
    parallel_bases: bool,
) -> None:
    """Change the turns of whole placements in a camera so that the cameras agree.

    Bases are parallel where the joints of both eyes turn about the head's axes.
    """
    n = len(R)
    votes: dict[int, dict[tuple[str, str], Array]] = {}
    for a, b in combinations(cameras, 2):
        same_eye = eyes[a] == eyes[b]
        placement, links = _links(cameras[a], cameras[b], R, same_eye=same_eye)
        if len(placement):
            mounted = cameras[a].R_base_cam is not None and cameras[b].R_base_cam is not None
            most_rad = MOST_TURNED_RAD if mounted and (same_eye or parallel_bases) else np.pi
            costs = costs_of_turns(*links, R, most_rad=most_rad)
            for p, cost in zip(placement, costs, strict=True):
                pairs = votes.setdefault(int(p), {})
                pairs[a, b] = pairs.get((a, b), np.zeros(n)) + cost
    upright = {name: seen.R_cam_target[:, :, 0].mean(axis=0) for name, seen in cameras.items()}
    for p, pairs in votes.items():
        for names in _connected(pairs):
            here = {name: cameras[name].placement == p for name in names}
            views = sum(np.count_nonzero(mask) for mask in here.values())
            own = np.zeros((len(names), n))
            for c, shift in np.ndindex(own.shape):
                seen, mask = cameras[names[c]], here[names[c]]
                turns = (seen.turns[mask] + shift) % n
                x_axes = (seen.R_cam_target[mask] @ R[turns])[:, :, 0] @ upright[names[c]]
                # Boards are mostly held the same way up; this only decides between equals.
                own[c, shift] = PRIOR * (np.count_nonzero(turns) - x_axes.sum() / views / 2)
            between = {
                (names.index(a), names.index(b)): cost
                for (a, b), cost in pairs.items()
                if a in here
            }
            shifts, evidence = agreed_shifts(own, between)
            for name, shift in zip(names, shifts, strict=True):
                seen = cameras[name]
                seen.turns[here[name]] = (seen.turns[here[name]] + shift) % n
                seen.unclear[here[name]] |= evidence < CLEAR


def _connected(pairs: Collection[tuple[str, str]]) -> list[list[str]]:
    """Return the names that pairs connect, directly or not."""
    found: list[set[str]] = []
    for pair in pairs:
        touching = [names for names in found if names & set(pair)]
        found = [names for names in found if names not in touching]
        found.append(set(pair).union(*touching))
    return [sorted(names) for names in found]


def _links(
    a: _CameraViews, b: _CameraViews, R: Array, *, same_eye: bool
) -> tuple[np.ndarray, tuple[Array, Array, Array, Array]]:
    """Return the placements (L,) that link two cameras, and the links: see costs_of_turns."""
    seen_a, seen_b = (each.R_cam_target @ R[each.turns] for each in (a, b))
    if a.R_base_cam is not None and b.R_base_cam is not None:
        placement = np.intersect1d(a.placement[~a.unclear], b.placement[~b.unclear])
        in_base = (a.R_base_cam @ seen_a, b.R_base_cam @ seen_b)
        groups = [[(e.placement == p) & ~e.unclear for p in placement] for e in (a, b)]
        sums = [[R[g].sum(axis=0) for g in own] for R, own in zip(in_base, groups, strict=True)]
        mean_a, mean_b = nearest_rotation(np.reshape(sums, (2, -1, 3, 3)))  # (P, 3, 3)
        least = np.min([[g.sum() for g in own] for own in groups], axis=0)
        return placement, (mean_a, mean_b, np.zeros(len(placement)), least)
    _, i, j = np.intersect1d(a.view, b.view, return_indices=True)
    usable = ~(a.unclear[i] | b.unclear[j])
    i, j = i[usable], j[usable]
    slack = angle(a.R_base_eye[i]) + angle(b.R_base_eye[j])
    slack = np.zeros(len(i)) if same_eye else slack
    return a.placement[i], (seen_a[i], seen_b[j], slack, np.ones(len(i)))
