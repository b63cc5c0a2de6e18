"""Finding the board in a dataset: what is found is right, what fails has its reason."""

import json
import os
from dataclasses import replace

import cv2
import numpy as np
import pytest

from recordings import (
    CHARUCO,
    CHESSBOARD,
    board_json,
    change_about,
    description,
    held,
    picture,
    rows,
    seen_dataset,
    small_dataset,
    write_dataset,
)
from vergence.calibration import detection
from vergence.calibration.detection import detect_or_explain, detect_target
from vergence.data.images import UNREADABLE
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.board import Charuco
from vergence.vision.board_detection import detect_board


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_corners_of_every_image_stand_at_its_row_and_camera(tmp_path, board):
    truth = seen_dataset(tmp_path / "set", board)
    dataset = load_dataset(tmp_path / "set")
    calls = []
    found = detect_target(dataset, progress=lambda *call: calls.append(call))
    assert calls == [("finding the board", done, 5) for done in range(6)]
    assert found.findings == ()
    assert found.board == board
    assert found.sizes == {"left_wide": (280, 240), "right_wide": (280, 240)}
    for camera, files in dataset.files.items():
        for row, name in enumerate(files):
            corners = found.corners[camera][row]
            if name is None:
                assert np.isnan(corners).all()
            else:
                np.testing.assert_allclose(corners, truth[name], atol=0.1)
    assert (found.placement == dataset.placement).all()
    assert (found.eye_angles == dataset.eye_angles).all()
    assert found.timing is None


@pytest.mark.parametrize("upside_down", [False, True])
@pytest.mark.parametrize("seen", [np.s_[:, 130:], np.s_[:110]])
def test_part_of_a_charuco_board_gives_the_right_corners(seen, upside_down):
    image, truth = picture(CHARUCO, held(0, shift=20), (280, 240))
    part = np.full_like(image, 120)
    part[seen] = image[seen]
    if upside_down:
        part, truth = np.ascontiguousarray(part[::-1, ::-1]), np.array([279, 239]) - truth
    found = detect_board(part, CHARUCO)
    assert found is not None
    finite = np.isfinite(found[:, 0])
    assert 6 <= finite.sum() < len(truth)
    np.testing.assert_allclose(found[finite], truth[finite], atol=0.15)


@pytest.mark.parametrize(
    ("board", "change", "named"),
    [
        (CHARUCO, {"squares_x": 2}, "3 to 100 squares"),
        (CHARUCO, {"marker_m": 0.04}, "marker_m lies between"),
        (CHARUCO, {"marker_m": 0.0}, "marker_m lies between"),
        (CHARUCO, {"dictionary": "DICT_9X9"}, "No marker dictionary is called"),
        (
            CHARUCO,
            {"squares_x": 12, "squares_y": 12},
            "marker 71 of DICT_4X4_50",
        ),
        (CHESSBOARD, {"columns": 0}, "columns"),
        (CHESSBOARD, {"rows": -1}, "rows"),
        (CHESSBOARD, {"square_m": 0.0}, "square_m"),
        (CHESSBOARD, {"square": 1}, "square"),
    ],
)
def test_impossible_boards_are_refused(board, change, named):
    with pytest.raises(ValueError, match=named):
        type(board)(**vars(board) | change)


def board_image() -> np.ndarray:
    return picture(CHESSBOARD, held(0), (280, 240))[0]


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (board_image() // 10, "too dark"),
        (np.full((240, 280), 250, np.uint8), "overexposed"),
        (cv2.GaussianBlur(board_image(), (0, 0), 12), "blurred"),
        (np.random.default_rng(0).integers(0, 255, (240, 280), dtype=np.uint8), "was not found"),
        (np.zeros((1, 1), np.uint8), ""),
        (np.full((40, 2), 120, np.uint8), "too small"),
    ],
    ids=["dark", "bright", "blurred", "noise", "one pixel", "two columns"],
)
def test_an_image_without_a_board_gives_its_reason(image, reason):
    corners, found = detect_or_explain(image, CHESSBOARD)
    assert corners is None
    assert reason in found
    assert found


