"""Features tracked from an earlier frame, in each eye: how far it has turned.

Between the eyes, images tell how these stand to each other, but hardly focal lengths, gains and
mountings, least of all while the eyes move in parallel. Over time, what an eye has turned shows all
three. So one earlier frame, the keyframe, stays in the state with its joint angles; when the eyes
have turned far enough, its features are found again in the present images, and the present frame
takes its place. What has moved by itself, as most things a robot handles, contradicts the rest, and
does not count (`motion_evidence`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import inverse
from vergence.self_calibration.match_noise import recurrence_inflation
from vergence.self_calibration.residuals import depths_of_matches
from vergence.self_calibration.robust_fit import INLIER
from vergence.self_calibration.state import (
    FrameEstimate,
    Keyframe,
    SelfCalibration,
    TrackedFeatures,
)
from vergence.stereo.extrinsics import T_rcam_lcam, camera_poses
from vergence.vision.matching.scene_features import track_features

TURNED_RAD = float(np.radians(8.0))
"""Least change of a reading since the keyframe, from which is learned: with 4 or 12 degrees depth
is about as steady. Small turns show little, and of large ones a narrow camera would lose sight."""
_LARGEST_INFLATION = 10.0
"""Variance inflation of a frame, for its posture was seen before, from which no features are
tracked: they would count for a tenth or less, and take longer than the estimate. On the same images
learned depth spreads by up to 4 percent more."""
_FEATURES = 150
"""Features of a keyframe; with twice as many depth is no steadier, and tracking takes a third
longer."""


def worth_tracking(state: SelfCalibration, seen: FrameEstimate) -> bool:
    """Return whether features tracked to a frame would tell enough of the head.

    The eyes have turned far enough since the keyframe, to a posture at which little was learned
    before.
    """
    key = state.keyframe
    if key is None or _turned_rad(key, seen) < TURNED_RAD:
        return False
    posture = state.head.kinematics.factors * seen.readings
    return recurrence_inflation(state.recurrence, posture) < _LARGEST_INFLATION


def track_keyframe(state: SelfCalibration, seen: FrameEstimate) -> TrackedFeatures | None:
    """Return where the features of the keyframe are in a frame.

    None: there is no keyframe, or one of the two has no images.
    """
    key = state.keyframe
    if key is None or key.images is None or seen.images is None:
        return None
    moments = np.stack([key.joints, seen.joints])
    then, now = camera_poses(state.head, moments, cameras=state.cameras)
    found = []
    for k, name in enumerate(state.cameras):
        matches, which = track_features(
            key.images[k],
            seen.images[k],
            camera=state.head.camera(name).intrinsics,
            T_now_before=inverse(now[k]) @ then[k],
            pixels=key.pixels[k],
            depths_m=key.depths_m[k],
        )
        found.append((matches, key.depths_m[k][which]))
    (left, left_depths), (right, right_depths) = found
    return TrackedFeatures(key.readings, (left, right), (left_depths, right_depths))


def next_keyframe(
    state: SelfCalibration, seen: FrameEstimate, head: HeadCalibration, C: Array, change: Array
) -> Keyframe:
    """Return the keyframe after a frame: the one before, known better, or the frame itself.

    Args:
        state: before the frame.
        seen: the frame.
        head: after the frame.
        C: (K, K) covariance of parameters, present readings and joints of the keyframe, if any.
        change: (K,) of them.
    """
    P, r = len(state.names), len(seen.readings)
    key = state.keyframe
    if key is not None and _turned_rad(key, seen) < TURNED_RAD:
        return replace(
            key,
            joints=key.joints + change[P + r :],
            covariance=C[P + r :, P + r :],
            with_head=C[:P, P + r :],
        )
    joints = seen.readings + change[P : P + r]
    fits = np.flatnonzero(seen.weights > INLIER)  # in rows of the image: from all of its parts
    fits = fits[np.linspace(0, len(fits), min(len(fits), _FEATURES), endpoint=False, dtype=int)]
    left, right = seen.matches.left[fits], seen.matches.right[fits]
    lenses = [head.camera(name).intrinsics for name in state.cameras]
    return Keyframe(
        readings=seen.readings,
        # Copies, since a driver may write the next images into the same arrays.
        images=None if seen.images is None else (seen.images[0].copy(), seen.images[1].copy()),
        joints=joints,
        covariance=C[P : P + r, P : P + r],
        with_head=C[:P, P : P + r],
        pixels=(left, right),
        depths_m=depths_of_matches(
            lenses, T_rcam_lcam(head, joints, cameras=state.cameras), left, right
        ),
    )


def _turned_rad(key: Keyframe, seen: FrameEstimate) -> float:
    return float(np.abs(seen.head.kinematics.factors * (seen.readings - key.readings)).max())
