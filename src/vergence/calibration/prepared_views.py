"""Prepare views for a calibration: lenses, poses of the board, and all checks that precede it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.calibration import board_numbering, excitation, plausibility
from vergence.calibration.intrinsics import Intrinsics, calibrate_intrinsics
from vergence.calibration.lens_choice import (
    LensChoice,
    LensOption,
    choose_lenses,
)
from vergence.calibration.lenses import LensModel
from vergence.calibration.observations import Observations, camera_eyes
from vergence.calibration.outliers import without_strays
from vergence.geometry.board import corner_points
from vergence.vision.board_pose import board_poses

Method = Literal["bundle", "paper"]


@dataclass(frozen=True, eq=False)
class PreparedViews:
    """Observations that no check has refused, with the lenses and the poses of the board."""

    observations: Observations
    """All boards of a placement are numbered from the same end. With the findings on the way."""
    T_cam_target: Mapping[str, Array]
    """By camera: (V, 4, 4) poses of the board, NaN where not known."""
    lenses: Mapping[str, LensChoice]
    """By camera."""
    intrinsics: Mapping[str, Intrinsics]
    """By camera, from the views at rest."""

    @property
    def models(self) -> dict[str, LensModel]:
        """By camera its lens model."""
        return {name: choice.model for name, choice in self.lenses.items()}

    @property
    def at_rest(self) -> tuple[Observations, dict[str, Array]]:
        """The views in which the eyes stand still, and the board's poses in them."""
        return self.take(self.observations.at_rest)

    def take(self, rows: np.ndarray) -> tuple[Observations, dict[str, Array]]:
        """Select views by a mask (V,), and the board's poses in them."""
        poses = {name: T[rows] for name, T in self.T_cam_target.items()}
        return self.observations.take(rows), poses

    def without(self, corners: Mapping[str, np.ndarray]) -> PreparedViews:
        """Leave out corners, by camera (V, K) of bool."""
        seen = self.observations.corners
        kept = {name: np.where(corners[name][..., None], np.nan, seen[name]) for name in seen}
        T = {
            name: np.where(np.all(corners[name], axis=1, keepdims=True)[..., None], np.nan, each)
            for name, each in self.T_cam_target.items()
        }
        observations = replace(self.observations, corners=kept)
        return replace(self, observations=observations, T_cam_target=T)


def prepare(
    data: Observations, method: Method, lens: LensOption | Mapping[str, LensOption]
) -> PreparedViews:
    """Choose lenses, solve for the boards' poses, and check that readings and images agree.

    VergenceError if the views are too few or too much alike, or if a check refuses them.
    """
    data = without_strays(data)
    seen = data.take(data.at_rest)
    camera_eyes(seen)  # VergenceError for a camera of no known eye
    lenses = choose_lenses(seen, lens, of_the_paper=method == "paper")
    models: dict[str, LensModel] = {name: choice.model for name, choice in lenses.items()}
    intrinsics = calibrate_intrinsics(seen, lenses=models)
    points = corner_points(data.board)
    T_cam_target = {
        name: board_poses(each.camera, data.corners[name], points)
        for name, each in intrinsics.items()
    }
    numbered = board_numbering.number_alike(data, T_cam_target)
    observations, T_cam_target = numbered.observations, numbered.T_cam_target
    plausibility.check_readings_and_images(observations, T_cam_target)
    views = PreparedViews(observations, T_cam_target, lenses, intrinsics)
    excitation.check_excitation(*views.at_rest)
    observations, unsettled = board_numbering.without_unclear(observations, numbered)
    findings = (*observations.findings, *unsettled)
    return replace(views, observations=replace(observations, findings=findings))
