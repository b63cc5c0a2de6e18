"""What the covariance of a calibration adds to that of located points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.batches import BLOCK, batch_first, batch_last, product
from vergence.geometry.head import HeadCalibration, stated_covariance, states_covariance
from vergence.stereo.extrinsics import per_pair
from vergence.stereo.linearised import Linearised, pair_columns, pair_parameters


@dataclass(frozen=True, eq=False)
class PairCovariance:
    """The part of a head's covariance on which the pixels of two cameras depend."""

    own: tuple[list[int], list[int]]
    """By camera, which p_l and p_r of its `pair_columns` have a stated covariance."""
    by_left: Array
    """(p_l + p_r, p_l) covariance of both cameras' with the left one's."""
    by_right: Array
    """(p_r, p_r)."""


@per_pair
def pair_covariance(
    head: HeadCalibration, cameras: tuple[str, str] | None
) -> PairCovariance | None:
    """Return the covariance that the pixels of a pair depend on; None where none is stated."""
    if not states_covariance(head):
        return None
    names, (left, right) = pair_parameters(head, cameras), pair_columns(head, cameras)
    of_base = np.array([name.startswith("T_rbase_lbase.") for name in names])
    stated = np.isin(np.arange(len(names)), stated_covariance(head, names)[0])
    own = np.flatnonzero((stated & ~of_base)[left]), np.flatnonzero(stated[right])
    _, C = stated_covariance(head, [names[k] for k in (*left[own[0]], *right[own[1]])])
    n = len(own[0])
    return PairCovariance(
        (own[0].tolist(), own[1].tolist()),
        np.ascontiguousarray(C[:, :n]),
        np.ascontiguousarray(C[n:, n:]),
    )


def covariance_of_calibration(seen: Linearised, known: PairCovariance) -> Array:
    """Compute what a calibration adds to the covariances (..., 3, 3) of points.

    By way of the covariance of the four pixel coordinates, which takes half the time.
    """
    batch, n = seen.status.shape, seen.status.size
    left, right = (
        [batch_last(part, 2).reshape(2, part.shape[-1], n) for part in parts]
        for parts in seen.pixels_by_head
    )
    own_left, own_right = known.own
    split = len(own_left)
    pixels = np.empty((4, 4, n))
    for start in range(0, n, BLOCK):
        block = np.s_[..., start : start + BLOCK]
        one, other = (
            np.concatenate([part[block] for part in parts], axis=1)[:, own]
            for parts, own in ((left, own_left), (right, own_right))
        )
        into = pixels[block]
        by_left, by_right = known.by_left @ one, known.by_right @ other
        np.einsum("ipn,jpn->ijn", one, by_left[:, :split], out=into[:2, :2])
        np.einsum("ipn,jpn->ijn", by_left[:, split:], other, out=into[:2, 2:])
        np.einsum("ipn,jpn->ijn", other, by_right, out=into[2:, 2:])
    pixels[2:, :2] = pixels[:2, 2:].swapaxes(0, 1)
    whole = batch_first(pixels.reshape(4, 4, *batch), 2)
    return product(product(seen.by_pixels, whole), seen.by_pixels.swapaxes(-1, -2))


@per_pair
def pair_factor(head: HeadCalibration, cameras: tuple[str, str] | None) -> Array:
    """Return F (P, q) with F F^T the calibration's covariance of `pair_parameters`."""
    names = pair_parameters(head, cameras)
    stated, C = stated_covariance(head, names)
    factor = np.zeros((len(names), len(stated)))
    factor[stated] = covariance_factor(C)
    return factor


def covariance_factor(C: Array) -> Array:
    """Return F (n, n) with F F^T = C (n, n), whatever the units of the n numbers."""
    std = np.sqrt(np.diag(C))
    unit = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(C / unit / unit[:, None])
    return std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