@pytest.fixture
def folder(tmp_path):
    """Return a dataset of a ChArUco board."""
    seen_dataset(tmp_path / "set", CHARUCO)
    return tmp_path / "set"


@pytest.mark.parametrize("kept", [0.01, 0.5])
def test_an_unreadable_image_fails_alone_and_is_named_in_a_remark(folder, kept, capfd):
    image = folder / "images" / "left_2.png"
    content = image.read_bytes()
    image.write_bytes(content[: int(kept * len(content))])
    found = detect_target(load_dataset(folder))
    assert capfd.readouterr().err == ""  # nothing of libpng's own
    (unreadable,) = found.findings
    assert (unreadable.code, unreadable.where) == ("unreadable-image", "line 4, left_wide")
    assert unreadable.sentence == (
        f"Line 4, images/left_2.png: the file {UNREADABLE}; leave the cell empty where there is no "
        "image."
    )
    assert np.isfinite(found.corners["right_wide"][2]).all()


def test_images_in_which_opencv_cannot_look_for_another_board_are_no_failure(tmp_path, monkeypatch):
    def refuse(image: np.ndarray, board: object) -> None:
        if board != CHESSBOARD:
            raise cv2.error("no room")

    small_dataset(tmp_path / "set")
    monkeypatch.setattr(detection, "detect_board", refuse)
    with pytest.raises(VergenceError, match=r"check board in dataset\.json"):
        detect_target(load_dataset(tmp_path / "set"))


def test_images_of_another_size_are_refused(folder):
    assert cv2.imwrite(str(folder / "images" / "left_2.png"), np.zeros((120, 140), np.uint8))
    with pytest.raises(VergenceError, match=r"line 4: left_wide: .* 140 x 120 .* 280 x 240"):
        detect_target(load_dataset(folder))


def test_a_dataset_that_shows_nothing_is_refused(tmp_path):
    small_dataset(tmp_path / "set")
    with pytest.raises(VergenceError, match=r"No image of .* shows a chessboard of 6 x 5 inner"):
        detect_target(load_dataset(tmp_path / "set"))


FIVE = Charuco(5, 7, 0.03, 0.022, "DICT_5X5_50")
SQUARE = replace(CHARUCO, squares_y=6)


@pytest.mark.parametrize(
    ("there", "described", "said"),
    [
        (
            CHESSBOARD,
            {"columns": 7, "rows": 6},
            "a chessboard of 6 x 5 inner corners is there.*not its squares",
        ),
        (CHESSBOARD, {"columns": 4, "rows": 4}, "set board.columns to 6, board.rows to 5"),
        (CHESSBOARD, {"columns": 7}, "a chessboard of 6 x 5 inner corners is there"),
        (FIVE, {"squares_x": 7, "squares_y": 5}, "set board.squares_x to 5, board.squares_y to 7"),
        (FIVE, {"dictionary": "DICT_6X6_50"}, "is there: set board.dictionary to DICT_5X5"),
        (CHARUCO, {"squares_x": 7}, "set board.squares_x to 6"),
        (SQUARE, {"legacy": True}, "is there: set board.legacy to false"),
        (
            replace(SQUARE, legacy=True, dictionary="DICT_5X5_50"),
            {"squares_x": 5, "legacy": False, "dictionary": "DICT_4X4_50"},
            "set board.squares_x to 6, board.dictionary to DICT_5X5_.*, board.legacy to true",
        ),
        (
            CHARUCO,
            board_json(CHESSBOARD),
            "set board.squares_x to 6, board.squares_y to 5, .*DICT_4X4_50, .*charuco",
        ),
        (
            CHESSBOARD,
            board_json(CHARUCO),
            "set board.columns to 6, board.rows to 5, board.kind to chessboard",
        ),
    ],
)
def test_a_board_that_is_described_wrongly_is_named(tmp_path, there, described, said):
    seen_dataset(tmp_path / "set", there, 2 if there.kind == "charuco" else 1)
    about = description(there, (280, 240))
    about["board"] = described if "kind" in described else about["board"] | described
    (tmp_path / "set" / "dataset.json").write_text(json.dumps(about))
    with pytest.raises(VergenceError, match=said):
        detect_target(load_dataset(tmp_path / "set"))


