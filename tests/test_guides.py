"""The programs of the guides do what their pages say."""

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import TypeAdapter

import moving_frames
import vergence
from cards import marker_card
from documents import blocks, commands, first
from drawn_head import DrawnHead, four_cameras, point_at
from texts import texts
from vergence import cli
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.data.reader import load_dataset
from vergence.geometry.head import save_head
from vergence.geometry.kinematics import EYE_JOINTS, EYES
from vergence.geometry.se3 import boxminus


def test_the_guide_to_recording_writes_a_dataset(tmp_path, monkeypatch):
    grey = np.full((480, 640), 90, np.uint8)
    reads = iter(range(1000))
    angles = [np.zeros(4)]

    def read(names: Sequence[str]) -> Frame | None:
        k = next(reads)
        return None if k == 1 else Frame(k, k, angles[-1], np.zeros(3), dict.fromkeys(names, grey))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("builtins.input", lambda _: "")
    postures = [np.array([0.1, -0.2, 0.05, -0.2]), np.array([-0.1, 0.1, -0.2, 0.1])]
    code = next(block.text for block in blocks("docs/dataset.md") if "DatasetRow" in block.text)
    description = Description(
        cameras={f"{eye}_wide": DatasetCamera(eye, width=640, height=480) for eye in EYES},
        board=vergence.Chessboard(columns=9, rows=6, square_m=0.03),
        joints={name: DatasetJoint(name, unit="rad") for name in EYE_JOINTS},
    )
    head = SimpleNamespace(read=read, description=description)
    exec(code, {"head": head, "postures": postures, "move_to": angles.append})
    dataset = load_dataset("my_recording")
    assert dataset.findings == ()
    assert len(set(dataset.placement[:15])) == 15
    assert list(dataset.placement[15:]) == [0, 0]
    np.testing.assert_allclose(dataset.eye_angles[15:], postures)


def run_blocks(document: str, names: dict[str, Any]) -> dict[str, Any]:
    """Run the blocks of Python of a document, as one program."""
    for block in blocks(document):
        if block.language == "python":
            exec(compile(block.text, document, "exec"), names)
    return names


def test_the_guide_to_detectors_runs(tmp_path, monkeypatch, capsys):
    save_head(four_cameras(), tmp_path / "head.json")
    table = np.full((480, 640, 3), 250, np.uint8)
    picture = marker_card("DICT_APRILTAG_36H11", 3, 0.1).picture
    table[200:260, 300:360] = cv2.resize(picture, (60, 60), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(tmp_path / "table.png"), table)
    monkeypatch.chdir(tmp_path)
    names = run_blocks("docs/own_detector.md", {})
    np.testing.assert_allclose(names["found"].pixel, [329.5, 229.5], atol=0.3)
    assert names["bright_spot"](np.zeros((480, 640, 3), np.uint8), None, None) is None
    printed = capsys.readouterr().out
    assert "looking at ball with ('left_wide', 'right_wide', 'left_narrow'" in printed
    assert "No object is called 'cup'" in printed
    assert "centred in ('left_wide', 'right_wide')" in printed


def test_the_guide_to_other_joints_describes_and_uses_them(tmp_path, monkeypatch, capsys):
    described, version = (
        json.loads(block.text)
        for block in blocks("docs/other_joints.md")
        if block.language == "json"
    )
    adapter = TypeAdapter(Description)
    shared = adapter.validate_python(described).head_kinematics
    assert shared.used("left") == [0, 1]
    assert shared.used("right") == [0, 2]
    readings = {name: {"unit": "rad"} for name in ("version", "vergence", "tilt")}
    described |= {"kinematics": version, "readings": readings}
    assert adapter.validate_python(described).head_kinematics.readings == tuple(readings)
    save_head(four_cameras(), tmp_path / "calibration.json")
    monkeypatch.chdir(tmp_path)
    names = run_blocks("docs/other_joints.md", {})
    np.testing.assert_allclose(names["points"].xyz, [[0.6, -0.04, 0.1]], atol=1e-9)
    assert "(3,) [[ 0.6" in capsys.readouterr().out


