"""The driver for Reachy Mini: on a robot that turns as it is told, and on its maker's simulation.

The maker's package needs system headers (`gi`, for audio and video) and another version of MuJoCo;
where it was installed without its dependencies, its simulation is tried with the present one.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vergence import cli
from vergence.arrays import Array
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand, setpoint
from vergence.geometry.se3 import pose
from vergence.live import reachy_mini
from vergence.live.driver import open_driver
from vergence.live.reachy_mini import BOARD, ReachyMiniHead

WIDTH, HEIGHT = 640, 360
DRIVER = "vergence.live.reachy_mini:ReachyMiniHead"


class ObedientRobot:
    """Is where it is told to be."""

    pose = np.eye(4)
    released = False

    def __init__(self, automatic_body_yaw: bool):
        assert not automatic_body_yaw
        blue = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        blue[..., 0] = 200  # BGR
        self.media = SimpleNamespace(get_frame=lambda: blue)

    def set_target_head_pose(self, pose: Array) -> None:
        self.pose = pose

    def get_current_head_pose(self) -> Array:
        return self.pose

    def __exit__(self, *_: object) -> None:
        self.released = True


def package(monkeypatch: pytest.MonkeyPatch, robot: Any) -> None:
    module: Any = ModuleType("reachy_mini")
    module.ReachyMini = robot
    monkeypatch.setitem(sys.modules, "reachy_mini", module)


def turn(head: Any, goal: Array, wait_s: float) -> None:
    """Turn the head to pan, tilt and roll [rad]."""
    now_s = head.now_s()
    start = setpoint(head._command, now_s)
    head.command(HeadCommand(now_s, start, goal, np.zeros(3), head.limits))
    time.sleep(wait_s)


def test_readings_and_commands_are_pan_tilt_and_roll(monkeypatch):
    robot = ObedientRobot(False)
    package(monkeypatch, lambda automatic_body_yaw: robot)
    head = ReachyMiniHead()
    goal = np.array([0.3, -0.2, 0.1])
    turn(head, goal, 0.3)
    found = head.read(("camera",))
    np.testing.assert_allclose(found.eye_angles, goal, atol=1e-9)
    assert found.images["camera"][0, 0].tolist() == [0, 0, 200]
    left = Rotation.from_matrix(robot.pose[:3, :3]).apply([1.0, 0, 0])
    assert left[1] > 0.2  # pan is positive to the left
    assert left[2] > 0.1  # and tilt negative up
    (left_eye, _) = head.description.head_kinematics.chains.values()
    assert left_eye.axes.tolist() == [[0, 0, 1], [0, 1, 0], [1, 0, 0]]
    head.close()
    assert robot.released


def test_a_missing_robot_or_camera_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "reachy_mini", None)
    with pytest.raises(VergenceError, match="pip install reachy_mini"):
        open_driver(DRIVER)
    robot = ObedientRobot(False)
    robot.media.get_frame = lambda: None
    package(monkeypatch, lambda automatic_body_yaw: robot)
    monkeypatch.setattr(reachy_mini, "FAILED_S", 0.05)
    with pytest.raises(VergenceError, match="camera gives no images"):
        open_driver(DRIVER)


class SimulatedRobot(ObedientRobot):
    """The maker's simulation, before a board and a red ball, with the robot itself out of sight."""

    def __init__(self, backend: Any):
        import mujoco

        super().__init__(False)
        scene = Path(sys.modules["reachy_mini"].__file__ or "").parent
        scene /= "descriptions/reachy_mini/mjcf/scenes/empty.xml"
        spec = mujoco.MjSpec.from_file(str(scene))
        for geom in spec.geoms:
            geom.group = 4
        self._body(spec, "ball", mujoco.mjtGeom.mjGEOM_SPHERE, [([0.03, 0, 0], [0, 0, 0], 2)])
        side, (columns, rows) = BOARD.square_m, (BOARD.columns, BOARD.rows)
        middle = np.array([columns - 1, rows - 1]) * side / 2
        geoms = [([0.2, 0.15, 0.001], [*middle, 0.0025], 1)]
        for i, j in np.ndindex(columns + 1, rows + 1):
            if (i + j) % 2 == 0:
                at = [(i - 0.5) * side, (j - 0.5) * side, 0.0]
                geoms.append(([side / 2, side / 2, 0.0005], at, 0))
        self._body(spec, "board", mujoco.mjtGeom.mjGEOM_BOX, geoms)
        backend.model, step_s = spec.compile(), backend.model.opt.timestep
        backend.model.opt.timestep, backend.data = step_s, mujoco.MjData(backend.model)
        backend.head_site_id, backend.col_inds = backend.model.site("head").id, []
        backend.model.geom_contype[:] = backend.model.geom_conaffinity[:] = 0
        self.backend, self._option = backend, mujoco.MjvOption()
        self._option.geomgroup[4] = 0
        self._renderer = mujoco.Renderer(backend.model, HEIGHT, WIDTH)
        self._thread = threading.Thread(target=backend.run, daemon=True)
        self._thread.start()
        self.media = SimpleNamespace(get_frame=self.picture)
        self.set_target_head_pose = backend.set_target_head_pose
        time.sleep(1.5)  # until it stands

    @staticmethod
    def _body(spec: Any, name: str, kind: Any, geoms: list[Any]) -> None:
        colours = [0, 0, 0, 1], [1, 1, 1, 1], [0.9, 0.05, 0.05, 1]
        body = spec.worldbody.add_body(name=name, mocap=True, pos=[-2, 0, 1])
        for size, at, colour in geoms:
            body.add_geom(type=kind, size=size, pos=at, rgba=colours[colour])

    def picture(self) -> np.ndarray:
        self._renderer.update_scene(self.backend.data, "eye_camera", scene_option=self._option)
        return self._renderer.render()[..., ::-1]

    def get_current_head_pose(self) -> Array:
        return self.backend.get_present_head_pose().copy()

    def T_world_cam(self) -> Array:
        camera = self.backend.data.cam("eye_camera")
        return pose(camera.xmat.reshape(3, 3) @ np.diag([1, -1, -1]), camera.xpos)

    def put(self, body: str, T_world_body: Array) -> None:
        mocap = self.backend.model.body(body).mocapid[0]
        self.backend.data.mocap_pos[mocap] = T_world_body[:3, 3]
        turned = Rotation.from_matrix(T_world_body[:3, :3]).as_quat(scalar_first=True)
        self.backend.data.mocap_quat[mocap] = turned

    def __exit__(self, *_: object) -> None:
        """Stay for the next driver."""

    def end(self) -> None:
        self.backend.should_stop.set()
        self._thread.join()
        self._renderer.close()


