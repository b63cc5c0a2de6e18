"""Small datasets to test on, written without the code under test."""

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.board import Charuco, Chessboard, opencv_board

CHESSBOARD = Chessboard(columns=6, rows=5, square_m=0.03)
CHARUCO = Charuco(squares_x=6, squares_y=5, square_m=0.03, marker_m=0.022, dictionary="DICT_4X4_50")
_TEXELS = 40  # a square

JOINTS = ("left_pan", "left_tilt", "right_pan", "right_tilt")


def texture(board: Chessboard | Charuco) -> np.ndarray:
    """Return the board (H, W) uint8 with half a square of white around."""
    if isinstance(board, Charuco):
        size = (board.squares_x * _TEXELS, board.squares_y * _TEXELS)
        drawn = opencv_board(board).generateImage(size, marginSize=0)
    else:
        pattern = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
        drawn = np.kron(pattern, np.ones((_TEXELS, _TEXELS))) * 255
    return np.pad(
        np.where(drawn > 127, 230, 20).astype(np.uint8), _TEXELS // 2, constant_values=230
    )


def picture(
    board: Chessboard | Charuco, H: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return an image (H, W) uint8 of a board, and its corners (K, 2) [px].

    Args:
        board: whose squares are 1 in the coordinates that H maps, the first inner corner at 0, 0.
        H: (3, 3) from the board to pixels.
        size: width and height.
    """
    fine = 4
    scale = 1 / _TEXELS
    # A texel's centre in squares: half a square of margin and one square before the first corner.
    T_texel = np.array([[scale, 0, scale / 2 - 1.5], [0, scale, scale / 2 - 1.5], [0, 0, 1]])
    enlarge = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]])
    large = cv2.warpPerspective(
        texture(board), enlarge @ H @ T_texel, (size[0] * fine, size[1] * fine), borderValue=120
    )
    image = cv2.resize(large, size, interpolation=cv2.INTER_AREA)
    j, i = np.mgrid[: board.rows, : board.columns]
    points = np.stack([i.ravel(), j.ravel(), np.ones(i.size)])
    uvw = H @ points
    return cv2.GaussianBlur(image, (0, 0), 0.5), (uvw[:2] / uvw[2]).T


def held(k: int, *, shift: float = 0.0, square_px: float = 24.0) -> np.ndarray:
    """Return an H at which a board is seen a little differently for each k."""
    turn = 0.1 + 0.05 * k
    c, s = np.cos(turn) * square_px, np.sin(turn) * square_px
    return np.array([[c, -s, 70.3 + shift + k], [s, c, 40.6 - 2 * k], [1e-2, 5e-3 * k, 1.0]])


def board_json(board: Chessboard | Charuco) -> dict[str, Any]:
    return {key: value for key, value in vars(board).items() if not key.startswith("_")}


def description(
    board: Chessboard | Charuco = CHESSBOARD, size: tuple[int, int] = (32, 24)
) -> dict[str, Any]:
    """Return the content of a dataset.json with two wide cameras."""
    cameras = {
        f"{eye}_wide": {"eye": eye, "width": size[0], "height": size[1]}
        for eye in ("left", "right")
    }
    return {
        "format": "vergence-dataset-1",
        "cameras": cameras,
        "board": board_json(board),
        "joints": {name: {"column": name, "unit": "rad"} for name in JOINTS},
    }


def rows(count: int) -> list[dict[str, Any]]:
    """Return rows of frames.csv for two wide cameras."""
    return [
        {
            "time_s": 10 + 0.5 * k,
            "joint_time_s": 10.01 + 0.5 * k,
            "placement": "" if k == 0 else k % 2,
            **{name: round(0.1 * np.sin(k + j), 6) for j, name in enumerate(JOINTS)},
            "left_wide": f"images/left_{k}.png",
            "right_wide": "" if k == 1 else f"images/right_{k}.png",
        }
        for k in range(count)
    ]


def without(table: list[dict[str, Any]], *columns: str) -> list[dict[str, Any]]:
    return [{name: row[name] for name in row if name not in columns} for row in table]


def write_table(folder: Path, table: list[dict[str, Any]]) -> None:
    with (folder / "frames.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)


def write_dataset(
    folder: Path, table: list[dict[str, Any]], about: dict[str, Any], images: dict[str, np.ndarray]
) -> None:
    """Write a dataset with json, csv and cv2 alone."""
    (folder / "images").mkdir(parents=True)
    (folder / "dataset.json").write_text(json.dumps(about), encoding="utf-8")
    write_table(folder, table)
    for name, image in images.items():
        done, data = cv2.imencode(Path(name).suffix, image)
        assert done
        (folder / name).write_bytes(data.tobytes())


def small_dataset(folder: Path, count: int = 4) -> None:
    """Write a valid dataset whose images show nothing."""
    rng = np.random.default_rng(5)
    table = rows(count)
    names = [row[c] for row in table for c in ("left_wide", "right_wide") if row[c]]
    images = {name: rng.integers(0, 255, (24, 32, 3), dtype=np.uint8) for name in names}
    write_dataset(folder, table, description(), images)


def seen_dataset(
    folder: Path, board: Chessboard | Charuco, count: int = 3
) -> dict[str, np.ndarray]:
    """Write a dataset whose images show a board; return the corners (K, 2) by file name."""
    table, images, corners = rows(count), {}, {}
    for k, row in enumerate(table):
        for camera, shift in (("left_wide", 12.0), ("right_wide", 0.0)):
            if row[camera]:
                H = held(k, shift=shift)
                images[row[camera]], corners[row[camera]] = picture(board, H, (280, 240))
    write_dataset(folder, table, description(board, (280, 240)), images)
    return corners


def change_about(folder: Path, change: dict[str, Any]) -> None:
    """Change fields of dataset.json; a dotted name reaches inside, None removes."""
    about = json.loads((folder / "dataset.json").read_text())
    for name, value in change.items():
        *path, last = name.split(".")
        inside = about
        for part in path:
            inside = inside[part]
        if value is None:
            del inside[last]
        else:
            inside[last] = value
    (folder / "dataset.json").write_text(json.dumps(about))


def change_cell(folder: Path, row: int, column: str, value: str) -> None:
    """Change a cell of a small dataset's frames.csv."""
    table = rows(4)
    table[row][column] = value
    write_table(folder, table)


def refusal(folder: Path) -> str:
    """Return the one sentence in which loading a dataset ends."""
    with pytest.raises(VergenceError) as refused:
        load_dataset(folder)
    message = str(refused.value)
    assert "\n" not in message
    assert message.endswith(".")
    return message
