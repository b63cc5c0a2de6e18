"""Estimate of one frame: head and joint angles from readings, images and the filter's prior.

The unknowns are the errors of the readings and the head parameters, both with Gaussian priors. A
scene that shows little leaves estimate and covariance at the prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.estimation.linear import posterior
from vergence.geometry.camera import check_image_fits
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import checked_readings
from vergence.geometry.parameters import change_named
from vergence.self_calibration.prior import UNCALIBRATED, tolerance_covariance
from vergence.self_calibration.residuals import epipolar_residuals, pair_coordinates
from vergence.self_calibration.robust_fit import (
    FEWEST,
    LINEAR_RAD,
    Linearised,
    passes_gate,
    robust_fit,
)
from vergence.self_calibration.state import Evidence, FilterState, FrameEstimate
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.stereo.uncertainty import LocatedPoints, locate_jointly
from vergence.vision.exposure import checked_image, grey_levels
from vergence.vision.matching.scene_features import Matches, match_scene


def estimate_frame(
    state: FilterState, left: np.ndarray, right: np.ndarray, joints: ArrayLike
) -> FrameEstimate:
    """Estimate head and joint angles from a pair of images, (H, W, 3) RGB or (H, W) grey, uint8.

    The state is predicted for the frame; see `kalman.predict`. VergenceError if an image is
    missing, not uint8 or not of the calibration's size, or the readings (r,) [rad] are not those of
    the head, not finite or not in radians.
    """
    lenses = [state.head.camera(name).intrinsics for name in state.cameras]
    images = [checked_image(image, "Self-calibration") for image in (left, right)]
    for name, lens, image in zip(state.cameras, lenses, images, strict=True):
        check_image_fits(name, lens, image.shape, whose="the frame's")
    # A copy, since a driver may write its next readings into the same array.
    joints = checked_readings(state.head.kinematics, joints, one_posture=True).copy()
    if not np.isfinite(joints).all():
        raise VergenceError(
            "Self-calibration corrects the readings of the moment of the images; found "
            f"{joints.tolist()}: leave out frames without readings."
        )
    left, right = (grey_levels(image) for image in images)
    matches = match_scene(
        left,
        right,
        left_camera=lenses[0],
        right_camera=lenses[1],
        T_rcam_lcam=relative_camera_pose(state.head, joints, cameras=state.cameras),
    )
    return estimate_from_matches(state, matches, joints, images=(left, right))


def estimate_from_matches(
    state: FilterState,
    matches: Matches,
    joints: Array,
    *,
    images: tuple[np.ndarray, np.ndarray] | None = None,
    at_head: bool = False,
) -> FrameEstimate:
    """Estimate head and joint angles from the matches of a pair, at readings (r,) [rad].

    Without its grey images features are not tracked to or from this frame. `at_head`: residuals are
    linearised at the state's head instead of the frame's own.
    """
    prior = FrameEstimate(
        head=state.head,
        cameras=state.cameras,
        joints=joints,
        readings=joints,
        names=state.names,
        covariance=state.frame_covariance,
        matches=matches,
        weights=np.zeros(len(matches.left)),
        status="little seen",
        evidence=None,
        images=images,
    )
    C, N, P = prior.covariance, len(prior.weights), len(state.names)
    if FEWEST > N:
        return prior
    weights, evidence = _fit(state, prior, C, at_head=at_head)
    if 2 * evidence.inliers < N:
        # Either most matches are wrong, or the head is far from its mean.
        wide = C.copy()
        wide[:P, :P] += tolerance_covariance(state.head, state.names, UNCALIBRATED)
        wide_weights, wide_evidence = _fit(state, prior, wide)
        if wide_evidence.inliers > max(FEWEST, N / 2):
            return replace(
                prior, status="contradiction", weights=wide_weights, evidence=wide_evidence
            )
    if evidence.inliers < max(FEWEST, N / 10):  # wrong matches agree by chance
        return replace(prior, weights=weights)
    novelty = state.revisits.novelty(state.head.kinematics.gear_ratios * joints)
    prior = replace(prior, weights=weights, evidence=evidence, novelty=novelty)
    if not passes_gate(evidence):
        return replace(prior, status="contradiction")
    change, posterior_C = posterior(*_discount_revisits(state, prior, evidence), C)
    return replace(
        prior,
        head=change_named(state.head, state.names, change[:P]),
        joints=joints + change[P:],
        covariance=posterior_C,
        status="seen" if evidence.degrees > 1.5 else "little seen",  # of the five of a pair
    )


def _fit(
    state: FilterState, prior: FrameEstimate, C: Array, *, at_head: bool = False
) -> tuple[Array, Evidence]:
    """Fit the matches with a prior covariance (K, K); see `robust_fit`."""
    P = len(state.names)
    limits = np.append(np.full(P, np.inf), LINEAR_RAD / np.abs(state.head.kinematics.gear_ratios))

    def linearise(change: Array) -> Linearised:
        head = change_named(state.head, state.names, change[:P])
        return _whiten(state, head, prior.joints + change[P:], prior.matches)

    return robust_fit(
        linearise,
        C,
        pixels=prior.matches.left,
        size=state.head.camera(state.cameras[0]).intrinsics.size,
        prior_design_effect=state.design_effect,
        fixed=P if at_head else 0,
        linear_range=limits if state.settled else None,
    )


def _discount_revisits(
    state: FilterState, estimate: FrameEstimate, evidence: Evidence
) -> tuple[Array, Array]:
    """Inflate the head's part of normal equations (K, K) and (K,) at a revisited posture.

    As in a Schmidt-Kalman filter the head is then a consider parameter: recurring errors of matches
    have been learned with it, and it would follow them from frame to frame. Given the head, the
    frame determines its joints without inflation.
    """
    N, b, P = evidence.information, evidence.vector, len(state.names)
    of_joints = N[P:, P:] + np.diag(state.reading_std_rad**-2.0)
    gain = np.linalg.solve(of_joints, N[P:, :P]).T
    information, vector = N.copy(), b.copy()
    known = 1 - 1 / state.revisits.inflation(estimate.novelty)
    information[:P, :P] -= known * (N[:P, :P] - gain @ N[P:, :P])
    vector[:P] -= known * (b[:P] - gain @ b[P:])
    return information, vector


def _whiten(
    state: FilterState, head: HeadCalibration, joints: Array, matches: Matches
) -> Linearised:
    """Compute epipolar residuals (N,) in their standard deviations, by P + r unknowns."""
    pair = pair_coordinates(head, state.names, joints, state.cameras)
    found = epipolar_residuals(pair.lenses, pair.T_second_first, matches.left, matches.right)
    A, n = found.by_coordinates, found.normals[:, 2:]
    random = state.match_scale**2 * np.einsum("ni,nij,nj->n", n, matches.covariance, n)
    systematic = found.normals**2 @ np.repeat(np.square(state.systematic_px), 2)
    std = np.sqrt(random + systematic)
    good = np.isfinite(found.residuals) & np.isfinite(A).all(axis=1)
    # Where the rays of a wrong match meet in the plane of a camera, noise and residual vanish; the
    # part of the unit normal in the right image is 0.7 elsewhere.
    good &= (std > 0) & (np.linalg.norm(n, axis=1) > 0.01)
    share = float(np.median(systematic[good] / std[good] ** 2)) if good.any() else 0.0
    return Linearised(
        residuals=np.where(good, found.residuals / std, 1e3),
        by_coordinates=np.where(good[:, None], A / std[:, None], 0.0),
        by_unknowns=pair.by_unknowns,
        systematic=share,
    )


def locate_in_frame(
    estimate: FrameEstimate,
    *,
    left: Array,
    right: Array,
    pixel_std_px: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> LocatedPoints:
    """Locate points that both eyes see, with the joint covariance of head and readings.

    Pixels are (N, 2) in the left and the right camera, by default those of the estimate. Other
    arguments and errors are those of `uncertainty.locate`.
    """
    return locate_jointly(
        estimate.head,
        left=left,
        right=right,
        joints=estimate.joints,
        estimate=(estimate.names, estimate.covariance),
        pixel_std_px=pixel_std_px,
        cameras=cameras or estimate.cameras,
    )
