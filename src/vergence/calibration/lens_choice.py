"""Which lens model each camera gets: as stated, or selected by how well it fits and predicts views.

The Bayesian information criterion decides between the fits of all candidates. Errors that corners
share favour more coefficients; so a usual model gives way to a simpler one that predicts held-out
views as well. A rational lens contains nearly all others: it has to predict such views better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.intrinsics import held_out_squares, lenses_of_the_paper
from vergence.calibration.lenses import (
    FREE_COEFFICIENTS,
    ROUGH,
    LensFit,
    LensModel,
    fit_model,
    pinhole_start,
)
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.vision.board_pose import determines_pose, seen_corners

LensOption = LensModel | Literal["auto"]
"""What may be stated of a camera; auto: selected by `best_lens`."""
CANDIDATES: tuple[LensModel, ...] = (
    "none",
    "radial-tangential",
    "radial-tangential-k3",
    "fisheye",
    "rational",
)
"""The simplest first: between models that predict alike, the earlier one is taken."""
CHOICE_VIEWS = 10
"""Fewest views of a camera for a choice; with fewer the paper's model is taken."""
MOST_VIEWS = 60
"""More views, spread over the recording, would not change the choice, and take time."""
FISHEYE_MARGIN = 10.0
"""Least advantage of a fisheye in the criterion: very strong evidence (Kass and Raftery). It does
not contain the usual models, is seldom the true one, and fits mild lenses nearly as well."""
RATIONAL_ERROR = 0.995
"""Held-out error of a rational lens, relative to that of the model that would be taken else, up to
which it is taken. Of 1044 simulated cameras with other lenses - bent boards, errors that an image
shares and outliers among them - three were then given a rational one, all of bent boards; of 192
with rational lenses, such boards among them, 35 were."""
LEAST_ERROR_PX = 1e-3
"""Error of a coordinate below which a fit counts as no better: no corner is known as well."""


@dataclass(frozen=True)
class LensChoice:
    """The lens model of a camera, and how well the candidates predicted held-out images."""

    model: LensModel
    held_out_px: Mapping[LensModel, float] = field(default_factory=dict)
    """By candidate: root mean square of one coordinate of a corner in a view that the fit had not
    seen [px]; empty where the model was stated, or there were too few views for a choice."""

    @property
    def runner_up(self) -> LensModel | None:
        """The best of the candidates that were not taken; None: there was no choice."""
        others: dict[LensModel, float] = {
            name: px for name, px in self.held_out_px.items() if name != self.model
        }
        return min(others, key=lambda name: others[name]) if others else None


def choose_lenses(
    observations: Observations,
    lens: LensOption | Mapping[str, LensOption] = "auto",
    *,
    of_the_paper: bool = False,
) -> dict[str, LensChoice]:
    """Choose the lens model of every camera by views in which the eyes stood still.

    The lens is stated for all cameras, or by camera (those left out: "auto"); "auto" becomes the
    best one, or that of the paper; known lenses keep theirs. VergenceError for an unknown model or
    camera.
    """
    names = list(observations.corners)
    stated: dict[str, LensOption] = dict.fromkeys(names, lens if isinstance(lens, str) else "auto")
    if not isinstance(lens, str):
        unknown = sorted(set(lens) - set(names))
        if unknown:
            raise VergenceError(
                f"A lens is stated for {unknown[0]!r}; the cameras are {', '.join(names)}."
            )
        stated.update(lens)
    wrong = [each for each in stated.values() if each != "auto" and each not in FREE_COEFFICIENTS]
    if wrong:
        raise VergenceError(
            f"There is no lens model {wrong[0]!r}; there are auto, {', '.join(FREE_COEFFICIENTS)}."
        )
    for name, (camera, _) in observations.known_lenses.items():
        k3 = camera.model == "radial-tangential" and camera.distortion[-1] != 0
        stated[name] = "radial-tangential-k3" if k3 else camera.model
    usual, points = lenses_of_the_paper(observations), corner_points(observations.board)
    choices: dict[str, LensChoice] = {}
    for name, model in stated.items():
        if model != "auto":
            choices[name] = LensChoice(model)
        elif of_the_paper:
            choices[name] = LensChoice(usual[name])
        else:
            corners, size = observations.corners[name], observations.sizes[name]
            choices[name] = best_lens(corners, points, size=size, otherwise=usual[name])
    return choices