@pytest.fixture
def simulation(opengl: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimulatedRobot]:
    for name in ("gi", "gi.repository"):  # sound and video, which are not used
        monkeypatch.setitem(sys.modules, name, MagicMock())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            from reachy_mini.daemon.backend.mujoco.backend import (  # type: ignore[import-not-found]
                MujocoBackend,
            )
        except ImportError as error:
            pytest.skip(f"Reachy Mini's package is missing: {error}")
        robot = SimulatedRobot(MujocoBackend(headless=True))
    monkeypatch.setattr(sys.modules["reachy_mini"], "ReachyMini", lambda **_: robot)
    yield robot
    robot.end()


@pytest.mark.slow
def test_the_makers_simulation_is_calibrated_and_fixates(simulation, tmp_path, monkeypatch, capsys):
    rng, rows = np.random.default_rng(0), []
    middle = pose(t=[-0.12, -0.075, 0])
    head = open_driver(DRIVER)
    turn(head, np.zeros(3), 1.0)
    T_world_cam = simulation.T_world_cam()
    for placement in range(12):
        t = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.25, 0.5)]
        R = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)).as_matrix()
        simulation.put("board", T_world_cam @ pose(R, t) @ middle)
        time.sleep(0.1)
        rows.append(DatasetRow(head.read(("camera",)), placement))
    R = Rotation.from_rotvec([0.25, -0.2, 0.05]).as_matrix()
    simulation.put("board", T_world_cam @ pose(R, [0, 0, 0.5]) @ middle)
    for _ in range(20):
        turn(head, rng.uniform(-1, 1, 3) * [0.3, 0.2, 0.2], 0.8)
        rows.append(DatasetRow(head.read(("camera",)), 12))
    write_dataset(tmp_path / "recording", head.description, rows)
    head.close()
    simulation.put("board", pose(t=[-2.0, 0, 1]))
    simulation.put("ball", pose(t=[0.8, 0.15, 0.3]))
    monkeypatch.chdir(tmp_path)
    words = ["--driver", DRIVER, "--calibration", "head.json", "--seconds", "4"]
    for command in (["calibrate", "recording", "--out", "head.json"], ["foveate", *words]):
        monkeypatch.setattr(sys, "argv", ["vergence", *command])
        capsys.readouterr()
        cli.main()
    assert json.loads(capsys.readouterr().out)["final_px"]["camera"] < 8
    ball = (np.linalg.inv(simulation.T_world_cam()) @ [0.8, 0.15, 0.3, 1])[:3]
    focal_px = HEIGHT / 2 / np.tan(np.radians(40))
    assert np.linalg.norm(focal_px * ball[:2] / ball[2]) < 8
