"""Backlash of joints: its sign is that of the last motion, its width is estimated.

A joint that has turned one way stands half the backlash off its reading, and as much to the other
side after it has turned the other way: true reading = reading - b / 2 * sign. A far posture is
mostly reached from the middle, so backlash that is not modelled passes for a gain that is too low.

Many heads have none, and then unknown widths would still cost accuracy. So the prior is a mixture:
no joint has backlash, or the widths of all are normally distributed with one of several standard
deviations (spike and slab, Mitchell and Beauchamp 1988). The posterior mixture is summed up by its
mean and covariance; in the solver stands a normal prior that gives this mean (expectation
propagation, Minka 2001).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import softmax

from vergence.arrays import Array
from vergence.estimation.adjustment import Adjustment
from vergence.estimation.linear import covariance_with
from vergence.estimation.residual import Posterior, Residual, Rows
from vergence.estimation.variables import Block, Variables

BLOCK = "backlash"
"""Name of the shared unknown: (m,) widths [rad of the reading]."""
WIDTHS_RAD = np.radians([0.05, 0.1, 0.2, 0.4, 0.8, 1.6])
"""Standard deviations of the widths at the joints of a head with backlash [rad], equally probable.
Hobby servos have 0.5 to 1 degrees unloaded, and up to 2.6 under load."""
SOME = 0.25
"""Probability that a head has backlash, before any data: an assumption."""
LEAST_SHARE = 1e-6
"""Least share of the data in a mean, and of the prior: keeps both variances finite."""


def backlash_block(gear_ratios: Array, *, free: bool) -> Block:
    """Make unknowns of the backlash (m,) of readings before gears of these ratios (m,)."""
    m, scale = len(gear_ratios), WIDTHS_RAD[-1] / gear_ratios
    return Block(np.zeros(m), scale, free=np.full(m, free), nuisance=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class BacklashPrior(Residual):
    """The mixture's normal approximation, for m readings."""

    gear_ratios: Array
    """(m,) of the readings, whose widths are as much larger."""
    noise_scale: Array
    """(m,) standard deviation of the normal prior [rad of the reading]."""
    covariance: Array
    """(m, m) of the widths by the mixture."""
    robust: bool = field(default=False, init=False)

    def error(self, x: Variables) -> Array:
        return x[BLOCK][:, None]

    def rows(self, x: Variables) -> Rows:
        m = len(self.gear_ratios)
        return Rows(np.ones((m, 1, 1)), x.columns(BLOCK)[:, None])

    def judge(self, x: Variables, posterior: Posterior) -> BacklashPrior:
        """Weigh the parts of the mixture by how well the data agree with each."""
        before, covariance = self.noise_scale**-2, posterior(BLOCK)
        precision = np.linalg.inv(covariance)
        vector = precision @ x[BLOCK]
        m, scales = len(vector), WIDTHS_RAD[:, None] / self.gear_ratios
        by_data = precision - np.diag(before)
        covariances = np.linalg.inv(by_data + np.eye(m) * scales[:, None] ** -2)
        means = covariances @ vector
        # The density of the data, relative to that without backlash.
        log_density = means @ vector / 2 + np.linalg.slogdet(covariances)[1] / 2
        log_density -= np.log(scales).sum(axis=1)
        log_some = np.log(SOME / len(scales)) + log_density
        weights = softmax(np.append(log_some, np.log(1 - SOME)))[:-1]
        mean = weights @ means
        squares = covariances + means[:, :, None] * means[:, None]
        # For each joint alone: the variance by the data, and how far the mean follows them.
        data = 1 / np.maximum(1 / np.diag(covariance) - before, LEAST_SHARE * before)
        follows = weights @ (scales**2 / (scales**2 + data))
        follows = np.clip(follows, LEAST_SHARE, 1 - LEAST_SHARE)
        return replace(
            self,
            noise_scale=np.sqrt(data * follows / (1 - follows)),
            covariance=np.tensordot(weights, squares, 1) - np.outer(mean, mean),
        )


def backlash_prior(gear_ratios: Array) -> BacklashPrior:
    """Make the prior of the backlash (m,) of readings before gears of these ratios (m,)."""
    std = np.sqrt(SOME * (WIDTHS_RAD**2).mean()) / gear_ratios
    return BacklashPrior(gear_ratios=gear_ratios, noise_scale=std, covariance=np.diag(std**2))


def mixture_covariance(found: Adjustment, prior: BacklashPrior) -> Array:
    """Compute what the mixture adds to the covariance (G, G) of the normal approximation.

    Given the widths, all else is normally distributed, with a mean that is linear in them.
    """
    columns = found.x.columns(BLOCK)
    C = covariance_with(found.linear, found.levels, found.observability.basis, columns)
    slopes = np.linalg.solve(C[columns], C.T).T
    return slopes @ (prior.covariance - C[columns]) @ slopes.T