def best_lens(
    corners: Array, points: Array, *, size: tuple[int, int], otherwise: LensModel
) -> LensChoice:
    """Choose the lens model of a camera by criterion and held-out views of a board.

    The result is `otherwise` if the views are too few, or no model fits them.
    """
    usable = np.flatnonzero(determines_pose(points, seen_corners(corners)))
    if len(usable) > MOST_VIEWS:
        usable = usable[np.arange(MOST_VIEWS) * len(usable) // MOST_VIEWS]
    if len(usable) < CHOICE_VIEWS:
        return LensChoice(otherwise)
    corners = corners[usable]
    fits = _fits(corners, points, size)
    squares: dict[LensModel, Array] = {model: held_out_squares(fit) for model, fit in fits.items()}
    squares = {model: each for model, each in squares.items() if np.isfinite(each).all()}
    count = 2 * int(np.count_nonzero(seen_corners(corners)))
    held_out: dict[LensModel, float] = {
        model: float(np.sqrt(each.sum() / count)) for model, each in squares.items()
    }
    criterion: dict[LensModel, float] = {
        model: _criterion(model, fits[model], count) for model in squares if model != "rational"
    }
    if not criterion:
        return LensChoice(otherwise)
    chosen: LensModel = _choice(criterion, held_out)
    error: dict[LensModel, float] = {
        model: float(np.hypot(px, LEAST_ERROR_PX)) for model, px in held_out.items()
    }
    if error.get("rational", np.inf) < RATIONAL_ERROR * error[chosen]:
        chosen = "rational"
    return LensChoice(chosen, held_out)


def _choice(criterion: Mapping[LensModel, float], held_out: Mapping[LensModel, float]) -> LensModel:
    """Choose among models with a criterion, the simplest first."""
    models = list(criterion)
    best = min(models, key=lambda model: criterion[model])
    enough = criterion[best] + (FISHEYE_MARGIN if best == "fisheye" else 0.0)
    number = next(k for k, model in enumerate(models) if criterion[model] <= enough)
    if models[number] == "fisheye":  # which contains none of the usual models
        return "fisheye"
    return min(models[: number + 1], key=lambda model: held_out[model])


def _criterion(model: LensModel, fit: LensFit, count: int) -> float:
    """Compute the Bayesian information criterion of a fit to `count` coordinates of corners.

    Terms that all models have in common are left out: the noise level and the boards' poses.
    """
    mean_square = fit.sum_squares / count + LEAST_ERROR_PX**2
    return float(count * np.log(mean_square) + FREE_COEFFICIENTS[model] * np.log(count))


def _fits(corners: Array, points: Array, size: tuple[int, int]) -> dict[LensModel, LensFit]:
    """Fit the candidates that these views allow; each starts from one before."""
    fits: dict[LensModel, LensFit] = {}
    pinhole = pinhole_start(corners, points, size)
    start = pinhole
    for model in CANDIDATES:
        if pinhole is None and model not in ("fisheye", "rational"):
            continue
        try:
            fits[model] = fit_model(model, start, corners, points, size, tolerance=ROUGH)
        except (cv2.error, ValueError, np.linalg.LinAlgError):
            continue
        if model in ("radial-tangential", "fisheye"):
            start = fits[model].camera, fits[model].T_cam_target
    return {model: fit for model, fit in fits.items() if _determined(model, fit)}


def _determined(model: LensModel, fit: LensFit) -> bool:
    """Check whether there are more corners than unknowns, and a lens that a camera can have."""
    unknowns = 4 + FREE_COEFFICIENTS[model] + 6 * len(fit.T_cam_target)
    return bool(np.count_nonzero(fit.errors) > unknowns and np.isfinite(fit.errors).all())
