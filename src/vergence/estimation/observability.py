"""Which directions of the unknowns the data cannot determine.

The yardstick is the scale of each unknown: its standard deviation before any data. A direction that
the data determine `FIXED` times worse keeps its start; one that they determine little better is
reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.estimation.linear import Linear, eliminate
from vergence.estimation.residual import Levels
from vergence.estimation.variables import Variables

UNKNOWN = 1e3
"""Standard deviation, in scales, that stands for "not determined at all"."""
FIXED = 5.0
"""Standard deviation, in scales, from which a direction is fixed: 14 degrees, 5 cm of a mounting.
One that is known better is estimated: the start may be worse still, and would spoil the rest."""
WEAK = 0.3
"""Standard deviation, in scales, from which a direction is reported: 0.9 degrees, 3 mm."""


@dataclass(frozen=True, eq=False)
class Observability:
    """What the data determine; c counts the shared unknowns of blocks that are not nuisance."""

    basis: Array
    """(G, F) free directions of the shared unknowns."""
    fixed: Array
    """(H, c) directions that are not observable, each one scale long."""
    weak: Array
    """(W, c) directions that are only just observable."""
    covariance: Array
    """(c, c); where nothing is known, UNKNOWN scales."""


def observe(x: Variables, linear: Linear, levels: Levels) -> Observability:
    """Find the directions that the data determine.

    The information on the unknowns of interest (latent and nuisance ones eliminated), in units of
    their scales, has these directions as eigenvectors.
    """
    scale, free = x.scaled_basis(), x.free
    interest = ~x.stacked(lambda block: block.nuisance).astype(bool)
    mine = interest[free]
    S = eliminate(linear.onto(scale), levels).schur
    nuisance = S[np.ix_(~mine, ~mine)]
    nuisance = nuisance + UNKNOWN**-2 * np.eye(len(nuisance))
    across = S[np.ix_(mine, ~mine)]
    information = S[np.ix_(mine, mine)] - across @ np.linalg.solve(nuisance, across.T)
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, UNKNOWN**-2)
    kept = values > FIXED**-2
    weak = kept & (values < WEAK**-2)
    directions = scale[:, mine] @ vectors
    unscaled = np.eye(len(free))[interest][:, free][:, mine]
    return Observability(
        basis=np.concatenate([directions[:, kept], scale[:, ~mine]], axis=1),
        fixed=(unscaled @ vectors[:, ~kept]).T,
        weak=(unscaled @ vectors[:, weak]).T,
        covariance=(directions / values @ directions.T)[np.ix_(interest, interest)],
    )
