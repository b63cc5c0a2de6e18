"""The evidence that boards are numbered from the wrong end, from rotations, in nats.

A cost is minus the logarithm of a likelihood: half the square of an angle, in units of the spread
that good views have, up to a cap.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array

SPREAD_RAD = 0.05
"""Between two views of one board, if both are numbered alike: gains of a few percent, joint noise
of half a degree, preliminary lenses and the planar pose's own error stay below."""
CAP = 50.0
"""Most that one comparison weighs: ten times the spread."""
PRIOR = float(np.log(2.0))
"""Against a view being turned: at most a third of the views are."""
MOST_OFFERS = 100
"""Views of which each says how the others, or two cameras, are related; more find nothing new."""


def angles_apart(R_cam_target: Array, R_base_eye: Array, R: Array) -> Array:
    """Return (N, N, n) how far angles between views are from those of the readings [rad].

    A rotation's angle is the same in every frame: the mounting of the camera is not needed.
    """
    between = np.einsum("iab,nbc,jac->ijn", R_cam_target, R, R_cam_target, optimize=True)
    read = np.einsum("iab,jab->ij", R_base_eye, R_base_eye, optimize=True)
    return np.abs(angle_of(between) - angle_of(read)[..., None])


def apart(R_a: Array, R_b: Array, R: Array) -> Array:
    """Return (..., n) angles between R_a turned and R_b (..., 3, 3)."""
    return angle_of(np.einsum("...ab,nbc,...ac->...n", R_a, R, R_b, optimize=True))


def angle_of(trace: Array) -> Array:
    """Return the angles (...,) [rad] of rotations of these traces (...,)."""
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def cost_of(off: Array) -> Array:
    """Return what angles (...,) [rad] cost that should be zero."""
    return np.minimum((off / SPREAD_RAD) ** 2 / 2, CAP)


def synchronised(off: Array) -> tuple[np.ndarray, Array]:
    """Return turns (N,) and the evidence for each.

    `off` is (N, N, n), the disagreement of views i and j if i is turned by k more than j.
    """
    N, n = off.shape[0], off.shape[2]
    cost = cost_of(off)
    cost[np.arange(N), np.arange(N)] = 0.0
    relative = cost.argmin(axis=2)  # by how much i is turned more than j
    i, j = np.indices((N, N))

    def total(turns: np.ndarray) -> float:
        return float(cost[i, j, (turns[:, None] - turns) % n].sum())

    def options(turns: np.ndarray) -> Array:
        return np.stack([cost[i, j, (k - turns) % n].sum(axis=1) for k in range(n)], axis=1)

    references = np.unique(np.linspace(0, N - 1, MOST_OFFERS).astype(int))
    turns = relative[:, min(references, key=lambda r: total(relative[:, r]))]
    for _ in range(10):
        turns, before = options(turns).argmin(axis=1), turns
        if (turns == before).all():
            break
    evidence = np.diff(np.sort(options(turns), axis=1)[:, :2], axis=1)[:, 0]
    return (turns - np.bincount(turns, minlength=n).argmax()) % n, evidence


def costs_of_turns(
    R_a: Array, R_b: Array, slack: Array, weight: Array, R: Array, *, most_rad: float
) -> Array:
    """Return (L, n) what it costs to turn the board of camera b by k more than that of a.

    The rotation between the cameras is unknown: each link offers n of them. A link's cost is that
    of the rotation that suits it and all others best, less the least of these.

    Args:
        R_a: (L, 3, 3) orientation of the board in camera a, or in the base of its eye.
        R_b: (L, 3, 3) the same in camera b: R_b = Y R_a, with one unknown rotation Y for all links.
        slack: (L,) how far that may be wrong because the eyes were not straight [rad].
        weight: (L,) number of views that would have to be turned for a link to be wrong.
        R: (n, 3, 3) turns of the board.
        most_rad: largest angle of Y that is possible; pi: no limit.
    """
    L, n = len(R_a), len(R)
    between = np.einsum("lab,nbc,ldc->lnad", R_b, R, R_a, optimize=True)
    offering = np.unique(np.linspace(0, L - 1, MOST_OFFERS).astype(int))
    offers = between[offering].reshape(-1, 9)
    too_far = angle_of(offers @ np.eye(3).ravel()) - most_rad
    off = angle_of(offers @ between.reshape(-1, 9).T).reshape(len(offers), L, n)
    allowed = np.repeat(slack[offering], n)[:, None] + slack
    cost = cost_of(np.maximum(off - allowed[..., None], 0.0))
    turned = np.arange(n) > 0
    least = (cost + PRIOR * weight[:, None] * turned).min(axis=2)
    least_total = least.sum(axis=1) + cost_of(np.maximum(too_far, 0.0))
    total = least_total[:, None, None] - least[..., None] + cost
    found = total.min(axis=0)
    return found - found.min(axis=1, keepdims=True)


def agreed_shifts(own: Array, pairs: Mapping[tuple[int, int], Array]) -> tuple[np.ndarray, float]:
    """Return the shifts (C,) of the boards of C cameras that cost least, and the evidence [nats].

    The evidence is what the next best cost more in pairs of cameras: `own` only decides between
    equals, as all views of a camera that hangs upside down are turned together. Nothing depends on
    one shift of all cameras: only what differs by more is another answer. Groups of cameras are
    joined, the clearest first; then whole groups are shifted as long as that costs less, and the
    next best is that of one group.

    Args:
        own: (C, n) what each shift of one camera's boards costs by itself.
        pairs: by cameras a and b (n,) what it costs to shift those of b by k more than those of a.
    """
    C, n = own.shape
    back = -np.arange(n) % n
    between = np.zeros((C, C, n))
    for (a, b), cost in pairs.items():
        between[a, b] += cost
        between[b, a] += cost[back]
    groups = np.eye(C, dtype=bool)  # of each camera, the row of its first one
    shifts, alive, moved = np.zeros(C, dtype=int), np.ones(C, dtype=bool), [*groups.copy()]
    while alive.sum() > 1:
        least = np.sort(between, axis=2)
        clear = np.where(alive[:, None] & alive, least[..., 1] - least[..., 0], -1.0)
        np.fill_diagonal(clear, -1.0)
        a, b = np.unravel_index(clear.argmax(), clear.shape)
        shift = int(between[a, b].argmin())
        shifts[groups[b]] = (shifts[groups[b]] + shift) % n
        between[a] += np.roll(between[b], shift, axis=1)
        between[:, a] = between[a][:, back]
        groups[a] |= groups[b]
        alive[b] = False
        moved.append(groups[a].copy())
    moves = np.concatenate([k * np.array(moved) for k in range(1, n)])
    partial = ~np.array(moved * (n - 1)).all(axis=1)
    while True:
        tried = np.vstack([shifts, (shifts + moves) % n])
        totals = _totals(tried, own, pairs)
        if totals[1:].min() >= totals[0]:
            in_pairs = _totals(tried, np.zeros_like(own), pairs)
            return shifts, float(in_pairs[1:][partial].min() - in_pairs[0])
        shifts = (shifts + moves[totals[1:].argmin()]) % n


def _totals(shifts: np.ndarray, own: Array, pairs: Mapping[tuple[int, int], Array]) -> Array:
    """Return (M,) what shifts (M, C) cost."""
    n = own.shape[1]
    alone = own[np.arange(len(own)), shifts].sum(axis=1)
    return alone + sum(cost[(shifts[:, b] - shifts[:, a]) % n] for (a, b), cost in pairs.items())
