"""Settings that all tests share, and the markers by which a run is chosen.

`pytest -m "not render and not slow"` is the short run. A test is marked `render` when it needs the
twin's OpenGL, and `slow` when it, or its file as a whole, takes seconds of processor time without.
"""

import os
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; workers have one core each
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")
if sys.platform.startswith("linux"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when a test imports mujoco, before the twin
    os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa renders in the worker's own thread

import numpy as np
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from mutated_files import Kind

# Derandomised, so that a run can be repeated. No deadline: machines are shared.
settings.register_profile("vergence", deadline=None, derandomize=True, max_examples=25)
settings.load_profile("vergence")


@pytest.fixture(scope="session")
def opengl() -> None:
    """Is requested by every fixture that renders: its tests are marked `render`."""


@pytest.fixture(scope="session")
def slow_setup() -> None:
    """Is requested by every fixture that takes more than 2 s: its tests are marked `slow`."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        for fixture, marker in (("opengl", "render"), ("slow_setup", "slow")):
            if fixture in getattr(item, "fixturenames", ()):
                item.add_marker(marker)


@pytest.fixture(scope="session")
def sound_files(tmp_path_factory: pytest.TempPathFactory) -> "dict[str, Kind]":
    """A sound file of every kind that is read, for tests that put another in its place."""
    from mutated_files import kinds

    return kinds(tmp_path_factory.mktemp("files"))


@pytest.fixture(scope="session")
def coarsely() -> Callable[[pytest.MonkeyPatch], None]:
    """Return what lets images be rendered coarsely: `coarse_images` for fixtures of a module."""

    def patched(patch: pytest.MonkeyPatch) -> None:
        from vergence.twin import head, renderer

        def coarse(*args, **kwargs):
            model = compile_head(*args, **kwargs)
            model.vis.quality.offsamples = 0
            return model

        compile_head = head.compile_head
        patch.setattr(head, "compile_head", coarse)
        patch.setattr(renderer, "OVERSAMPLING", 1)
        patch.setattr("vergence.twin.record.FINE", 1)

    return patched


@pytest.fixture
def coarse_images(
    coarsely: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Render images coarsely, where a test does not depend on hundredths of a pixel."""
    coarsely(monkeypatch)


@pytest.fixture
def few_views(coarse_images: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the twin's calibration sequence, where a test does not depend on its accuracy.

    Images are rendered coarsely, too.
    """
    from vergence.twin.calibration_sequence import plan

    monkeypatch.setitem(plan.__kwdefaults__, "views", (4, 3, 8))


@pytest.fixture
def two_folds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cross-validate by two folds, where a test does not depend on their number.

    Also where each of few views would be left out by itself.
    """
    from vergence.calibration import cross_validation

    monkeypatch.setattr(cross_validation, "FOLDS", 2)
    monkeypatch.setattr(cross_validation, "EACH_BELOW", 0)


@pytest.fixture
def true_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the demos the true calibration, which takes no images."""
    from vergence.demos import experiment
    from vergence.gaze.state import GazeSettings

    def given(twin, seed: int, progress: object) -> GazeSettings:
        reading_std = np.hypot(5e-5, np.radians(twin.profile.joints.noise_deg))
        return GazeSettings(calibration=twin.truth, reading_std=float(reading_std))

    monkeypatch.setattr(experiment, "calibrate_twin", given)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Fail a test that renders without saying so, in its fixtures too."""
    mujoco = sys.modules.get("mujoco")
    if mujoco is None or item.get_closest_marker("render"):
        return (yield)

    def refuse(*_: object, **__: object) -> None:
        pytest.fail("This test renders: mark it `render`, or let its fixture request `opengl`.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mujoco, "MjrContext", refuse)
        return (yield)
