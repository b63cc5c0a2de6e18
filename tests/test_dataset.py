"""Datasets on disk: good ones are read as they were meant."""

from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

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
from vergence.data.images import decode_image, to_8_bits
from vergence.data.reader import _unmarked_motion, load_dataset
from vergence.errors import VergenceError
from vergence.geometry.kinematics import Kinematics


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    small_dataset(tmp_path / "set")
    return tmp_path / "set"


def test_a_dataset_is_read_as_it_was_written(folder):
    dataset = load_dataset(folder)
    table = rows(4)
    assert len(dataset) == 4
    assert repr(dataset) == f"<Dataset {folder}: 4 frames of left_wide, right_wide>"
    assert dataset.time_s.tolist() == [row["time_s"] for row in table]
    assert dataset.joint_time_s.tolist() == [row["joint_time_s"] for row in table]
    assert dataset.eye_angles.tolist() == [[row[name] for name in JOINTS] for row in table]
    assert (dataset.neck_angles == 0).all()
    assert dataset.lines.tolist() == [2, 3, 4, 5]
    right = [None if k == 1 else f"images/right_{k}.png" for k in range(4)]
    assert list(dataset.files["right_wide"]) == right
    assert not dataset.moving.any()
    assert dataset.findings == ()
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


@pytest.mark.parametrize(
    ("bits", "brightest", "grey"),
    [(None, 1000, 128), (None, 100, 100), (9, 1000, 250), (12, 1000, 31)],
)
def test_images_of_16_bits_are_reduced_by_the_range_that_they_fill_or_as_stated(
    tmp_path, bits, brightest, grey
):
    table, about = rows(1), description()
    if bits:
        about["cameras"]["left_wide"]["bits"] = bits
    picture = np.full((24, 32, 3), min(500, brightest), np.uint16)
    picture[0, 0, 0] = brightest
    images = {table[0]["left_wide"]: picture, table[0]["right_wide"]: np.zeros_like(picture)}
    write_dataset(tmp_path / "set", table, about, images)
    image = load_dataset(tmp_path / "set").image("left_wide", 0)
    assert image is not None
    assert image.dtype == np.uint8
    assert image[5, 5].tolist() == [grey] * 3


@pytest.mark.parametrize("offset", [0, 300, 60000])
def test_a_hot_pixel_and_a_narrow_range_leave_an_image_of_16_bits_its_contrast(offset):
    """A picture that fills 3 % of the range."""
    grey = np.linspace(0, 255, 64 * 48).reshape(48, 64)
    picture = (offset + grey * 8).astype(np.uint16)
    picture[7, 9] = 65535
    found = to_8_bits(picture).astype(float)
    assert found[7, 9] == 255
    found[7, 9] = grey[7, 9]
    np.testing.assert_allclose(found, grey, atol=3)


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_pixels_stay_as_they_are_stored_whatever_the_orientation(kind):
    stored = cv2.resize(np.random.default_rng(0).integers(0, 255, (3, 4, 3), np.uint8), (32, 24))
    for dtype in (np.uint8, np.uint16):
        image = Image.fromarray(stored if dtype == np.uint8 else stored[..., 0].astype(dtype) * 99)
        if kind == "JPEG" and dtype == np.uint16:
            continue
        found = []
        for orientation in range(1, 9):
            exif, content = Image.Exif(), BytesIO()
            exif[274] = orientation
            image.save(content, kind, exif=exif)
            found.append(decode_image(content.getvalue()))
        for each in found:
            np.testing.assert_array_equal(each, found[0] if kind == "JPEG" else np.asarray(image))


@pytest.mark.parametrize("part", [0.3, 0.9])
def test_a_damaged_jpeg_is_none_and_no_library_says_so(part, capfd):
    content = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (60, 80), np.uint8))[1]
    assert decode_image(content.tobytes()) is not None
    assert decode_image(content.tobytes()[: int(part * len(content))]) is None
    assert capfd.readouterr() == ("", "")


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
    np.testing.assert_allclose(dataset.neck_angles, [[-0.3]] * 2)


def test_an_unknown_camera_of_a_dataset_is_named(folder):
    dataset = load_dataset(folder)
    with pytest.raises(VergenceError, match=r"No camera is called 'middle'; the dataset has left"):
        dataset.image("middle", 0)


def test_an_eye_without_a_camera_needs_no_joints(folder):
    gone = ("right_wide", "right_pan", "right_tilt")
    change_about(folder, dict.fromkeys(("cameras.right_wide", *(f"joints.{n}" for n in gone[1:]))))
    write_table(folder, without(rows(3), *gone))
    assert (load_dataset(folder).eye_angles[:, 2:] == 0).all()
    change_about(folder, {"joints.right_tilt": {"column": "left_tilt", "unit": "rad"}})
    assert load_dataset(folder).description.head_kinematics.eyes["right"] == ()


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


def test_a_stream_of_readings_surrounds_the_rows_that_move(tmp_path):
    moving_dataset(tmp_path / "set", 20)  # from 100 s to 100.63 s
    lines = [f"{99.9 + 0.01 * k!r},0.1,0.2,{0.01 * k!r},0.3" for k in range(100)]
    header = ",".join(["time_s", *JOINTS])
    (tmp_path / "set" / "joints.csv").write_text("\n".join([header, *lines]))
    stream = load_dataset(tmp_path / "set").stream
    assert stream is not None
    np.testing.assert_allclose(stream.readings[:, 2], 0.01 * np.arange(100))
    for part in (lines[20:], lines[:50], lines[:30] + lines[60:]):
        (tmp_path / "set" / "joints.csv").write_text("\n".join([header, *part]))
        with pytest.raises(VergenceError, match=r"joints\.csv needs readings before and after"):
            load_dataset(tmp_path / "set")


