"""Make the scenes' textures, in colour and from seeds, and the calibration board.

Run from anywhere (the PNGs are written beside this file):

    python models/room/assets/make_textures.py

No colour is as red as the object or as blue as the marker, by which these are found. Widths and
heights are powers of two, so that mipmaps are halved evenly.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ASSETS = Path(__file__).parent
Image = NDArray[np.float64]
"""(H, W, 3), RGB, grey levels."""

SQUARES = (10, 7)
"""Columns and rows of the board: 9 x 6 inner corners."""
MARGIN_SQUARES = 1
"""White all around the pattern; the chessboard detector needs about one square of it."""
TEXELS_PER_SQUARE = 16
"""Corners are rendered best with 8 to 16; more makes the mipmaps do the blurring."""
BLACK, WHITE = 25, 235
"""The board's material glows at full strength, so these are the grey levels in the images."""

LEVELS = 32
"""Grey levels of a channel: enough for features, and half the file of 256 levels."""
MUTED = np.array(
    [(205, 196, 172), (84, 112, 108), (150, 128, 96), (60, 66, 72), (168, 172, 150), (112, 84, 74)]
)
"""Colours of printed and painted things."""


def noise(shape: tuple[int, int], rng: np.random.Generator, *, cells: tuple[int, int]) -> Image:
    """Return periodic noise (H, W, 1) of unit deviation, equally strong at every scale.

    Args:
        shape: height and width [texels], powers of two.
        rng: of the noise.
        cells: down and across, of the coarsest scale; more down than across makes grain.
    """
    total, (rows, columns) = np.zeros(shape), cells
    while rows <= shape[0] and columns <= shape[1]:
        tiled = np.tile(rng.uniform(-1, 1, (rows, columns)), (3, 3))
        size = 3 * shape[1], 3 * shape[0]
        large = cv2.resize(tiled, size, interpolation=cv2.INTER_CUBIC)
        total += large[shape[0] : 2 * shape[0], shape[1] : 2 * shape[1]]
        rows, columns = 2 * rows, 2 * columns
    return ((total - total.mean()) / total.std())[..., None]


def wood(rng: np.random.Generator) -> Image:
    """Planks with grain along the rows."""
    image = np.array([158.0, 131.0, 100.0]) + 13 * noise((256, 256), rng, cells=(32, 2))
    image += 5 * noise((256, 256), rng, cells=(4, 4))
    for top in range(0, 256, 64):
        image[top : top + 64] += rng.normal(0, 8)
        image[top : top + 2] *= 0.6
    for _ in range(6):  # knots
        centre = rng.integers(16, 240, 2).tolist()
        cv2.ellipse(image, centre, (rng.integers(4, 9), 3), 0, 0, 360, (96, 72, 54), -1)
    return image


def brick(rng: np.random.Generator) -> Image:
    """Eight courses of bricks in a running bond."""
    image = 168 + 6 * noise((256, 256), rng, cells=(8, 8)) * np.ones(3)
    grain = 12 * noise((256, 256), rng, cells=(16, 16))
    for row in range(8):
        for column in range(4):
            colour = np.array([138.0, 99.0, 84.0]) + rng.normal(0, 11) + rng.normal(0, 3, 3)
            across = np.arange(64 * column + 3, 64 * column + 64) + 32 * (row % 2)
            inside = np.ix_(range(32 * row + 3, 32 * row + 32), across % 256)
            image[inside] = colour + grain[inside]
    return image


def tiles(rng: np.random.Generator) -> Image:
    """Sixteen tiles: the repeated pattern that a matcher may confuse."""
    image = np.full((256, 256, 3), 88.0)
    grain = 7 * noise((256, 256), rng, cells=(32, 32))
    for row in range(4):
        for column in range(4):
            inside = np.s_[64 * row + 2 : 64 * row + 62, 64 * column + 2 : 64 * column + 62]
            grey = 150 if (row + column) % 2 else 118
            image[inside] = grey + rng.normal(0, 4, 3) + grain[inside]
    return image


def marbled(rng: np.random.Generator) -> Image:
    """Veined stone."""
    veins = np.exp(-np.abs(noise((128, 128), rng, cells=(4, 4))) * 4)
    return np.array([148.0, 150.0, 140.0]) - 60 * veins + 14 * noise((128, 128), rng, cells=(8, 8))


def pattern(rng: np.random.Generator) -> Image:
    """A printed cloth: figures in muted colours."""
    image = np.ones((128, 128, 3)) * MUTED[0]
    for _ in range(70):
        colour = MUTED[rng.integers(1, len(MUTED))].tolist()
        centre, size = rng.integers(0, 128, 2), rng.integers(3, 10, 2)
        cv2.rectangle(image, centre.tolist(), (centre + size).tolist(), colour, -1)
    return image


