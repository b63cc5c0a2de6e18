"""Noise model of matches: their level, and their correlation in space and over time.

Windows on one edge share their errors, so errors are independent only between blocks of the image;
the design effect of clusters measures the variance inflation within them. A posture that is
revisited shows the same windows with the same errors: a frame counts by what its posture adds.
Systematic lens errors are smooth over the image and the same in all frames; their size comes from
the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array

CUT = 4.685
"""Tuning constant of Tukey's biweight [standard deviations], 95 % efficient for normal errors."""
_SCALE_MATCHES = 30.0
"""Weight of the prior scale, as a number of matches; an assumption."""
_DESIGN_BLOCKS = 10.0
"""Weight of the prior design effect, as a number of blocks: a third of those that a pair fills."""
_BLOCKS = 16
"""Most blocks along each axis; blocks are larger in images of more than 1024 px."""
_UNKNOWNS = 5
"""Degrees of freedom of a stereo pair."""
_WINDOWS_RAD, _SURFACES_RAD = np.radians([1.2, 13.0])
"""Scales of the correlation over the distance of postures, half exp(-x) and half exp(-x^2); fitted
to 800 rendered pairs with correlations of 0.36 within 1 degree, 0.14 at 5, 0.07 at 13."""
_FADING_S = 600.0
"""Decay time of the correlation, so that a drifted head is learned again; with 120 s the squared
Mahalanobis distances of nine rendered minutes are 1.2 to 1.4 times as large."""
_FAR_CORRELATION = 0.005
"""Correlation at distant postures; measured between 20 and 60 degrees, to a factor of two."""
PACE = 0.1
"""Weight of a frame in running means of noise parameters; an assumption."""
_NEAREST, _REMEMBERED = 60, 2000
"""Numbers of past postures that are compared with a new one, and that are kept; limits of cost."""


@dataclass(frozen=True, eq=False)
class RevisitCorrelation:
    """Correlation of match errors between frames, by the distance of their postures."""

    postures: Array
    """(n, r) joint angles of past frames [rad]: readings times gear factors."""
    ages_s: Array
    """(n,)"""
    independent: float = 0.0
    """Equivalent number of independent frames, apart from the far correlation."""
    far_correlation: float = _FAR_CORRELATION
    """Of the errors of two frames at any two postures."""

    def novelty(self, posture: Array) -> float:
        """Compute how many independent frames one at a posture (r,) [rad] adds, from 0 to 1.

        The mean of frames with correlated errors (covariance K) has the information of 1' K^-1 1
        independent ones; a frame adds the difference.
        """
        nearest = np.argsort(np.linalg.norm(self.postures - posture, axis=1))[:_NEAREST]
        postures, ages_s = self.postures[nearest], self.ages_s[nearest]
        between_s = np.abs(ages_s[:, None] - ages_s)
        K = _correlation(postures[:, None] - postures, between_s)
        K[np.diag_indices(len(K))] = 1.0
        k = _correlation(postures - posture, ages_s)
        weights = np.linalg.solve(K, k)
        return float(max(1 - weights.sum(), 1e-3) ** 2 / (1 - weights @ k))

    def inflation(self, novelty: float) -> float:
        """Compute the covariance inflation of a frame of a `novelty`.

        Frames equivalent to n independent ones have the information of n / (1 + c (n - 1)), where
        c is the far correlation; a frame adds the difference.
        """
        n, c = self.independent, self.far_correlation
        return (1 + c * (n - 1)) * (1 + c * (n + novelty - 1)) / (novelty * (1 - c))

    def predict(self, elapsed_s: float) -> RevisitCorrelation:
        """Let the correlation with past frames fade."""
        independent = self.independent * float(np.exp(-elapsed_s / _FADING_S))
        return replace(self, ages_s=self.ages_s + elapsed_s, independent=independent)

    def update(self, posture: Array, novelty: float, systematic: float) -> RevisitCorrelation:
        """Add a frame at a posture (r,) [rad], with a systematic share of its variance."""
        far = systematic + (1 - systematic) * _FAR_CORRELATION
        pace = PACE if len(self.postures) else 1.0
        return RevisitCorrelation(
            postures=np.concatenate([self.postures, posture[None]])[-_REMEMBERED:],
            ages_s=np.append(self.ages_s, 0.0)[-_REMEMBERED:],
            independent=self.independent + novelty,
            far_correlation=self.far_correlation + pace * (far - self.far_correlation),
        )


def no_revisits(readings: int) -> RevisitCorrelation:
    """Start without past frames, for a number of readings."""
    return RevisitCorrelation(np.empty((0, readings)), np.empty(0))


def tukey_weights(y: Array) -> Array:
    """Compute the weights (N,) of Tukey's biweight for residuals (N,) [standard deviations]."""
    return np.maximum(1 - (y / CUT) ** 2, 0) ** 2


def tukey_loss(y: Array) -> Array:
    """Compute the losses (N,) of residuals (N,): their squares near 0, at most CUT^2 / 3."""
    return CUT**2 / 3 * (1 - np.maximum(1 - (y / CUT) ** 2, 0) ** 3)


def noise_variance(y: Array) -> float:
    """Estimate the variance of residuals (N,) over the expected one, with a prior of one."""
    inside = np.abs(y) < 3
    squares = float((y[inside] ** 2).sum()) / 0.973  # variance of a normal cut at 3 deviations
    degrees = max(float(inside.sum()) - _UNKNOWNS, 0.0)
    return (squares + _SCALE_MATCHES) / (degrees + _SCALE_MATCHES)


def design_effect(
    y: Array, pixels: Array, size: tuple[int, int], expected: float
) -> tuple[float, float]:
    """Estimate the variance inflation by errors that neighbours share.

    The sandwich formula of an M-estimate with clusters, relative to independent errors of unit
    variance, for residuals y (N,) [standard deviations] at pixels (N, 2) of an image. Returns also
    the share of the image's blocks with inliers.
    """
    block_px = max(64, max(size) / _BLOCKS)  # rendered correlations are below 0.03 at 64 px
    column, row = np.clip(pixels // block_px, 0, _BLOCKS - 1).astype(int).T
    block = row * _BLOCKS + column
    u2 = np.minimum((y / CUT) ** 2, 1.0)
    weights, slopes = (1 - u2) ** 2, (1 - u2) * (1 - 5 * u2)  # psi(y) / y, and psi'(y)
    sums = np.bincount(block, weights * y, _BLOCKS**2).astype(float)
    used = float((np.bincount(block, weights, _BLOCKS**2) > 0.5).sum())
    filled = np.count_nonzero(sums) / float(np.prod(np.ceil(np.array(size) / block_px)))
    total, slope = float(weights.sum()), float(slopes.sum())
    if used <= _UNKNOWNS or slope < 0.2 * total:  # too few blocks, or most residuals are outliers
        return expected, filled
    measured = float(sums @ sums) * total / slope**2 * used / (used - _UNKNOWNS)
    mean = (used * measured + _DESIGN_BLOCKS * expected) / (used + _DESIGN_BLOCKS)
    return mean, filled


def _correlation(between_postures: Array, elapsed_s: Array) -> Array:
    """Compute the correlation of match errors from differences of postures (..., r) [rad]."""
    distance = np.linalg.norm(between_postures, axis=-1)  # Euclidean: K is positive definite
    shape = np.exp(-distance / _WINDOWS_RAD) + np.exp(-((distance / _SURFACES_RAD) ** 2))
    # 0.25 at the same posture: 0.1 to 0.33 in rendered figures
    return 0.25 * shape / 2 * np.exp(-elapsed_s / _FADING_S)