def joint(name: str, readings: dict[str, float], **more) -> dict:
    return {"name": name, "axis": name, "readings": readings} | more


VERGENCE = {
    "kinematics": {
        eye: [joint("pan", {"version": 1, "vergence": sign}), joint("tilt", {"tilt": 1})]
        for eye, sign in (("left", 0.5), ("right", -0.5))
    },
    "readings": {
        "version": {"unit": "deg"},
        "vergence": {"unit": "rad", "sign": -1},
        "tilt": {"unit": "rad"},
    },
}
"""Eyes that are read by their mean angle and their difference."""


def without_pan_and_tilt(folder: Path, described: dict) -> None:
    names = ("left_pan", "left_tilt", "right_pan", "right_tilt")
    change_about(folder, {f"joints.{name}": None for name in names} | described)
    table = without(rows(3), *names)
    for k, row in enumerate(table):
        row |= {"version": 10 * k, "vergence": 0.02, "tilt": -0.1}
    write_table(folder, table)


def test_readings_are_those_of_the_joints_that_are_described(folder):
    without_pan_and_tilt(folder, VERGENCE)
    dataset = load_dataset(folder)
    expected = [[np.radians(10 * k), -0.02, -0.1] for k in range(3)]
    np.testing.assert_allclose(dataset.eye_angles, expected)
    assert dataset.description.head_kinematics.readings == ("version", "vergence", "tilt")
    pan, tilt = dataset.description.head_kinematics.eyes["right"]
    assert pan.readings == {"version": 1.0, "vergence": -0.5}
    np.testing.assert_array_equal(tilt.axis, [0, 1, 0])


def test_readings_before_a_gear_are_neither_wrapped_nor_limited(folder):
    """A motor may turn more than once, and 190 degrees of it are not -170."""
    gear = {"version": 0.25, "vergence": 1}
    described = {
        "kinematics": {
            eye: [joint("pan", gear), joint("tilt", {"tilt": 1})] for eye in ("left", "right")
        },
        "readings": {name: {"unit": "deg"} for name in ("version", "vergence", "tilt")},
    }
    without_pan_and_tilt(folder, described)
    table = without(rows(3), "left_pan", "left_tilt", "right_pan", "right_tilt")
    for row, version in zip(table, (170.0, 190.0, 730.0), strict=True):
        row |= {"version": version, "vergence": 359.0, "tilt": 5.0}
    write_table(folder, table)
    dataset = load_dataset(folder)
    np.testing.assert_allclose(np.degrees(dataset.eye_angles[:, 0]), [170, 190, 730])
    np.testing.assert_allclose(np.degrees(dataset.eye_angles[:, 1]), -1)
    assert dataset.findings == ()
    gear["version"] = 1
    change_about(folder, described)
    with pytest.raises(VergenceError, match="a turn; if it is of a motor before a gear, give its"):
        load_dataset(folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kinematics.left": None}, "kinematics.left has no joint; that eye has a camera"),
        ({"kinematics.left": []}, "kinematics.left has no joint; that eye has a camera"),
        ({"readings.tilt": None}, "readings.tilt is missing"),
        ({"readings.roll": {"unit": "deg"}}, "readings.roll is in no joint of kinematics"),
        ({"eye_motion": "poses"}, "eye_motion is poses, but kinematics is given"),
        (
            {"joints.left_pan": {"column": "p", "unit": "deg"}},
            "kinematics is given, but joints has left_pan",
        ),
        (
            {"kinematics.left": [joint("yaw", {"version": 1})]},
            "left.0.axis: expected pan, tilt, roll or a direction",
        ),
        (
            {
                "kinematics.left": [
                    joint("pan", {"version": 1, "vergence": 1, "tilt": 1}, axis=[0, 0, 0])
                ]
            },
            "expected pan, tilt, roll or a direction",
        ),
        (
            {"kinematics.left": [joint("pan", {"version": 1}), joint("pan", {"tilt": 1})]},
            "each of its own name",
        ),
        ({"kinematics": None}, "joints.left_pan is missing; that eye has a camera"),
        (
            {"kinematics.left": [joint("pan", {"version": 1}, point_m=[50, 0, 0])]},
            "point_m of joint pan is in metres",
        ),
    ],
)
def test_joints_that_contradict_themselves_are_refused(folder, change: dict, said: str):
    without_pan_and_tilt(folder, VERGENCE)
    change_about(folder, change)
    with pytest.raises(VergenceError, match=said):
        load_dataset(folder)


def test_unmarked_motion_is_named_also_where_readings_of_an_unused_eye_are_missing():
    time_s = np.arange(30) / 30
    angles = 0.3 * np.sin(6 * time_s[:, None] * [1.0, 1.3, 1.0, 1.3])
    angles[:, 2:] = np.nan
    at_rest = np.zeros(30, bool)
    (said,) = _unmarked_motion(Kinematics(), angles, time_s, at_rest)
    assert "The eyes turn on in" in str(said)