def test_the_guide_to_drivers_moves_a_head(tmp_path, monkeypatch, capsys):
    """Motors and cameras are those of a drawn head, whose tilt encoders count upwards."""
    drawn = DrawnHead(lambda _: point_at(10, 5, 0.6))
    sign = {"left_pan": 1, "left_tilt": -1, "right_pan": 1, "right_tilt": -1}
    motors = dict.fromkeys(sign, 0.0)
    closed: list[str] = []

    def grab(names: Sequence[str], timeout_s: float) -> SimpleNamespace:
        time.sleep(0.02)
        angles = [sign[name] * motors[name] for name in sign]
        drawn.posture = lambda _: np.array([0.0, 0.0, 0.0, *angles])
        frame = drawn.read(names)
        assert frame is not None
        return SimpleNamespace(time_s=time.monotonic(), images=frame.images)

    robot: Any = ModuleType("my_robot")
    robot.Cameras = lambda: SimpleNamespace(grab=grab, close=lambda: closed.append("cameras"))
    robot.Motors = lambda: SimpleNamespace(angles_rad=motors.copy, move_to=motors.update)
    monkeypatch.setitem(sys.modules, "my_robot", robot)
    monkeypatch.chdir(tmp_path)
    Path("my_head.py").write_text(first("docs/own_driver.md", "python"))
    wide = {name: c for name, c in drawn.calibration.cameras.items() if name.endswith("wide")}
    save_head(replace(drawn.calibration, cameras=wide), "head.json")
    words = next(words for words in commands("docs/own_driver.md") if words[1] == "foveate")
    monkeypatch.setattr(sys, "argv", [*words[:-1], "2"])
    cli.main()
    found = json.loads(capsys.readouterr().out)
    assert max(found["final_px"].values()) < 0.5
    assert motors["left_pan"] > 0.05 > 0 > motors["left_tilt"]
    assert closed == ["cameras"]


@pytest.mark.slow
def test_the_guide_to_self_calibration_runs(tmp_path, monkeypatch):
    save_head(moving_frames.HEAD, tmp_path / "head.json")
    monkeypatch.chdir(tmp_path)
    ((_, frame),) = moving_frames.frames(1)
    pixels = np.array([[320.0, 240.0]])
    names: dict[str, Any] = {
        "frame": frame,
        **{"left_pixels": pixels, "right_pixels": pixels},
    }
    code = next(b.text for b in blocks("docs/locate.md") if "SelfCalibrator" in b.text)
    exec(code, names)
    assert names["seen"].status == "seen"
    assert vergence.load_head("learned.json").accuracy is not None


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, opengl: None, coarsely) -> Path:
    """Return a folder with `my_head`, a dataset of the twin."""
    folder = tmp_path_factory.mktemp("recorded")
    with pytest.MonkeyPatch.context() as patch:
        coarsely(patch)
        words = ["vergence", "record", "--out", str(folder / "my_head"), "--frames", "20"]
        patch.setattr(sys, "argv", words)
        cli.main()
    return folder


@pytest.mark.usefixtures("two_folds")
@pytest.mark.render
def test_the_program_on_the_first_screen_finds_where_points_are(recorded, monkeypatch, capsys):
    from vergence.twin.evaluation import TRUTH, load_truth

    monkeypatch.chdir(recorded)
    truth = load_truth(Path("my_head") / TRUTH).head
    there = np.array([[0.5, -0.05, 0.02], [0.7, 0.1, -0.05]])
    angles = np.array([0.05, -0.02, 0.1, -0.02])
    left, right = (
        vergence.project_point(truth, f"{eye}_wide", angles, there) for eye in ("left", "right")
    )
    names: dict[str, Any] = {"uv_left": left, "uv_right": right, "angles": angles}
    code = first("README.md", "python")
    assert '"my_head/"' in code
    exec(compile(code, "README.md", "exec"), names)
    points = names["points"]
    assert (points.status == vergence.Status.OK).all()
    error = points.xyz - there
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.inv(points.covariance), error)
    assert (distance < 25).all()  # five standard deviations
    assert np.abs(error).max() < 0.02
    assert Path("head.json").exists()
    assert capsys.readouterr().out.strip()


@pytest.mark.render
def test_the_program_that_shows_a_loop_shows_images_of_the_left_camera(
    recorded, monkeypatch, capsys
):
    monkeypatch.chdir(recorded)
    code = first("docs/live.md", "python").replace("serve=9090", "serve=0")
    names: dict[str, Any] = {}
    logged: list[tuple[Any, ...]] = []
    monkeypatch.setattr("vergence.viewer.recording.log_image", lambda *of: logged.append(of))
    exec(compile(code, "docs/live.md", "exec"), names)
    assert "Watch at http://127.0.0.1:" in capsys.readouterr().err
    assert logged
    assert all(entity == "left" for _, entity, _ in logged)


