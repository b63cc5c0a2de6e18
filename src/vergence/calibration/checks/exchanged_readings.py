"""Whether the readings of left and right are exchanged, of eyes that move nearly alike.

Before the calibration the images show it where each eye moves by itself (`encoders`). Afterwards
they show the true turns of both eyes so exactly that even a small difference between them will do:
is the error of an eye's readings the difference to the other's?
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.findings import Finding, note, void
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import boxminus

SURE = 4.0
"""Standard deviations from which the one or the other is beyond doubt."""


def exchanged_readings(
    observations: Observations, head: HeadCalibration, T_base_eye: Array
) -> list[Finding]:
    """Return a finding if left and right are exchanged, or if that cannot be told.

    None for heads with readings that move both eyes, and where poses are measured.

    Args:
        observations: with V views.
        head: as it came out of them.
        T_base_eye: (V, 2, 4, 4) true poses of the eyes, as they came out; NaN: not seen.
    """
    used = [head.kinematics.used(eye) for eye in EYES]
    if observations.T_base_eye is not None or set(used[0]) & set(used[1]):
        return []
    if len(used[0]) != len(used[1]) or not np.isfinite(T_base_eye).all((2, 3)).any(0).all():
        return []
    readings = observations.at_image_times(head).eye_angles
    swapped = readings.copy()
    complete = np.isfinite(readings[:, [*used[0], *used[1]]]).all(axis=1)
    swapped[:, [*used[0], *used[1]]] = readings[:, [*used[1], *used[0]]]
    errors, differences, unknowns = [], [], 1
    for e, eye in enumerate(EYES):
        rows = np.isfinite(T_base_eye[:, e]).all((1, 2)) & complete
        T_read, _, by_readings = eye_linearised(head.kinematics, eye, readings[rows])
        T_swapped, *_ = eye_linearised(head.kinematics, eye, swapped[rows])
        # What offsets and gains of the joints explain is not looked at.
        own = by_readings[:, :3, used[e]]
        known = np.concatenate([own, own * readings[rows][:, None, used[e]]], axis=2)
        known = known.reshape(-1, known.shape[2])
        turns = np.stack(
            [boxminus(T, T_read)[:, :3].ravel() for T in (T_base_eye[rows, e], T_swapped)]
        )
        left = turns.T - known @ np.linalg.lstsq(known, turns.T, rcond=None)[0]
        errors.append(left[:, 0])
        differences.append(left[:, 1])
        unknowns += known.shape[1]
    error, difference = np.concatenate(errors), np.concatenate(differences)
    # Noise of the readings is in both: it makes of the slopes 0 (right) and 1 (exchanged) any
    # below and above 1/2.
    square = difference @ difference
    slope = error @ difference / max(square, 1e-30)
    squares = ((error - slope * difference) ** 2).sum()
    std = np.sqrt(squares / max(len(error) - unknowns, 1) / max(square, 1e-30))
    if slope - 0.5 > SURE * std:
        sentence = (
            "The images of each eye follow the joint readings of the other: left and right are "
            "exchanged in the columns of the joint readings."
        )
        return [void("eyes-exchanged", sentence)]
    if slope - 0.5 > -SURE * std:
        sentence = (
            "Both eyes moved so much alike that joint readings of left and right, if they were "
            "exchanged, would not show; let the eyes verge in some of the views."
        )
        return [note("eyes-alike", sentence)]
    return []
