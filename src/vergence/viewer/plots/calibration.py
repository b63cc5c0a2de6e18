"""Plots of a calibration: the views of the board, and the residuals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from vergence.arrays import Array
from vergence.calibration.lens_map import LensMap
from vergence.errors import counted
from vergence.viewer.plots.canvas import BLUE, GREEN, RED, image_frame, label, panels, save
from vergence.viewer.style import MAGNIFICATION


def save_coverage(
    path: Path,
    corners: Mapping[str, Array],
    sizes: Mapping[str, tuple[int, int]],
    eye_angles: Mapping[str, Array],
) -> None:
    """Draw the corners (V, K, 2) [px] that each camera saw, NaN where it did not.

    Sizes are of the cameras' images [px]; angles (V, 2) are pan and tilt of each eye [rad].
    """
    canvas, grid = panels(len(corners) + len(eye_angles), "Where the board was seen")
    for axes, (name, pixels) in zip(grid, corners.items(), strict=False):
        axes.plot(*pixels.reshape(-1, 2).T, ".", markersize=1.5, color=BLUE)
        image_frame(axes, sizes[name])
        seen = int(np.isfinite(pixels[..., 0]).sum(axis=1).astype(bool).sum())
        axes.set_title(f"{name}, {counted(seen, 'view')}", fontsize=11, loc="left")
    for axes, (eye, angles) in zip(grid[len(corners) :], eye_angles.items(), strict=True):
        axes.plot(*np.degrees(angles).T, ".", markersize=5, color=RED)
        label(axes, f"{eye} eye", xlabel="pan [deg]", ylabel="tilt [deg], positive down")
        axes.axis("equal")
    save(canvas, path)


def save_residuals(
    path: Path,
    corners: Mapping[str, Array],
    errors: Mapping[str, Array],
    sizes: Mapping[str, tuple[int, int]],
    eye_angles: Mapping[str, Array],
) -> None:
    """Draw residuals (V, K, 2) [px] of corners (V, K, 2) [px], NaN where not seen, by camera.

    Arrows in the image are magnified; lengths are drawn over pan and tilt (V, 2) [rad] of the eye.
    """
    canvas, grid = panels(3 * len(corners), "Residuals", columns=3)
    for k, (name, pixels) in enumerate(corners.items()):
        over_image, over_pan, over_tilt = grid[3 * k : 3 * k + 3]
        points, arrows = pixels.reshape(-1, 2), errors[name].reshape(-1, 2)
        seen = np.asarray(np.isfinite(points + arrows).all(axis=1))
        size = float(np.sqrt((arrows[seen] ** 2).sum(axis=1).mean())) if seen.any() else 0.0
        enlarged = 0.02 * sizes[name][0] / max(size, 1e-9)
        _arrows(over_image, points[seen], enlarged * arrows[seen], width=0.0015, color=BLUE)
        image_frame(over_image, sizes[name])
        title = f"{name}: rms {size:.3f} px, arrows x {enlarged:.0f}"
        over_image.set_title(title, fontsize=11, loc="left")
        length = np.linalg.norm(errors[name], axis=2)
        for axes, angles, joint in zip(
            (over_pan, over_tilt), eye_angles[name].T, ("pan", "tilt"), strict=True
        ):
            across = np.repeat(np.degrees(angles)[:, None], length.shape[1], axis=1)
            axes.plot(across.ravel(), length.ravel(), ".", markersize=1.5, color=GREEN)
            label(axes, "", xlabel=f"{joint} [deg]", ylabel="residual [px]")
    save(canvas, path)


def save_views(path: Path, shown: Mapping[str, tuple[np.ndarray, Array, Array]]) -> None:
    """Draw images with corners (K, 2), and residuals (K, 2) [px] as magnified arrows."""
    title = f"The worst views; arrows: residuals x {MAGNIFICATION}"
    canvas, grid = panels(len(shown), title)
    for axes, (title, (image, corners, errors)) in zip(grid, shown.items(), strict=True):
        axes.imshow(image)
        axes.plot(*corners.T, "+", markersize=4, color=GREEN)
        seen = np.asarray(np.isfinite(errors).all(axis=1))
        _arrows(axes, corners[seen], MAGNIFICATION * errors[seen], width=0.003, color=RED)
        axes.set_axis_off()
        axes.set_title(title, fontsize=10, loc="left")
    save(canvas, path)


def _arrows(axes: Axes, points: Array, arrows: Array, *, width: float, color: str) -> None:
    """Draw arrows (N, 2) [px] that begin at points (N, 2) [px]."""
    to_scale = {"angles": "xy", "scale_units": "xy", "scale": 1}
    axes.quiver(*points.T, *arrows.T, width=width, color=color, **to_scale)


def save_lenses(
    path: Path, maps: Mapping[str, LensMap], sizes: Mapping[str, tuple[int, int]]
) -> None:
    """Draw by camera the standard deviation of its lens, coverage and residuals over the image."""
    canvas, grid = panels(3 * len(maps), "Lenses by part of the image", columns=3)
    for k, (name, own) in enumerate(maps.items()):
        width, height = sizes[name]
        mean_px = np.linalg.norm(own.residual_px, axis=-1)
        counts = np.where(own.corners > 0, own.corners, np.nan)
        covered = f"number of corners, in {100 * own.covered:.0f} % of the image"
        parts = {
            "standard deviation of the lens [px]": (own.std_px, "linear"),
            covered: (counts, "log"),
            "mean residual [px], x: significant": (mean_px, "linear"),
        }
        extent = (-0.5, width - 0.5, height - 0.5, -0.5)
        for axes, (title, (values, norm)) in zip(grid[3 * k :], parts.items(), strict=False):
            shown = axes.imshow(values, extent=extent, cmap="viridis", norm=norm)
            canvas.colorbar(shown, ax=axes, shrink=0.8)
            axes.set_title(f"{name}: {title}", fontsize=10, loc="left")
            axes.set_facecolor("0.85")  # no corner was seen, or the lens reaches no direction
        # Among 108 cells noise alone reaches three standard errors.
        beyond = mean_px > 4 * np.sqrt(2) * own.residual_std_px
        rows, columns = np.nonzero(beyond)
        u, v = (columns + 0.5) * width / mean_px.shape[1], (rows + 0.5) * height / mean_px.shape[0]
        grid[3 * k + 2].plot(u, v, "x", color="white", markersize=5)
    save(canvas, path)
