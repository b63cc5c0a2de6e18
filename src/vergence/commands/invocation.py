"""Tell the user a command that can be typed as it stands."""

from __future__ import annotations

import os
import shlex
import shutil
import sysconfig
from pathlib import Path


def invocation(program: str, *arguments: str | Path) -> str:
    """Return a command line that works in the shell and folder in which this process was started.

    A program of this Python environment gets the environment's folder in front of its name, unless
    the shell would find the same program without it: `.venv/bin/rerun runs/paper/fig06.rrd`.
    """
    own = shutil.which(program, path=sysconfig.get_path("scripts"))
    found = shutil.which(program)
    if own is not None and (found is None or not os.path.samefile(found, own)):
        below = Path.cwd() in Path(own).parent.parents  # a name alone would not be found
        program = str(Path(own).relative_to(Path.cwd())) if below else own
    return shlex.join([program, *map(str, arguments)])
