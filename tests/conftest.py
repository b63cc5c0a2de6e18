"""Settings that all tests share."""

from hypothesis import settings

import vergence.twin  # noqa: F401  # chooses OpenGL, before any test imports mujoco

# Derandomised: a test that passes here passes everywhere. No deadline: machines are shared.
settings.register_profile("vergence", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("vergence")
