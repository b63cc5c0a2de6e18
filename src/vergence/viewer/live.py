"""Watch a run while it goes on, in rerun's window or in a browser, on this computer only.

A viewer never delays the run: a thread feeds it, and skips moments while it lags.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import rerun as rr
import rerun.blueprint as rrb

from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.viewer import style
from vergence.viewer.layouts import following
from vergence.viewer.recording import log_surroundings, recording_file

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to watch a real head
    from vergence.twin.appearance import VisualGeom

HOST = "127.0.0.1"
"""The address of this computer that no other one can reach. Rerun's default is every address."""
BACKLOG = 10
"""Moments that may wait for the viewer: a third of a second at 30 Hz, 40 MB of four images each."""
START_S, WINDOW_S, END_S = 20.0, 0.5, 3.0
"""Limits [s]: for a viewer to start, for its window to fail, to take the last moments of a run.
Measured: 0.1 s, 0.1 s, 0.01 s."""
FLUSH_S = 0.2
"""Time between transfers to a viewer [s]: rerun's default. Single moments take it more work."""
_GUARDED = """
import os, signal, sys, threading
from rerun_cli.__main__ import main
end = lambda: sys.stdin.read() + os.killpg(0, signal.SIGKILL)
threading.Thread(target=end, daemon=True).start()
sys.exit(main())
"""
"""Rerun's command line, which ends with its standard input: no server outlives this program."""

Log = Callable[..., None]
"""A function that records something: its first argument is the recording, such as `log_frame`."""
Waiting = SimpleQueue[tuple[Log, tuple[Any, ...], dict[str, Any]] | None]


@dataclass(frozen=True, eq=False)
class Viewer:
    """A viewer that was opened."""

    process: subprocess.Popen[bytes]
    address: str
    """Where it takes recordings."""
    page: str | None
    """Address for a browser; None: the viewer has a window."""


@contextmanager
def open_viewer(serve: int | None = None) -> Iterator[Viewer]:
    """Open a window, or serve a page on a port (0: a free one), for a `with` block.

    The page takes recordings on the next port. It ends with the block, while a window stays open.
    VergenceError if a port is taken, or no window can be opened.
    """
    page_port = None if serve is None else _free_port(serve)
    port = _free_port(0 if page_port is None else page_port + 1)
    address = f"rerun+http://{HOST}:{port}/proxy"
    program, page = ["-m", "rerun_cli"], None
    if page_port is not None:
        program = ["-c", _GUARDED, "--serve-web", f"--web-viewer-port={page_port}"]
        page = f"http://{HOST}:{page_port}/?url={quote(address, safe='')}"
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen(
            [sys.executable, *program, f"--bind={HOST}", f"--port={port}"],
            stdin=subprocess.PIPE if page else subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            # With CI rerun reports no usage to its makers.
            env=os.environ | {"CI": "1", "RUST_LOG": "error"},
            start_new_session=True,  # Ctrl-C is for this program
        )
        try:
            if not _started(process, port):
                messages.seek(0)
                reason = messages.read().decode(errors="replace").strip().rpartition(": ")[2]
                instead = "" if page else "; serve=PORT (--serve PORT) shows the run in a browser"
                raise VergenceError(f"The viewer did not start: {reason.rstrip('.')}{instead}.")
            print("The viewer is open." if page is None else f"Watch at {page}", file=sys.stderr)
            yield Viewer(process, address, page)
        finally:
            if page is not None:
                _end(process)


def _free_port(port: int) -> int:
    """Check that a port can be served; 0: find one. VergenceError if it cannot."""
    with socket.socket() as trial:
        if os.name == "posix":  # a server that has just ended does not matter
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise VergenceError(
                "A page needs two free ports, the one that is named and the next; found for "
                f"{port}: {getattr(error, 'strerror', None) or error}."
            ) from None
        return trial.getsockname()[1]


