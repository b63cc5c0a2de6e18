"""Recordings as the tests read them."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from vergence.arrays import Array


def assert_valid(*paths: Path) -> None:
    """Check that recordings pass the viewer's own check, and that each brings its layout."""
    command = [sys.executable, "-m", "rerun", "rrd", "verify", *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for path in paths:
        stores = RrdReader(path)
        assert len(stores.blueprints()) == 1
        assert stores.blueprints()[0].application_id == stores.recordings()[0].application_id


def read_series(
    path: Path, entity: str, *, component: str = "Scalars:scalars", timeline: str = "sim_time"
) -> tuple[Array, Array]:
    """Return the times (N,) [s] and the values of one series of a recording, in order of time.

    Values are (N, ...), or (N, k, ...) where k were logged at a time, as in `/paper/x`. On the
    timeline `frame` times are sample numbers.
    """
    times: list[np.ndarray] = []
    rows: list[Any] = []
    stream = RrdReader(path).stream()
    for chunk in stream.filter(content=entity, components=component, has_timeline=timeline):
        batch = chunk.to_record_batch()
        times.append(batch.column(timeline).cast("int64").to_numpy())
        rows += batch.column(component).to_pylist()
    assert times, f"{path} has no {component} at {entity} on the timeline {timeline}."
    t, values = np.concatenate(times), np.array(rows)
    order = np.argsort(t, kind="stable")
    seconds = t[order] * (1e-9 if timeline == "sim_time" else 1.0)
    return seconds, (values[:, 0] if values.shape[1] == 1 else values)[order]
