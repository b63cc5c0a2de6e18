"""The calibration file, and the frames that follow from it."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from simulated_head import plain_head, skewed_head
from vergence.errors import VergenceError
from vergence.findings import void
from vergence.geometry.head import (
    HeadCalibration,
    base_pose,
    base_pose_in_body,
    camera_pose_in_base,
    load_head,
    parameter_names,
    save_head,
    stated_covariance,
    states_covariance,
    wide_pose_in_narrow,
)
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import inverse, transform

NOT_CONVERGED = void("not-converged", "The estimate did not converge.")


@pytest.fixture
def head() -> HeadCalibration:
    return skewed_head(np.random.default_rng(5))


@pytest.fixture
def file(head: HeadCalibration, tmp_path: Path) -> Path:
    save_head(head, tmp_path / "head.json")
    return tmp_path / "head.json"


def test_a_calibration_comes_back_from_its_file_to_the_last_digit(head, file):
    again = load_head(file)
    assert list(again.cameras) == list(head.cameras)
    np.testing.assert_equal(asdict(again), asdict(head))
    save_head(again, file.with_name("again.json"))
    assert file.read_bytes() == file.with_name("again.json").read_bytes()


def test_the_head_frame_lies_midway_between_the_eyes_with_the_left_eyes_axes(head):
    left, right = base_pose(head, "left"), base_pose(head, "right")
    np.testing.assert_allclose(left[:3, 3] + right[:3, 3], 0, atol=1e-16)
    np.testing.assert_array_equal(left[:3, :3], np.eye(3))
    np.testing.assert_allclose(inverse(right) @ left, head.T_rbase_lbase, atol=1e-15)
    assert base_pose(plain_head(0.09, 280.0), "left")[1, 3] == pytest.approx(0.045)


def test_a_camera_moves_with_pan_then_with_the_neck():
    """A camera 20 mm ahead of the left eye's axes, a baseline of 90 mm, and a yaw of the neck."""
    ahead = (0.02, 0.0, 0.0)
    up, middle = np.array([[0.0, 0, 1]]), np.zeros((1, 3))
    neck = Neck(axes=up, points_m=middle, head_m=up[0], joints=("neck_yaw",))
    head = replace(plain_head(0.09, 280.0, camera_m=(ahead, ahead)), neck=neck)
    quarter = np.pi / 2
    for pan, yaw, where, towards in (
        (0.0, 0.0, (0.02, 0.045, 1.0), (1, 0, 0)),
        (quarter, 0.0, (0.0, 0.065, 1.0), (0, 1, 0)),
        (0.0, quarter, (-0.045, 0.02, 1.0), (0, 1, 0)),
        (quarter, quarter, (-0.065, 0.0, 1.0), (-1, 0, 0)),
    ):
        T_lbase_cam = camera_pose_in_base(head, "left_wide", np.array([pan, 0.0, 0.0, 0.0]))
        T_body_cam = base_pose_in_body(head, "left", np.array([yaw])) @ T_lbase_cam
        np.testing.assert_allclose(T_body_cam[:3, 3], where, atol=1e-15)
        np.testing.assert_allclose(T_body_cam[:3, 2], towards, atol=1e-15)


def test_the_pose_of_the_wide_camera_in_the_narrow_one_maps_wide_to_narrow(head: HeadCalibration):
    point = np.array([0.1, -0.2, 1.0])  # in the wide camera
    in_eye = transform(head.cameras["left_wide"].T_eye_cam, point)
    in_narrow = transform(inverse(head.cameras["left_narrow"].T_eye_cam), in_eye)
    np.testing.assert_allclose(transform(wide_pose_in_narrow(head, "left"), point), in_narrow)


def test_an_unknown_camera_and_a_missing_file_are_named(head: HeadCalibration, tmp_path: Path):
    with pytest.raises(VergenceError, match=r"'middle'.*left_wide, left_narrow, right_wide"):
        head.camera("middle")
    with pytest.raises(VergenceError, match=r"no\.json: No such file"):
        load_head(tmp_path / "no.json")


def test_only_a_head_is_saved(tmp_path: Path):
    with pytest.raises(VergenceError, match=r"save_head takes a HeadCalibration.*; found None"):
        save_head(None, tmp_path / "a.json")  # pyright: ignore[reportArgumentType]
    assert not (tmp_path / "a.json").exists()


def test_an_accuracy_of_parameters_that_the_head_does_not_have_is_refused(tmp_path: Path, head):
    accuracy = Accuracy("bundle", parameters=parameter_names(head)[:2], covariance=np.eye(2))
    save_head(replace(head, accuracy=accuracy), tmp_path / "head.json")
    assert load_head(tmp_path / "head.json").accuracy is not None
    content = json.loads((tmp_path / "head.json").read_text())
    content["cameras"]["left_middle"] = content["cameras"].pop("left_wide")
    (tmp_path / "head.json").write_text(json.dumps(content))
    said = (
        r"head\.json is not a head calibration: accuracy\.parameters has 'left_wide\.fx', .*; "
        r"it has left_narrow\.fx, .* and others\."
    )
    with pytest.raises(VergenceError, match=said):
        load_head(tmp_path / "head.json")


def test_a_head_is_printed_in_one_line(head: HeadCalibration):
    assert repr(head) == (
        "<HeadCalibration of left_wide, left_narrow, right_wide, right_narrow; moved by left_pan, "
        "left_tilt, right_pan, right_tilt; states no accuracy>"
    )


def test_a_void_calibration_is_read_only_where_that_is_asked_for(head, tmp_path: Path):
    void = replace(head, accuracy=Accuracy("bundle", findings=(NOT_CONVERGED,)))
    save_head(void, tmp_path / "void.json")
    with pytest.raises(VergenceError, match=r"void\.json is VOID: The estimate did not converge\."):
        load_head(tmp_path / "void.json")
    read = load_head(tmp_path / "void.json", allow_void=True)
    assert read.accuracy is not None
    assert read.accuracy.findings == (NOT_CONVERGED,)


@pytest.mark.parametrize("text", [b"", b"{", b"# Notes", b"[]", b"\xff\xfe", b"null"])
def test_a_file_that_is_no_calibration_is_refused(tmp_path: Path, text: bytes):
    (tmp_path / "head.json").write_bytes(text)
    with pytest.raises(VergenceError, match=r"head\.json is not a head calibration") as refused:
        load_head(tmp_path / "head.json")
    found = {b"[]": "found []", b"null": "found None"}.get(text, "")
    assert found in str(refused.value)


def test_the_stated_covariance_is_that_of_the_names_in_their_order(head: HeadCalibration):
    C = np.diag([1.0, 4.0, 9.0])
    C[0, 2] = C[2, 0] = 0.5
    names = ("left_wide.fx", "left_wide.fy", "left.pan_gain")
    stated = replace(head, accuracy=Accuracy(method="bundle", parameters=names, covariance=C))
    rows, found = stated_covariance(stated, ["left.pan_gain", "time_offset_s", "left_wide.fx"])
    assert rows.tolist() == [0, 2]
    np.testing.assert_array_equal(found, [[9.0, 0.5], [0.5, 1.0]])
    assert states_covariance(stated)
    for none in (replace(head, accuracy=None), replace(head, accuracy=Accuracy(method="paper"))):
        assert not states_covariance(none)
        assert stated_covariance(none, names)[1].shape == (0, 0)
