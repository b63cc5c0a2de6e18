"""Which directions of the unknowns the data cannot determine, and what to say about them.

The yardstick is what a ruler and a data sheet tell without any calibration: a direction that the
data know worse than that is called not observable, keeps its start, and is reported in words.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from vergence.arrays import Array
from vergence.calibration.problem import (
    AXES,
    POSE,
    Problem,
    State,
    calibration_size,
    names,
    size,
)
from vergence.calibration.solver import Linear, Noise, factorise

ROTATION_RAD = 0.05
"""How well a ruler knows a mounting: about 3 degrees ..."""
TRANSLATION_M = 0.01
"""... and a centimetre."""
AXES_RULER = (0.1, 0.1, 0.05, 0.05, 0.05, 0.005)
"""Gains, offsets and non-orthogonality [rad], distance of the axes [m]."""
TIME_S = 0.1
UNKNOWN = 1e3
"""Standard deviation, in rulers, that stands for "not determined at all"."""

AXIS_WORDS = {
    "rx": "rotation about x",
    "ry": "rotation about y",
    "rz": "rotation about z",
    "tx": "translation along x",
    "ty": "translation along y",
    "tz": "translation along z",
}


@dataclass(frozen=True, eq=False)
class Observability:
    """What the data determine."""

    basis: Array
    """(G, F) free directions of the shared unknowns, each a ruler long."""
    held: Array
    """(G', c) directions of the calibration that are not observable, in rulers, one a row."""
    covariance: Array
    """(c, c) of the calibration's unknowns, the placements' left out; where nothing is known,
    UNKNOWN rulers."""


def rulers(problem: Problem, state: State) -> Array:
    """Return (G,) how well each shared unknown is known without calibration."""
    scales = []
    for lens in state.lenses:
        f = lens.matrix[0, 0]
        reach = np.hypot(lens.width, lens.height) / 2 / f  # of the image's corner, normalised
        scales += [0.2 * f, 0.2 * f, 0.1 * lens.width, 0.1 * lens.height]
        # Distortion that moves the image's corner by a fifth of its distance from the centre.
        scales += [0.2 / reach**2, 0.2 / reach**4, 0.2 / reach, 0.2 / reach, 0.2 / reach**6]
        scales += [ROTATION_RAD] * 3 + [TRANSLATION_M] * 3
    scales += [ROTATION_RAD] * 3 + [TRANSLATION_M] * 3
    scales += [*AXES_RULER, *AXES_RULER, TIME_S]
    placements = (size(problem) - len(scales)) // len(POSE)
    return np.array(scales + ([ROTATION_RAD] * 3 + [TRANSLATION_M] * 3) * placements)


def observe(problem: Problem, state: State, linear: Linear, noise: Noise) -> Observability:
    """Return which directions of the calibration are known better than by a ruler.

    The information on the calibration alone (placements and latent angles eliminated) is scaled
    by the rulers; directions of eigenvalue below 1 are held.
    """
    scale = np.diag(rulers(problem, state))[:, problem.free]
    calibration = np.flatnonzero(problem.free) < calibration_size(problem)
    S = factorise(linear, noise, scale).schur
    boards = S[np.ix_(~calibration, ~calibration)]
    # Nothing but the start tells where a board stands that shows too few corners.
    boards = boards + UNKNOWN**-2 * np.eye(len(boards))
    across = S[np.ix_(calibration, ~calibration)]
    information = S[np.ix_(calibration, calibration)] - across @ np.linalg.solve(boards, across.T)
    values, vectors = np.linalg.eigh(information)
    kept = values > 1
    directions = np.eye(len(S))
    directions = np.concatenate(
        [
            _embed(vectors[:, kept], calibration),
            directions[:, ~calibration],
        ],
        axis=1,
    )
    scaled = vectors / np.maximum(values, UNKNOWN**-2) @ vectors.T
    D = scale[: calibration_size(problem)][:, calibration]
    held = np.zeros((int((~kept).sum()), calibration_size(problem)))
    held[:, problem.free[: held.shape[1]]] = vectors[:, ~kept].T
    return Observability(scale @ directions, held, D @ scaled @ D.T)


def _embed(vectors: Array, rows: np.ndarray) -> Array:
    out = np.zeros((len(rows), vectors.shape[1]))
    out[rows] = vectors
    return out
