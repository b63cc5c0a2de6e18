"""Views of a board after all checks that precede a calibration, and what these found on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.calibration.checks import board_flips, encoders, excitation
from vergence.calibration.checks.pose_readings import check_axis_order, check_pose_readings
from vergence.calibration.intrinsics import (
    LEAST_VIEWS,
    Intrinsics,
    calibrate_intrinsics,
    lenses_of_the_paper,
)
from vergence.calibration.lens_choice import (
    LensChoice,
    LensOption,
    by_camera,
    choose_lenses,
)
from vergence.calibration.lenses import LensModel
from vergence.calibration.observations import Observations, camera_eyes, check_readings
from vergence.errors import VergenceError
from vergence.findings import Finding
from vergence.geometry.board import corner_points
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, seen_corners

Method = Literal["bundle", "paper"]


@dataclass(frozen=True, eq=False)
class CheckedViews:
    """Observations that no check has refused, and what the checks found on the way."""

    renumbered: board_flips.Renumbered
    """The observations, in which each placement's boards are numbered from the same end."""
    lenses: dict[str, LensChoice]
    """By camera."""
    intrinsics: Mapping[str, Intrinsics]
    """By camera, from the views at rest."""
    pose_findings: tuple[Finding, ...]
    """On measured eye poses that were left out."""

    @property
    def observations(self) -> Observations:
        return self.renumbered.observations

    @property
    def T_cam_target(self) -> Mapping[str, Array]:
        """By camera: (V, 4, 4) poses of the board, NaN where not known."""
        return self.renumbered.T_cam_target

    @property
    def models(self) -> dict[str, LensModel]:
        """By camera its lens model."""
        return _models(self.lenses)

    @property
    def at_rest(self) -> tuple[Observations, dict[str, Array]]:
        """The views in which the eyes stand still, and the board's poses in them."""
        return self.take(self.observations.at_rest)

    def take(self, rows: np.ndarray) -> tuple[Observations, dict[str, Array]]:
        """Return some of the views, and the board's poses in them."""
        poses = {name: T[rows] for name, T in self.T_cam_target.items()}
        return self.observations.take(rows), poses


def checked_views(
    data: Observations, method: Method, lens: LensOption | Mapping[str, LensOption]
) -> CheckedViews:
    """Return the views after all checks that precede a calibration: VergenceError if one fails."""
    seen = data.take(data.at_rest)
    _check_views(seen)
    if method == "bundle":  # the paper's steps need the readings of some views only
        check_readings(data)
    lenses = _lenses(seen, method, lens)
    intrinsics = calibrate_intrinsics(seen, lenses=_models(lenses))
    points = corner_points(data.board)
    # Once for each image: all that follows asks for these.
    T_cam_target = {
        name: board_poses(each.camera, data.corners[name], points)
        for name, each in intrinsics.items()
    }
    posed = check_pose_readings(data, T_cam_target)
    renumbered = board_flips.number_alike(posed.observations, T_cam_target)
    views = CheckedViews(renumbered, lenses, intrinsics, posed.findings)
    # Of boards that one eye numbers from the other end the cameras seem to stand elsewhere.
    encoders.check_encoders(*views.at_rest)
    check_axis_order(*views.at_rest)
    excitation.check_excitation(*views.at_rest)
    return views


def _check_views(seen: Observations) -> None:
    """Raise a VergenceError for a camera of no known eye, or that shows the board too seldom."""
    camera_eyes(seen)
    for name, corners in seen.corners.items():
        enough = int((seen_corners(corners).sum(axis=1) >= LEAST_CORNERS).sum())
        if enough < LEAST_VIEWS:
            raise VergenceError(
                f"{name} shows the board in {enough} images at rest: fx, fy and T_eye_cam "
                f"are not observable; record at least {LEAST_VIEWS}, better 10, at different "
                "distances and slants."
            )


def _lenses(
    seen: Observations,
    method: Method,
    lens: LensOption | Mapping[str, LensOption],
) -> dict[str, LensChoice]:
    """Return the lens model of every camera."""
    if method == "paper":
        stated: dict[str, LensOption] = {**lenses_of_the_paper(seen)}
        for name, each in by_camera(seen, lens).items():
            stated[name] = stated.get(name, each) if each == "auto" else each
        return choose_lenses(seen, stated)
    return choose_lenses(seen, lens)


def _models(lenses: Mapping[str, LensChoice]) -> dict[str, LensModel]:
    return {name: choice.model for name, choice in lenses.items()}
