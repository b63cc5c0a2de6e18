"""One pair of images: joint angles and head as both the readings and the scene tell.

Unknown are what the readings of this moment miss (joint noise) and the parameters of the head
that persist, with their prior. Both are Gaussian, so that where the scene shows little the result
is the prior, and the covariance says so. Matches may be wrong: the best of many hypotheses from
three matches each starts a robust fit with a fixed scale. Where the eyes see too little in common,
what each of them sees again since the keyframe still tells how far it has turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import check_image_fits
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import checked_readings
from vergence.geometry.parameters import change_named
from vergence.self_calibration.keyframe import track_keyframe
from vergence.self_calibration.match_noise import Recurrence, recurrence_inflation
from vergence.self_calibration.motion_evidence import by_each_eye
from vergence.self_calibration.residuals import epipolar_residuals, pair_coordinates
from vergence.self_calibration.robust_fit import (
    FEWEST,
    GATE,
    LINEAR_RAD,
    MOST,
    LinearisedResiduals,
    robust_fit,
)
from vergence.self_calibration.state import Evidence, FrameEstimate, SelfCalibration
from vergence.self_calibration.tolerances import UNCALIBRATED, tolerance_covariance
from vergence.stereo.extrinsics import T_rcam_lcam
from vergence.stereo.uncertainty import LocatedPoints, locate_jointly
from vergence.vision.exposure import checked_image, grey_levels
from vergence.vision.matching.scene_features import Matches, match_scene

_GATE_OF_FEW = 1e-3
"""Probability by chance of a change that is not believed where most matches contradict each other;
robust_fit.GATE where they do not."""
_LEAST_SHARE = 0.1
"""Share of the matches that must fit, for the same reason."""
_LEAST_SHOWN = 0.01
"""Share of a residual's normal in the right image, of usually 0.7, from which a match counts. Where
the rays of a wrong match are nearest in the plane of a camera it is zero, and its noise with it."""
_LITTLE = 1.5
"""Degrees of freedom of the pair, of five, below which the scene showed too little."""


def self_calibrate_frame(
    state: SelfCalibration, left: np.ndarray, right: np.ndarray, joints: ArrayLike
) -> FrameEstimate:
    """Return the head and its joint angles as a pair of images shows them.

    Args:
        state: what is known of the head; it is not changed, see `learning.learn`.
        left: (H, W, 3) RGB or (H, W) grey image of the left camera, uint8.
        right: the same moment in the right camera.
        joints: (r,) readings [rad].

    Raises:
        VergenceError: an image is missing, not uint8, or not of the calibration's size, or the
            readings are not as many as the head has, not finite, or not in radians.
    """
    cameras = [state.head.camera(name).intrinsics for name in state.cameras]
    left, right = (checked_image(image, "Self-calibration") for image in (left, right))
    for name, lens, image in zip(state.cameras, cameras, (left, right), strict=True):
        check_image_fits(name, lens, image.shape, whose="the frame's")
    # A copy, since a driver may write its next readings into the same array.
    joints = _finite_readings(state, joints).copy()
    left, right = grey_levels(left), grey_levels(right)
    matches = match_scene(
        left,
        right,
        left_camera=cameras[0],
        right_camera=cameras[1],
        T_rcam_lcam=T_rcam_lcam(state.head, joints, cameras=state.cameras),
    )
    return from_matches(state, matches, joints, images=(left, right))


def _finite_readings(state: SelfCalibration, joints: ArrayLike) -> Array:
    joints = checked_readings(state.head.kinematics, joints, one_posture=True)
    if not np.isfinite(joints).all():
        raise VergenceError(
            "Self-calibration corrects the readings of the moment of the images; found "
            f"{joints.tolist()}: leave out frames without readings."
        )
    return joints


def _check_matches(matches: Matches) -> None:
    parts = matches.left, matches.right, matches.covariance
    shapes, N = [np.shape(each) for each in parts], len(matches.left)
    if shapes != [(N, 2), (N, 2), (N, 2, 2)]:
        raise VergenceError(
            "Matches are N pixels (N, 2) in the left and in the right image, and covariances "
            f"(N, 2, 2); found arrays of shapes {', '.join(map(str, shapes))}."
        )
    variances = np.diagonal(matches.covariance, axis1=1, axis2=2)
    if not all(np.isfinite(each).all() for each in parts) or not (variances > 0).all():
        raise VergenceError(
            "Pixels of matches and their covariances are finite, and variances above 0; leave out "
            "points that one of the images does not show."
        )


def from_matches(
    state: SelfCalibration,
    matches: Matches,
    joints: Array,
    *,
    images: tuple[np.ndarray, np.ndarray] | None = None,
    at_head: bool = False,
) -> FrameEstimate:
    """Return the head and its joint angles as matches of a pair of images show them.

    Args:
        state: what is known of the head; it is not changed.
        matches: of the pair.
        joints: (r,) readings [rad].
        images: in which they were found; None: features are not tracked to here or from here.
        at_head: whether residuals are linearised at the head as it is, which must be nearly right,
            and not where the pair alone would have it.

    Raises:
        VergenceError: the matches are not N finite pixels in each image with their covariances, or
            the readings are not as many as the head has, not finite, or not in radians.
    """
    joints = _finite_readings(state, joints)
    _check_matches(matches)
    seen = replace(_from_matches(state, matches, joints, at_head), images=images)
    found = track_keyframe(state, seen) if seen.evidence is None else None
    return seen if found is None else by_each_eye(state, seen, found)


def _from_matches(
    state: SelfCalibration, matches: Matches, joints: Array, at_head: bool
) -> FrameEstimate:
    C = state.before_frame
    unseen = FrameEstimate(
        head=state.head,
        cameras=state.cameras,
        joints=joints,
        readings=joints,
        names=state.names,
        covariance=C,
        matches=matches,
        weights=np.zeros(len(matches.left)),
        status="little seen",
        evidence=None,
    )
    if len(matches.left) < FEWEST:
        return unseen
    z, weights, evidence = _fit(state, matches, joints, C, at_head)
    if evidence.inliers < MOST * len(weights):
        # Either much is matched wrongly, or the head is far from what is known.
        P = len(state.names)
        far = C.copy()
        far[:P, :P] += tolerance_covariance(state.head, state.names, UNCALIBRATED)
        _, other_weights, other = _fit(state, matches, joints, far)
        if other.inliers > max(FEWEST, MOST * len(weights), 1.3 * evidence.inliers):
            return replace(unseen, status="contradiction", weights=other_weights, evidence=other)
    if evidence.inliers < max(FEWEST, _LEAST_SHARE * len(weights)):
        return replace(unseen, weights=weights)
    prior = np.linalg.inv(C)
    posterior = np.linalg.inv(evidence.information + prior)
    observed = float(np.trace(posterior @ evidence.information))
    gate = GATE if evidence.inliers > MOST * len(weights) else _GATE_OF_FEW
    if float(z @ prior @ z) > chdtri(max(observed, 1.0), gate):
        return replace(unseen, status="contradiction", weights=weights, evidence=evidence)
    vector = evidence.vector
    if state.recurrence is not None:
        information, vector = _beyond_known(state, state.recurrence, evidence, joints)
        posterior = np.linalg.inv(information + prior)
    head, now = _changed(state, joints, posterior @ vector)
    return replace(
        unseen,
        head=head,
        joints=now,
        covariance=posterior,
        weights=weights,
        status="seen" if observed > _LITTLE else "little seen",
        evidence=evidence,
    )


def _fit(
    state: SelfCalibration, matches: Matches, joints: Array, C: Array, at_head: bool = False
) -> tuple[Array, Array, Evidence]:
    """Return the change (K,) that matches and prior give, weights (N,), and what matches say."""

    P, factors = len(state.names), state.head.kinematics.factors

    def linear(z: Array) -> bool:
        return bool(np.abs(factors * z[P:]).max() < LINEAR_RAD)

    def linearised(z: Array, some: np.ndarray) -> LinearisedResiduals:
        those = Matches(matches.left[some], matches.right[some], matches.covariance[some])
        return _whitened(state, *_changed(state, joints, z), those)

    return robust_fit(
        linearised,
        C,
        pixels=matches.left,
        size=state.head.camera(state.cameras[0]).intrinsics.size,
        expected_design_effect=state.design_effect,
        fixed=P if at_head else 0,
        linear=linear if state.settled else None,
    )


def _beyond_known(
    state: SelfCalibration, recurrence: Recurrence, says: Evidence, joints: Array
) -> tuple[Array, Array]:
    """Return what a frame says, (K, K) and (K,), with less of the head where it was seen like this.

    Errors of matches that recur were learned with the head: they tell no more of it, as in
    `update.updated`, and the head would else follow them from frame to frame. Given the head, they
    tell of the frame's joints what they do.
    """
    N, b = says.information, says.vector
    posture = state.head.kinematics.factors * joints
    inflation, P = recurrence_inflation(recurrence, posture), len(state.names)
    of_joints = N[P:, P:] + np.diag(state.reading_std_rad**-2.0)
    follows = np.linalg.solve(of_joints, N[P:, :P]).T
    information, vector = N.copy(), b.copy()
    known = 1 - 1 / inflation
    information[:P, :P] -= known * (N[:P, :P] - follows @ N[P:, :P])
    vector[:P] -= known * (b[:P] - follows @ b[P:])
    return information, vector


def _changed(state: SelfCalibration, joints: Array, z: Array) -> tuple[HeadCalibration, Array]:
    P = len(state.names)
    return change_named(state.head, state.names, z[:P]), joints + z[P:]


def _whitened(
    state: SelfCalibration, head: HeadCalibration, joints: Array, matches: Matches
) -> LinearisedResiduals:
    """Return residuals of N matches in their standard deviations; unknowns are P + r."""
    pair = pair_coordinates(head, state.names, joints, state.cameras)
    found = epipolar_residuals(pair.lenses, pair.T_second_first, matches.left, matches.right)
    A, n = found.by_coordinates, found.normals[:, 2:]
    random = state.match_scale**2 * np.einsum("ni,nij,nj->n", n, matches.covariance, n)
    systematic = found.normals**2 @ np.repeat(np.square(state.systematic_px), 2)
    std = np.sqrt(random + systematic)
    good = np.isfinite(found.residuals) & np.isfinite(A).all(axis=1)
    good &= (std > 0) & (np.linalg.norm(n, axis=1) > _LEAST_SHOWN)
    y = np.where(good, found.residuals / std, 1e3)
    A = np.where(good[:, None], A / std[:, None], 0.0)
    share = float(np.median(systematic[good] / std[good] ** 2)) if good.any() else 0.0
    return LinearisedResiduals(y, A, pair.by_unknowns, share)


def locate_seen(
    seen: FrameEstimate,
    *,
    left: Array,
    right: Array,
    pixel_std_px: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> LocatedPoints:
    """Return where points are that both eyes see at the moment of a self-calibrated frame.

    Pixels are (N, 2) in the left and the right camera, by default those that see the geometry; the
    covariance has what the frame leaves open of the head and the joints. Other arguments and errors
    are those of `uncertainty.locate`.
    """
    return locate_jointly(
        seen.head,
        left=left,
        right=right,
        joints=seen.joints,
        parameters=seen.names,
        covariance=seen.covariance,
        pixel_std_px=pixel_std_px,
        cameras=cameras or seen.cameras,
    )
