"""Features of a keyframe, tracked in each eye over time.

The rotation of each eye determines focal lengths, gains and mountings. One keyframe stays in the
state with its joint angles. When an eye has turned far enough, its features are tracked into the
present images, and the present frame becomes the keyframe.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from vergence.arrays import Array
from vergence.estimation.linear import posterior
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_between, change_named
from vergence.geometry.se3 import inverse
from vergence.self_calibration.residuals import (
    depths_of_matches,
    motion_coordinates,
    motion_residuals,
)
from vergence.self_calibration.robust_fit import FEWEST, INLIER, Linearised, passes_gate, robust_fit
from vergence.self_calibration.state import FilterState, FrameEstimate, Keyframe, TrackedFeatures
from vergence.stereo.extrinsics import camera_poses, relative_camera_pose
from vergence.vision.matching.scene_features import track_features

TURNED_RAD = float(np.radians(8.0))
"""Change of a joint angle from which features are tracked; with 4 or 12 degrees learned depth is
about as steady."""
_MOTION_INFLATION = 2.5
"""Covariance inflation of tracked features for errors that all motions share, such as those of the
lens model; with it they leave the squared Mahalanobis distance of rendered figures unchanged."""


def worth_tracking(state: FilterState, estimate: FrameEstimate) -> bool:
    """Decide whether the eyes have turned far enough, to a posture that is new enough."""
    key = state.keyframe
    if key is None or state.largest_turn_rad(estimate.readings, key.readings) < TURNED_RAD:
        return False
    return state.revisits.inflation(estimate.novelty) < 10  # tracking takes longer than estimating


def track_keyframe(state: FilterState, estimate: FrameEstimate) -> TrackedFeatures | None:
    """Find the features of the keyframe in a frame; None: there are no images of both."""
    key = state.keyframe
    if key is None or key.images is None or estimate.images is None:
        return None
    moments = np.stack([key.joints, estimate.joints])
    then, now = camera_poses(state.head, moments, cameras=state.cameras)
    found = []
    for k, name in enumerate(state.cameras):
        matches, which = track_features(
            key.images[k],
            estimate.images[k],
            camera=state.head.camera(name).intrinsics,
            T_now_before=inverse(now[k]) @ then[k],
            pixels=key.pixels[k],
            depths_m=key.depths_m[k],
        )
        found.append((matches, key.depths_m[k][which]))
    (left, left_depths), (right, right_depths) = found
    return TrackedFeatures(key.readings, (left, right), (left_depths, right_depths))


def next_keyframe(
    state: FilterState, estimate: FrameEstimate, *, head: HeadCalibration, change: Array, C: Array
) -> Keyframe:
    """Update the keyframe after a frame, or replace it if the eyes have turned far enough.

    The head is that after the frame; change (K,) and covariance C (K, K) are those of the
    `augmented_covariance`.
    """
    P, r = len(state.names), len(estimate.readings)
    head_rows, now, then = slice(P), slice(P, P + r), slice(P + r, None)
    key = state.keyframe
    if key is not None and state.largest_turn_rad(estimate.readings, key.readings) < TURNED_RAD:
        return replace(
            key,
            joints=key.joints + change[then],
            covariance=C[then, then],
            cross_covariance=C[head_rows, then],
        )
    joints = estimate.readings + change[now]
    fits = np.flatnonzero(estimate.weights > INLIER)  # in rows of the image: from all of its parts
    count = min(len(fits), 150)  # with twice as many learned depth is no steadier
    fits = fits[np.linspace(0, len(fits), count, endpoint=False, dtype=int)]
    left, right = estimate.matches.left[fits], estimate.matches.right[fits]
    lenses = [head.camera(name).intrinsics for name in state.cameras]
    T = relative_camera_pose(head, joints, cameras=state.cameras)
    images = estimate.images
    return Keyframe(
        readings=estimate.readings,
        # Copies, since a driver may write the next images into the same arrays.
        images=None if images is None else (images[0].copy(), images[1].copy()),
        joints=joints,
        covariance=C[now, now],
        cross_covariance=C[head_rows, now],
        pixels=(left, right),
        depths_m=depths_of_matches(lenses, T, left, right),
    )


def augmented_covariance(state: FilterState) -> Array:
    """Assemble the covariance (K, K) of head, readings and the keyframe's joints, if any."""
    C, key = state.frame_covariance, state.keyframe
    if key is None:
        return C
    cross = np.concatenate([key.cross_covariance, np.zeros_like(key.covariance)])
    return np.block([[C, cross], [cross.T, key.covariance]])