def _started(process: subprocess.Popen[bytes], port: int) -> bool:
    """Wait until a viewer takes connections; False: it has ended, or does not take any."""
    until = time.monotonic() + START_S
    while time.monotonic() < until and process.poll() is None:
        with suppress(OSError), socket.create_connection((HOST, port), timeout=1.0):
            break
        time.sleep(0.02)
    with suppress(subprocess.TimeoutExpired):  # a window comes last, and fails without a display
        process.wait(WINDOW_S)
    return time.monotonic() < until and process.poll() is None


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a viewer with all that it has started."""
    with suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    if process.stdin is not None:
        process.stdin.close()
    process.wait()


def stay(viewer: Viewer) -> None:
    """Serve the page of a run that is over until Ctrl-C, or until its server is ended."""
    if viewer.page is not None and viewer.process.poll() is None:
        print(f"The run is over. Ctrl-C ends the page {viewer.page}", file=sys.stderr)
        with suppress(KeyboardInterrupt):
            viewer.process.wait()


@dataclass(frozen=True, eq=False)
class Feed:
    """A run that is recorded in a file, shown in a viewer, both, or neither.

    Arrays that are passed on must not change later: the viewer's thread may still have to read
    them.
    """

    file: rr.RecordingStream | None = None
    waiting: Waiting | None = None
    """What the viewer's thread has to do."""

    def __call__(self, log: Log, *args: Any, **kwargs: Any) -> None:
        """Record a moment by log(recording, ...); a viewer that lags does not get it."""
        lags = self.waiting is not None and self.waiting.qsize() >= BACKLOG
        (Feed(self.file) if lags else self).always(log, *args, **kwargs)

    def always(self, log: Log, *args: Any, **kwargs: Any) -> None:
        """Record by log(recording, ...) what later moments need, such as names of curves."""
        if self.waiting is not None:
            self.waiting.put((log, args, kwargs))
        if self.file is not None:
            log(self.file, *args, **kwargs)


@contextmanager
def open_feed(
    title: str,
    layout: rrb.Blueprint | None = None,
    head: HeadCalibration | None = None,
    geoms: Sequence[VisualGeom] = (),
    *,
    file: Path | None = None,
    viewer: Viewer | None = None,
) -> Iterator[Feed]:
    """Record a run to a file and to a viewer in a `with` block.

    The file is as of `recording_file`. Without a layout rerun chooses one. The cameras of a head
    and the visible shapes of a robot are drawn.
    """
    with nullcontext() if file is None else recording_file(file, title, layout, head, geoms) as rec:
        if viewer is None:
            yield Feed(rec)
            return
        waiting: Waiting = SimpleQueue()
        waiting.put((log_surroundings, (head, geoms), {}))
        thread = threading.Thread(target=_show, args=(viewer, title, layout, waiting), daemon=True)
        thread.start()
        try:
            yield Feed(rec, waiting)
        finally:
            waiting.put(None)
            thread.join(END_S)
            if thread.is_alive():  # rerun waits for a viewer that is stuck until that ends
                print("The viewer hangs; it is ended.", file=sys.stderr)
                _end(viewer.process)
                thread.join()


def _show(viewer: Viewer, title: str, layout: rrb.Blueprint | None, waiting: Waiting) -> None:
    """Record to a viewer what waits, moment by moment, until None."""
    rr.set_strict_mode(True)  # by default bad data is dropped with a warning
    rec = rr.RecordingStream(style.APPLICATION)
    layout = None if layout is None else following(layout)
    rec.connect_grpc(viewer.address, default_blueprint=layout)
    rec.set_log_time_enabled(False)
    rec.send_recording_name(title)
    flushed_s = time.monotonic()
    while call := waiting.get():
        log, args, kwargs = call
        log(rec, *args, **kwargs)
        if time.monotonic() < flushed_s + FLUSH_S:
            continue
        try:
            rec.flush()  # waits for a viewer that lags; rerun would keep 100 MB for it
            flushed_s = time.monotonic()
        except RuntimeError:
            print("The viewer has gone; the run goes on.", file=sys.stderr)
            return
    rec.disconnect()
