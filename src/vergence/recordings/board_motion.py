"""Whether a board stood still between the views of one camera while its eye turned.

A camera that sits at T_eye_cam in its eye places the board at T_base_eye T_eye_cam T_cam_target.
Errors of readings shift and turn that pose along a few directions only, far more than errors of
corners do along the others: each view has the covariance of both. A board stands still as long as
its views agree, by a Kalman filter with a gate. Where the camera sits follows from the views
themselves: first by a consensus of turns between successive views, then by all of a placement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from vergence.arrays import Array, nearest_rotation
from vergence.geometry.se3 import boxminus, boxplus, hat, inverse, pose, rotvec

READING_RAD = np.radians(0.5), np.radians(0.01), np.radians(1.0)
"""Deviation of readings assumed first, least and largest [rad]: half of a backlash of one degree;
below a good encoder; a hobby servo."""
GAIN_STD = 0.03
"""Deviation of a gain of readings from one, of servos and of gears."""
POSE_SCALES = 0.1, 3.0
"""Least and largest factor on the stated deviation of a board's pose."""
GATE = float(chi2.isf(1e-6, 6))
"""Squared distance of six standard normal numbers from which a board has moved."""
TURNS_RAD, TURNS_PART = np.radians(1.5), 0.05
"""Difference of an eye's and a camera's turn [rad], and as a part of it, that backlash and gains
explain."""
LEAST_TURN_RAD = np.radians(2.0)
"""Turn from which a pair of views tells where the camera sits: above the noise of readings."""
LEAST_PAIRS, DRAWS = 4, 200
"""Fewest pairs that make a consensus, and random draws of three pairs."""
WRONG = -1
"""Number of views that do not agree with those before and after, which agree."""
ROUNDS = 4
"""Rounds of numbering views and of placing the camera."""


