"""The digital twin: plays the part of the hardware, and alone knows the truth.

Only this package imports mujoco. MuJoCo chooses its OpenGL when it is imported, and nothing falls
back by itself, so the choice is made here.
"""

from __future__ import annotations

import multiprocessing
import os
import sys

from vergence.errors import VergenceError

if sys.platform.startswith("linux"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # renders without a screen
    if multiprocessing.parent_process() is not None:  # one of several, which share the cores:
        os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa takes no threads besides


def no_opengl(reason: object) -> VergenceError:
    """Make the error of a machine that cannot render."""
    first_line = (str(reason) or type(reason).__name__).splitlines()[0]
    return VergenceError(
        f"Rendering needs OpenGL, and MUJOCO_GL={os.environ.get('MUJOCO_GL', '(unset)')} gave none "
        f"({first_line}); install Mesa's drivers (Debian: apt-get install libegl1 "
        "libgl1-mesa-dri), leave MUJOCO_GL unset or egl, and import vergence.twin before mujoco."
    )


try:
    import mujoco  # noqa: F401
except (ImportError, AttributeError, RuntimeError, OSError) as error:
    raise no_opengl(error) from error
