"""Inject errors into a finished calibration, to study their effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.geometry.head import WIDE, HeadCalibration, MountedCamera
from vergence.geometry.kinematics import straight_gaze
from vergence.geometry.se3 import pose, rotation
from vergence.stereo.extrinsics import T_rcam_lcam, rebase
from vergence.twin.profile import ByHand, Lens


def inject_calibration_error(
    calibration: HeadCalibration, by_hand: ByHand, lens: Lens
) -> HeadCalibration:
    """Add errors to the wide cameras of a calibration; straight gaze stays exact (Eq. 10).

    T_rbase_lbase is recomputed by Eq. 10, so that T_rcam_lcam at zero joint angles stays the same.
    The lens selects the error of the focal length.
    """
    if by_hand == ByHand():
        return calibration
    focal = by_hand.focal_percent_28 if lens == "2.8mm" else by_hand.focal_percent_40
    cameras = dict(calibration.cameras)
    for name, sign in zip(WIDE, (1, -1), strict=True):
        mounted = calibration.camera(name)
        matrix = mounted.intrinsics.matrix.copy()
        matrix[[0, 1], [0, 1]] *= 1 + focal / 100
        roll = rotation([0, 0, sign * np.radians(by_hand.roll_deg)])
        cameras[name] = MountedCamera(
            eye=mounted.eye,
            intrinsics=replace(mounted.intrinsics, matrix=matrix),
            T_eye_cam=mounted.T_eye_cam @ pose(roll, [0, 0, by_hand.axial_mm * 1e-3]),
        )
    straight = straight_gaze(calibration.kinematics)
    T = T_rcam_lcam(calibration, straight, cameras=WIDE)
    return rebase(replace(calibration, cameras=cameras), T, joints=straight, cameras=WIDE)
