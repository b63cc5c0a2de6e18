"""The outcome of a bundle adjustment, and what in its data contradicts it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vergence.calibration.bundle_start import BundleProblem
from vergence.calibration.observations import Observations, PoseObservations
from vergence.calibration.readings import PLAY, Readings
from vergence.estimation.adjustment import Adjustment
from vergence.estimation.noise import Level

MOST_WRONG = 0.15
"""Largest share of wrong views, or of wrong corners, with which the others are trusted."""


@dataclass(frozen=True, eq=False)
class Outliers:
    """What contradicts an estimate."""

    corners: np.ndarray
    """(M, K) of bool: single corners of detections."""
    images: np.ndarray
    """(C, V) of bool: images with most of their corners."""
    readings: np.ndarray
    """(B, n) of bool: readings of postures."""
    few: bool
    """Whether the views concerned are so few that they leave all later figures."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A bundle adjustment with what went into it and came out."""

    observations: Observations | PoseObservations
    problem: BundleProblem
    found: Adjustment
    levels: Sequence[Level]
    systematic_px: Mapping[str, float]
    scale_std: float
    """Of the size of the board, relative to the stated one."""
    backlash_rad: Mapping[str, tuple[float, float]]
    """See BundleEstimate."""

    def left_out(self) -> dict[str, np.ndarray]:
        """Select by camera the corners (V, K) that must not take part in later figures."""
        outliers, detections = self.outliers, self.problem.measured.detections
        V, K = outliers.images.shape[1], outliers.corners.shape[1]
        masks = {name: np.zeros((V, K), bool) for name in detections.cameras}
        wrong = outliers.images.copy()
        of_reading = np.any(outliers.readings[detections.posture], axis=1)
        wrong[detections.camera[of_reading], detections.views[of_reading]] = True
        for c, mask in enumerate(masks.values()):
            mine = detections.of_camera(c)
            mask[detections.views[mine]] = outliers.corners[mine]
            mask[wrong[c] & outliers.few] = True
        return masks

    @property
    def eyes(self) -> np.ndarray:
        """(M,) the eye of each detection."""
        return self.problem.measured.detections.eyes

    @cached_property
    def outliers(self) -> Outliers:
        """Collect what contradicts the estimate."""
        measured, weights = self.problem.measured, self.found.linear.weights
        detections = measured.detections
        corners = measured.seen & (weights[0] < 1)
        readings = self.readings.seen & (weights[1] < 1)
        images = self.problem.contradicting.copy()
        lost = corners.sum(axis=1) > measured.seen.sum(axis=1) / 2
        images[detections.camera[lost], detections.views[lost]] = True
        of_readings = self.problem.readings.postures.view[readings.any(axis=1)]
        views = np.union1d(np.flatnonzero(images.any(axis=0)), of_readings)
        few = len(views) <= MOST_WRONG * images.shape[1]
        return Outliers(corners & ~lost[:, None], images, readings, few)

    @property
    def readings(self) -> Readings:
        """Return the readings as they follow the estimate."""
        readings = self.found.residuals[1]
        assert isinstance(readings, Readings)
        return readings

    @property
    def reading_levels(self) -> list[Level]:
        """List the noise levels of the readings."""
        return [level for level in self.levels if level.latent and PLAY not in level.name]

    @property
    def poses_read(self) -> bool:
        """Whether poses of the eyes were measured instead of angles."""
        return self.problem.readings.postures.T_base_eye_read is not None
