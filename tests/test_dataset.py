"""Datasets on disk: good ones are read as they were meant, bad ones end in one sentence."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heads import random_pose
from recordings import CHARUCO, JOINTS, description, rows, small_dataset, write_dataset, write_table
from vergence.dataset import (
    DatasetCamera,
    DatasetJoint,
    Description,
    Frame,
    pose_columns,
    runs,
)
from vergence.dataset_files import load
from vergence.dataset_writer import Entry, write
from vergence.errors import VergenceError
from vergence.kinematics import EYE_JOINTS, NECK_JOINTS


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    small_dataset(tmp_path / "set")
    return tmp_path / "set"


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
    table = rows(4)
    table[row][column] = value
    write_table(folder, table)


def refusal(folder: Path) -> str:
    with pytest.raises(VergenceError) as refused:
        load(folder)
    message = str(refused.value)
    assert "\n" not in message
    assert message.endswith(".")
    return message


def test_a_dataset_is_read_as_it_was_written(folder):
    dataset = load(folder)
    table = rows(4)
    assert len(dataset) == 4
    assert dataset.time_s.tolist() == [row["time_s"] for row in table]
    assert dataset.joint_time_s.tolist() == [row["joint_time_s"] for row in table]
    assert dataset.eye_angles.tolist() == [[row[name] for name in JOINTS] for row in table]
    assert (dataset.neck_angles == 0).all()
    assert dataset.lines.tolist() == [2, 3, 4, 5]
    assert dataset.files["right_wide"] == ("images/right_0.png", None, "images/right_2.png",
                                           "images/right_3.png")  # fmt: skip
    assert not dataset.moving.any()
    assert dataset.remarks == ()
    assert dataset.T_base_eye is None


def test_rows_without_a_placement_stand_alone(folder):
    table = rows(4)
    for row, placement in zip(table, ["", 7, "", 7], strict=True):
        row["placement"] = placement
    write_table(folder, table)
    first, second, third, fourth = load(folder).placement.tolist()
    assert second == fourth == 7
    assert len({first, second, third}) == 3


def test_a_row_comes_back_as_a_frame(folder):
    dataset = load(folder)
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
    image = load(tmp_path / "set").image("left_wide", 0)
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
    table = rows(2)
    for k, row in enumerate(table):
        del row["left_pan"], row["left_tilt"], row["right_tilt"]
        row |= {"eyes_version": 20 * k, "eyes_tilt": -10, "yaw": 0.3, "placement": k}
    write_table(folder, table)
    dataset = load(folder)
    np.testing.assert_allclose(dataset.eye_angles[1, [0, 1, 3]], np.radians([-20, -10, -10]))
    np.testing.assert_allclose(dataset.neck_angles, [[0, 0, -0.3]] * 2)


def test_poses_take_the_place_of_angles(folder):
    change_about(folder, {"joints": {}, "eye_motion": "poses"})
    rng = np.random.default_rng(3)
    T = np.array([[random_pose(rng), random_pose(rng)] for _ in range(4)])
    table = rows(4)
    for k, row in enumerate(table):
        for name in JOINTS:
            del row[name]
        for e, eye in enumerate(("left", "right")):
            row |= dict(zip(pose_columns(eye), map(repr, T[k, e].ravel().tolist()), strict=True))
    write_table(folder, table)
    dataset = load(folder)
    assert dataset.T_base_eye is not None
    assert (dataset.T_base_eye == T).all()
    assert np.isnan(dataset.eye_angles).all()
    assert not runs(dataset).any()
    table[2]["left_T00"] = "2.0"
    write_table(folder, table)
    assert "line 4: left_T00 to left_T33 are not a rigid transform" in refusal(folder)


def test_an_eye_without_a_camera_needs_no_joints(folder):
    change_about(
        folder,
        {"cameras.right_wide": None, "joints.right_pan": None, "joints.right_tilt": None},
    )
    table = rows(3)
    for row in table:
        del row["right_wide"], row["right_pan"], row["right_tilt"]
    write_table(folder, table)
    assert (load(folder).eye_angles[:, 2:] == 0).all()


def test_columns_of_ones_own_begin_with_an_underscore(folder):
    table = [row | {"_temperature": "warm"} for row in rows(2)]
    write_table(folder, table)
    assert len(load(folder)) == 2
    write_table(folder, [row | {"temperature": "warm"} for row in rows(2)])
    assert "'temperature' is not known" in refusal(folder)


def test_a_byte_order_mark_and_blank_lines_are_no_matter(folder):
    text = (folder / "frames.csv").read_text()
    (folder / "frames.csv").write_bytes(b"\xef\xbb\xbf" + text.encode() + b"\r\n\r\n")
    assert len(load(folder)) == 4


@pytest.mark.parametrize(
    ("row", "column", "value", "sentence"),
    [
        (1, "time_s", "10", "line 3: time_s = 10 repeats that of line 2"),
        (2, "time_s", "9.5", "line 4: time_s = 9.5 is earlier than that of line 3"),
        (2, "joint_time_s", "10.51", "line 4: joint_time_s = 10.51 repeats"),
        (0, "joint_time_s", "7.5", "line 2: time_s and joint_time_s lie 2.5 s apart"),
        (1, "time_s", "", "line 3: time_s is blank"),
        (1, "time_s", "1_0.5", "line 3: time_s is '1_0.5', not a number"),
        (1, "left_pan", "nan", "line 3: left_pan is nan; every number is finite"),
        (1, "left_pan", "-Infinity", "line 3: left_pan is -Infinity"),
        (1, "left_pan", "1e999", "line 3: left_pan is '1e999'"),
        (1, "left_pan", "0,2", "line 3: left_pan is '0,2', not a number such as 0.25"),
        (3, "left_tilt", "17.2", "half a turn; if it is in degrees, set joints.left_tilt.unit"),
        (1, "placement", "-1", "line 3: placement is '-1'; it is blank or a whole number"),
        (1, "placement", "1.5", "line 3: placement is '1.5'"),
        (1, "left_wide", "images/left_0.png", "is also the image of left_wide in line 2"),
        (1, "left_wide", "images/../images/left_0.png", "is also the image of left_wide in line 2"),
        (1, "left_wide", "images/none.png", "line 3: left_wide: 'images/none.png': there is no"),
        (1, "left_wide", "images", "line 3: left_wide: 'images': there is no such file"),
        (1, "left_wide", "../secret.png", "'../secret.png' leads out of the dataset's folder"),
        (1, "left_wide", "/etc/passwd", "'/etc/passwd' leads out of the dataset's folder"),
        (1, "left_wide", "a\0b", "is not a possible file name"),
        (1, "left_wide", "x" * 5000, "is not a possible file name"),
    ],
)
def test_a_bad_cell_is_named_by_its_line(folder, row, column, value, sentence):
    (folder.parent / "secret.png").write_bytes(b"")
    change_cell(folder, row, column, value)
    assert sentence in refusal(folder)


def test_links_that_leave_the_folder_are_refused(folder):
    (folder.parent / "secret.png").write_bytes(b"")
    (folder / "images" / "left_0.png").unlink()
    (folder / "images" / "left_0.png").symlink_to(folder.parent / "secret.png")
    assert "leads out of the dataset's folder" in refusal(folder)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "vergence-dataset-9"}, "format: Input should be 'vergence-dataset-1'"),
        ({"cameras": None}, "cameras: Field required"),
        ({"cameras": {}}, "cameras is empty"),
        ({"cameras.left_wide.width": 0}, "cameras.left_wide.width: Input should be greater"),
        ({"cameras.left_wide.width": "32"}, "cameras.left_wide.width: Input should be a valid int"),
        ({"cameras.left_wide.eye": "right"}, "are left and right exchanged?"),
        ({"cameras.left_wide.eye": "middle"}, "cameras.left_wide.eye: Input should be 'left' or"),
        ({"cameras.cam0": {"eye": "left", "width": 1, "height": 1}}, "expected one of left_wide"),
        ({"cameras.left_wide.colour": True}, "cameras.left_wide.colour: Unexpected keyword"),
        ({"board.kind": None}, "board: Unable to extract tag"),
        ({"board.columns": 2}, "count inner corners, 3 to 100 each; found 2 x 5"),
        ({"board.square_m": 30}, "board.square_m is 30.0 m"),
        ({"board.square_m": 0}, "board.square_m: Input should be greater than 0"),
        ({"joints.left_pan": None}, "joints.left_pan is missing; that eye has a camera"),
        ({"joints.left_pan.unit": "degrees"}, "joints.left_pan.unit: Input should be 'rad' or"),
        ({"joints.left_pan.unit": None}, "joints.left_pan.unit: Field required"),
        ({"joints.left_pan.sign": 0.5}, "joints.left_pan.sign: Input should be 1 or -1"),
        ({"joints.left_pan.column": "time_s"}, "not the name of a column of joint readings"),
        ({"joints.jaw": {"column": "jaw", "unit": "rad"}}, "expected one of left_pan"),
        ({"eye_motion": "poses"}, "eye_motion is poses, but joints has left_pan"),
        (
            {
                "cameras.left_wide.intrinsics": {
                    "width": 64,
                    "height": 24,
                    "matrix": [[20, 0, 15], [0, 20, 11], [0, 0, 1]],
                }
            },
            "has images of 32 x 24, but its intrinsics are of 64 x 24",
        ),
    ],
)
def test_a_bad_field_is_named(folder, change, sentence):
    change_about(folder, change)
    assert sentence in refusal(folder)


@pytest.mark.parametrize("column", ["time_s", "joint_time_s", "placement", "left_pan", "left_wide"])
def test_a_missing_column_is_named(folder, column):
    table = rows(4)
    for row in table:
        del row[column]
    write_table(folder, table)
    assert f"the column {column!r} is missing; found" in refusal(folder)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "is empty; its first line names the columns"),
        (b"time_s,time_s\n1,2\n", "the column 'time_s' stands there twice"),
        (b"time_s;joint_time_s\n1;2\n", "separated by semicolons"),
        (b"time_s,\xff\n", "is not a CSV file in UTF-8"),
        (b'time_s\n"1', "is not a CSV file in UTF-8"),
        (b"time_s,joint_time_s\n", "has no frames, only a header"),
        (b"time_s,joint_time_s\n1\n", "line 2: found 1 fields for 2 columns"),
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
    (folder / "frames.csv").unlink()
    assert "There is no frames.csv in" in refusal(folder)
    (folder / "dataset.json").unlink()
    assert "There is no dataset.json in" in refusal(folder)


def test_a_neck_that_moves_while_the_board_is_said_to_rest_is_noticed(folder):
    change_about(folder, {"joints.neck_pitch": {"column": "pitch", "unit": "rad"}})
    table = [row | {"pitch": 0.05 * k, "placement": 3} for k, row in enumerate(rows(3))]
    write_table(folder, table)
    assert "line 3: neck_pitch has moved by 0.050 rad since line 2" in refusal(folder)


@pytest.mark.parametrize(
    ("unit", "value", "remark"),
    [("rad", 2.5, "is its unit deg?"), ("deg", 0.4, "are these radians?")],
)
def test_angles_that_look_like_another_unit_are_remarked(folder, unit, value, remark):
    change_about(folder, {"joints.left_pan.unit": unit})
    change_cell(folder, 2, "left_pan", str(value))
    remarks = load(folder).remarks
    assert len(remarks) == 1
    assert remark in remarks[0]
    assert "left_pan" in remarks[0]


def test_a_wrong_size_is_named_when_the_image_is_read(folder):
    change_about(folder, {"cameras.left_wide.width": 64})
    with pytest.raises(VergenceError, match=r"line 2: left_wide: .* has 32 x 24 .* says 64 x 24"):
        load(folder).frame(0)


def test_an_unreadable_image_is_named_when_it_is_read(folder):
    (folder / "images" / "left_0.png").write_bytes(b"")
    with pytest.raises(VergenceError, match=r"line 2: left_wide: images/left_0\.png is not a read"):
        load(folder).frame(0)


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
        how = data.draw(st.sampled_from(["cell", "drop", "swap", "double", "shorten"]))
        if how == "cell":
            table[k][c] = data.draw(CELLS)
        elif how == "drop" and len(table) > 1:
            del table[k]
        elif how == "swap":
            table[k], table[-1] = table[-1], table[k]
        elif how == "double":
            table.insert(k, list(table[k]))
        elif how == "shorten" and len(table[k]) > 1:
            del table[k][c]
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
    try:
        dataset = load(folder)
    except VergenceError as error:
        message = str(error)
        dataset = None
    else:
        message = ""
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
    dataset = load(tmp_path / "set")
    dataset.moving[:5] = False
    dataset.joint_time_s[12:] += 1.0  # a gap
    np.testing.assert_array_equal(runs(dataset), np.repeat([0, 1, 2], [5, 7, 8]))
    dataset.moving[:] = False
    assert not runs(dataset).any()


def test_a_motion_of_two_rows_is_refused(tmp_path):
    moving_dataset(tmp_path / "set", 2)
    with pytest.raises(VergenceError, match="moving rows come at least 3 in sequence"):
        runs(load(tmp_path / "set"))


def entries(count: int, rng: np.random.Generator) -> list[Entry]:
    return [
        Entry(
            frame=Frame(
                time_s=1.1 * k,
                joint_time_s=1.1 * k + 0.1,
                eye_angles=rng.uniform(-0.5, 0.5, 4),
                neck_angles=np.zeros(3),
                images={
                    name: rng.integers(0, 255, (24, 32, 3), dtype=np.uint8)
                    for name in ("left_wide", "right_wide")[: 1 + k % 2]
                },
            ),
            placement=k // 2 if k else None,
            moving=k > 2,
        )
        for k in range(count)
    ]


def about(**joint: Any) -> Description:
    return Description(
        cameras={
            f"{eye}_wide": DatasetCamera(eye=eye, width=32, height=24) for eye in ("left", "right")
        },
        board=CHARUCO,
        joints={
            name: DatasetJoint(column=name, **({"unit": "rad"} | joint))
            for name in (*EYE_JOINTS, *NECK_JOINTS)
        },
        note="Umlaute: äöü",
    )


@pytest.mark.parametrize("joint", [{}, {"unit": "deg", "sign": -1}])
def test_what_is_written_is_read_back(tmp_path, joint):
    made = entries(5, np.random.default_rng(1))
    write(tmp_path / "deep" / "set", about(**joint), made)
    dataset = load(tmp_path / "deep" / "set")
    assert dataset.description.note == "Umlaute: äöü"
    assert dataset.description.board == CHARUCO
    assert dataset.moving.tolist() == [entry.moving for entry in made]
    for k, entry in enumerate(made):
        frame = dataset.frame(k)
        assert (frame.time_s, frame.joint_time_s) == (entry.frame.time_s, entry.frame.joint_time_s)
        np.testing.assert_allclose(frame.eye_angles, entry.frame.eye_angles, rtol=4e-16)
        assert list(frame.images) == list(entry.frame.images)
        for name, image in frame.images.items():
            grey = entry.frame.images[name] @ [0.299, 0.587, 0.114]
            assert np.abs(image[..., 0] - grey).max() <= 1


def test_written_poses_are_read_back_exactly(tmp_path):
    rng = np.random.default_rng(2)
    described = Description(cameras=about().cameras, board=CHARUCO, eye_motion="poses")
    T = [np.array([random_pose(rng), random_pose(rng)]) for _ in range(3)]
    made = [
        Entry(frame=entry.frame, T_base_eye=each)
        for entry, each in zip(entries(3, rng), T, strict=True)
    ]
    write(tmp_path / "set", described, made)
    assert (load(tmp_path / "set").T_base_eye == np.array(T)).all()


def test_a_folder_that_is_not_empty_is_never_overwritten(folder):
    before = sorted(folder.rglob("*"))
    with pytest.raises(VergenceError, match="is there already and not empty"):
        write(folder, about(), entries(2, np.random.default_rng(0)))
    assert sorted(folder.rglob("*")) == before


def test_an_empty_folder_is_used(tmp_path):
    (tmp_path / "set").mkdir()
    write(tmp_path / "set", about(), entries(2, np.random.default_rng(0)))
    assert len(load(tmp_path / "set")) == 2


def test_an_interrupted_recording_leaves_nothing_behind(tmp_path):
    def broken():
        yield from entries(2, np.random.default_rng(0))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "set", about(), broken())
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(VergenceError, match="Cannot") as refused:
        write(tmp_path / "file" / "set", about(), [])
    assert "\n" not in str(refused.value)


DOCUMENT = Path(__file__).parents[1] / "docs" / "dataset.md"


def fenced(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)


def test_the_documented_example_is_a_dataset(tmp_path):
    (tmp_path / "dataset.json").write_text(fenced("json")[0])
    table = fenced("csv")[0]
    (tmp_path / "frames.csv").write_text(table)
    for name in re.findall(r"images/\w+\.png", table):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    dataset = load(tmp_path)
    assert dataset.remarks == ()
    assert len(dataset) == len(table.splitlines()) - 1


def test_the_documented_reader_reads_a_dataset(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    exec(compile(fenced("python")[0], "docs/dataset.md", "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out.splitlines()
    dataset = load(folder)
    assert len(printed) == len(dataset)
    assert f"{dataset.eye_angles[2, 0]:.4f}" in printed[2]
