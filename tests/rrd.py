"""Recordings as the tests read them."""

import subprocess
import sys
from pathlib import Path

from rerun.chunk import RrdReader


def assert_valid(*paths: Path) -> None:
    """Check that recordings pass the viewer's own check, and that each brings its layout."""
    command = [sys.executable, "-m", "rerun", "rrd", "verify", *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for path in paths:
        stores = RrdReader(path)
        assert len(stores.blueprints()) == 1
        assert stores.blueprints()[0].application_id == stores.recordings()[0].application_id
