"""Fixation with a driver, on a head that draws its own images and on a robot on a bus."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drawn_head import DrawnHead, four_cameras, point_at
from postures import LIMITS, NECK, NECK_JOINTS
from robot_on_a_bus import RobotOnABus, robot_on_a_bus
from rrd import read_series
from vergence import cli
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.demos import simulated_person
from vergence.demos.simulated_person import Person
from vergence.errors import VergenceError
from vergence.gaze.commands import hold
from vergence.geometry.head import load_head, save_head
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.live import capture
from vergence.live.capture import CaptureState
from vergence.live.fixate import fixate
from vergence.live.uvc_servos import UvcServoHead


class DrawnDriver(DrawnHead):
    """A drawn head as a driver, whose images come late and without saying so."""

    limits = LIMITS
    description = Description(
        cameras={
            name: DatasetCamera(camera.eye, width=640, height=480)
            for name, camera in four_cameras().cameras.items()
        },
        joints={name: DatasetJoint(name, unit="rad") for name in (*NECK_JOINTS, *EYE_JOINTS)},
    )
    closed = False

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("late_s", [0.0, 0.1])
def test_an_object_is_centred_while_the_neck_rests_though_images_are_late(late_s: float):
    turned = np.array([0.1, 0.0, -0.2, 0, 0, 0, 0])
    head = DrawnDriver(lambda _: point_at(-12, 9, 0.7))
    head.commands = [hold(turned, LIMITS, -1.0)]
    posture = head.posture
    head.posture = lambda time_s: posture(time_s - late_s)
    found = fixate(head, four_cameras(), seconds=2.0)
    np.testing.assert_array_equal(head.commands[-1].goal[NECK], turned[NECK])
    assert head.errors_px(head.time_s).max() < 2
    assert list(found.final_px) == ["left_narrow", "right_narrow"]
    assert max(found.final_px.values()) < 2
    assert found.found_s == 2.0
    assert found.settled_s is not None
    assert found.settled_s < 1.2


def test_an_object_that_goes_away_is_not_centred():
    head = DrawnDriver(lambda time_s: point_at(3, 2, 0.7) if time_s < 1 else None)
    found = fixate(head, four_cameras(), seconds=2.0)
    assert found.found_s == pytest.approx(1, abs=0.1)
    assert found.settled_s is None
    assert np.isnan(list(found.final_px.values())).all()


def test_an_object_that_is_nowhere_is_one_sentence():
    with pytest.raises(VergenceError, match=r"never found in \d+ frames of left_wide, right_wide"):
        fixate(DrawnDriver(lambda _: None), four_cameras(), seconds=1.0)


def other_size(driver: DrawnDriver) -> None:
    cameras = dict(driver.description.cameras)
    cameras["left_wide"] = DatasetCamera("left", width=320, height=240)
    driver.description = replace(driver.description, cameras=cameras)


def no_limits(driver: DrawnDriver) -> None:
    driver.limits = None  # type: ignore[assignment]


def other_readings(driver: DrawnDriver) -> None:
    joints = dict(driver.description.joints)
    joints["right_tilt"] = joints["left_tilt"]
    driver.description = replace(driver.description, joints=joints)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (other_size, r"'left_wide': \('left', 640, 480\).*'left_wide': \('left', 320, 240\)"),
        (no_limits, "with no limits"),
        (other_readings, r"the readings \('left_pan', .*, 'right_tilt'\), the driver"),
    ],
)
def test_a_calibration_of_another_head_is_refused(change, sentence: str):
    driver = DrawnDriver(lambda _: None)
    change(driver)
    with pytest.raises(VergenceError, match=sentence):
        fixate(driver, four_cameras(), seconds=1.0)


def vergence(monkeypatch: pytest.MonkeyPatch, *words: str | Path) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, words)])
    cli.main()


@pytest.fixture(scope="module")
def robot(opengl: None) -> Iterator[RobotOnABus]:
    pytest.importorskip("dynamixel_sdk")
    with robot_on_a_bus() as robot:
        yield robot


def test_a_robot_on_a_bus_fixates_by_the_command_line(robot, tmp_path, monkeypatch, capsys):
    cameras = {name: robot.truth.cameras[name] for name in robot.cameras}
    save_head(replace(robot.truth, cameras=cameras), tmp_path / "head.json")
    monkeypatch.chdir(tmp_path)
    robot.object_lbase = np.array([0.6, -0.15, 0.1])
    words = ["--driver", "robot_on_a_bus:head", "--calibration", "head.json", "--seconds", "2.5"]
    monkeypatch.setattr("vergence.viewer.live.stay", lambda viewer: None)  # until Ctrl-C
    vergence(monkeypatch, "foveate", *words, "--out", "out", "--serve", "0")
    found = json.loads(Path("out/foveate.json").read_text())
    angles = read_series(Path("out/foveate.rrd"), "/eyes/left_pan")[1]
    assert abs(angles[-1] - angles[0]) > 0.1
    assert max(found["final_px"].values()) < 2
    assert found["settled_s"] < 2
    assert json.loads(capsys.readouterr().out)["found_s"] > 2
    robot.object_lbase = None
    with pytest.raises(SystemExit) as stop:
        vergence(monkeypatch, "foveate", *words)
    assert stop.value.code == 2
    assert "never found" in capsys.readouterr().err


@pytest.mark.skipif("LONG_TESTS" not in os.environ, reason="takes 30 s: set LONG_TESTS=1")
@pytest.mark.usefixtures("two_folds")
def test_a_robot_on_a_bus_is_captured_calibrated_and_fixates(robot, tmp_path, monkeypatch, capsys):
    """A person with a quick hand holds the board where the capture asks for it."""
    monkeypatch.setattr(simulated_person, "MOVE_S", 0.2)
    monkeypatch.setattr(capture, "STILL_S", 0.2)
    person = Person(0)
    robot.T_lbase_board = person.board

    def follow(driver: UvcServoHead, state: CaptureState, frame: Frame) -> None:
        person.follow(state, driver.now_s())

    monkeypatch.setattr(UvcServoHead, "follow", follow, raising=False)
    monkeypatch.chdir(tmp_path)
    driver = "--driver", "robot_on_a_bus:head"
    vergence(monkeypatch, "capture", *driver, "--out", "recording", "--goal-mm", "40")
    told = capsys.readouterr().err
    assert "the accuracy is reached" in told
    assert "next: move the board" in told
    assert "left_wide covered to" in told
    robot.T_lbase_board, robot.object_lbase = lambda time_s: None, np.array([0.6, -0.15, 0.1])
    calibration = "--calibration", "recording/calibration.json"
    vergence(monkeypatch, "foveate", *driver, *calibration, "--seconds", "2.5")
    found = json.loads(capsys.readouterr().out)
    assert max(found["final_px"].values()) < 3
    head = load_head("recording/calibration.json")
    for name in robot.cameras:
        focal_px = robot.truth.camera(name).intrinsics.matrix[0, 0]
        assert head.camera(name).intrinsics.matrix[0, 0] == pytest.approx(focal_px, rel=0.002)
