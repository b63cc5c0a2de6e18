"""Make the scene's textures: seeded multi-scale grey noise, and the calibration board.

Run from anywhere (the PNGs are written beside this file):

    python models/cbi_head/assets/make_textures.py

Everything is grey on purpose: the object of the experiments is found by its redness.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ASSETS = Path(__file__).parent

SQUARES = (10, 7)
"""Columns and rows of the board: 9 x 6 inner corners."""
MARGIN_SQUARES = 1
"""White all around the pattern; the chessboard detector needs about one square of it."""
TEXELS_PER_SQUARE = 16
"""Corners are rendered best with 8 to 16; more makes the mipmaps do the blurring."""
BLACK, WHITE = 25, 235
"""The board's material glows at full strength, so these are the grey levels in the images."""

NOISE_LEVELS = 64
"""Grey levels in a noise texture: enough for features, and half the file of 256 levels."""


def noise(size: int, *, seed: int, mean: float, contrast: float) -> NDArray[np.uint8]:
    """Periodic grey noise with equal power at every scale, from `size / 2` to 1 texel.

    Args:
        size: Width and height [texels], a power of two.
        seed: Of the random generator.
        mean: Mean grey level.
        contrast: Standard deviation [grey levels].
    """
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size))
    cells = 2
    while cells <= size:
        coarse = rng.uniform(-1.0, 1.0, (cells, cells))
        # Three tiles a side, of which the middle one is kept: the texture repeats seamlessly.
        tiled = np.tile(coarse, (3, 3))
        tiled = cv2.resize(tiled, (3 * size, 3 * size), interpolation=cv2.INTER_CUBIC)
        total += tiled[size : 2 * size, size : 2 * size]
        cells *= 2
    total = (total - total.mean()) / total.std()
    step = 256 // NOISE_LEVELS
    grey = np.clip(mean + contrast * total, 0.0, 255.0)
    return (np.round(grey / step).clip(0, NOISE_LEVELS - 1) * step).astype(np.uint8)


def chessboard() -> NDArray[np.uint8]:
    """The board seen from its front, first corner top left, its outer square black."""
    columns, rows = (n + 2 * MARGIN_SQUARES for n in SQUARES)
    squares = np.full((rows, columns), WHITE, np.uint8)
    pattern = np.indices((SQUARES[1], SQUARES[0])).sum(axis=0) % 2
    inside = slice(MARGIN_SQUARES, -MARGIN_SQUARES)
    squares[inside, inside] = np.where(pattern == 0, BLACK, WHITE)
    return np.kron(squares, np.ones((TEXELS_PER_SQUARE, TEXELS_PER_SQUARE), np.uint8))


def textures() -> dict[str, NDArray[np.uint8]]:
    """All textures by file name."""
    return {
        "board.png": chessboard(),
        "wall.png": noise(512, seed=1, mean=158.0, contrast=24.0),
        "floor.png": noise(512, seed=2, mean=95.0, contrast=20.0),
        "object.png": noise(256, seed=3, mean=150.0, contrast=34.0),
    }


def main() -> None:
    for name, image in textures().items():
        path = ASSETS / name
        cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        height, width = image.shape
        print(f"{path.name}: {width} x {height}, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
