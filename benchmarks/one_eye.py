"""The mounting alone of one camera of known lens in an eye whose joints are as designed."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, NoiseModel, bundle_adjust
from vergence.calibration.hand_eye import robust_park_martin
from vergence.calibration.observations import Observations
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera, parameter_names
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics, pan_tilt
from vergence.geometry.se3 import known_poses
from vergence.vision.board_pose import board_poses

CAMERA = "left_cam"
PAN_TILT = pan_tilt("left")


def mount_camera(
    read: Array,
    pixels: Array,
    board: Chessboard,
    lens: Camera,
    *,
    joints: tuple[Joint, ...] = PAN_TILT,
    noise: NoiseModel | None = None,
    start: Array | None = None,
) -> BundleEstimate:
    """Find T_eye_cam from N views of a board at rest; it starts from Park and Martin's.

    Read are angles (N, r) [rad] of the joints, or poses (N, 4, 4) of the eye; corners are pixels
    (N, K, 2).
    """
    names = tuple(dict.fromkeys(name for joint in joints for name in joint.readings))
    poses = read.ndim == 3
    seen = Observations(
        board=board,
        placement=np.zeros(len(read), int),
        eye_angles=np.full((len(read), len(names)), np.nan) if poses else read,
        corners={CAMERA: pixels},
        sizes={CAMERA: lens.size},
        kinematics=Kinematics({"left": joints, "right": ()}, names),
        T_base_eye=np.stack([read, read], axis=1) if poses else None,
    )
    T_cam_target = board_poses(lens, pixels, corner_points(board))
    if start is None:
        known = known_poses(T_cam_target)
        start = robust_park_martin(seen.eye_poses()[known, 0], T_cam_target[known])
    mounted = MountedCamera(eye="left", intrinsics=lens, T_eye_cam=start)
    head = HeadCalibration({CAMERA: mounted}, np.eye(4), seen.kinematics)
    return bundle_adjust(
        head,
        seen,
        T_cam_target={CAMERA: T_cam_target},
        fixed=[name for name in parameter_names(head) if ".T_eye_cam." not in name],
        noise=NoiseModel() if noise is None else noise,
    )
