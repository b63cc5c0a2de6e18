"""Watching a run: on this computer only, without delay, and with the same results."""

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from guided_capture import simulated
from rrd import read_series
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.live.capture import CaptureState, begin_capture
from vergence.live.session import run_capture
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.simulated_robot import SimulatedHead
from vergence.viewer import live
from vergence.viewer.capture import capture_blueprint, capture_log
from vergence.viewer.gaze import watch_gaze
from vergence.viewer.layouts import camera_entities, gaze_blueprint
from vergence.viewer.live import Viewer, open_feed, open_viewer
from vergence.viewer.recording import set_time

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

IMAGE = rr.EncodedImage(contents=bytes(200_000), media_type="image/jpeg")


def two_free_ports() -> int:
    """A free port whose successor is free, too."""
    while True:
        with socket.socket() as first, socket.socket() as second:
            first.bind(("127.0.0.1", 0))
            port = first.getsockname()[1]
            try:
                second.bind(("127.0.0.1", port + 1))
            except (OSError, OverflowError):
                continue
            return port


def listening(*ports: int) -> list[str]:
    """Addresses in hexadecimal at which somebody listens on these ports, by IPv4 or 6."""
    rows = []
    for table in ("tcp", "tcp6"):
        rows += [row.split() for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
    wanted = {f"{port:04X}" for port in ports}
    addresses = [row[1].split(":") for row in rows if row[3] == "0A"]
    return [address for address, port in addresses if port in wanted]


def soon_free(port: int) -> bool:
    """Whether a page's ports become free: processes that are killed end a little later."""
    until = time.monotonic() + 10
    while listening(port, port + 1) and time.monotonic() < until:
        time.sleep(0.02)
    return not listening(port, port + 1)


def log_moment(rec: rr.RecordingStream, index: int) -> None:
    set_time(rec, index / 30, index)
    rec.log("image", IMAGE)
    rec.log("curve", rr.Scalars(float(index)))


def test_only_this_computer_is_served_and_nothing_is_left_afterwards(capsys):
    port = two_free_ports()
    with open_viewer(serve=port) as viewer:
        assert listening(port, port + 1) == ["0100007F", "0100007F"]
        with pytest.raises(VergenceError, match=f"two free ports.* {port}: "), open_viewer(port):
            pass
    assert soon_free(port)
    assert capsys.readouterr().err == f"Watch at {viewer.page}\n"


def test_a_program_that_is_killed_leaves_no_server(tmp_path):
    port = two_free_ports()
    program = f"""
import time
from vergence.viewer.live import open_viewer
with open_viewer(serve={port}):
    time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert b"Watch at" in process.stderr.readline()
        process.kill()
    assert soon_free(port)


@pytest.mark.parametrize("disturbance", [None, signal.SIGKILL, signal.SIGSTOP])
def test_a_viewer_that_goes_away_or_hangs_delays_nothing(
    tmp_path, disturbance, capsys, monkeypatch
):
    monkeypatch.setattr(live, "END_S", 0.5)
    file, calls_s = tmp_path / "run.rrd", []
    with open_viewer(serve=two_free_ports()) as viewer:
        with open_feed("test", file=file, viewer=viewer) as feed:
            for index in range(100):
                if index == 20 and disturbance is not None:
                    os.killpg(viewer.process.pid, disturbance)
                began = time.perf_counter()
                feed(log_moment, index)
                calls_s.append(time.perf_counter() - began)
                time.sleep(0.005)
            feed.always(log_moment, 100)
            began = time.perf_counter()
        ended_s = time.perf_counter() - began
    assert np.median(calls_s) < 0.003
    assert max(calls_s) < 0.5  # this thread waits for no viewer, though for a busy processor
    assert ended_s < 2
    _, values = read_series(file, "/curve")
    np.testing.assert_array_equal(values, np.arange(101))
    said = {None: "", signal.SIGKILL: "The viewer has gone; ", signal.SIGSTOP: "The viewer hangs; "}
    assert said[disturbance] in capsys.readouterr().err


def gaze_commands(file: Path, viewer: Viewer | None) -> np.ndarray:
    """Goals (N, j) of a head that looks at an object, while its viewer is killed in between."""
    goals: list[np.ndarray] = []
    with Twin(ErrorProfile(), seed=0) as twin:
        settings = GazeSettings(calibration=twin.truth)
        layout = gaze_blueprint("test", twin.truth, reach_m=1.0, speed=1.0, hand=False)
        with open_feed("test", layout, twin.truth, file=file, viewer=viewer) as feed:
            show = watch_gaze(feed, settings)

            def watch(state: GazeState, frame: Frame | None) -> None:
                if viewer is not None and len(goals) == 3:
                    os.killpg(viewer.process.pid, signal.SIGKILL)
                show(state, frame)
                goals.append(state.command.goal)

            head = SimulatedHead(twin, 0, lambda _: np.array([0.6, 0.05, -0.1]))
            run_gaze(
                head, settings, initial_gaze_state(settings, np.zeros(7), 0.0), 0.3, watch=watch
            )
    return np.array(goals)


@pytest.mark.render
def test_killing_the_viewer_changes_neither_the_commands_nor_the_recording(tmp_path):
    with open_viewer(serve=two_free_ports()) as viewer:
        shown = gaze_commands(tmp_path / "shown.rrd", viewer)
    unseen = gaze_commands(tmp_path / "unseen.rrd", None)
    np.testing.assert_array_equal(shown, unseen)
    for curve in ("/eyes/left_pan", "/error/fused"):
        series = [read_series(tmp_path / name, curve) for name in ("shown.rrd", "unseen.rrd")]
        np.testing.assert_array_equal(*series)
        assert len(series[0][0]) == len(shown)


def test_a_capture_shows_every_frame_and_all_corners_that_were_kept(tmp_path):
    head, settings = simulated(0, 0.006)
    read, file, image = head.read, tmp_path / "capture.rrd", np.zeros((480, 640, 3), np.uint8)
    head.read = lambda names: replace(read(names), images=dict.fromkeys(names, image))
    state, times_s = begin_capture(settings), []
    with open_feed("test", capture_blueprint(state.head), file=file) as feed:
        show = capture_log(feed, settings)

        def look(state: CaptureState, frame: Frame) -> None:
            show(state, frame)
            times_s.append(frame.time_s)
            head.follow(state, frame)

        state = run_capture(
            head, settings, state, lambda rows: None, until_s=20.0, detect=head.detect, look=look
        )
    for name, entity in camera_entities(state.head).items():
        shown_s, _ = read_series(file, f"/{entity}/image", component="EncodedImage:blob")
        np.testing.assert_allclose(shown_s, times_s, atol=1e-6)
        chunks = RrdReader(file).stream().filter(content=f"/{entity}/kept")
        rows = [chunk.to_record_batch().column("Points2D:positions") for chunk in chunks]
        shown = max((row for column in rows for row in column.to_pylist()), key=len)
        wanted = np.concatenate([v.corners[name] for v in state.kept if name in v.corners])
        np.testing.assert_allclose(shown, wanted + 0.5, atol=1e-3)  # positions are float32


def test_a_window_that_cannot_open_is_explained(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(VergenceError, match=r"not start: .*DISPLAY.*--serve"), open_viewer():
        pass
    for port in (-1, 65535, 70000):
        with pytest.raises(VergenceError, match="needs two free ports"), open_viewer(serve=port):
            pass
