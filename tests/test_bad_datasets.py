"""Datasets that are not in order end in one sentence, whatever is wrong with them."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recordings import (
    change_about,
    change_cell,
    refusal,
    rows,
    small_dataset,
    without,
    write_table,
)  # fmt: skip
from texts import texts
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYE_JOINTS


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    small_dataset(tmp_path / "set")
    return tmp_path / "set"


@pytest.mark.parametrize(
    ("row", "column", "value", "sentence"),
    [
        (1, "time_s", "10", "line 3: time_s = 10 repeats that of line 2"),
        (2, "time_s", "9.5", "line 4: time_s = 9.5 is earlier than that of line 3"),
        (2, "joint_time_s", "10.51", "line 4: joint_time_s = 10.51 repeats"),
        (0, "joint_time_s", "7.5", "line 2: time_s and joint_time_s lie 2.5 s apart"),
        (3, "time_s", "1.7e18", "line 5: time_s = 1.7e18 is no time in seconds"),
        (3, "joint_time_s", "1.7e15", "line 5: joint_time_s = 1.7e15 is no time in seconds"),
        (
            3,
            "time_s",
            "100000000",
            "line 5: time_s = 100000000 is no time in seconds of one recording",
        ),
        (1, "time_s", "", "line 3: time_s is blank"),
        (1, "time_s", "1_0.5", "line 3: time_s is '1_0.5', not a finite number"),
        (1, "left_pan", "nan", "line 3: left_pan is 'nan', not a finite number"),
        (1, "left_pan", "-Infinity", "line 3: left_pan is '-Infinity'"),
        (1, "left_pan", "1e999", "line 3: left_pan is '1e999'"),
        (1, "left_pan", "0,2", "line 3: left_pan is '0,2', not a finite number such as 0.25"),
        (3, "left_tilt", "17.2", "a turn; if it is in degrees, set joints.left_tilt.unit"),
        (1, "placement", "-1", "line 3: placement is '-1'; expected blank or a whole number"),
        (1, "placement", "1.5", "line 3: placement is '1.5'"),
        (1, "left_wide", "images/left_0.png", "is also the image of left_wide in line 2"),
        (1, "left_wide", "images/../images/left_0.png", "is also the image of left_wide in line 2"),
        (1, "left_wide", "images/none.png", "line 3: left_wide: 'images/none.png' is missing"),
        (1, "left_wide", "images", "line 3: left_wide: 'images' is missing, or not a regular file"),
        (1, "left_wide", "../secret.png", "'../secret.png' leads out of the dataset's folder"),
        (1, "left_wide", "/etc/passwd", "'/etc/passwd' leads out of the dataset's folder"),
        (1, "left_wide", "a\0b", "is not a possible file name"),
        (1, "left_wide", "x" * 4000, "is not a possible file name"),
    ],
)
def test_a_bad_cell_is_named_by_its_line(folder, row, column, value, sentence):
    (folder.parent / "secret.png").write_bytes(b"")
    change_cell(folder, row, column, value)
    assert sentence in refusal(folder)


def test_folders_that_links_lead_to_are_read(folder):
    (folder / "images").rename(folder.parent / "elsewhere")
    (folder / "images").symlink_to(folder.parent / "elsewhere")
    assert load_dataset(folder).image("left_wide", 0) is not None


def test_links_that_leave_the_folder_are_refused(folder):
    (folder.parent / "secret.png").write_bytes(b"")
    (folder / "images" / "left_0.png").unlink()
    (folder / "images" / "left_0.png").symlink_to(folder.parent / "secret.png")
    assert "leads out of the dataset's folder" in refusal(folder)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "vergence-dataset-9"}, "format: Input should be 'vergence-dataset-1'"),
        ({"cameras": None}, "cameras: this field is missing; found "),
        ({"cameras": {}}, "cameras is empty"),
        ({"cameras.left_wide.width": 0}, "cameras.left_wide.width: Input should be greater"),
        ({"cameras.left_wide.width": "32"}, "cameras.left_wide.width: Input should be a valid int"),
        ({"cameras.left_wide.eye": "right"}, "perhaps left and right are exchanged."),
        ({"cameras.left_wide.eye": "middle"}, "cameras.left_wide.eye: Input should be 'left' or"),
        ({"cameras.cam 0": {"eye": "left", "width": 1, "height": 1}}, "a camera's name begins"),
        ({"cameras.left": {"eye": "left", "width": 1, "height": 1}}, "is not the name of an eye"),
        (
            {"cameras.time_s": {"eye": "left", "width": 1, "height": 1}},
            "'time_s' is used twice",
        ),
        ({"cameras.left_wide.colour": True}, "colour: unknown field"),
        ({"cameras.left_wide.widht": 32}, "widht: unknown field; perhaps width is meant"),
        ({"board.square": 0.03}, "board.square: unknown field; perhaps square_m is meant"),
        ({"board.kind": None}, "board: Unable to extract tag"),
        ({"board.kind": "dots"}, "board: Input tag 'dots' found using 'kind' does not"),
        ({"board.square_y_m": 0.3}, "square_y_m is the other side of nearly square squares of"),
        ({"board.columns": 2}, "count inner corners, 3 to 100 each; found 2 x 5"),
        ({"board.square_m": 30}, "board.square_m is 30.0 m"),
        ({"board.square_m": 0}, "board.square_m: Input should be greater than 0"),
        ({"joints.left_pan": None}, "joints.left_pan is missing; that eye has a camera"),
        (
            {"joints.left_pan": None, "joints.left_pam": {"column": "left_pan", "unit": "rad"}},
            "joints.left_pan is missing; that eye has a camera",
        ),
        ({"joints.left_pan.unit": "degrees"}, "joints.left_pan.unit: Input should be 'rad' or"),
        ({"joints.left_pan.unit": None}, "joints.left_pan.unit: this field is missing; found "),
        ({"joints.left_pan.sign": 0.5}, "joints.left_pan.sign: Input should be 1 or -1"),
        ({"joints.left_pan.column": "time_s"}, "'time_s' is used twice"),
        ({"joints.left_tilt.column": "left_pan"}, "joints.left_tilt has the column of left_pan"),
        (
            {"joints.right_pan": {"column": "left_pan", "unit": "deg"}},
            "joints.right_pan.unit differs from joints.left_pan.unit",
        ),
        ({"joints.9": {"column": "jaw", "unit": "rad"}}, "joints.9: String should match pattern"),
        ({"eye_motion": "poses"}, "eye_motion is poses, but joints has left_pan"),
    ],
)
def test_a_bad_field_is_named(folder, change, sentence):
    change_about(folder, change)
    assert sentence in refusal(folder)


@pytest.mark.parametrize("column", ["time_s", "joint_time_s", "placement", "left_pan", "left_wide"])
def test_a_missing_column_is_named(folder, column):
    write_table(folder, without(rows(4), column))
    assert f"the column {column!r} is missing; found" in refusal(folder)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "the column 'time_s' is missing; found "),
        (b"\ntime_s\n", "the column 'time_s' is missing; found "),
        (b"time_s,time_s\n1,2\n", "the column 'time_s' is repeated"),
        (b"time_s;joint_time_s\n1;2\n", "named in the first line and separated by commas"),
        (b"time_s,\xff\n", "is not a CSV file"),
        (b'time_s\n"1', "is not a CSV file"),
        (b"time_s,joint_time_s\n1\n", "line 2: found 1 field for 2 columns"),
    ],
)
def test_a_table_that_is_none_is_refused(folder, content, sentence):
    (folder / "frames.csv").write_bytes(content)
    assert sentence in refusal(folder)


@pytest.mark.parametrize(
    "content", ["", "{", "[]", '"x"', '{"note": "a", "note": "b"}', "[" * 20_000, "\xff"]
)
def test_a_description_that_is_none_is_refused(folder, content):
    (folder / "dataset.json").write_text(content, encoding="latin-1")
    assert "dataset.json" in refusal(folder)


def test_what_is_missing_is_named(tmp_path, folder):
    assert "There is no dataset folder" in refusal(tmp_path / "none")
    assert "There is no dataset folder" in refusal(tmp_path / ("long" * 100))
    assert "dataset.json: a dataset is a folder with dataset.json and frames" in refusal(
        folder / "dataset.json"
    )
    (folder / "frames.csv").unlink()
    assert "frames.csv: No such file" in refusal(folder)
    (folder / "dataset.json").unlink()
    assert "dataset.json: No such file" in refusal(folder)


def test_a_neck_that_moves_while_the_board_is_said_to_rest_is_noticed(folder):
    change_about(folder, {"joints.neck_pitch": {"column": "pitch", "unit": "rad"}})
    table = [row | {"pitch": 0.05 * k, "placement": 3} for k, row in enumerate(rows(3))]
    write_table(folder, table)
    assert "line 3: neck_pitch has moved by 0.050 rad since line 2" in refusal(folder)


def test_a_motion_that_is_not_said_to_be_one_is_remarked(folder):
    soon = [
        row | dict.fromkeys(("time_s", "joint_time_s"), k / 10) for k, row in enumerate(rows(4))
    ]
    write_table(folder, soon)
    (remark,) = texts(load_dataset(folder).findings, "note")
    assert remark.startswith("The eyes turn on in 2 rows")
    for moving_or_at_one_place in ({"moving": 1}, dict.fromkeys(EYE_JOINTS, 0.1)):
        write_table(folder, [row | moving_or_at_one_place for row in soon])
        assert load_dataset(folder).findings == ()


CELLS = st.one_of(
    st.text(max_size=12),
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(["", "images/left_0.png", "../x", "1e5", "0.1", "nan", "images/", "é\u0660"]),
)


@given(data=st.data())
def test_no_damage_to_the_table_is_met_with_a_traceback(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("set") / "set"
    small_dataset(folder)
    table = [list(rows(4)[0])] + [[str(cell) for cell in row.values()] for row in rows(4)]
    for _ in range(data.draw(st.integers(1, 3))):
        k = data.draw(st.integers(0, len(table) - 1))
        c = data.draw(st.integers(0, len(table[k]) - 1))
        head, row, tail = table[:k], table[k], table[k + 1 :]
        damaged = {
            "cell": [*head, [*row[:c], data.draw(CELLS), *row[c + 1 :]], *tail],
            "drop": [*head, *tail] or table,
            "swap": [*head, *tail[-1:], *tail[:-1], row],
            "double": [*head, row, row, *tail],
            "shorten": [*head, row[:c] + row[c + 1 :] or row, *tail],
        }
        table = damaged[data.draw(st.sampled_from(sorted(damaged)))]
    with (folder / "frames.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(table)
    loads_or_refuses(folder)


@given(text=st.text(max_size=40), where=st.floats(0, 1), cut=st.integers(0, 30))
def test_no_damage_to_the_description_is_met_with_a_traceback(text, where, cut, tmp_path_factory):
    folder = tmp_path_factory.mktemp("set") / "set"
    small_dataset(folder)
    about = (folder / "dataset.json").read_text()
    at = int(where * len(about))
    damaged = about[:at] + text + about[at + cut :]
    (folder / "dataset.json").write_bytes(damaged.encode("utf-8", errors="replace"))
    loads_or_refuses(folder)


def loads_or_refuses(folder: Path) -> None:
    """Check that what loads is what stands there, and that nothing but VergenceError refuses."""
    message, dataset = "", None
    try:
        dataset = load_dataset(folder)
    except VergenceError as error:
        message = str(error)
    assert "\n" not in message
    if dataset is None:
        return
    with (folder / "frames.csv").open(encoding="utf-8", newline="") as file:
        table = [row for row in csv.DictReader(file) if any(v.strip() for v in row.values())]
    assert len(dataset) == len(table)
    assert (np.diff(dataset.time_s) > 0).all()
    assert np.isfinite(dataset.eye_angles).all()
    assert (np.abs(dataset.eye_angles) <= np.pi).all()
    joints = dataset.description.joints
    for k, row in enumerate(table):
        cells = {name.strip(): cell.strip() for name, cell in row.items()}
        assert dataset.time_s[k] == float(cells["time_s"])
        for j, name in enumerate(EYE_JOINTS):
            if name in joints:
                read = float(cells[joints[name].column])
                angle = np.radians(read) if joints[name].unit == "deg" else read
                assert dataset.eye_angles[k, j] == joints[name].sign * angle
