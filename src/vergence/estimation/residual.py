"""Residual blocks, and the robust loss that weighs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array
from vergence.estimation.variables import Variables

OUTLIER = 4.0
"""Standard deviations beyond which the loss is Cauchy's and below which it is quadratic. A good
point in the plane exceeds it once in 3000, a good scalar once in 16000."""
UNIT = ""
"""Name of the noise level that is one: errors of priors are in their standard deviations."""
LOST_WEIGHT = 1e-9
"""Weight of an outlier where it is left out: latent elements with outliers only stay solvable."""


class Rows(NamedTuple):
    """Derivatives of errors (M, k), zero where nothing was measured."""

    by_shared: Array
    """(M, k, s)."""
    columns: NDArray[np.intp]
    """(M, s) to which of the shared unknowns these belong."""
    by_latent: Array | None = None
    """(M, k, n) by the latent element of each row."""


class Residual:
    """One kind of measurement, made M times with k coordinates each.

    Subclasses implement `error` and `rows`, and override the attributes they need.
    """

    level: Any = UNIT
    """Name of the noise level (str), or one name for each coordinate (tuple)."""
    together: int = 1
    """Coordinates that are outliers together: 2 for points in an image."""
    element: Any = None
    """(M,) the latent element that each row depends on; None: none."""
    seen: Any = None
    """(M, k / together) of bool, which were measured; None: all."""
    noise_scale: Any = 1.0
    """(M,), or (M, k), noise relative to the level."""
    weighs_rows: bool = False
    """Whether the noise scale of each row is estimated."""
    robust: bool = True

    def error(self, x: Variables) -> Array:
        """Compute the errors (M, k): predicted minus measured, zero where not measured."""
        raise NotImplementedError

    def rows(self, x: Variables) -> Rows:
        """Compute the derivatives of the errors, in new arrays, which the solver overwrites."""
        raise NotImplementedError

    def costs(self, errors: Array, levels: Levels, outlier: float) -> Array:
        """Compute -2 log likelihood (M,) of errors (M, k): infinite where one is not finite."""
        sizes = relative_sizes(self, errors, levels)
        costs = cauchy_loss(sizes, outlier if self.robust else np.inf).sum(axis=1)
        return np.where(np.isfinite(costs), costs, np.inf)

    def follow(self, x: Variables) -> Residual:
        """Return the residual with what it takes from the current estimate brought up to date."""
        return self

    def trust(self, levels: Levels, determined: Levels) -> Residual:
        """Return the residual for the noise levels of the next round.

        `determined` has for each level how well all other data determine what it measures.
        """
        return self

    def judge(self, x: Variables, posterior: Posterior) -> Residual:
        """Return the residual as the settled estimate suggests it, such as a prior's deviation.

        `posterior` computes the covariance of a shared block.
        """
        return self


Levels = Mapping[str, float]
"""Standard deviation of each noise level, by name."""
Posterior = Callable[[str], Array]
"""Covariance (s, s) of the shared block of a name."""
Residuals = Sequence[Residual]


def cauchy_loss(sizes: Array, outlier: float) -> Array:
    """Compute squares up to the outlier limit, and Cauchy's loss beyond it."""
    squares = np.minimum(sizes, outlier) ** 2
    if np.isfinite(outlier):
        squares += 2 * outlier**2 * np.log(np.maximum(sizes / outlier, 1.0))
    return squares


def coordinate_levels(residual: Residual, k: int) -> tuple[str, ...]:
    """Return the name of the noise level of each of k coordinates."""
    level = residual.level
    return (level,) * k if isinstance(level, str) else level


def standard_deviations(residual: Residual, k: int, levels: Levels) -> Array:
    """Compute the standard deviations (M, k) or (1, k) of errors."""
    level = np.array([levels.get(name, 1.0) for name in coordinate_levels(residual, k)])
    return level * noise_scales(residual)


def noise_scales(residual: Residual) -> Array:
    """Return the relative noise of a residual, in a shape that broadcasts to its errors (M, k)."""
    scale = np.asarray(residual.noise_scale, dtype=float)
    return scale if scale.ndim == 2 else np.atleast_1d(scale)[:, None]


def relative_sizes(residual: Residual, errors: Array, levels: Levels) -> Array:
    """Compute the sizes (M, k / together) of errors (M, k) in standard deviations."""
    relative = errors / standard_deviations(residual, errors.shape[1], levels)
    if residual.together == 1:
        return np.abs(relative)
    return np.linalg.norm(relative.reshape(len(errors), -1, residual.together), axis=-1)


def robust_weights(residual: Residual, errors: Array, levels: Levels, outlier: float) -> Array:
    """Compute Cauchy's weights (M, k / together): 1 up to the limit, 0 where not measured."""
    sizes = relative_sizes(residual, errors, levels)
    weights = np.ones_like(sizes)
    if residual.robust and np.isfinite(outlier):
        weights = (outlier / np.maximum(sizes, outlier)) ** 2
    return weights if residual.seen is None else np.where(residual.seen, weights, 0.0)


def inlier_weights(residual: Residual, errors: Array, levels: Levels, outlier: float) -> Array:
    """Compute weights (M, k / together): 1 for inliers, LOST_WEIGHT for outliers."""
    weights = robust_weights(residual, errors, levels, outlier)
    return np.where(weights == 1, 1.0, np.where(weights > 0, LOST_WEIGHT, 0.0))
