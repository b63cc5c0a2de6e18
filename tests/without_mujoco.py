"""Commands on a machine where mujoco cannot be imported, as without OpenGL."""

import subprocess
import sys
from pathlib import Path

_CODE = "import sys; sys.modules['mujoco'] = None; from vergence import cli; cli.main()"


def without_mujoco(*words: object, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a `vergence` command in a folder, in a process that has no mujoco."""
    typed = [sys.executable, "-c", _CODE, *map(str, words)]
    return subprocess.run(typed, cwd=folder, capture_output=True, text=True, check=False)
