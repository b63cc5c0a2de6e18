"""Heads that are not built like this project's: one eye, other names, poses, no straight gaze."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from observed import BOARD, Recording, as_poses, head, observe

from recordings import description, write_dataset
from vergence import cli
from vergence.calibration import calibrate as solving
from vergence.calibration.calibrate import Answer, Method, estimate
from vergence.calibration.checks.cross_validation import Observations
from vergence.calibration.detection import Detections
from vergence.data.dataset import Dataset, pose_columns
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, load, main_pair
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Side
from vergence.geometry.parameters import difference
from vergence.geometry.se3 import pose

QUIET = Recording(reach_rad=(0.3, 0.3), joint_std_rad=np.radians(0.05))
METHODS: tuple[Method, ...] = ("refined", "paper")


def recorded(seed: int, *, narrow: bool = False) -> tuple[HeadCalibration, Observations]:
    rng = np.random.default_rng(seed)
    truth = head(rng, narrow=narrow)
    return truth, observe(truth, rng, QUIET)


def only(seen: Observations, names: dict[str, str], eyes: dict[str, Side]) -> Observations:
    """Return what some cameras saw, under other names."""
    views = seen.views
    chosen = replace(
        views,
        corners={new: views.corners[old] for old, new in names.items()},
        sizes={new: views.sizes[old] for old, new in names.items()},
        eyes=eyes,
    )
    return replace(seen, views=chosen)


def assert_near(found: Answer, truth: HeadCalibration) -> None:
    off = difference(found.head, truth)
    for name, value in off.items():
        if "T_eye_cam.r" in name or "T_rbase_lbase.r" in name:
            assert abs(value) < np.radians(0.4), name
        if "T_eye_cam.t" in name or "T_rbase_lbase.t" in name:
            assert abs(value) < 0.004, name


@pytest.mark.parametrize("method", METHODS)
def test_eyes_that_give_poses_are_calibrated(method: Method):
    truth, seen = recorded(1)
    found = estimate(as_poses(seen), method=method)
    assert_near(found, truth)
    assert found.head.accuracy is not None
    assert found.head.accuracy.eye_motion == "poses"
    assert found.head.accuracy.warnings == ()


def test_eye_poses_about_one_axis_are_refused_with_the_axis():
    rng = np.random.default_rng(2)
    seen = observe(head(rng), rng, Recording(reach_rad=(0.25, 0)))
    with pytest.raises(
        VergenceError, match=r"rotation about and translation along \(-?0\.0.*1\.00\)"
    ):
        estimate(as_poses(seen))


@pytest.mark.parametrize(("side", "method"), [("left", "refined"), ("right", "paper")])
def test_a_head_of_one_eye_is_calibrated(side: str, method: Method):
    truth, seen = recorded(3, narrow=True)
    names = {f"{side}_wide": f"{side}_wide", f"{side}_narrow": f"{side}_narrow"}
    found = estimate(only(seen, names, {}), method=method)
    alone = replace(
        truth,
        cameras={name: truth.cameras[name] for name in names},
        T_rbase_lbase=np.eye(4),
    )
    assert_near(found, alone)
    assert main_pair(found.head) is None
    assert found.head.accuracy is not None
    assert found.head.accuracy.warnings == ()
    assert not any("T_rbase" in name for name in found.head.accuracy.parameters)


def test_cameras_may_be_called_anything_and_sit_three_in_an_eye():
    truth, seen = recorded(4, narrow=True)
    third = truth.cameras["left_wide"]
    third = replace(third, T_eye_cam=third.T_eye_cam @ pose(t=[0.01, 0.01, 0]))
    truth = replace(truth, cameras={**truth.cameras, "left_third": third})
    seen = observe(truth, np.random.default_rng(5), QUIET)
    names = {"left_wide": "port", "left_narrow": "port_narrow", "left_third": "thermal",
             "right_wide": "starboard"}  # fmt: skip
    eyes = {new: truth.cameras[old].eye for old, new in names.items()}
    found = estimate(only(seen, names, eyes))
    renamed = {new: truth.cameras[old] for old, new in names.items()}
    assert_near(found, replace(truth, cameras=renamed))
    assert main_pair(found.head) == ("port", "starboard")


@pytest.mark.parametrize("method", METHODS)
def test_without_straight_gaze_a_board_before_both_eyes_will_do(method: Method):
    rng = np.random.default_rng(7)
    truth = head(rng)
    # Boards held at many places while the eyes look somewhere else than straight ahead.
    seen = observe(truth, rng, replace(QUIET, gaze_rad=(0.1, -0.08)))
    assert (np.abs(seen.views.eye_angles) > 0.05).any(axis=1).all()
    found = estimate(seen, method=method)
    assert_near(found, truth)
    assert found.start.stereo_rms_px is None


def test_eyes_that_never_see_one_board_together_are_refused():
    _, seen = recorded(8)
    corners = {name: each.copy() for name, each in seen.views.corners.items()}
    corners["left_wide"][::2] = np.nan
    corners["right_wide"][1::2] = np.nan
    with pytest.raises(VergenceError, match="T_rbase_lbase is not observable: no view shows the"):
        estimate(replace(seen, views=replace(seen.views, corners=corners)))


def write_folder(folder: Path, seen: Observations, eyes: dict[str, Side]) -> None:
    """Write a dataset of these cameras whose images show nothing."""
    views = seen.views
    about = description(BOARD, (640, 480)) | {
        "cameras": {name: {"eye": eye, "width": 640, "height": 480} for name, eye in eyes.items()}
    }
    poses = seen.T_base_eye
    if poses is not None:
        about |= {"joints": {}, "eye_motion": "poses"}
    table = []
    for v, placement in enumerate(views.placement):
        row = {"time_s": v + 1.0, "joint_time_s": v + 1.0, "placement": placement}
        if poses is None:
            row |= dict(zip(EYE_JOINTS, views.eye_angles[v].tolist(), strict=True))
        else:
            for k, eye in enumerate(EYES):
                columns = pose_columns(eye)
                row |= dict(zip(columns, poses[v, k].ravel().tolist(), strict=True))
        table.append(row | {name: f"images/{name}_{v}.png" for name in eyes})
    images = {row[name]: np.zeros((1, 1), np.uint8) for row in table for name in eyes}
    write_dataset(folder, table, about, images)


@pytest.mark.parametrize("poses", [False, True])
def test_other_heads_go_all_the_way_from_a_folder_to_a_report(
    poses: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    truth, seen = recorded(9)
    eyes: dict[str, Side] = {"port": "left", "starboard": "right"}
    seen = only(seen, {"left_wide": "port", "right_wide": "starboard"}, eyes)
    seen = as_poses(seen) if poses else seen
    write_folder(tmp_path / "set", seen, eyes)
    # Corners as if they had been found.
    found = Detections(seen.views, None, seen.T_base_eye, (), ())
    monkeypatch.setattr(solving, "detect", lambda *_, **__: found)
    monkeypatch.setattr(Dataset, "image", lambda *_: np.zeros((480, 640, 3), np.uint8))
    out, report = tmp_path / "head.json", tmp_path / "report"
    arguments = [tmp_path / "set", "--out", out, "--report", report]
    monkeypatch.setattr(sys, "argv", ["vergence", "calibrate", *map(str, arguments)])
    cli.main()
    printed = capsys.readouterr().out
    assert printed.startswith("UNKNOWN" if poses else ("GOOD", "FAIR"))
    assert ("mm in eye poses" in printed) == poses
    assert (report / "report.md").read_text().startswith("# Calibration")
    calibrated = load(out)
    assert main_pair(calibrated) == ("port", "starboard")
    assert calibrated.accuracy is not None
    assert calibrated.accuracy.eye_motion == ("poses" if poses else "pan-tilt")
    checked = calibrated.accuracy.held_out
    assert checked is not None
    assert checked.transfer_views > 10
    assert (checked.point_mm is None) == poses
    off = calibrated.T_rbase_lbase[:3, 3] - truth.T_rbase_lbase[:3, 3]
    assert np.abs(off).max() < 0.004
