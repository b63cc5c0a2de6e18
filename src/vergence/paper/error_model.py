"""Point model of the paper's experiment: predict the spreads of Figs. 6-11 from error sources.

There are no images and no calibration: the believed head differs from the true one by stated
errors. Errors that follow the motion are computed exactly, white noise by the covariance of the
located points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import Array
from vergence.geometry.camera import pinhole
from vergence.geometry.head import R_EYE_CAM, WIDE, HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import pose, rotation
from vergence.paper.figures import FIGURES, Figure
from vergence.stereo.extrinsics import rebase, relative_camera_pose
from vergence.stereo.triangulation import Status
from vergence.stereo.uncertainty import locate
from vergence.twin.profile import Lens

FOCAL_PX: dict[Lens, float] = {"2.8mm": 280.0, "4.0mm": 400.0}
PIXEL_UM = 10.0
"""Pitch of the pixels [um]: a sensor 6.4 mm wide with 640 columns."""
_UP = np.array([1.0, -1.0, 1.0, -1.0])
"""Signs of the joints: in this study's version of Eqs. 22-23 positive tilt looks up."""


@dataclass(frozen=True)
class Errors:
    """Sources of errors; pairs are for the left and the right eye."""

    baseline_mm: float = 92.0
    """Baseline of the true head, which the paper does not state."""
    joint_noise_deg: float = 0.0
    """White, of each reading."""
    pixel_noise_um: float = 0.0
    """White, of each coordinate on the sensor."""
    delay_ms: float = 0.0
    """Time by which readings are older than images."""
    pan_gain_percent: tuple[float, float] = (0.0, 0.0)
    tilt_gain_percent: tuple[float, float] = (0.0, 0.0)
    roll_deg: tuple[float, float] = (0.0, 0.0)
    """Error of the believed mounting about the optical axis."""
    pitch_deg: tuple[float, float] = (0.0, 0.0)
    axial_mm: tuple[float, float] = (0.0, 0.0)
    """Error of the believed mounting along the optical axis."""
    focal_28_percent: tuple[float, float] = (0.0, 0.0)
    """Error of the believed focal length of the 2.8 mm lenses."""
    focal_40_percent: tuple[float, float] = (0.0, 0.0)


def true_head(
    lens: Lens,
    baseline_mm: float,
    camera_mm: tuple[tuple[float, ...], ...] = ((20.0, 0.0, 0.0),) * 2,
    mounting_deg: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 0.0),) * 2,
) -> HeadCalibration:
    """Build a head of two wide cameras; by default they look ahead, 20 mm before the axes."""
    cameras = {
        f"{eye}_wide": MountedCamera(
            eye=eye,
            intrinsics=pinhole(640, 480, FOCAL_PX[lens]),
            T_eye_cam=pose(
                rotation(np.radians(mounting_deg[k])) @ R_EYE_CAM, 1e-3 * np.array(camera_mm[k])
            ),
        )
        for k, eye in enumerate(EYES)
    }
    return HeadCalibration(cameras=cameras, T_rbase_lbase=pose(t=[0, baseline_mm * 1e-3, 0]))


def believed_head(truth: HeadCalibration, lens: Lens, errors: Errors) -> HeadCalibration:
    """Apply errors to a head, and recompute T_rbase_lbase by Eq. 10.

    Straight gaze stays exact, where the static stereo of a robot is calibrated.
    """
    focal = errors.focal_28_percent if lens == "2.8mm" else errors.focal_40_percent
    cameras = {}
    for k, (name, mounted) in enumerate(truth.cameras.items()):
        turn = rotation(np.radians([errors.pitch_deg[k], 0.0, errors.roll_deg[k]]))
        shift = [0.0, 0.0, 1e-3 * errors.axial_mm[k]]
        matrix = mounted.intrinsics.matrix * [[1 + focal[k] / 100], [1 + focal[k] / 100], [1]]
        matrix[:2, 2] = mounted.intrinsics.matrix[:2, 2]
        cameras[name] = replace(
            mounted,
            intrinsics=replace(mounted.intrinsics, matrix=matrix),
            T_eye_cam=mounted.T_eye_cam @ pose(turn, shift),
        )
    straight = straight_gaze(truth.kinematics)
    return rebase(
        replace(truth, cameras=cameras), relative_camera_pose(truth, straight), joints=straight
    )


def spread_mm(
    figure: Figure, errors: Errors, *, samples: int = 240, truth: HeadCalibration | None = None
) -> Array:
    """Predict the standard deviations (3,) [mm] of a figure's estimates over its combined period.

    NaN if a sample cannot be located. The truth is by default that of `true_head`.
    """
    believed, seen = _measured(figure, errors, samples, truth)
    found = locate(
        believed,
        **seen,
        pixel_std_px=errors.pixel_noise_um / PIXEL_UM,
        reading_std=np.radians(errors.joint_noise_deg),
    )
    if (found.status != Status.OK).any():
        return np.full(3, np.nan)
    noise = np.diagonal(found.covariance, axis1=1, axis2=2).mean(axis=0)
    return 1e3 * np.sqrt(found.xyz.var(axis=0) + noise)


def sampled_mm(figure: Figure, errors: Errors, seed: int, *, samples: int = 6000) -> Array:
    """Simulate what `spread_mm` predicts, with the noise drawn in each sample."""
    rng = np.random.default_rng([seed, figure.number])
    believed, seen = _measured(figure, errors, samples, None)
    for name, std in (
        ("left", errors.pixel_noise_um / PIXEL_UM),
        ("right", errors.pixel_noise_um / PIXEL_UM),
        ("joints", np.radians(errors.joint_noise_deg)),
    ):
        seen[name] = seen[name] + rng.normal(0, std, seen[name].shape)
    return 1e3 * locate(believed, **seen).xyz.std(axis=0)


def _measured(
    figure: Figure, errors: Errors, samples: int, truth: HeadCalibration | None
) -> tuple[HeadCalibration, dict[str, Any]]:
    """Simulate the believed head, and exact pixels and readings as arguments of `locate`."""
    truth = truth or true_head(figure.lens, errors.baseline_mm)
    time_s = np.arange(samples) * PERIOD_S[figure.motion] / samples
    angles = eye_angles(figure.motion, time_s) * _UP
    gains = np.array([errors.pan_gain_percent, errors.tilt_gain_percent]).T.ravel()
    sensed = eye_angles(figure.motion, time_s - 1e-3 * errors.delay_ms) * _UP
    left, right = (project_point(truth, name, angles, np.array(figure.mean_m)) for name in WIDE)
    seen = {"left": left, "right": right, "joints": (1 + gains / 100) * sensed}
    return believed_head(truth, figure.lens, errors), seen


def spreads_mm(errors: Errors) -> Array:
    """Predict the standard deviations (6, 3) [mm] of all figures."""
    return np.array([spread_mm(figure, errors) for figure in FIGURES.values()])


PAPER_MM = 1e3 * np.array([figure.std_m for figure in FIGURES.values()])
"""Standard deviations (6, 3) [mm] of the paper's captions."""
