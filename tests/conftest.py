"""Settings that all tests share, and the markers by which a run is chosen.

`pytest -m "not render and not slow"` is the short run. A test is marked `render` when it needs the
twin's OpenGL, and `slow` when it takes more than about three seconds of processor time without it.
"""

import os
import sys
from collections.abc import Iterator

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; workers have one core each
if sys.platform.startswith("linux"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when a test imports mujoco, before the twin

import pytest
from hypothesis import settings

# Derandomised: a test that passes here passes everywhere. No deadline: machines are shared.
settings.register_profile("vergence", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("vergence")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "render: needs the twin's OpenGL")
    config.addinivalue_line("markers", "slow: takes more than 3 s without rendering")


@pytest.fixture(scope="session")
def opengl() -> None:
    """Is requested by every fixture that renders, so that tests of such fixtures are marked."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "opengl" in getattr(item, "fixturenames", ()):
            item.add_marker("render")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Fail a test that renders without saying so, in its fixtures too."""
    mujoco = sys.modules.get("mujoco")
    if mujoco is None or item.get_closest_marker("render"):
        return (yield)

    def refuse(*_: object, **__: object) -> None:
        pytest.fail("This test renders: mark it `render`, or let its fixture request `opengl`.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mujoco, "Renderer", refuse)
        return (yield)
