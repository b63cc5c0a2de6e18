"""Watching a run: on this computer only, without delay, and with the same results."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from rrd import read_series
from vergence.errors import VergenceError
from vergence.viewer import live
from vergence.viewer.live import open_feed, open_viewer
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


def log_moment(rec: rr.RecordingStream, index: int) -> None:
    set_time(rec, index / 30, index)
    rec.log("image", IMAGE)
    rec.log("curve", rr.Scalars(float(index)))


def test_only_this_computer_is_served_and_nothing_is_left_afterwards(capsys):
    port = two_free_ports()
    with open_viewer(serve=port) as viewer:
        assert viewer is not None
        assert listening(port, port + 1) == ["0100007F", "0100007F"]
        with pytest.raises(VergenceError, match=f"cannot use port {port}"), open_viewer(serve=port):
            pass
    assert listening(port, port + 1) == []
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
    until = time.monotonic() + 10
    while listening(port, port + 1) and time.monotonic() < until:
        time.sleep(0.02)
    assert listening(port, port + 1) == []


@pytest.mark.parametrize("disturbance", [None, signal.SIGKILL, signal.SIGSTOP])
def test_a_viewer_that_goes_away_or_hangs_delays_nothing(
    tmp_path, disturbance, capsys, monkeypatch
):
    monkeypatch.setattr(live, "END_S", 0.5)
    file, calls_s = tmp_path / "run.rrd", []
    with open_viewer(serve=two_free_ports()) as viewer:
        assert viewer is not None
        with open_feed("test", file=file, viewer=viewer) as feed:
            for index in range(60):
                if index == 20 and disturbance is not None:
                    os.killpg(viewer.process.pid, disturbance)
                began = time.perf_counter()
                feed(log_moment, index)
                calls_s.append(time.perf_counter() - began)
                time.sleep(0.005)
            feed.always(log_moment, 60)
            began = time.perf_counter()
        ended_s = time.perf_counter() - began
    assert np.median(calls_s) < 0.003
    assert max(calls_s) < 0.5  # this thread waits for no viewer, though for a busy processor
    assert ended_s < 2
    _, values = read_series(file, "/curve")
    np.testing.assert_array_equal(values, np.arange(61))
    said = {None: "", signal.SIGKILL: "The viewer has gone; ", signal.SIGSTOP: "The viewer hangs; "}
    assert said[disturbance] in capsys.readouterr().err
