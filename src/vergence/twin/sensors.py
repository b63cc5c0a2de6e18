"""The joint sensors: readings of true joint angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Kinematics, Side
from vergence.twin.profile import Joints


def play(angles: Array, width: float | Array, start: Array | None = None) -> Array:
    """Simulate backlash: angles (T, J) [rad] on the sensor's side of a mechanical play.

    After a reversal the eye crosses the whole width [rad] before the sensor follows. `start` (J,)
    is the sensor's side before the first angle; None: the middle of the play.
    """
    sensed = np.empty_like(angles)
    last = angles[0] if start is None else start
    for k, angle in enumerate(angles):
        last = np.clip(last, angle - width / 2, angle + width / 2)
        sensed[k] = last
    return sensed


def sensor_columns(kinematics: Kinematics) -> list[int]:
    """Assign one of a profile's four sensors, in the order of EYE_JOINTS, to each reading (r,).

    A reading with another name gets the pan or tilt sensor of the first eye that it moves, by the
    axis of the joint.
    """
    found = []
    for r, name in enumerate(kinematics.readings):
        if name in EYE_JOINTS:
            found.append(EYE_JOINTS.index(name))
            continue
        eye = EYES[0] if r in kinematics.used(EYES[0]) else EYES[1]
        _, y, z = np.abs(kinematics.chains[eye].mixing[:, r] @ kinematics.chains[eye].axes)
        found.append(EYE_JOINTS.index(f"{eye}_{'pan' if z >= y else 'tilt'}"))
    return found


def with_sensor_errors(kinematics: Kinematics, gain: Array, offset: Array) -> Kinematics:
    """Change joints so that they read angles as gain * reading + offset, both (r,)."""
    gains = dict(zip(kinematics.readings, gain.tolist(), strict=True))
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye, joints in kinematics.eyes.items():
        turns = (kinematics.chains[eye].mixing @ offset).tolist()
        eyes[eye] = tuple(
            replace(_scaled(joint, gains), offset_rad=joint.offset_rad + turn)
            for joint, turn in zip(joints, turns, strict=True)
        )
    return replace(kinematics, eyes=eyes)


def _scaled(joint: Joint, gains: Mapping[str, float]) -> Joint:
    if len(joint.readings) == 1:
        return replace(joint, gain=joint.gain * gains[next(iter(joint.readings))])
    return replace(joint, readings={name: f * gains[name] for name, f in joint.readings.items()})


def gains_and_offsets(joints: Joints, kinematics: Kinematics) -> tuple[Array, Array]:
    """Compute gains (r,) and offsets (r,) [rad] of sensors, which read gain * angle + offset.

    The angle is that of the motor; the profile states offsets of the joint behind the gear.
    """
    columns = sensor_columns(kinematics)
    offset = np.radians(joints.offset_deg)[columns] / kinematics.gear_ratios
    return 1 + np.array(joints.gain_percent)[columns] / 100, offset


def read(
    sensed: Array, joints: Joints, rng: np.random.Generator, kinematics: Kinematics | None = None
) -> Array:
    """Simulate readings (N, r) [rad] of angles (N, r) [rad] on the sensors' side."""
    kinematics = kinematics or Kinematics()
    noise = rng.normal(0.0, np.radians(joints.noise_deg), sensed.shape) / kinematics.gear_ratios
    gain, offset = gains_and_offsets(joints, kinematics)
    reading = gain * sensed + offset + noise
    if joints.counts_per_turn:
        step = 2 * np.pi / joints.counts_per_turn / kinematics.gear_ratios
        reading = np.round(reading / step) * step
    return reading


def with_sensors(head: HeadCalibration, joints: Joints) -> HeadCalibration:
    """Give a head the joints that undo the gains and offsets of its sensors.

    A sensor reads gain * angle + offset; a calibration states angle = gain * reading + offset.
    """
    gain, offset = gains_and_offsets(joints, head.kinematics)
    undone = with_sensor_errors(head.kinematics, 1 / gain, -offset / gain)
    return replace(head, kinematics=undone)
