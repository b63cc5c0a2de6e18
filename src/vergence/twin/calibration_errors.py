"""Errors of a finished calibration by a profile: injected, and as sources of an error budget."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vergence.accuracy.budget import TIME_OFFSET, Source
from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, MountedCamera, pair_names
from vergence.geometry.kinematics import straight_gaze
from vergence.geometry.parameters import boxminus, is_gain
from vergence.geometry.se3 import pose, rotation
from vergence.stereo.extrinsics import rebase, relative_camera_pose
from vergence.twin.profile import ByHand, ErrorProfile
from vergence.twin.sensors import with_sensors

BETWEEN_LENSES_PX = 340.0
"""Focal length [px] midway between those of the 2.8 mm and 4.0 mm lenses, 280 and 400 px."""
OBJECT_NOISE_PX = 0.02
"""Noise of the centre of the twin's sphere [px]; rms over Figs. 6-11 with the profile `ideal`."""
BY_HAND = {
    "roll_deg": "roll of the mountings, by hand",
    "axial_mm": "shift of the mountings, by hand",
}


def inject_calibration_error(calibration: HeadCalibration, by_hand: ByHand) -> HeadCalibration:
    """Add errors to the main cameras of a calibration; straight gaze stays exact (Eq. 10).

    T_rbase_lbase is recomputed by Eq. 10, so that T_rcam_lcam at zero joint angles stays the same.
    """
    if by_hand == ByHand():
        return calibration
    focal = getattr(by_hand, _focal_error(calibration))
    cameras, pair = dict(calibration.cameras), pair_names(calibration)
    for name, sign in zip(pair, (1, -1), strict=True):
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
    T = relative_camera_pose(calibration, straight, cameras=pair)
    return rebase(replace(calibration, cameras=cameras), T, joints=straight, cameras=pair)


def _focal_error(head: HeadCalibration) -> str:
    """Select the field of `ByHand` for the focal length of the main cameras."""
    focal_px = head.camera(pair_names(head)[0]).intrinsics.matrix[0, 0]
    return "focal_percent_40" if focal_px > BETWEEN_LENSES_PX else "focal_percent_28"


def profile_sources(
    head: HeadCalibration, profile: ErrorProfile, pixel_std_px: float | Array | None = None
) -> list[Source]:
    """List the noise and errors of a profile that the head's calibration did not estimate.

    Offsets of joints are left out: calibration estimates them as rotations of the mountings.
    """
    pixels = OBJECT_NOISE_PX if pixel_std_px is None else pixel_std_px
    sources = [Source("pixel noise", pixel_std_px=pixels)] if np.any(pixels) else []
    joints = profile.joints
    step_rad = 2 * np.pi / joints.counts_per_turn if joints.counts_per_turn else 0.0
    for name, std_rad in (
        ("joint noise", np.radians(joints.noise_deg)),
        ("steps of the encoders", step_rad / np.sqrt(12)),
        ("backlash", np.radians(joints.backlash_deg) / 2),  # the sensor lags by half of it
    ):
        if std_rad:
            sources.append(Source(name, reading_std=std_rad / head.kinematics.gear_ratios))
    estimated = head.accuracy.parameters if head.accuracy else ()
    larger = 1 / (1 + profile.calibration.square_percent / 100) - 1
    shift = zip("xyz", (larger * head.T_rbase_lbase[:3, 3]).tolist(), strict=True)
    # No method can find the size of the board.
    errors = {"size of the board": {f"T_rbase_lbase.t{axis}": value for axis, value in shift}}
    if not any(map(is_gain, estimated)):
        without_offsets = joints.model_copy(update={"offset_deg": (0.0,) * 4})
        change = boxminus(replace(head, accuracy=None), with_sensors(head, without_offsets))
        errors["gains of the joints"] = {n: e for n, e in change.items() if is_gain(n)}
    if TIME_OFFSET not in estimated:
        errors["delay"] = {TIME_OFFSET: -1e-3 * joints.delay_ms}
    for name, title in {_focal_error(head): "focal lengths, by hand", **BY_HAND}.items():
        if value := getattr(profile.by_hand, name):
            alone = type(profile.by_hand)(**{name: value})
            errors[title] = boxminus(inject_calibration_error(head, alone), head)
    for title, change in errors.items():
        nonzero = {name: error for name, error in change.items() if abs(error) > 1e-15}
        if nonzero:
            sources.append(Source(title, errors=nonzero))
    return sources
