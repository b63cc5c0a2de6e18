"""Errors of measured eye poses that neighbouring postures share, as residuals estimate them.

Part of each error is a smooth function of the posture (`geometry.pose_errors`), with coefficients
of one standard deviation. What constant transformations before and after the poses explain belongs
to T_eye_cam and to the board (restricted spatial regression: Hodges and Reich 2010), so that
T_eye_cam is the mounting that predicts images best where the arm was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.postures import Postures
from vergence.calibration.readings import SMOOTH
from vergence.estimation.residual import Levels, Residual, Rows
from vergence.estimation.variables import Block, Variables
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.parameters import named_columns
from vergence.geometry.pose_errors import PoseErrors, constant_transformations, kernel
from vergence.geometry.se3 import POSE, hat

MOST_MODES = 24
"""Largest number of smooth functions of the posture, for each component of a pose."""
MOST_POSES = 100
"""Largest number of poses about which the functions have kernels; of recordings in motion, whose
rows are alike, so that files stay below 100 kB."""
LENGTH = 2.0
"""Scale of the kernel, relative to the rms distance of two postures. Of seven arms with errors of
their links held-out views erred by 0.86 px at 1.0, 0.80 at 1.6 and 0.79 at 2.5."""
LEAST_MODE = 1e-3
"""Smallest variance of such a function, relative to the largest, that noise does not cover."""


@dataclass(frozen=True, eq=False)
class SmoothFunctions:
    """Smooth functions of the posture of one eye."""

    eye: int
    poses: Array
    """(N, 4, 4) some of the measured ones."""
    lengths: Array
    """(2,) see PoseErrors."""
    modes: Array
    """(N, m) weights of the kernels about the poses."""
    explained: Array
    """(12, 6 m) constant transformations that explain a part of each function."""

    def values(self, T: Array) -> Array:
        """Compute the increments (B, 6, 6 m) of poses (B, 4, 4) by coefficients of one."""
        found = _of_components(kernel(T, self.poses, self.lengths) @ self.modes)
        return found - constant_transformations(T) @ self.explained


def smooth_functions(postures: Postures, information: Array) -> tuple[SmoothFunctions, ...]:
    """Make the smooth functions of each eye.

    They are orthogonal to constant transformations in the metric of the information (B, 6, 6) that
    images hold on each pose.
    """
    assert postures.T_base_eye_read is not None
    found = []
    for e in np.unique(postures.eye).tolist():
        mine = postures.eye == e
        T = postures.T_base_eye_read[mine]
        parts = T[:, :3, 3], T[:, :3, :3].reshape(-1, 9)
        apart = np.sqrt([max(2 * part.var(axis=0).sum(), 1e-12) for part in parts])  # rms
        lengths = LENGTH * apart
        poses = T[:: -(-len(T) // MOST_POSES)]
        values, vectors = np.linalg.eigh(kernel(poses, poses, lengths))
        kept = np.flatnonzero(values > LEAST_MODE * values[-1])[-MOST_MODES:]
        modes = vectors[:, kept] / np.sqrt(values[kept])
        constant = constant_transformations(T)
        weighed = np.swapaxes(constant, 1, 2) @ information[mine]
        functions = _of_components(kernel(T, poses, lengths) @ modes)
        normal, right = (np.sum(weighed @ each, axis=0) for each in (constant, functions))
        explained = np.linalg.lstsq(normal, right)[0]
        found.append(SmoothFunctions(e, poses, lengths, modes, explained))
    return tuple(found)


def _of_components(modes: Array) -> Array:
    """Let each of m functions (B, m) change each component of a pose: (B, 6, 6 m)."""
    return np.einsum("bm,ij->bimj", modes, np.eye(6)).reshape(len(modes), 6, -1)


def at_postures(functions: tuple[SmoothFunctions, ...], postures: Postures) -> Array:
    """Compute the increments (B, 6, F) of all postures by coefficients of one."""
    T = postures.T_base_eye_read
    assert T is not None
    parts = [np.zeros((len(T), 6, each.explained.shape[1])) for each in functions]
    for part, each in zip(parts, functions, strict=True):
        part[postures.eye == each.eye] = each.values(T[postures.eye == each.eye])
    return np.concatenate(parts, axis=2)


def pose_errors_block(functions: tuple[SmoothFunctions, ...]) -> Block:
    """Make unknowns of the coefficients (F,)."""
    F = sum(each.explained.shape[1] for each in functions)
    return Block(np.zeros(F), np.full(F, 0.01), nuisance=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothErrors(Residual):
    """The coefficients of smooth errors of poses, with a level for rotations and translations."""

    functions: tuple[SmoothFunctions, ...]
    level: tuple[str, ...] = (SMOOTH[0],) * 3 + (SMOOTH[1],) * 3
    robust: bool = False

    def error(self, x: Variables) -> Array:
        return x["pose_errors"].reshape(-1, 6)

    def rows(self, x: Variables) -> Rows:
        columns = x.columns("pose_errors").reshape(-1, 6)
        return Rows(np.tile(np.eye(6), (len(columns), 1, 1)), columns)

    def of_eyes(self, x: Variables) -> dict[Side, PoseErrors]:
        """Return what to add to measured poses of each eye."""
        found, first = {}, 0
        for each in self.functions:
            F = each.explained.shape[1]
            coefficients = x["pose_errors"][first : first + F]
            first += F
            found[EYES[each.eye]] = PoseErrors(
                each.poses,
                each.lengths,
                each.modes @ coefficients.reshape(-1, 6),
                each.explained @ coefficients,
            )
        return found

    def in_constants(self, x: Variables, levels: Levels) -> Array:
        """Compute what the constant part of smooth errors adds to the covariance (c, c) of a head.

        No image tells it from T_eye_cam, and from the base of the eye.
        """
        head, free = x["head"], x.free[x.columns("head")]
        covariance = np.zeros((len(free), len(free)))
        variances = np.repeat([levels[name] ** 2 for name in SMOOTH], 3)
        R_between, t_between = head.T_rbase_lbase[:3, :3], head.T_rbase_lbase[:3, 3]
        for each in self.functions:
            by = np.zeros((len(free), 12))
            for name, mounted in head.cameras.items():
                if mounted.eye == EYES[each.eye]:
                    rows = named_columns(head, [f"{name}.T_eye_cam.{axis}" for axis in POSE])
                    by[rows, 6:] = np.eye(6)
                    by[rows[3:], 6:9] = -hat(mounted.T_eye_cam[:3, 3])
            rows = named_columns(head, [f"T_rbase_lbase.{axis}" for axis in POSE])
            if EYES[each.eye] == "right":
                by[rows, :6] = np.eye(6)
                by[rows[3:], :3] = -hat(t_between)
            else:
                by[rows, :6] = -np.kron(np.eye(2), R_between)
            by = by @ each.explained * free[:, None]
            covariance += by * np.tile(variances, by.shape[1] // 6) @ by.T
        return covariance

    def remaining_std(self, levels: Levels, independent: Array) -> list[float]:
        """Compute the noise (2,) of a new pose that is corrected by the others.

        By leaving out one pose after the other, whose independent errors have deviations (2,).
        """
        squares = []
        for smooth, own in zip(SMOOTH, independent, strict=True):
            variances = [
                1 / np.diag(np.linalg.inv(levels[smooth] ** 2 * k + own**2 * np.eye(len(k))))
                for k in (kernel(each.poses, each.poses, each.lengths) for each in self.functions)
            ]
            squares.append(np.concatenate(variances).mean())
        return np.sqrt(squares).tolist()