def test_a_few_markers_that_fit_a_wrong_description_do_not_pass_for_a_board(tmp_path, monkeypatch):
    """Of the rows nearest to the first one, those of a board with a square more are the same."""
    seen_dataset(tmp_path / "set", CHARUCO, 3)
    first, _ = picture(CHARUCO, held(0), (280, 240))
    real = detection.detect_or_explain

    def by_chance(grey: np.ndarray, board: Charuco):
        if (grey == first).all() and board != CHARUCO:
            return real(grey, CHARUCO)
        return real(grey, board)

    monkeypatch.setattr(detection, "detect_or_explain", by_chance)
    change_about(tmp_path / "set", {"board.squares_x": 7})
    said = r"Only 1 of 5 images of .* shows .* 6 x 4 .* \(another board is there .*set board\.squar"
    with pytest.raises(VergenceError, match=said):
        detect_target(load_dataset(tmp_path / "set"))


@pytest.mark.parametrize("eyes", [("left",), ("left", "right")])
def test_mirrored_images_are_named(folder, eyes):
    for path in (folder / "images").iterdir():
        if path.name.startswith(eyes):
            image = cv2.imread(str(path))
            assert image is not None
            assert cv2.imwrite(str(path), image[:, ::-1])
    said = r"No image of left_wide shows a charuco .*; its mirror image is there: store the images"
    with pytest.raises(VergenceError, match=said):
        detect_target(load_dataset(folder))


def test_a_few_images_tell_that_another_board_was_shown(tmp_path):
    seen_dataset(tmp_path / "set", CHESSBOARD, 20)
    change_about(tmp_path / "set", {"board.columns": 9, "board.rows": 8})
    counts = []
    with pytest.raises(VergenceError, match=r"of 13 all over it, .* set board.columns to 6"):
        detect_target(load_dataset(tmp_path / "set"), progress=lambda *each: counts.append(each))
    assert counts[-1][1:] == (13, 39)


def test_a_chessboard_that_the_image_cuts_off_is_called_that_and_not_a_smaller_one(tmp_path):
    table, size = rows(1), (280, 240)
    names = [row[c] for row in table for c in ("left_wide", "right_wide") if row[c]]
    images = {
        name: picture(CHESSBOARD, held(k, shift=105), size)[0] for k, name in enumerate(names)
    }
    write_dataset(tmp_path / "set", table, description(CHESSBOARD, size), images)
    said = (
        r"only \d x \d of its 6 x 5 corners were found.*as a whole.*; check board in dataset\.json"
    )
    with pytest.raises(VergenceError, match=said):
        detect_target(load_dataset(tmp_path / "set"))


def test_detection_does_not_depend_on_the_number_of_threads(folder, monkeypatch):
    dataset = load_dataset(folder)
    many = detect_target(dataset)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    one = detect_target(dataset)
    for camera, corners in many.corners.items():
        np.testing.assert_array_equal(corners, one.corners[camera])


def test_a_marker_of_the_family_beside_a_charuco_board_does_not_hide_it():
    """OpenCV alone finds no board then."""
    image, truth = picture(CHARUCO, held(0, shift=20), (280, 240))
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    wide = np.full((240, 400), 200, np.uint8)
    wide[:, :280] = image
    wide[100:136, 330:366] = cv2.aruco.generateImageMarker(family, 7, 36)
    found = detect_board(wide, CHARUCO)
    assert found is not None
    seen = np.isfinite(found[:, 0])
    assert seen.sum() >= 12
    np.testing.assert_allclose(found[seen], truth[seen], atol=0.1)
