"""The unknown postures of the eyes in the views of a calibration, and what was read of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array
from vergence.calibration.observations import Observations, PoseObservations, missing_reading
from vergence.estimation.variables import Variables
from vergence.geometry.kinematics import EYES, Kinematics, Side, eye_pose, reading_kinds
from vergence.geometry.se3 import boxplus, known_poses

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Postures:
    """B postures of eyes with n latent unknowns each.

    A posture is an eye in a view, or both eyes where some reading moves both.
    """

    view: Index
    """(B,)."""
    eye: Index
    """(B,) 0 or 1; 0 where a posture is of both eyes."""
    columns: Index
    """(B, n) which reading of the head each latent unknown is; unused for measured poses."""
    reading: Array
    """(B, n) angles [rad]; zeros for measured eye poses."""
    T_base_eye_read: Array | None
    """(B, 4, 4) measured poses of the eyes; None: angles."""
    own: Index
    """(n,) which eye alone each latent unknown turns, 0 or 1; -1: all eyes of the posture. One
    reading that turns a joint in each eye is two latent unknowns, for the play of its linkage."""
    motion: Array
    """(B, n) sign of the last motion of each reading, see Observations.last_motion."""
    joint: Index
    """(B, n) number of the joint behind each latent unknown, whose backlash is an unknown."""

    @property
    def as_read(self) -> Array:
        """(B, n) the latent unknowns if readings had no errors."""
        return np.asarray(np.linalg.solve(self.tied, self.reading.T).T, dtype=float)

    @property
    def tied(self) -> Array:
        """(n, n): times the latent unknowns it is what is read: the mean of two that share a
        reading, then their difference, which is zero without play."""
        tied = np.eye(len(self.own))
        for k in np.flatnonzero(self.own == 0):
            tied[k : k + 2, k : k + 2] = [[0.5, 0.5], [1.0, -1.0]]
        return tied

    def eye_poses(self, x: Variables) -> Array:
        """Compute T_base_eye (2, B, 4, 4) of the left and the right eye (the paper's T_er)."""
        if self.T_base_eye_read is not None:
            T = boxplus(self.T_base_eye_read, x.latent.value)
            return np.stack([T, T])
        kinematics, readings = x["head"].kinematics, self.head_readings(x)
        return np.stack([
            eye_pose(kinematics, eye, own) for eye, own in zip(EYES, readings, strict=True)
        ])  # fmt: skip

    def head_readings(self, x: Variables) -> Array:
        """Compute the noise-free readings (2, B, r) of the left and the right eye.

        They are 0 for readings that move no eye of a posture.
        """
        full = np.zeros((2, len(self.reading), len(x["head"].kinematics.readings)))
        for e, own in enumerate(full):
            mine = self.own != 1 - e
            np.put_along_axis(own, self.columns[:, mine], x.latent.value[:, mine], axis=1)
        return full


def postures_of(
    kinematics: Kinematics,
    observations: Observations | PoseObservations,
    view: np.ndarray,
    eye: np.ndarray,
) -> tuple[Index, Postures]:
    """Assign a posture to each of M detections, in views (M,) and by eyes (M,), and all of them.

    VergenceError if a reading that is needed is not finite.
    """
    columns, own = _latent_columns(kinematics, sorted(set(eye.tolist())))
    poses = observations.T_base_eye
    alone = poses is not None or len(columns) == len(EYES)
    whose = eye if alone else np.zeros(len(eye), dtype=np.intp)
    pairs, posture = np.unique(np.stack([view, whose], axis=1), axis=0, return_inverse=True)
    view, whose = pairs.T
    if poses is not None:
        read, reading = poses[view, whose], np.zeros((len(view), 6))
        finite = known_poses(read)
        columns_of = reading.astype(np.intp)
        own, joint = np.full(6, -1), columns_of
        motion = np.zeros_like(reading)
    else:
        columns_of, read = np.array(columns, dtype=np.intp)[whose], None
        reading = observations.eye_angles[view[:, None], columns_of]
        finite = np.isfinite(reading).all(axis=1)
        reading[:, own == 1] = 0.0  # two joints of one reading differ by nothing
        motion = observations.last_motions()[view[:, None], columns_of]
        of_joint = np.stack([columns_of, np.broadcast_to(own, columns_of.shape)], axis=-1)
        joint = np.unique(of_joint.reshape(-1, 2), axis=0, return_inverse=True)[1]
        joint = joint.reshape(columns_of.shape)
    if not finite.all():
        v, e = pairs[~finite][0]
        raise missing_reading(EYES[e] if alone else None, observations.name_of_view(v))
    return posture.ravel(), Postures(view, whose, columns_of, reading, read, own, motion, joint)


def readings_of_joints(postures: Postures) -> np.ndarray:
    """Find which reading moves each joint (m,) that may have backlash."""
    if postures.T_base_eye_read is not None:
        return np.zeros(0, dtype=np.intp)
    return postures.columns.ravel()[np.unique(postures.joint, return_index=True)[1]]


def _latent_columns(kinematics: Kinematics, eyes: list[int]) -> tuple[list[list[int]], np.ndarray]:
    """Find which readings are latent in the postures of the left eye and of the right one.

    In the order of their kinds, so that those of the two eyes have noise of the same levels. One
    list, for postures of both eyes, where some reading moves both or their kinds differ. Also
    returns Postures.own (n,): there a reading stands twice that alone moves a joint in each eye.
    """
    kinds = reading_kinds(kinematics)
    by_eye = [sorted(kinematics.used(eye), key=kinds.__getitem__) for eye in EYES]
    alone = np.full(len(by_eye[0]), -1, dtype=np.intp)
    if len(eyes) == 1:
        return [by_eye[eyes[0]]] * 2, np.full(len(by_eye[eyes[0]]), -1, dtype=np.intp)
    left, right = by_eye
    if not set(left) & set(right) and [kinds[k] for k in left] == [kinds[k] for k in right]:
        return by_eye, alone
    columns, own = [], []
    for k in sorted({*left, *right}):
        shared = all(_moves_alone(kinematics, eye, k) for eye in EYES)
        columns += [k, k] if shared else [k]
        own += [0, 1] if shared else [-1]
    return [columns], np.array(own, dtype=np.intp)


def _moves_alone(kinematics: Kinematics, eye: Side, reading: int) -> bool:
    """Check whether a reading moves joints of an eye, each of them without another reading."""
    mixing = kinematics.chains[eye].mixing
    moved = mixing[:, reading] != 0
    return bool(moved.any() and (np.count_nonzero(mixing[moved], axis=1) == 1).all())
