"""What persists, learned from frame to frame: a recursive estimate with its covariance."""

from __future__ import annotations

from dataclasses import replace

from vergence.geometry.head import Accuracy, HeadCalibration
from vergence.self_calibration.frame import SelfCalibrated, SelfCalibration
from vergence.self_calibration.prior import DRIFT, tolerance_covariance


def learn(state: SelfCalibration, seen: SelfCalibrated, elapsed_s: float) -> SelfCalibration:
    """Return the state after a frame: its joints are marginalised, what persists is kept."""
    P = len(state.names)
    drift = tolerance_covariance(state.head, state.names, DRIFT) * elapsed_s / 60
    if seen.status != "seen":
        return replace(state, covariance=state.covariance + drift)
    C = seen.covariance[:P, :P]
    scale = state.match_scale + 0.1 * (seen.match_scale - state.match_scale)
    return replace(
        state,
        head=seen.head,
        covariance=(C + C.T) / 2 + drift,
        match_scale=scale,
        frames=state.frames + 1,
    )


def learned_head(state: SelfCalibration) -> HeadCalibration:
    """Return the learned head with its accuracy, to be saved and used as any calibration."""
    before = state.head.accuracy
    accuracy = Accuracy(
        method=before.method if before else "bundle",
        parameters=state.names,
        covariance=state.covariance,
        pixel_std_px=before.pixel_std_px if before else None,
        joint_std=(state.joint_std_rad,),
        eye_motion=before.eye_motion if before else "pan-tilt",
    )
    return replace(state.head, accuracy=accuracy)