def add_tracked(
    state: FilterState,
    estimate: FrameEstimate,
    tracked: TrackedFeatures,
    equations: tuple[Array, Array],
    *,
    at: HeadCalibration | None = None,
) -> tuple[Array, Array]:
    """Add tracked features that pass the innovation gate to normal equations (K, K) and (K,).

    The unknowns are those of `augmented_covariance`. Features of another keyframe do not count.
    Residuals are linearised at a head or, without one, at the frame's own.
    """
    information, vector = equations
    if state.keyframe is None or not np.array_equal(tracked.readings, state.keyframe.readings):
        return equations
    prior, P = augmented_covariance(state), len(state.names)
    inflation = state.revisits.inflation(estimate.novelty)
    for k in range(len(state.cameras)):
        if len(tracked.depths_m[k]) < FEWEST:
            continue
        start, C = posterior(information, vector, prior)
        if at is not None:  # joints given this head
            to_head = change_between(at, state.head, state.names)
            joints = start[P:] + C[P:, :P] @ np.linalg.solve(C[:P, :P], to_head - start[:P])
            start = np.concatenate([to_head, joints])

        weights, evidence = robust_fit(
            partial(_whiten, state, tracked, k, estimate.readings, start),
            np.asarray(block_diag(C, 1.0), float),
            pixels=np.tile(tracked.matches[k].left, (2, 1)),
            size=state.head.camera(state.cameras[k]).intrinsics.size,
            prior_design_effect=state.design_effect,
            fixed=0 if at is None else P,
        )
        # The relative error of all depths together is as good as unknown: its deviation is one.
        # Else parallax would determine the scale of the depths from hundredths of a pixel.
        N, b = evidence.information / _MOTION_INFLATION, evidence.vector / _MOTION_INFLATION
        gain = N[:-1, -1] / (N[-1, -1] + 1)
        N, b = N[:-1, :-1] - np.outer(gain, N[-1, :-1]), b[:-1] - gain * b[-1]
        if passes_gate(evidence) and 2 * evidence.inliers > len(weights):
            information = information + N / inflation
            vector = vector + (b + N @ start) / inflation
    return information, vector


def _whiten(
    state: FilterState,
    tracked: TrackedFeatures,
    k: int,
    readings: Array,
    start: Array,
    further: Array,
) -> Linearised:
    """Compute residuals (2 N,) of camera k in standard deviations, all u before all v.

    The readings (r,) are those now. The K unknowns are changed by start (K,) and by a further
    change (K + 1,), the last number being the relative change of all depths.
    """
    assert state.keyframe is not None
    change = start + further[:-1]
    P, r, matches = len(state.names), len(readings), tracked.matches[k]
    head = change_named(state.head, state.names, change[:P])
    joints = state.keyframe.joints + change[P + r :], readings + change[P : P + r]
    coordinates = motion_coordinates(head, state.names, *joints, state.cameras[k])
    off, A = motion_residuals(
        coordinates.lenses[0],
        coordinates.T_second_first,
        earlier=matches.left,
        later=matches.right,
        depths_m=tracked.depths_m[k] * np.exp(further[-1]),
    )
    good = np.asarray(np.isfinite(off).all(axis=1) & np.isfinite(A).all(axis=(1, 2)))
    by_depth = 0.05 * A[..., -1]  # by the relative error of each depth, an assumption
    C = state.match_scale**2 * matches.covariance + np.einsum("ni,nj->nij", by_depth, by_depth)
    C[~good] = np.eye(2)
    systematic = 2 * state.systematic_px[k] ** 2  # then and now, in two places of the image
    random = float(np.median(C[:, 0, 0] + C[:, 1, 1])) / 2
    whiten = np.linalg.inv(np.linalg.cholesky(C + systematic * np.eye(2)))
    y = np.where(good[:, None], (whiten @ off[..., None])[..., 0], 1e3)
    A = np.where(good[:, None, None], whiten @ A, 0.0)
    return Linearised(
        residuals=y.T.reshape(-1),
        by_coordinates=A.swapaxes(0, 1).reshape(-1, A.shape[-1]),
        by_unknowns=np.asarray(block_diag(coordinates.by_unknowns, 1.0), float),
        systematic=systematic / (systematic + random),
    )