def page(rng: np.random.Generator, *, size: tuple[int, int] = (256, 128)) -> Image:
    """A printed sheet (H, W): lines of words, and a picture."""
    height, width = size
    image = np.full((height, width, 3), 226.0)
    for top in range(12, height - 12, 7):
        left = 10
        while left < width - 24:
            word = int(rng.integers(4, 16))
            cv2.rectangle(image, (left, top), (left + word, top + 2), (70, 70, 74), -1)
            left += word + 4
    picture = image[height // 3 : height // 3 + height // 4, 10 : width - 10]
    picture[:] = MUTED[1] + 26 * noise((height // 4, width), rng, cells=(2, 4))[:, : width - 20]
    return image


def poster(rng: np.random.Generator) -> Image:
    """A picture of hills under a heading, and columns of text."""
    image = page(rng, size=(256, 256))
    image[4:36] = MUTED[3]
    for left in range(14, 236, 14):
        height = int(rng.integers(8, 20))
        cv2.rectangle(image, (left, 10), (left + 9, 10 + height), (225, 222, 205), -1)
    columns = np.arange(256)
    for horizon, colour in zip((70, 92, 120), MUTED[[4, 1, 2]], strict=True):
        ridge = horizon + 14 * noise((2, 256), rng, cells=(2, 4))[0, :, 0]
        for column in columns:
            image[int(ridge[column]) : 150, column] = colour
    image[44:150] += 9 * noise((128, 256), rng, cells=(16, 32))[:106]
    return image


def spines(rng: np.random.Generator) -> Image:
    """A row of books seen from their backs, dark gaps above the lower ones."""
    image, left = np.full((128, 256, 3), 40.0), 0
    while left < 256:
        width, top = int(rng.integers(7, 20)), int(rng.integers(2, 40))
        colour = MUTED[rng.integers(len(MUTED))] + rng.normal(0, 10)
        image[top:, left : left + width - 1] = colour
        for band in rng.integers(top + 6, 120, 3):
            image[band : band + rng.integers(2, 7), left + 1 : left + width - 2] = 235 - colour / 2
        left += width
    return image


def rack(rng: np.random.Generator) -> Image:
    """Four units of a rack, all alike: slots, plugs and lamps."""
    image = np.full((128, 256, 3), 62.0)
    for top in range(0, 128, 32):
        image[top : top + 2] = 20
        image[top + 5 : top + 28, 8:248] = 96
        for left in range(16, 150, 8):
            image[top + 9 : top + 24, left : left + 4] = 30
        for left in range(160, 240, 14):
            cv2.circle(image, (left, top + 16), 4, (190, 188, 170), -1)
    return image + 3 * noise((128, 256), rng, cells=(16, 32))


def outside(rng: np.random.Generator) -> Image:
    """The view from the window: sky, houses and trees."""
    image = np.linspace((176, 190, 200), (214, 218, 216), 128)[:, None] * np.ones((1, 256, 1))
    for left in range(0, 256, 43):
        top, colour = int(rng.integers(40, 80)), MUTED[rng.integers(len(MUTED))] * 1.1
        image[top:, left : left + 38] = colour
        for row in range(top + 6, 118, 10):
            image[row : row + 5, left + 5 : left + 33 : 9] *= 0.6
    trees = 96 + 10 * noise((2, 256), rng, cells=(2, 8))[0, :, 0]
    leaves = np.array([92.0, 108.0, 74.0]) + 16 * noise((128, 256), rng, cells=(16, 32))
    below = np.arange(128)[:, None] > trees
    image[below] = leaves[below]
    return image


def parcel(rng: np.random.Generator) -> Image:
    """The front of a carton: cardboard, tape and an address label."""
    image = np.array([163.0, 138.0, 108.0]) + 7 * noise((128, 128), rng, cells=(64, 4))
    image[:, 56:72] = (186, 172, 142)
    image[20:84, 14:100] = page(rng, size=(64, 128))[:, :86]
    cv2.rectangle(image, (78, 92), (118, 116), (60, 56, 50), 2)
    return image


def chessboard() -> NDArray[np.uint8]:
    """The board seen from its front, first corner top left, its outer square black."""
    columns, rows = (n + 2 * MARGIN_SQUARES for n in SQUARES)
    squares = np.full((rows, columns), WHITE, np.uint8)
    pattern = np.indices((SQUARES[1], SQUARES[0])).sum(axis=0) % 2
    inside = slice(MARGIN_SQUARES, -MARGIN_SQUARES)
    squares[inside, inside] = np.where(pattern == 0, BLACK, WHITE)
    return np.kron(squares, np.ones((TEXELS_PER_SQUARE, TEXELS_PER_SQUARE), np.uint8))


def textures() -> dict[str, NDArray[np.uint8]]:
    """All textures by file name: (H, W) grey or (H, W, 3) RGB."""
    made = {"board.png": chessboard()}
    drawings = (wood, brick, tiles, marbled, pattern, page, poster, spines, rack, outside, parcel)
    step = 256 // LEVELS
    for seed, draw in enumerate(drawings):
        image = draw(np.random.default_rng(seed))
        levels = np.clip(np.round(image / step), 0, LEVELS - 1) * step
        made[f"{draw.__name__}.png"] = levels.astype(np.uint8)
    return made


def main() -> None:
    for name, image in textures().items():
        path = ASSETS / name
        stored = image[..., ::-1] if image.ndim == 3 else image  # OpenCV writes BGR
        cv2.imwrite(str(path), stored, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        height, width = image.shape[:2]
        print(f"{path.name}: {width} x {height}, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
