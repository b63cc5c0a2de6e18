"""How the matches of a pair of images err: how much, and how correlated in space and over time.

The contrast of a window tells how well it can be matched, but not edges that are drawn or occluded
alike in several windows. So errors are taken as independent from one block of the image to the next
only. How much the correlation within inflates variances is measured from the residuals (the design
effect of clusters). And eyes that come back to a posture see the same windows with the same errors
again, however much later: how far these recur is measured too, and a frame counts by what it adds.

Where lenses are not as their models, errors are smooth over the image and the same in all frames.
Residuals hardly show them; how large they are is known from the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from vergence.arrays import Array

CUT = 4.685
"""Tukey's biweight: residuals beyond so many standard deviations do not count."""
_PRIOR_MATCHES = 30.0
"""How many matches the expected noise counts for, beside the frame's own."""
_BLOCK_PX = 64
"""Errors of matches farther apart than this are taken as independent."""
_BLOCKS = 16
"""Most blocks along each axis; they are larger in images of more than 1024 px."""
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
_SAME_WINDOWS_RAD, _SAME_SURFACES_RAD = np.radians([1.2, 13.0])
"""Distances in the space of the readings over which the correlation of errors falls to 1 / e: one
half as exp(-x) with the windows themselves, one as exp(-x^2) with what surrounds them. The second
was fitted, by eye, to what the errors of matches do to the parameters of the head (two heads in the
room and two in the sparse scene, both lenses, 800 pairs of images at known postures): correlations
of 0.36 within 1 degree, 0.20 at 2.5, 0.14 at 5, 0.09 at 9, 0.07 at 13, 0.02 at 18, 0.01 at 22."""
_FADING_S = 600.0
"""Time over which the correlation falls to 1 / e: an assumption, so that a head that has drifted
is learned again. In nine rendered minutes errors recurred as within seconds. With two minutes
instead of ten, squared Mahalanobis distances of what these had taught were 1.2 to 1.4 times as
large. What all frames have taught fades as fast."""
_FIELD_PARTS = 15.0
"""How many independent parts the systematic errors of a lens have in an image: functions of two
coordinates up to the fourth degree, as their size is estimated with."""
_EVERYWHERE = 0.005
"""Correlation of errors at any two postures: rendered matches have mean residuals of some
thousandths of a pixel that many frames hardly average out, and that pull in the same few directions
for all heads and lenses. Measured between postures 20 to 60 degrees apart, with an uncertainty as
large. With it the squared Mahalanobis distance of the 40 learned parameters is 33 in the mean of
twenty cases (five heads in the room and in the sparse scene, both lenses, with all figures of a
lens learned one after the other); with 0.01
it was 25 in sixteen of these, and learned depth as steady within 6 percent."""
_EXPECTED_RECURRENCE = 0.4
"""Correlation of errors at the same posture, before it is measured."""
_MOST_RECURRENCE = 0.95
_PACE = 0.1
"""Share of a frame in its running mean."""
_NEAREST = 60
"""Past frames that tell what is new: the nearest ones, so that few equations are solved."""
_LEAST_NEW = 1e-3
"""Share of a frame that is new at least."""
_REMEMBERED = 2000
"""Frames that are compared; older ones count as new again."""


@dataclass(frozen=True, eq=False)
class Recurrence:
    """How far the errors of matches recur where the eyes stood before."""

    joints: Array
    """(n, r) readings of past frames [rad], times `Kinematics.factors`."""
    ages_s: Array
    """(n,) how long ago they were."""
    blocks: np.ndarray
    """(n, B) float32 sums of their residuals in blocks, as unit vectors."""
    correlation: float = _EXPECTED_RECURRENCE
    """Correlation of the errors of two frames of the same posture."""
    independent: float = 0.0
    """How many independent frames would tell as much as all of them, if those at different postures
    had no errors in common."""
    everywhere: float = _EVERYWHERE
    """Correlation of the errors of two frames at any two postures."""


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


