"""Datasets that are written: what stands there is what was meant, or nothing is."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from postures import NECK_JOINTS
from recordings import CHARUCO, refusal, small_dataset
from simulated_head import random_pose
from vergence.data.dataset import Frame, runs
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYE_JOINTS


def entries(count: int, rng: np.random.Generator) -> list[DatasetRow]:
    return [
        DatasetRow(
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
    write_dataset(tmp_path / "deep" / "set", about(**joint), made)
    dataset = load_dataset(tmp_path / "deep" / "set")
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


def image(width: int = 32, height: int = 24) -> np.ndarray:
    return np.zeros((height, width, 3), np.uint8)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"images": {"third": image()}}, "an image of 'third'; the cameras described are left_w"),
        (
            {"images": {"left_wide": image(24, 32)}},
            r"of shape \(32, 24, 3\) and uint8; images are arrays",
        ),
        ({"images": {"left_wide": image() / 255}}, "and float64; images are arrays of u"),
        ({"images": {"left_wide": image()[..., 0].astype("i4")}}, "and int32; images are arrays"),
        ({"images": {"left_wide": image().tolist()}}, "and list; images are arrays of uint8"),
        ({"eye_angles": np.array([0, np.nan, 0, 0])}, "line 4: left_tilt is 'nan', not a finite"),
        ({"neck_angles": np.array([np.inf, 0, 0])}, "line 4: neck_.* is 'inf', not a finite"),
        ({"eye_angles": np.full(4, 30.0)}, "line 4: left_pan = 30.0 rad is more than a turn"),
        ({"neck_angles": np.full(3, 0.1)}, "line 4: neck_.* has moved by 0.100 rad since line 3"),
        ({"time_s": None}, "line 4: time_s is blank"),
        ({"eye_angles": [0.1, "x", 0, 0]}, "needs numbers of the readings .*; found .*'x'"),
        ({"eye_angles": np.zeros(7)}, "needs numbers of the readings .*; found "),
        ({"neck_angles": np.zeros(2)}, "needs numbers of the readings .*; found "),
        ({"joint_time_s": np.nan}, "line 4: joint_time_s is 'nan'"),
        ({"joint_time_s": 7.2}, "line 4: time_s and joint_time_s lie 5 s apart"),
        ({"time_s": 1.1}, "line 4: time_s = 1.1 repeats that of line 3; time stamps increase"),
        ({"joint_time_s": 0.9}, "line 4: joint_time_s = 0.9 is earlier than that of line 3"),
        (
            {"time_s": 1e8, "joint_time_s": 1e8},
            "time_s = 100000000.0 is no time in seconds of one recording",
        ),
        ({"placement": -1}, "line 4: placement is '-1'; expected blank or a whole number from 0"),
        ({"placement": 1.5}, "line 4: placement is '1.5'; expected blank"),
        ({"placement": "a"}, "line 4: placement is 'a'; expected blank"),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path, change, said):
    *good, last = entries(3, np.random.default_rng(1))
    last = replace(last, placement=change.pop("placement", 0))
    wrong = replace(last, frame=replace(last.frame, **change))
    with pytest.raises(VergenceError, match=said):
        write_dataset(tmp_path / "set", about(), [*good, wrong])
    assert not (tmp_path / "set").exists()


def test_images_are_those_of_their_row_though_the_driver_uses_one_array_again(tmp_path):
    made = entries(40, np.random.default_rng(1))
    buffer = {name: np.zeros((24, 32), np.uint8) for name in ("left_wide", "right_wide")}

    def driver() -> Iterator[DatasetRow]:
        for k, row in enumerate(made):
            for image in buffer.values():
                image[:] = k
            images = {name: buffer[name] for name in row.frame.images}
            yield replace(row, frame=replace(row.frame, images=images))

    write_dataset(tmp_path / "set", about(), driver())
    dataset = load_dataset(tmp_path / "set")
    for k in range(len(made)):
        image = dataset.image("left_wide", k)
        assert image is not None
        assert (image == k).all()


def test_poses_take_the_place_of_angles_and_are_read_back_exactly(tmp_path):
    rng, folder = np.random.default_rng(2), tmp_path / "set"
    described = Description(cameras=about().cameras, board=CHARUCO, eye_motion="poses")
    T = np.array([[random_pose(rng), random_pose(rng)] for _ in range(3)])
    made = zip(entries(3, rng), T, strict=True)
    write_dataset(folder, described, [DatasetRow(frame=e.frame, T_base_eye=t) for e, t in made])
    with pytest.raises(VergenceError, match=r"needs the poses of both eyes.*; found None"):
        write_dataset(tmp_path / "none", described, entries(1, rng))
    scaled = replace(entries(1, rng)[0], T_base_eye=np.tile(np.diag([2.0, 2, 2, 1]), (2, 1, 1)))
    with pytest.raises(VergenceError, match=r"line 2: left_T00 to .*: expected a rigid transform"):
        write_dataset(tmp_path / "scaled", described, [scaled])
    dataset = load_dataset(folder)
    assert (dataset.T_base_eye == T).all()
    assert np.isnan(dataset.eye_angles).all()
    assert not runs(dataset).any()
    table = (folder / "frames.csv").read_text()
    (folder / "frames.csv").write_text(table.replace(repr(float(T[2, 0, 0, 0])), "2.0"))
    assert "line 4: left_T00 to left_T33: expected a rigid transform" in refusal(folder)


def test_a_folder_that_is_not_empty_is_never_overwritten(tmp_path):
    folder = tmp_path / "set"
    small_dataset(folder)
    before = sorted(folder.rglob("*"))
    with pytest.raises(VergenceError, match="already exists and is not empty"):
        write_dataset(folder, about(), entries(2, np.random.default_rng(0)))
    assert sorted(folder.rglob("*")) == before
    with pytest.raises(VergenceError, match="A dataset has one row or more; found none"):
        write_dataset(tmp_path / "none", about(), [])
    assert not (tmp_path / "none").exists()


def test_images_of_16_bits_keep_their_levels(tmp_path):
    row = entries(1, np.random.default_rng(1))[0]
    deep = np.arange(768, dtype=np.uint16).reshape(24, 32)
    wide = replace(row, frame=replace(row.frame, images={"left_wide": deep}))
    write_dataset(tmp_path / "set", about(), [wide])
    read = load_dataset(tmp_path / "set").image("left_wide", 0)
    assert read is not None
    np.testing.assert_allclose(read[..., 0], deep / 3.0, atol=3)
