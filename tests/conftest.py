"""Settings that all tests share."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; workers have one core each

from hypothesis import settings

import vergence.twin  # noqa: F401  # chooses OpenGL, before any test imports mujoco

# Derandomised: a test that passes here passes everywhere. No deadline: machines are shared.
settings.register_profile("vergence", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("vergence")
