"""Which directions of the unknowns the data cannot determine.

The yardstick is a prior standard deviation: how well a ruler and a data sheet know each parameter
without any calibration. A direction that the data determine `FIXED` times worse keeps its start,
and one that they determine hardly better is reported too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.problem import BundleProblem, BundleState, head_size
from vergence.calibration.bundle.solver import LinearProblem, NoiseLevels, factorise, project_onto
from vergence.calibration.sequential.lens_prior import EQUIDISTANT
from vergence.geometry.joints import joint_parameters
from vergence.geometry.kinematics import EYES
from vergence.geometry.lens import CameraModel

ROTATION_RAD = 0.05
"""How well a ruler knows a mounting: about 3 degrees ..."""
TRANSLATION_M = 0.01
"""... and a centimetre."""
JOINT_STD = {
    "gain": 0.1,
    "offset_rad": 0.05,
    "nonorthogonality_rad": 0.05,
    "inclination_rad": 0.05,
    "axis_distance_m": 0.005,
    "slide_m": 0.005,
}
"""Usual standard deviations of the errors of a joint."""
FACTOR_STD = 0.1
"""Usual standard deviation of the factor of one of several readings of a joint."""
TIME_S = 0.1
"""Usual standard deviation of the time offset."""
BOARD_SCALE = 0.02
"""Usual standard deviation of the size of a board, relative to the stated one."""
UNKNOWN = 1e3
"""Standard deviation, in prior ones, that stands for "not determined at all"."""
FIXED = 5.0
"""Standard deviation, in prior ones, from which a direction is fixed: 14 degrees, 5 cm. One that is
known better is estimated: the start may be worse still, and would spoil what is observable."""
WEAK = 0.3
"""Standard deviation, in prior ones, from which a direction deserves a warning: 0.9 degrees,
3 mm."""
_POWERS: dict[CameraModel, tuple[int, ...]] = {
    "radial-tangential": (2, 4, 1, 1, 6),
    "rational": (2, 4, 1, 1, 6, 2, 4, 6),
    "fisheye": (2, 4, 6, 8),
}
"""Power of the radius with which each coefficient moves a point, relative to its distance."""
_MOVED = 0.2
"""By how much a coefficient may move the image's corner, relative to its distance from the centre.
"""


@dataclass(frozen=True, eq=False)
class Observability:
    """What the data determine; c is the number of unknowns of the calibration."""

    basis: Array
    """(G, F) free directions of the shared unknowns."""
    fixed: Array
    """(H, c) directions of the head that are not observable, each one prior deviation long."""
    weak: Array
    """(W, c) directions that are observable, but hardly."""
    covariance: Array
    """(c, c) of the calibration; where nothing is known, UNKNOWN prior standard deviations."""


def whole_basis(problem: BundleProblem, state: BundleState) -> Array:
    """Return (G, F) directions, one prior standard deviation long each, of all that is free."""
    pose = [ROTATION_RAD] * 3 + [TRANSLATION_M] * 3
    scales = []
    for mounted in state.head.cameras.values():
        lens = mounted.intrinsics
        f = lens.matrix[0, 0]
        # Of the image's corner: normalised radius or, for a fisheye lens, angle.
        reach = np.hypot(lens.width, lens.height) / 2 / f
        scales += [0.2 * f, 0.2 * f, 0.1 * lens.width, 0.1 * lens.height]
        own = _MOVED / reach ** np.array(_POWERS[lens.model])
        if lens.model == "rational":  # the numerator moves with what is assumed of the denominator
            own[-3:] = EQUIDISTANT
            own[[0, 1, 4]] = np.hypot(own[[0, 1, 4]], own[-3:])
        scales += own.tolist() + pose
    joints = state.head.kinematics.eyes
    names = [name for eye in EYES for _, name in joint_parameters(joints[eye])]
    errors = [JOINT_STD.get(name, FACTOR_STD) for name in names]
    scales += [*pose, *errors, TIME_S] + pose * len(state.T_lbase_target)
    scales.append(BOARD_SCALE)
    return np.diag(scales)[:, problem.free]


def observe(
    problem: BundleProblem, state: BundleState, linear: LinearProblem, noise: NoiseLevels
) -> Observability:
    """Return which directions of the calibration the data determine.

    The information on the calibration alone (placements and latent angles eliminated) is scaled
    by the prior standard deviations, and its eigenvectors are the directions.
    """
    scale = whole_basis(problem, state)
    c = head_size(problem)
    mine = np.flatnonzero(problem.free) < c
    S = factorise(project_onto(linear, scale), noise).schur
    boards = S[np.ix_(~mine, ~mine)]
    # A board that shows too few corners is placed by its start alone.
    boards = boards + UNKNOWN**-2 * np.eye(len(boards))
    across = S[np.ix_(mine, ~mine)]
    information = S[np.ix_(mine, mine)] - across @ np.linalg.solve(boards, across.T)
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, UNKNOWN**-2)
    kept = values > FIXED**-2
    hardly = kept & (values < WEAK**-2)
    directions, unscaled = scale[:, mine] @ vectors, np.eye(c)[:, problem.free[:c]]
    return Observability(
        basis=np.concatenate([directions[:, kept], scale[:, ~mine]], axis=1),
        fixed=(unscaled @ vectors[:, ~kept]).T,
        weak=(unscaled @ vectors[:, hardly]).T,
        covariance=(directions / values @ directions.T)[:c, :c],
    )
