"""How the matches of a pair of images err: how much, and how correlated in space and in time.

The contrast of a window tells how well it can be matched, but not edges that are drawn or occluded
alike in several windows. So errors are taken as independent from one block of the image to the
next only, and from one second to the next only. How much the correlation within inflates variances
is measured from the residuals: the design effect of clusters, and the long-run variance of a
sequence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array

CUT = 4.685
"""Tukey's biweight: residuals beyond so many standard deviations do not count."""
_PRIOR_MATCHES = 30.0
"""How many matches the expected noise counts for, beside the frame's own."""
_BLOCK_PX = 64
"""Errors of matches farther apart than this are taken as independent."""
_BLOCKS = 64
"""Blocks along each axis of the largest image; those of smaller ones stay empty."""
EXPECTED_MATCH_SCALE = 1.3
"""Noise of matches, relative to what their windows tell, before anything is seen: that of windows
with relief, the worst kind of surface that was measured."""
EXPECTED_DESIGN_EFFECT = 2.0
"""Before anything is seen; more than the 1.1 to 1.8 of a furnished room, for scenes with fewer and
longer edges."""
_PRIOR_BLOCKS = 10.0
"""How many blocks the expected design effect counts for: a third of the 20 to 40 that a pair fills,
of which the sum of squares alone is uncertain by a quarter."""
_LEAST_DESIGN_EFFECT = 0.5
"""Below one by chance only: errors of neighbours do not cancel."""
_UNKNOWNS = 5
"""Degrees of freedom of a pair, which the residuals lack."""
_FADING_S = 1.0
"""Errors of frames this far apart share little: the eyes have turned by more than a window."""
_PACE = 0.05
"""Share of a frame in the running mean of the long-run variance."""
EXPECTED_RATIO = 2.0
"""Of the long-run variance at the first frame: as in a room at ten pairs a second (1.6 to 2.2)."""


@dataclass(frozen=True, eq=False)
class LongRunVariance:
    """How the correlation of errors from frame to frame inflates the variance of their mean."""

    blocks: Array
    """(B,) sums of residuals in blocks, summed over past frames, which fade."""
    ratio: float = EXPECTED_RATIO
    """Of the variance of a mean over frames to that of independent errors."""


def tukey_weights(y: Array) -> Array:
    """Return the weights (N,) of residuals (N,) [standard deviations]: Tukey's biweight."""
    return np.maximum(1 - (y / CUT) ** 2, 0) ** 2


def tukey_loss(y: Array) -> Array:
    """Return the losses (N,) of residuals (N,): near their squares, and at most CUT^2 / 3."""
    return CUT**2 / 3 * (1 - np.maximum(1 - (y / CUT) ** 2, 0) ** 3)


def noise_variance(y: Array) -> float:
    """Return the variance of residuals relative to what was expected, with the prior's matches."""
    inside = np.abs(y) < 3
    # Of a normal distribution that is cut at 3 standard deviations, the variance is 0.973.
    own = float((y[inside] ** 2).sum()) / 0.973
    degrees = max(float(inside.sum()) - _UNKNOWNS, 0.0)
    return (own + _PRIOR_MATCHES) / (degrees + _PRIOR_MATCHES)


def design_effect(y: Array, pixels: Array, expected: float) -> tuple[float, Array]:
    """Return the variance inflation by errors that neighbours share, and sums (B,) over blocks.

    The variance of a mean of matches, relative to what independent errors of unit variance would
    give: that of an M-estimate with errors that are independent from block to block (the sandwich
    formula, for clusters). It also counts the tails, which the weights leave.

    Args:
        y: (N,) residuals [standard deviations].
        pixels: (N, 2) where they are, in one of the images.
        expected: the design effect that is expected; it counts for ten blocks.
    """
    column, row = np.clip(pixels // _BLOCK_PX, 0, _BLOCKS - 1).astype(int).T
    block = row * _BLOCKS + column
    u2 = np.minimum((y / CUT) ** 2, 1.0)
    weights, slopes = (1 - u2) ** 2, (1 - u2) * (1 - 5 * u2)  # psi(y) / y, and psi'(y)
    sums = np.bincount(block, weights * y, _BLOCKS**2).astype(float)
    used = float((np.bincount(block, weights, _BLOCKS**2) > 0.5).sum())
    total, slope = float(weights.sum()), float(slopes.sum())
    if used <= _UNKNOWNS or slope < 0.2 * total:  # too little is seen, or most does not fit
        return expected, sums
    own = float(sums @ sums) * total / slope**2 * used / (used - _UNKNOWNS)
    mean = (used * own + _PRIOR_BLOCKS * expected) / (used + _PRIOR_BLOCKS)
    return max(mean, _LEAST_DESIGN_EFFECT), sums


def long_run_variance(
    before: LongRunVariance | None, blocks: Array, elapsed_s: float
) -> LongRunVariance:
    """Return how far the errors of matches are those of the frames before.

    The variance of a mean over frames is that of one, plus twice the covariances with all before
    it, here with weights that fade.

    Args:
        before: until the last frame; None: there was none.
        blocks: (B,) of `design_effect`, of the frame.
        elapsed_s: since the last frame.
    """
    if before is None:
        return LongRunVariance(blocks)
    faded = before.blocks * np.exp(-elapsed_s / _FADING_S)
    own = 1 + 2 * float(blocks @ faded) / max(float(blocks @ blocks), 1e-9)
    ratio = before.ratio + _PACE * (own - before.ratio)
    return LongRunVariance(faded + blocks, max(ratio, 1.0))
