"""Datasets on disk: good ones are read as they were meant."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recordings import (
    JOINTS,
    change_about,
    description,
    refusal,
    rows,
    small_dataset,
    without,
    write_dataset,
    write_table,
)  # fmt: skip
from vergence.data.dataset import runs
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    small_dataset(tmp_path / "set")
    return tmp_path / "set"


def test_a_dataset_is_read_as_it_was_written(folder):
    dataset = load_dataset(folder)
    table = rows(4)
    assert len(dataset) == 4
    assert dataset.time_s.tolist() == [row["time_s"] for row in table]
    assert dataset.joint_time_s.tolist() == [row["joint_time_s"] for row in table]
    assert dataset.eye_angles.tolist() == [[row[name] for name in JOINTS] for row in table]
    assert (dataset.neck_angles == 0).all()
    assert dataset.lines.tolist() == [2, 3, 4, 5]
    right = [None if k == 1 else f"images/right_{k}.png" for k in range(4)]
    assert list(dataset.files["right_wide"]) == right
    assert not dataset.moving.any()
    assert dataset.remarks == ()
    assert dataset.T_base_eye is None


def test_rows_without_a_placement_stand_alone(folder):
    table = rows(4)
    for row, placement in zip(table, ["", 7, "", 7], strict=True):
        row["placement"] = placement
    write_table(folder, table)
    first, second, third, fourth = load_dataset(folder).placement.tolist()
    assert second == fourth == 7
    assert len({first, second, third}) == 3


def test_a_row_comes_back_as_a_frame(folder):
    dataset = load_dataset(folder)
    frame = dataset.frame(1)
    assert frame.time_s == 10.5
    assert frame.joint_time_s == 10.51
    assert list(frame.images) == ["left_wide"]
    assert frame.images["left_wide"].shape == (24, 32, 3)
    assert dataset.image("right_wide", 1) is None


def test_images_are_rgb(tmp_path):
    table = rows(1)
    blue = np.zeros((24, 32, 3), np.uint8)
    blue[..., 0] = 200  # as OpenCV stores it
    green = np.roll(blue, 1, axis=2)
    images = {table[0]["left_wide"]: blue, table[0]["right_wide"]: green}
    write_dataset(tmp_path / "set", table, description(), images)
    image = load_dataset(tmp_path / "set").image("left_wide", 0)
    assert image is not None
    assert image[0, 0].tolist() == [0, 0, 200]


def test_units_signs_and_columns_are_those_of_the_head(folder):
    change_about(
        folder,
        {
            "joints.left_pan": {"column": "eyes_version", "unit": "deg", "sign": -1},
            "joints.left_tilt": {"column": "eyes_tilt", "unit": "deg", "sign": 1},
            "joints.right_tilt": {"column": "eyes_tilt", "unit": "deg", "sign": 1},
            "joints.neck_yaw": {"column": "yaw", "unit": "rad", "sign": -1},
        },
    )
    table = without(rows(2), "left_pan", "left_tilt", "right_tilt")
    for k, row in enumerate(table):
        row |= {"eyes_version": 20 * k, "eyes_tilt": -10, "yaw": 0.3, "placement": k}
    write_table(folder, table)
    dataset = load_dataset(folder)
    np.testing.assert_allclose(dataset.eye_angles[1, [0, 1]], np.radians([-20, -10]))
    # Both tilts are one reading.
    assert dataset.description.head_kinematics.readings == ("left_pan", "left_tilt", "right_pan")
    np.testing.assert_allclose(dataset.neck_angles, [[0, 0, -0.3]] * 2)


def test_an_eye_without_a_camera_needs_no_joints(folder):
    gone = ("right_wide", "right_pan", "right_tilt")
    change_about(folder, dict.fromkeys(("cameras.right_wide", *(f"joints.{n}" for n in gone[1:]))))
    write_table(folder, without(rows(3), *gone))
    assert (load_dataset(folder).eye_angles[:, 2:] == 0).all()


def test_columns_of_ones_own_begin_with_an_underscore(folder):
    table = [row | {"_temperature": "warm"} for row in rows(2)]
    write_table(folder, table)
    assert len(load_dataset(folder)) == 2
    write_table(folder, [row | {"temperature": "warm"} for row in rows(2)])
    assert "'temperature' is not known" in refusal(folder)


def test_a_byte_order_mark_and_blank_lines_are_no_matter(folder):
    text = (folder / "frames.csv").read_text()
    (folder / "frames.csv").write_bytes(b"\xef\xbb\xbf" + text.encode() + b"\r\n\r\n")
    assert len(load_dataset(folder)) == 4


def test_a_wrong_size_is_named_when_the_image_is_read(folder):
    change_about(folder, {"cameras.left_wide.width": 64})
    with pytest.raises(VergenceError, match=r"line 2: left_wide: .* has 32 x 24 .* says 64 x 24"):
        load_dataset(folder).frame(0)


def test_an_unreadable_image_is_named_when_it_is_read(folder):
    (folder / "images" / "left_0.png").write_bytes(b"")
    with pytest.raises(VergenceError, match=r"line 2: left_wide: images/left_0\.png is not a read"):
        load_dataset(folder).frame(0)


def moving_dataset(folder: Path, count: int, **extra: Any) -> None:
    """Write rows of eyes that swing at 30 Hz."""
    small_dataset(folder, 1)
    table = []
    for k in range(count):
        row = dict.fromkeys(rows(1)[0], "") | extra
        t = 100 + k / 30
        angles = 0.2 * np.cos(3 * t + np.arange(4))
        row |= {"time_s": repr(t), "joint_time_s": repr(t), "moving": 1, "placement": 0}
        table.append(row | dict(zip(JOINTS, map(repr, angles.tolist()), strict=True)))
    write_table(folder, table)


def test_rows_of_one_motion_share_a_number(tmp_path):
    moving_dataset(tmp_path / "set", 20)
    dataset = load_dataset(tmp_path / "set")
    dataset.moving[:5] = False
    dataset.joint_time_s[12:] += 1.0  # a gap
    np.testing.assert_array_equal(runs(dataset), np.repeat([0, 1, 2], [5, 7, 8]))
    dataset.moving[:] = False
    assert not runs(dataset).any()


def test_a_motion_of_two_rows_is_refused(tmp_path):
    moving_dataset(tmp_path / "set", 2)
    with pytest.raises(VergenceError, match="moving rows come at least 3 in sequence"):
        runs(load_dataset(tmp_path / "set"))
