"""Recording on the twin: what is written is a dataset, and the truth beside it is true."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from described_heads import described_head
from vergence.calibration.detection import detect_target
from vergence.calibration.observations import Observations
from vergence.data.dataset import Dataset
from vergence.data.reader import load_dataset
from vergence.data.timing import moved_readings
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.kinematics import Kinematics, eye_pose
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import transform
from vergence.twin.calibration_sequence import BOARD
from vergence.twin.evaluation import Truth, load_truth
from vergence.twin.profile import (
    CalibrationProcedure,
    ErrorProfile,
    Image,
    Joints,
    Mounting,
)
from vergence.twin.record import CHARUCO, record

PROFILE = ErrorProfile(
    name="test",
    mounting=Mounting(rotation_deg=0.7, translation_mm=2.0),
    image=Image(noise_grey=1.5, blur_px=0.4),
    joints=Joints(
        noise_deg=0.02, delay_ms=20, gain_percent=(1.0, 0, -0.5, 0), offset_deg=(0.3, 0, 0, -0.2)
    ),
    calibration=CalibrationProcedure(square_percent=2.0),
)


SETTINGS: dict[str, Any] = {"profile": PROFILE, "seed": 2, "frames": 12, "moving": 10}
once = pytest.mark.parametrize("recorded", ["chessboard"], indirect=True)
"""For tests in which the board does not matter."""


@pytest.fixture(scope="module", params=["chessboard", "charuco"])
def recorded(
    request, tmp_path_factory, opengl: None, coarsely
) -> tuple[Dataset, Observations, Truth]:
    """A small recording with moving frames at its end."""
    out = tmp_path_factory.mktemp("out") / request.param
    with pytest.MonkeyPatch.context() as patch:
        coarsely(patch)
        images = record(out, target=request.param, **SETTINGS)
    assert len(list((out / "images").iterdir())) == images
    dataset = load_dataset(out)
    return dataset, detect_target(dataset), load_truth(out / "truth.json")


@pytest.mark.usefixtures("coarse_images")
@pytest.mark.render
@pytest.mark.parametrize("kind", ["shared tilt", "with roll", "pair on a neck", "one eye"])
def test_a_head_with_other_joints_is_recorded_within_its_limits(tmp_path, kind):
    head = described_head(kind, tmp_path)
    record(tmp_path / "out", profile=PROFILE, frames=12, moving=3, head=head)
    dataset = load_dataset(tmp_path / "out")
    truth = load_truth(tmp_path / "out" / "truth.json")
    perfect = head.designed.head
    assert dataset.description.head_kinematics.readings == perfect.kinematics.readings
    assert np.ptp(dataset.eye_angles[~dataset.moving], axis=0).min() > 0.01  # all were moved
    lower, upper = head.limits.range_rad[len(head.designed.neck) :].T
    assert ((truth.eye_angles >= lower) & (truth.eye_angles <= upper)).all()
    still = ~dataset.moving
    for eye in head.designed.eyes:  # by the gains and offsets of the sensors, readings are true
        read = eye_pose(truth.head.kinematics, eye, dataset.eye_angles[still])
        true = eye_pose(perfect.kinematics, eye, truth.eye_angles[still])
        np.testing.assert_allclose(read, true, atol=0.004)


def test_corners_lie_where_the_truth_says(recorded):
    dataset, found, truth = recorded
    points = corner_points(truth.board)
    # True angles need no gain and offset; these axes are perfect otherwise.
    head = replace(truth.head, kinematics=Kinematics())
    boards = np.stack(
        [transform(truth.T_lbase_target[int(number)], points) for number in dataset.placement]
    )
    for name in head.cameras:
        pixels = project_point(head, name, truth.eye_angles[:, None], boards)
        errors = found.corners[name] - pixels
        assert np.sqrt(np.nanmean(np.square(errors))) < 0.08
        assert np.nanmax(np.abs(errors)) < 0.5


@once
def test_the_true_delay_explains_the_moving_readings(recorded):
    dataset, found, truth = recorded
    assert truth.time_offset_s == 0.02
    assert found.timing is not None
    np.testing.assert_array_equal(found.timing.run > 0, dataset.moving)
    moving, (pan, _) = dataset.moving, truth.head.kinematics.eyes["left"]
    later = moved_readings(dataset.eye_angles, found.timing, truth.time_offset_s)[moving, 0]
    read = pan.gain * later + pan.offset_rad
    off = truth.eye_angles[moving, 0] - read
    moved = pan.gain * (later - dataset.eye_angles[moving, 0])
    assert abs(off @ moved / (moved @ moved)) < 0.15


@once
@pytest.mark.usefixtures("coarse_images")
def test_the_same_seed_gives_the_same_dataset(recorded, tmp_path):
    record(tmp_path / "again", **SETTINGS)
    before, again = recorded[0].folder, tmp_path / "again"
    files, others = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}
        for folder in (before, again)
    )
    assert files == others


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"frames": 5}, "12 to 10000 frames at rest; asked for 5"),
        ({"moving": 2}, "3 to 10000 frames; asked for 2"),
        ({"moving": -1}, "3 to 10000 frames; asked for -1"),
        ({"seed": -1}, "whole number from 0, found -1"),
    ],
)
def test_what_cannot_be_recorded_is_refused(tmp_path, arguments, sentence):
    with pytest.raises(VergenceError, match=sentence):
        record(tmp_path / "set", profile=PROFILE, **arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_use_is_refused_before_anything_is_rendered(tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(VergenceError, match="not empty"):
        record(tmp_path, profile=PROFILE)


@once
def test_the_truth_is_in_one_file_alone(recorded):
    dataset, _, truth = recorded
    about = json.loads((dataset.folder / "dataset.json").read_text())
    assert set(about["cameras"]) == set(truth.head.cameras)
    assert all("intrinsics" not in camera for camera in about["cameras"].values())
    names = sorted(path.name for path in dataset.folder.iterdir())
    assert names == ["dataset.json", "frames.csv", "images", "truth.json"]
    assert truth.board.square_m == pytest.approx(1.02 * dataset.description.board.square_m)
    assert truth.board in (BOARD, CHARUCO)