def design_effect(
    y: Array, pixels: Array, size: tuple[int, int], expected: float
) -> tuple[float, Array]:
    """Return the variance inflation by errors that neighbours share, and sums (B,) over blocks.

    The variance of a mean of matches, relative to what independent errors of unit variance would
    give: that of an M-estimate with errors that are independent from block to block (the sandwich
    formula, for clusters). It also counts the tails, which the weights leave.

    Args:
        y: (N,) residuals [standard deviations].
        pixels: (N, 2) where they are, in one of the images.
        size: its width and height [px].
        expected: the design effect that is expected; it counts for ten blocks.
    """
    column, row = np.clip(pixels // _block_px(size), 0, _BLOCKS - 1).astype(int).T
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


def systematic_inflation(weights: Array, share: float) -> float:
    """Return what the systematic errors of lenses add to the variance inflation of residuals (N,).

    Args:
        weights: (N,) of the residuals.
        share: of their variance that is systematic.
    """
    return share * float(weights.sum()) / _FIELD_PARTS


def aged(before: Recurrence, elapsed_s: float) -> Recurrence:
    """Return the recurrence some time later, after which a frame comes."""
    independent = before.independent * float(np.exp(-elapsed_s / _FADING_S))
    return replace(before, ages_s=before.ages_s + elapsed_s, independent=independent)


def recurrence_inflation(before: Recurrence | None, joints: Array) -> float:
    """Return the variance inflation of a frame, which shares errors with the frames before it.

    Frames that would tell as much as n independent ones tell n / (1 + c (n - 1)), where the errors
    of any two have a correlation of c. A frame counts by what it adds.

    Args:
        before: of the frames before, as old as they are now; None: there was none.
        joints: (r,) readings of the frame [rad], times `Kinematics.factors`.
    """
    return 1.0 if before is None else _inflation(before, _added(before, tuple(joints)))


def _inflation(before: Recurrence, added: float) -> float:
    """Return the variance inflation of a frame by how many independent ones it adds."""
    n, c = before.independent, before.everywhere
    return (1 + c * (n - 1)) * (1 + c * (n + added - 1)) / (added * (1 - c))


@lru_cache(maxsize=1)  # the estimate, the tracking and the filter ask for one and the same frame
def _added(before: Recurrence, joints: tuple[float, ...]) -> float:
    """Return how many independent frames a frame adds, whose posture was observed before.

    The mean of frames with correlated errors (covariance K) tells as much as 1' K^-1 1 independent
    ones; a frame adds the difference.
    """
    posture = np.array(joints)
    near = np.argsort(_apart(before.joints, posture))[:_NEAREST]
    at, ages_s = before.joints[near], before.ages_s[near]
    between_s = np.abs(ages_s[:, None] - ages_s)
    K = before.correlation * _kernel(_apart(at[:, None], at), between_s)
    K[np.diag_indices(len(K))] = 1.0
    k = before.correlation * _kernel(_apart(at, posture), ages_s)
    weights = np.linalg.solve(K, k)
    return float(max(1 - weights.sum(), _LEAST_NEW) ** 2 / (1 - weights @ k))


def share_filled(blocks: np.ndarray, size: tuple[int, int]) -> float:
    """Return the share of an image that features fill, by their sums (B,) over its blocks."""
    across, down = np.ceil(np.array(size) / _block_px(size))
    return float(np.count_nonzero(blocks) / (across * down))


def _block_px(size: tuple[int, int]) -> float:
    """Return the side of a block [px] in an image of a width and a height."""
    return max(_BLOCK_PX, max(size) / _BLOCKS)


def noise_degrees(before: Recurrence | None) -> float:
    """Return from how many independent blocks the noise of the matches in past frames is estimated.

    Less the unknowns, as degrees of freedom: few where features cover a small part of the images,
    or frames repeat each other.
    """
    if before is None:
        return 1.0
    blocks = float(np.count_nonzero(before.blocks, axis=1).mean())
    return max(before.independent * blocks - _UNKNOWNS, 1.0)


def with_frame(
    before: Recurrence | None, joints: Array, blocks: Array, systematic: float = 0.0
) -> tuple[Recurrence, float]:
    """Return the recurrence after a frame, and the frame's `recurrence_inflation`.

    Args:
        before: of the frames before, as old as they are now; None: there was none.
        joints: (r,) readings [rad], times `Kinematics.factors`.
        blocks: (B,) of `design_effect`.
        systematic: share of the variance of what the frame tells that is by systematic errors.
    """
    everywhere = systematic + (1 - systematic) * _EVERYWHERE
    unit = (blocks / max(float(np.linalg.norm(blocks)), 1e-9)).astype(np.float32)[None]
    if before is None:
        first = Recurrence(joints[None], np.zeros(1), unit, independent=1.0, everywhere=everywhere)
        return first, 1.0
    near = _kernel(_apart(before.joints, joints), before.ages_s)
    weight = float(near @ near)
    measured = float(near @ (before.blocks @ unit[0])) / max(weight, 1e-9)
    pace = _PACE * weight / (1 + weight)
    c = before.correlation + pace * (measured - before.correlation)
    added = _added(before, tuple(joints))
    after = Recurrence(
        joints=np.concatenate([before.joints, joints[None]])[-_REMEMBERED:],
        ages_s=np.append(before.ages_s, 0.0)[-_REMEMBERED:],
        blocks=np.concatenate([before.blocks, unit])[-_REMEMBERED:],
        correlation=min(max(c, 0.0), _MOST_RECURRENCE),
        independent=before.independent + added,
        everywhere=before.everywhere + _PACE * (everywhere - before.everywhere),
    )
    return after, _inflation(before, added)


def _apart(a: Array, b: Array) -> Array:
    """Return the distance of postures (..., r) [rad]; Euclidean, so that K is positive definite."""
    return np.linalg.norm(a - b, axis=-1)


def _kernel(apart: Array, elapsed_s: Array) -> Array:
    same = np.exp(-apart / _SAME_WINDOWS_RAD) + np.exp(-((apart / _SAME_SURFACES_RAD) ** 2))
    return same / 2 * np.exp(-elapsed_s / _FADING_S)
