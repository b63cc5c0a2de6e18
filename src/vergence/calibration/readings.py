"""What joints read, or measured poses of the eyes: with noise, backlash, play and a time offset."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vergence.arrays import Array
from vergence.calibration.backlash import BLOCK
from vergence.calibration.observations import Observations, PoseObservations
from vergence.calibration.postures import Index, Postures
from vergence.data import timing
from vergence.data.timing import Stencil, Timing
from vergence.estimation.residual import UNIT, Levels, Posterior, Residual, Rows
from vergence.estimation.variables import Variables
from vergence.geometry.kinematics import Kinematics
from vergence.geometry.se3 import boxplus

PLAY = "play"
"""Begin of the noise levels of what two joints of one reading differ by."""
SMOOTH = "smooth rotations", "smooth translations"
"""Noise levels [rad], [m] of errors of eye poses that neighbouring postures share."""
LEAST_SEEN = 0.5
"""Share of the rows of a motion in which an eye must see the board, among its neighbours in time,
so that these determine the trajectory. An assumption: 2 and 5 of 30 rows are too few."""
UNKNOWN = 2.5
"""Noise of a reading whose last motion is not known, in widths of the backlash: five times what it
errs by, so that it counts for little."""
LEAST_PLAY_RAD = 3.5e-4
"""Turn of a joint from which the images show its sense [rad]: a wide camera's fifty corners of 0.1
px, five times their noise."""
SLOW_RAD_S = 0.1
"""Rate of a joint below which its motor may be crossing the play [rad/s]: a twentieth to a tenth of
the peak in usual recordings."""
TRUSTED_READINGS = 2.0
"""Noise of readings, as a multiple of how well one image determines the joints, up to which the
readings give the eyes' trajectory in time. At it they hold the latent angles to a fifth, and
offsets of 0.1 s still settle."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Readings(Residual):
    """Readings of the joints, or measured poses of the eyes, in moments before the images'.

    The latent unknowns are of the image's moment, which is the head's time offset later. Between
    the two the eyes move along polynomials in time. The reading differs by half of the backlash, to
    the side of the last motion.
    """

    postures: Postures
    kinds: tuple[str, ...]
    """(n,) their noise levels."""
    around: Stencil | None = None
    """The neighbours of each posture in time; None: the eyes stood still."""
    read_motion: Array | None = None
    """(B, n, TRAJECTORY_DEGREE) of the motion by all readings; None: the eyes stood still."""
    seldom_seen: Any = False
    """(B,) of bool: where the board is seen in too few rows to determine the motion."""
    coefficients: Array | None = None
    """(B, n, TRAJECTORY_DEGREE) of the motion in time, None: at rest."""
    trusted: frozenset[str] = frozenset()
    """Levels of readings that determine the motion better than the images do."""
    smooth: Array | None = None
    """(B, n, F) errors that postures share, by their coefficients; None: all are independent."""
    run: Any = 0
    """(B,) number of the motion, of one eye where a posture is of one; 0: at rest."""
    time_s: Any = 0.0
    """(B,) when the readings were taken."""
    least_play: Any = 0.0
    """(n,) turn from which the images show its sense."""
    slow: Any = 0.0
    """(n,) rate below which an eye may stand still within the play [1/s]."""
    unknown: bool = False
    """Whether these are the readings whose last motion is not known, where backlash exceeds their
    noise, instead of the others. They count for little: after a small turn back the sign goes with
    the angle, as a gain does. Without them eyes might turn together with boards that only these
    views show."""
    seen: Any = True
    """(B, n) of bool: which count here."""
    std: Any = np.inf
    """(n,) noise by the last estimate [rad]."""
    noise_scale: Any = 1.0
    """(B, n) [rad] of unknown ones, whose level is one."""
    element: Index = field(init=False)

    def __post_init__(self) -> None:
        shape = self.postures.reading.shape
        vars(self).update(element=np.arange(shape[0]), seen=np.broadcast_to(self.seen, shape))

    @property
    def level(self) -> Any:
        """Return the noise level of each reading (n,)."""
        return UNIT if self.unknown else self.kinds

    def error(self, x: Variables) -> Array:
        """Compute noise-free readings minus readings (B, n), without errors that are shared."""
        postures = self.postures
        at_reading = x.latent.value.copy()
        if self.coefficients is not None:
            at_reading += timing.change(self.coefficients, -x["head"].time_offset_s)
        if postures.T_base_eye_read is None:
            at_reading += x[BLOCK][postures.joint] * postures.motion / 2
        off = at_reading @ postures.tied.T - postures.reading
        off = off if self.smooth is None else off - self.smooth @ x["pose_errors"]
        return np.where(self.seen, off, 0.0)

    def rows(self, x: Variables) -> Rows:
        postures = self.postures
        by_latent = np.tile(postures.tied, (len(postures.reading), 1, 1))
        columns = np.tile(x.columns("head")[-1:], (len(by_latent), 1))
        shared = -(self.rate(x) @ postures.tied.T)[..., None]
        if self.smooth is not None:
            shared = np.concatenate([shared, -self.smooth], axis=2)
            own = np.tile(x.columns("pose_errors"), (len(by_latent), 1))
            columns = np.concatenate([columns, own], axis=1)
        elif postures.T_base_eye_read is None:
            by_backlash = by_latent * postures.motion[:, None] / 2
            shared = np.concatenate([shared, by_backlash], axis=2)
            columns = np.concatenate([columns, x.columns(BLOCK)[postures.joint]], axis=1)
        return Rows(shared, columns, by_latent)

    def rate(self, x: Variables) -> Array:
        """Compute the rates (B, n) of the joints when they were read [1/s]."""
        if self.coefficients is None:
            return np.zeros_like(self.postures.reading)
        return timing.rate(self.coefficients, -x["head"].time_offset_s)

    def follow(self, x: Variables) -> Readings:
        """Fit the trajectory to the latent unknowns, or take it from the readings.

        The latent unknowns include the images: readings, whose noise makes the eyes look faster,
        would make the time offset smaller than it is. Where the readings are the better ones, or
        the board is seen in few rows, the trajectory is theirs.
        """
        if self.around is None or self.read_motion is None:
            return self
        if self.postures.T_base_eye_read is None:
            latent = timing.coefficients(self.around, x.latent.value)
        else:
            poses = boxplus(self.postures.T_base_eye_read, x.latent.value)
            latent = timing.pose_coefficients(self.around, poses)
        # Seen from the reading's moment time runs the other way: odd powers keep their sign.
        reading = self.read_motion * -((-1.0) ** np.arange(1, timing.TRAJECTORY_DEGREE + 1))
        # Of two unknowns with one reading both go by the noise of the reading.
        trusted = np.array([name in self.trusted for name in self.kinds])
        trusted[self.postures.own == 1] = trusted[self.postures.own == 0]
        chosen = np.where(trusted[:, None] | self.seldom_seen[:, None, None], reading, latent)
        return replace(self, coefficients=chosen)

    def trust(self, levels: Levels, determined: Levels) -> Readings:
        """Take the trajectory from readings that are known well."""
        well = {k for k in set(self.kinds) if levels[k] < TRUSTED_READINGS * determined[k]}
        std = np.array([levels[name] for name in self.kinds])
        return replace(self, trusted=self.trusted | well, std=std)

    def judge(self, x: Variables, posterior: Posterior) -> Readings:
        """Follow the last motions."""
        if self.postures.T_base_eye_read is not None:
            return self
        postures = replace(self.postures, motion=self._motion(x))
        width, turned = np.abs(x[BLOCK][postures.joint]), np.abs(postures.tied.T)
        known = ((postures.motion == 0) * width) @ turned < self.std
        if not self.unknown:
            return replace(self, postures=postures, seen=known)
        scale = np.hypot(self.std, UNKNOWN * (width @ turned))
        return replace(self, postures=postures, seen=~known, noise_scale=scale)

    def _motion(self, x: Variables) -> Array:
        """Find to which side, and how far, the backlash is taken up (B, n).

        Of moving eyes the images show it: by noisy readings it would go with their noise. Where the
        sensor lags behind the eye, it does so only after the width.
        """
        motion = self.postures.motion
        if self.around is None or self.coefficients is None:
            return motion
        angles = x.latent.value + timing.change(self.coefficients, -x["head"].time_offset_s)
        motion, lag = motion.copy(), np.maximum(-x[BLOCK][self.postures.joint], self.least_play)
        for number in np.unique(self.run[self.run != 0]):
            rows = np.flatnonzero(self.run == number)
            rows = rows[np.argsort(self.time_s[rows], kind="stable")]
            motion[rows] = timing.taken_up(angles[rows], lag[rows[0]])
        slow = (self.run != 0)[:, None] & (np.abs(self.rate(x)) < self.slow)
        return np.where(slow, 0.0, motion)