@pytest.mark.usefixtures("two_folds")
@pytest.mark.render
def test_each_ten_line_program_runs_by_itself(recorded, monkeypatch, capsys):
    monkeypatch.chdir(recorded)
    programs = [b.text for b in blocks("docs/ten_line_programs.md") if b.language == "python"]
    results = []
    for code in programs:
        names: dict[str, Any] = {}
        exec(compile(code, "ten_line_programs.md", "exec"), names)
        assert capsys.readouterr().out.strip()
        results.append(names)
        lines = [line for line in code.splitlines() if line and not line.startswith("import ")]
        assert len(lines) <= 10
    calibrated, located, learned, followed, gaze, depth, exported = results
    assert not texts(calibrated["result"].findings, "void")
    np.testing.assert_allclose(located["points"].xyz, located["there"], atol=1e-6)
    assert learned["result"].head.cameras.keys() == calibrated["result"].head.cameras.keys()
    assert np.isfinite(followed["estimate"].joints).all()
    assert gaze["state"].frame_s > 0
    assert len(depth["points"]) > 1000
    assert exported["imported"].cameras.keys() == exported["head"].cameras.keys()


def test_the_guide_to_calibration_runs(tmp_path, monkeypatch, capsys):
    head = four_cameras()
    vergence.save_head(head, tmp_path / "calibration.json")
    monkeypatch.chdir(tmp_path)
    programs = [b.text for b in blocks("docs/calibrate.md") if b.language == "python"]
    _, trackers = programs
    names: dict[str, Any] = {}
    exec(compile(trackers, "calibrate.md", "exec"), names)
    mounted = names["found"].head.cameras["left_wide"]
    off = boxminus(mounted.T_eye_cam, head.cameras["left_wide"].T_eye_cam)
    assert np.linalg.norm(off[:3]) < np.radians(0.05)
    assert np.linalg.norm(off[3:]) < 1e-3
    assert texts(names["found"].findings, "void") == []
    assert capsys.readouterr().out.strip()


def test_the_guide_to_calibration_describes_corners_of_another_detector(monkeypatch):
    """What is calibrated from such corners is in test_calibrate.py."""
    monkeypatch.setattr(vergence, "calibrate", lambda observations: observations)
    code = first("docs/calibrate.md", "python")
    left, right = np.full((2, 3, 54, 2), np.nan)
    names: dict[str, Any] = {"left": left, "right": right}
    names |= {"placement": np.array([0, 1, 1]), "readings": np.zeros((3, 4))}
    exec(compile(code, "calibrate.md", "exec"), names)
    assert names["result"].corners["right_wide"].shape == (3, 54, 2)


def test_the_guide_to_locating_points_runs(tmp_path, monkeypatch, capsys):
    text = first("docs/calibration_file.md", "json")
    head = json.loads(text)
    left = head["cameras"]["left_wide"]
    narrow = json.loads(json.dumps(left))
    narrow["intrinsics"]["matrix"] = [[1200.0, 0, 319.5], [0, 1200.0, 239.5], [0, 0, 1]]
    narrow["intrinsics"]["distortion"] = [0.0] * 5
    head["cameras"] = {
        f"{eye}_{lens}": {**camera, "eye": eye}
        for eye in ("left", "right")
        for lens, camera in (("wide", left), ("narrow", narrow))
    }
    head["accuracy"] = {
        **{"method": "bundle", "parameters": ["left_wide.fx"], "covariance": [[0.01]]},
        **{"pixel_std_px": 0.1, "joint_std": [0.001]},
    }
    (tmp_path / "head.json").write_text(json.dumps(head))
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks("docs/locate.md"):
        if block.language == "python" and "SelfCalibrator" not in block.text:
            exec(compile(block.text, "locate.md", "exec"), names)
            if "dense_depth" not in block.text:
                located = names["points"]
    assert names["found"].depth_m.shape == names["left"].shape[:2] == (480, 640)
    assert not names["found"].textured.any()  # the images of the guide are black
    assert (located.status == vergence.Status.OK).all()
    assert (names["narrow"].status == vergence.Status.OK).all()
    np.testing.assert_allclose(names["xyz_head"][:, 0], [0.6, 0.72], atol=0.01)
    printed = capsys.readouterr().out
    assert printed.count("depth") == 2
    assert "nan" not in printed
