"""Calibrate a pair of ordinary cameras from photographs of a chessboard, without a head.

    python benchmarks/stereo_pairs.py FOLDER --columns 9 --rows 6 --square-m 1

FOLDER holds left*.jpg and right*.jpg (or png), of which those with the same ending of their names
were taken together. Prints root mean square residuals of each camera and of the pair, and the
held-out epipolar error: lenses and pair are calibrated from four fifths of the pairs, and corners
of the others measured to the line on which the other image says that they lie. Then how much the
lenses by random halves of the pairs differ, over what they state (`Accuracy.lenses`; 1 is right).

OpenCV's own sample pairs (samples/data, unit squares), for comparison: 0.256 and 0.248 px for the
lenses, 0.272 px for the pair, 0.199 px held out with OpenCV's corners and calibration.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro

from vergence.arrays import Array
from vergence.calibration.intrinsics import calibrate_camera
from vergence.calibration.static_stereo import calibrate_pair
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, displaced_by_distortion, undistort
from vergence.geometry.parameter_names import PINHOLE
from vergence.geometry.parameters import lens_vector
from vergence.geometry.se3 import hat
from vergence.vision.board_detection import detect_board

FOLDS, HALVINGS = 5, 40
SUFFIXES = (".jpg", ".jpeg", ".png")


@dataclass(frozen=True, eq=False)
class Pair:
    """Two calibrated cameras."""

    cameras: tuple[Camera, Camera]
    T_right_left: Array
    """(4, 4)."""
    rms_px: tuple[float, float, float]
    """Left lens, right lens, pair."""


def pictures(folder: Path) -> dict[str, tuple[Path, Path]]:
    """Return left and right picture by what follows the side in their names."""
    files = [path for path in sorted(folder.glob("*")) if path.suffix.lower() in SUFFIXES]
    left, right = (
        {p.name.removeprefix(side): p for p in files if p.name.startswith(side)}
        for side in ("left", "right")
    )
    found = {end: (left[end], right[end]) for end in left if end in right}
    if len(found) < FOLDS:
        raise VergenceError(
            f"{folder} holds {len(found)} pairs left*.jpg, right*.jpg; at least {FOLDS} are needed."
        )
    return found


def corners_in(path: Path, board: Chessboard) -> tuple[Array, tuple[int, int]]:
    """Return the corners (K, 2) [px], NaN where there is no board, and width and height."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise VergenceError(f"{path} is not a readable image.")
    found = detect_board(grey, board)
    corners = np.full((board.columns * board.rows, 2), np.nan) if found is None else found
    return corners, (grey.shape[1], grey.shape[0])


def calibrate(corners: Array, points: Array, size: tuple[int, int]) -> Pair:
    """Calibrate from corners (2, V, K, 2) of the left and the right camera."""
    left, right = (
        calibrate_camera(c, points, size=size, lens_model="radial-tangential") for c in corners
    )
    T, rms = calibrate_pair(corners[0], corners[1], points, left.camera, right.camera)
    return Pair((left.camera, right.camera), T, (left.rms_px, right.rms_px, rms))


def epipolar_errors(pair: Pair, corners: Array) -> Array:
    """Return (2, ...) [px] how far corners (2, ..., 2) lie from their epipolar lines."""
    left, right = (np.linalg.inv(camera.matrix) for camera in pair.cameras)
    F = right.T @ hat(pair.T_right_left[:3, 3]) @ pair.T_right_left[:3, :3] @ left
    flat = [undistort(camera, c) for camera, c in zip(pair.cameras, corners, strict=True)]
    u, v = (np.concatenate([c, np.ones((*c.shape[:-1], 1))], axis=-1) for c in flat)
    in_left, in_right = v @ F, u @ F.T
    off = np.abs((v * in_right).sum(axis=-1))
    return np.stack([off / np.hypot(line[..., 0], line[..., 1]) for line in (in_left, in_right)])


def halves_apart(corners: Array, points: Array, size: tuple[int, int]) -> Array:
    """Return how much lenses by halves of views (V, K, 2) differ, over what they state.

    Root mean squares (3,) of focal length, principal point and displacement by the distortion, of
    halves that determine a lens; NaN: none does.
    """
    rng, views, found = np.random.default_rng(0), len(corners), []
    for _ in range(HALVINGS):
        order = rng.permutation(views)
        try:
            first, second = (
                calibrate_camera(corners[half], points, size=size, lens_model="radial-tangential")
                for half in np.array_split(order, 2)
            )
        except VergenceError:
            continue
        apart = lens_vector(first.camera) - lens_vector(second.camera)
        k = apart[len(PINHOLE) :]
        displaced = np.sqrt(k @ displaced_by_distortion(first.camera) @ k)
        off = [apart[:2].mean() / first.camera.matrix[0, 0], np.hypot(*apart[2:4]), displaced]
        stated = [
            np.hypot(getattr(first.accuracy, name), getattr(second.accuracy, name))
            for name in ("focal", "centre_px", "distortion_px")
        ]
        found.append(np.array(off) / stated / [1, np.sqrt(2), 1])
    return np.sqrt(np.mean(np.square(found), axis=0)) if found else np.full(3, np.nan)


def main(
    folder: Annotated[Path, tyro.conf.Positional],
    columns: int = 9,
    rows: int = 6,
    square_m: float = 1.0,
) -> int:
    """Print the figures; 2 for what the user can mend.

    Args:
        folder: of the pictures.
        columns: inner corners in a row.
        rows: inner corners in a column.
        square_m: 1 where it is not known: lengths come in squares.
    """
    board = Chessboard(columns=columns, rows=rows, square_m=square_m)
    try:
        found = pictures(folder)
        seen = [[corners_in(path, board) for path in pair] for pair in found.values()]
        sizes = {size for pair in seen for _, size in pair}
        if len(sizes) > 1:
            raise VergenceError(f"The pictures have different sizes: {sorted(sizes)}.")
        corners = np.array([[c for c, _ in pair] for pair in seen]).swapaxes(0, 1)
        points, size = corner_points(board), sizes.pop()
        whole = calibrate(corners, points, size)
        fold = np.arange(corners.shape[1]) % FOLDS
        errors = np.empty(corners.shape[:-1])
        for k in range(FOLDS):
            trained = calibrate(corners[:, fold != k], points, size)
            errors[:, fold == k] = epipolar_errors(trained, corners[:, fold == k])
        apart = [halves_apart(c, points, size) for c in corners]
    except VergenceError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    left, right, stereo = whole.rms_px
    print(f"{corners.shape[1]} pairs")
    print(f"residuals, rms: left {left:.3f} px, right {right:.3f} px, pair {stereo:.3f} px")
    print(
        f"corners from their epipolar lines, held out in {FOLDS} folds: mean "
        f"{np.nanmean(errors):.3f} px, rms {np.sqrt(np.nanmean(errors**2)):.3f} px"
    )
    for side, (focal, centre, distortion) in zip(("left", "right"), apart, strict=True):
        print(
            f"halves of the views of the {side} camera differ, over what they state: focal length "
            f"{focal:.2f}, principal point {centre:.2f}, distortion {distortion:.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(tyro.cli(main, description=__doc__))