def readings_of(
    observations: Observations | PoseObservations,
    kinematics: Kinematics,
    postures: Postures,
    kinds: tuple[str, ...],
) -> Readings:
    """Collect the readings of the postures, with their motion where the eyes moved."""
    when, poses = observations.timing, observations.T_base_eye
    if when is None:
        return Readings(postures=postures, kinds=kinds)
    run, time_s = when.run[postures.view], when.time_s[postures.view]
    run = np.where(run > 0, 2 * run - postures.eye, 0)  # a motion of one eye, not of both
    around = timing.stencil(time_s, run)
    read = observations.eye_angles if poses is None else poses
    motion, seldom = _read_motion(when, read, postures, around)
    return Readings(
        postures=postures,
        kinds=kinds,
        around=around,
        read_motion=motion,
        seldom_seen=seldom,
        run=run,
        time_s=time_s,
        least_play=LEAST_PLAY_RAD / kinematics.gear_ratios[postures.columns[0]],
        slow=SLOW_RAD_S / kinematics.gear_ratios[postures.columns[0]],
    )


def _read_motion(
    when: Timing, read: Array, postures: Postures, around: Stencil
) -> tuple[Array, np.ndarray]:
    """Fit polynomials in time to what was read around B postures, from the reading's moment on.

    Also returns (B,) of bool: where the board is seen in too few rows to determine the trajectory.
    A polynomial through these would bridge motions that only the readings show. Those of a stream
    at its own rate show more than the rows, unless these have a polynomial of full degree.
    """
    view = postures.view
    if when.stream is not None:
        motion = timing.course(when, read)[view[:, None], postures.columns]
        resolved = (around.weights[..., -1] != 0).any(axis=1)
        return motion, (when.run[view] > 0) & ~resolved
    motion = np.zeros((*postures.reading.shape, timing.TRAJECTORY_DEGREE))
    seldom = np.zeros(len(view), bool)
    nearby_s = when.time_s[view][around.neighbours]
    for e in np.unique(postures.eye):
        mine = np.flatnonzero(postures.eye == e)
        wanted = np.isin(np.arange(len(read)), view[mine])
        poses = read.ndim > 2
        own = read[:, e] if poses else read[:, postures.columns[mine[0]]]
        known = np.asarray(np.isfinite(own).reshape(len(own), -1).all(axis=1))
        run = np.where(known, when.run, 0)  # unknown rows are no neighbours of known ones
        every = timing.stencil(when.time_s, run, wanted)
        if poses:
            own = np.where(known[:, None, None], own, np.eye(4))
            motion[mine] = timing.pose_coefficients(every, own)[view[mine]]
        else:
            motion[mine] = timing.coefficients(every, np.nan_to_num(own))[view[mine]]
        for b in mine[run[view[mine]] > 0]:
            near = (when.time_s >= nearby_s[b].min()) & (when.time_s <= nearby_s[b].max())
            near &= run == run[view[b]]
            seen = np.isin(np.flatnonzero(near), view[mine]).sum()
            seldom[b] = seen < LEAST_SEEN * near.sum()
    return motion, seldom