@dataclass(frozen=True, eq=False)
class EyeViews:
    """n views of a board by one camera, in order of time."""

    T_base_eye: Array
    """(n, 4, 4) by the readings."""
    by_errors: Array
    """(n, 6, q) increments of that pose by the q quantities that err, each as 1 rad of a joint."""
    by_gains: Array
    """(n, 6, g) increments of that pose by an excess of the gains."""
    T_cam_target: Array
    """(n, 4, 4)."""
    covariance: Array
    """(n, 6, 6) of the increments of T_cam_target."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """Where n boards stand, and what errs."""

    T_base_target: Array
    by_camera: Array
    """(n, 6, 6 + g) derivatives by T_eye_cam and by the gains."""
    by_errors: Array
    """(n, 6, q)."""
    covariance: Array
    """(n, 6, 6) by the corners alone."""


def number_boards(
    views: EyeViews, stands: Callable[[int, int], bool | None]
) -> tuple[np.ndarray, bool]:
    """Number the boards (n,) of int, from 0: views with the same number show one that stood still.

    WRONG are views that disagree while those before and after agree.

    `stands(i, k)` tells of two views whether the eye stood still in between and the board did as
    well, or not; None: the eye moved. Returns also whether the camera's place in the eye was found,
    without which boards before a moving eye have numbers of their own.
    """
    T_eye_cam = _consensus(views)
    if T_eye_cam is None:
        return _segments(None, stands, len(views.T_base_eye)), False
    gains = np.zeros(views.by_gains.shape[2])
    scales, number = (READING_RAD[0], 1.0), np.zeros(0, int)
    for _ in range(ROUNDS):
        placed = _place(views, T_eye_cam, gains)
        covariance = _covariance(placed, scales)
        number = _segments((placed.T_base_target, covariance), stands, len(covariance))
        step = _adjust(placed, covariance, number, gains)
        T_eye_cam, gains = boxplus(T_eye_cam, step[:6]), gains + step[6:]
        scales = _scales(_place(views, T_eye_cam, gains), number)
    return number, True


def _place(views: EyeViews, T_eye_cam: Array, gains: Array) -> _Placed:
    """Place the boards in the base."""
    T_base_eye = boxplus(views.T_base_eye, views.by_gains @ gains)
    T_base_cam = T_base_eye @ T_eye_cam
    T = T_base_cam @ views.T_cam_target
    to_board = T[:, :3, 3] - T_base_eye[:, :3, 3]
    by_camera, turned = _block(T_base_eye), _block(T_base_cam)
    parts = [carried(by_camera, T[:, :3, 3] - T_base_cam[:, :3, 3])]
    parts += [carried(each, to_board) for each in (views.by_gains, views.by_errors)]
    return _Placed(
        T,
        np.concatenate(parts[:2], axis=2),
        parts[2],
        turned @ views.covariance @ np.swapaxes(turned, 1, 2),
    )


def _block(T: Array) -> Array:
    """Turn increments (..., 6) from the axes of frame b into those of frame a, by T_a_b."""
    found = np.zeros((*T.shape[:-2], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = T[..., :3, :3]
    return found


def carried(by: Array, arm: Array) -> Array:
    """Carry increments (n, 6, m) of a frame over to what is fixed to it, an arm (n, 3) away."""
    return np.concatenate([by[:, :3], by[:, 3:] - hat(arm) @ by[:, :3]], axis=1)


def _covariance(placed: _Placed, scales: tuple[float, float]) -> Array:
    """Compute the covariances (n, 6, 6), by the deviation of readings and a factor on poses."""
    reading_rad, factor = scales
    J = placed.by_errors
    return factor**2 * placed.covariance + reading_rad**2 * J @ np.swapaxes(J, 1, 2)


def _segments(
    placed: tuple[Array, Array] | None, stands: Callable[[int, int], bool | None], n: int
) -> np.ndarray:
    """Number views (n,) of int that show a board at one place, in order of time.

    `placed` are poses (n, 4, 4) with their covariances (n, 6, 6). A view that does not agree while
    one of the next two does is WRONG by itself.
    """
    number = np.zeros(n, int)
    first, last = 0, -1
    while first < n:
        last += 1
        number[first] = last
        mean, information, latest = np.zeros(6), np.zeros((6, 6)), first
        if placed is not None:
            information = np.linalg.inv(placed[1][first])
        k = first + 1
        while k < min(n, latest + 4):
            agrees = stands(latest, k)
            if agrees is False:
                break
            if placed is not None:
                T, covariance = placed
                away = boxminus(T[k], T[first]) - mean
                innovation = np.linalg.inv(information) + covariance[k]
                near = bool(away @ np.linalg.solve(innovation, away) < GATE)
                agrees = near if agrees is None else agrees
                if near:
                    weight = np.linalg.inv(covariance[k])
                    information = information + weight
                    mean = mean + np.linalg.solve(information, weight @ away)
            if agrees:
                number[latest + 1 : k], number[k], latest = WRONG, last, k
            k += 1
        first = latest + 1
    return number


def _adjust(placed: _Placed, covariance: Array, number: np.ndarray, gains: Array) -> Array:
    """Adjust T_eye_cam and gains by least squares so that boards of one number stand at one pose.

    Returns increments (6 + g,).
    """
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    m = placed.by_camera.shape[2]
    normal, right = np.zeros((m, m)), np.zeros(m)
    prior = np.append(np.zeros(6), np.full(m - 6, GAIN_STD**-2))
    for each in range(number.max() + 1):
        rows = np.flatnonzero(number == each)
        if len(rows) < 2:
            continue
        T = placed.T_base_target[rows]
        away = (whiten[rows] @ boxminus(T, T[0])[..., None])[..., 0].ravel()
        A = (whiten[rows] @ placed.by_camera[rows]).reshape(-1, m)
        # The board's own pose is eliminated.
        Q, _ = np.linalg.qr(whiten[rows].reshape(-1, 6))
        A, away = A - Q @ (Q.T @ A), away - Q @ (Q.T @ away)
        normal += A.T @ A
        right -= A.T @ away
    normal += np.diag(prior)
    right[6:] -= prior[6:] * gains
    return np.linalg.lstsq(normal, right, rcond=1e-9)[0]


def _scales(placed: _Placed, number: np.ndarray) -> tuple[float, float]:
    """Estimate the deviation of readings [rad] and the factor on that of poses.

    Medians of successive views with the same number, along the errors of readings and across.
    """
    i = np.flatnonzero((number[1:] == number[:-1]) & (number[1:] != WRONG))
    if len(i) < LEAST_PAIRS:
        return READING_RAD[0], 1.0
    away = boxminus(placed.T_base_target[i + 1], placed.T_base_target[i])
    C = placed.covariance[i] + placed.covariance[i + 1]
    whiten = np.linalg.inv(np.linalg.cholesky(C))
    J, q = placed.by_errors[i], placed.by_errors.shape[2]
    U, sizes, _ = np.linalg.svd(whiten @ J, full_matrices=False)
    away = (whiten @ away[..., None])[..., 0]
    along = np.einsum("nij,ni->nj", U, away)
    across = (away**2).sum(axis=1) - (along**2).sum(axis=1)
    free = max(1, 6 - min(q, 6))
    factor = np.sqrt(np.median(across) / chi2.median(free)) if q < 6 else 1.0
    factor = float(np.clip(factor, *POSE_SCALES))
    excess = np.median(along**2, axis=0) / chi2.median(1) - factor**2
    reading_rad = np.sqrt(np.maximum(excess, 0) / (2 * np.median(sizes**2, axis=0)))
    return float(np.clip(reading_rad.max(), *READING_RAD[1:])), factor


def _consensus(views: EyeViews) -> Array | None:
    """Find T_eye_cam by turns of the camera that agree with those of the eye; None: too few do.

    A reading of the wrong sign looks like another mounting, to first order.
    """
    n = len(views.T_base_eye)
    i, j = np.triu_indices(n, k=1)
    i, j = i[j - i <= 3], j[j - i <= 3]
    A = inverse(views.T_base_eye[i]) @ views.T_base_eye[j]
    B = views.T_cam_target[i] @ inverse(views.T_cam_target[j])
    a, b = rotvec(A[:, :3, :3]), rotvec(B[:, :3, :3])
    turn = np.linalg.norm(a, axis=1)
    allowed = TURNS_RAD + TURNS_PART * turn
    alike = np.abs(turn - np.linalg.norm(b, axis=1)) < allowed
    rows = np.flatnonzero(alike & (turn > LEAST_TURN_RAD))
    if len(rows) < LEAST_PAIRS:
        return None
    rng, best = np.random.default_rng(0), np.zeros(0, int)
    for _ in range(DRAWS):
        drawn = rng.choice(rows, 3, replace=False)
        R = nearest_rotation(a[drawn].T @ b[drawn])
        agreeing = rows[np.linalg.norm(a[rows] - b[rows] @ R.T, axis=1) < allowed[rows]]
        best = agreeing if len(agreeing) > len(best) else best
    spread = np.linalg.svd(a[best], compute_uv=False)
    if len(best) < LEAST_PAIRS or spread[1] < LEAST_TURN_RAD:
        return None
    R = nearest_rotation(a[best].T @ b[best])
    left = np.eye(3) - A[best, :3, :3]
    right = A[best, :3, 3] - B[best, :3, 3] @ R.T
    weights, t = np.ones(len(best)), np.zeros(3)
    for _ in range(20):  # of least distances, not squares
        rows_t, rest = (weights[:, None, None] * left).reshape(-1, 3), weights[:, None] * right
        t = np.linalg.lstsq(rows_t, rest.ravel(), rcond=0.01)[0]
        weights = 1 / np.sqrt(np.maximum(np.linalg.norm(left @ t - right, axis=1), 1e-4))
    return pose(R, t)
