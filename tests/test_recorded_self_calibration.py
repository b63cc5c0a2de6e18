"""`vergence self-calibrate`: what a recording shows of a head, and what it cannot show."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from moving_frames import GAIN, HEAD, frames, one_eyed, turn_error
from texts import texts
from vergence import cli
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard
from vergence.geometry.head import HeadCalibration, load_head, save_head
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Kinematics, Side, pan_tilt
from vergence.geometry.parameters import change_named
from vergence.self_calibration.prior import MOVED, USUAL, Changed, initial_state
from vergence.self_calibration.recorded import self_calibrate


@pytest.fixture(scope="module")
def moving(slow_setup: None) -> list[tuple[Array, Frame]]:
    return frames(10)


DESCRIPTION = Description(
    cameras={f"{eye}_wide": DatasetCamera(eye=eye, width=640, height=480) for eye in EYES},
    board=Chessboard(columns=9, rows=6, square_m=0.03),
    joints={name: DatasetJoint(column=name, unit="rad") for name in EYE_JOINTS},
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, moving):
    """A dataset of the moving eyes, and their calibration."""
    folder = tmp_path_factory.mktemp("recorded")
    rows = [DatasetRow(each, k, False) for k, (_, each) in enumerate(moving)]
    write_dataset(folder / "data", DESCRIPTION, rows)
    save_head(HEAD, folder / "head.json")
    return folder


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", "self-calibrate", *map(str, words)])
    cli.main()


def test_a_recording_says_what_it_shows_and_claims_no_more(recorded, monkeypatch, capsys):
    out, figures = recorded / "learned.json", recorded / "figures.json"
    words = recorded / "data", "--calibration", recorded / "head.json", "--out", out
    command(monkeypatch, *words, "--json", figures)
    said, found = capsys.readouterr().out, json.loads(figures.read_text())
    learned = load_head(out)
    assert learned.accuracy is not None
    assert (found["frames"], found["seen"], found["learned"]) == (10, 10, 9)
    assert found["depth_std_m"][1] < found["depth_std_m"][0] / 2
    counts = (
        "10 frames: 10 determined the relative pose of the cameras, and 9 updated the parameters"
    )
    assert counts in said
    assert "states no covariance" in said
    assert "observed" in said
    assert "Depth of a point 1 m straight ahead" in said
    assert "(assumed)" not in said
    assert "by what was learned" in said
    for name, each in found["parameters"].items():
        std = float(np.sqrt(learned.accuracy.covariance.diagonal()[
            learned.accuracy.parameters.index(name)
        ]))  # fmt: skip
        assert each["std"] == pytest.approx(std)
        true = 1 / GAIN - 1 if name.endswith("gain") else 0.0
        assert abs(each["change"] - true) < 4 * std
    assert found["parameters"]["left.pan_gain"]["verdict"] == "observed"


def test_a_head_that_was_just_calibrated_is_better_known_before(
    moving, tmp_path, monkeypatch, capsys
):
    rows = [DatasetRow(each, k, False) for k, (_, each) in enumerate(moving[:3])]
    write_dataset(tmp_path / "data", DESCRIPTION, rows)
    save_head(HEAD, tmp_path / "head.json")
    stds = {}
    for changed in ("nothing", "little"):
        out, figures = tmp_path / f"{changed}.json", tmp_path / f"{changed}_figures.json"
        words = tmp_path / "data", "--calibration", tmp_path / "head.json", "--out", out
        command(monkeypatch, *words, "--json", figures, "--changed", changed)
        found, said = json.loads(figures.read_text()), capsys.readouterr().out
        stds[changed] = {name: each["prior_std"] for name, each in found["parameters"].items()}
        assert ("what may have moved since" in said) == (changed == "little")
    assert all(stds["nothing"][name] <= std for name, std in stds["little"].items())
    assert stds["nothing"]["left_wide.cx"] == pytest.approx(USUAL.centre_px, rel=1e-3)
    both = np.hypot(USUAL.centre_px, MOVED.centre_px)
    assert stds["little"]["left_wide.cx"] == pytest.approx(both, rel=1e-3)


def test_a_repaired_head_is_learned_whatever_its_calibration_states(recorded):
    """Its gains are stated to 0.05 %, and have become wrong by 3 %."""
    plain = initial_state(HEAD)
    certain = 2.5e-4 * np.diag(np.diag(plain.covariance))
    head = replace(HEAD, accuracy=Accuracy("bundle", plain.names, certain, joint_std=(2e-3,)))
    found = {
        changed: self_calibrate(load_dataset(recorded / "data"), head, changed=changed)
        for changed in get_args(Changed)
    }
    gains = {
        changed: [each for each in one.parameters if each.name.endswith("gain")]
        for changed, one in found.items()
    }
    for each in gains["anything"]:
        assert abs(each.change - (1 / GAIN - 1)) < 3 * each.std < 0.06
    for changed in ("nothing", "little"):
        assert max(abs(each.change) for each in gains[changed]) < 0.01
    assert not texts(found["anything"].findings)
    said = found["anything"].summary()
    assert "mm by usual tolerances, " in said
    # The noise of the readings is that of the encoders, whatever became of the head.
    state = initial_state(head, changed="anything")
    assert state.reading_std == pytest.approx(2e-3)


def test_eyes_that_do_not_move_show_nothing_that_persists(tmp_path, moving):
    _, one = moving[0]
    rows = [
        DatasetRow(replace(one, time_s=float(k), joint_time_s=float(k)), k, False) for k in range(3)
    ]
    write_dataset(tmp_path / "still", DESCRIPTION, rows)
    found = self_calibrate(load_dataset(tmp_path / "still"), HEAD)
    assert found.head is HEAD
    assert {each.verdict for each in found.parameters} == {"not observed"}
    assert any("did not move" in each for each in texts(found.findings))
    said = found.summary()
    assert "(assumed)" in said
    assert "by what was learned" not in said


def test_a_recording_in_which_one_eye_was_covered_returns_the_calibration(tmp_path, moving):
    dark = np.full((480, 640, 3), 20, np.uint8)
    rows = [
        DatasetRow(replace(each, images={**each.images, "right_wide": dark}), k, False)
        for k, (_, each) in enumerate(moving[:3])
    ]
    write_dataset(tmp_path / "covered", DESCRIPTION, rows)
    found = self_calibrate(load_dataset(tmp_path / "covered"), HEAD)
    assert found.head is HEAD
    assert found.learned == 0
    assert any("showed enough of the scene" in each for each in texts(found.findings))


def test_a_head_that_is_not_as_calibrated_is_learned_anew(recorded):
    drawn = change_named(
        HEAD,
        ("left_wide.fx", "left_wide.fy", "left_wide.cx", "right_wide.cy", "T_rbase_lbase.ry"),
        np.array([-20.0, -20.0, 5.0, -5.0, np.radians(2.0)]),
    )
    data = load_dataset(recorded / "data")
    found = self_calibrate(data, drawn)
    straight = np.zeros(4)
    assert turn_error(found.head, straight, straight) < 0.1 * turn_error(drawn, straight, straight)
    assert any(
        "farther from its calibration than the stated covariance" in each
        for each in texts(found.findings)
    )


def test_a_camera_that_stands_otherwise_than_calibrated_is_named(recorded):
    data = load_dataset(recorded / "data")
    calibrated = self_calibrate(data, HEAD)
    turned = change_named(calibrated.head, ["right_wide.T_eye_cam.ry"], np.radians([1.0]))
    said = "right_wide.T_eye_cam.ry changed by more than 4 prior standard deviations"
    assert not any("changed by more than" in each for each in texts(calibrated.findings))
    assert any(each.startswith(said) for each in texts(self_calibrate(data, turned).findings))


def other_names() -> HeadCalibration:
    cameras = {name.replace("wide", "main"): each for name, each in HEAD.cameras.items()}
    return replace(HEAD, cameras={n: c for n, c in cameras.items() if "main" in n})


def half_size() -> HeadCalibration:
    cameras = {
        name: replace(each, intrinsics=replace(each.intrinsics, width=320, height=240))
        for name, each in HEAD.cameras.items()
    }
    return replace(HEAD, cameras=cameras)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (one_eyed, "Stereo needs a camera in each eye"),
        (other_names, "The calibration's main cameras are left_main and right_main"),
        (half_size, "is for images of 320 x 240 px"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused(
    head, said, recorded, tmp_path, monkeypatch, capsys
):
    save_head(head(), tmp_path / "head.json")
    words = recorded / "data", "--calibration", tmp_path / "head.json", "--out", tmp_path / "x.json"
    with pytest.raises(SystemExit) as stop:
        command(monkeypatch, *words)
    assert stop.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()


def test_poses_and_other_readings_are_refused(recorded):
    data = load_dataset(recorded / "data")
    poses = replace(data, T_base_eye=np.tile(np.eye(4), (len(data), 2, 1, 1)))
    with pytest.raises(VergenceError, match="has poses of the eyes"):
        self_calibrate(poses, HEAD)
    joints: dict[Side, tuple[Joint, ...]] = {eye: tuple(shared_tilt(eye)) for eye in EYES}
    other = replace(HEAD, kinematics=Kinematics(joints, ("left_pan", "right_pan", "tilt")))
    with pytest.raises(VergenceError, match="is for the joint readings left_pan, right_pan, tilt;"):
        self_calibrate(data, other)


def shared_tilt(eye: Side) -> Iterator[Joint]:
    for joint in pan_tilt(eye):
        yield replace(joint, readings={"tilt": 1.0}) if joint.name == "tilt" else joint
