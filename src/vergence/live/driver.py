"""The driver of a head that is there, and how a command line names one."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Protocol

from vergence.data.description import Description
from vergence.errors import VergenceError, explain
from vergence.gaze.commands import HeadDriver, JointLimits


class Driver(HeadDriver, Protocol):
    """A driver that describes its head: all that capture, calibration and gaze need of one.

    `close` ends what the driver began, such as its threads, and releases cameras and servos. One
    that also moves the board, such as with an arm, has `follow(state, frame)`: it is called after
    each frame of a capture with the CaptureState, whose `asked[0]` is the view to show.
    """

    @property
    def description(self) -> Description:
        """Cameras, joints and board, as in dataset.json."""
        ...

    @property
    def limits(self) -> JointLimits | None:
        """Ranges and speeds of the joints of a posture; None: the head takes no commands."""
        ...

    def close(self) -> None:
        """Stop the joints where they are, and release the devices."""
        ...


PARTS = ("description", "limits", "now_s", "read", "command", "close")
"""What a driver has; docs/own_driver.md describes each."""


def open_driver(name: str) -> Driver:
    """Open a driver named as `package.module:Name` or `folder/file.py:Name`.

    `Name` is a class or function without arguments; modules are also found in the current folder.
    VergenceError if the driver is not found, cannot be opened, or lacks one of PARTS.
    """
    where, _, attribute = name.rpartition(":")
    if not where or not attribute.isidentifier():
        raise VergenceError(
            f"A driver is named as module:Name or file.py:Name, such as my_head.py:MyHead; found "
            f"{name!r}."
        )
    make: Callable[[], Driver] | None = getattr(_module(where), attribute, None)
    if not callable(make):
        raise VergenceError(f"{where} has no class or function {attribute}.")
    try:
        driver = make()
    except (ValueError, OSError) as error:
        raise VergenceError(f"The driver {name} cannot be opened: {explain(error)}.") from error
    missing = [part for part in PARTS if not hasattr(driver, part)]
    if missing:
        raise VergenceError(
            f"The driver {name} has no {', no '.join(missing)}; docs/own_driver.md shows what a "
            "driver has."
        )
    return driver


def _module(where: str) -> ModuleType:
    """Import a module by name, or from a file."""
    if not where.endswith(".py"):
        if str(Path.cwd()) not in sys.path:
            sys.path.insert(0, str(Path.cwd()))
        try:
            return importlib.import_module(where)
        except ModuleNotFoundError as error:
            raise VergenceError(f"No driver can be loaded from {where}: {error}.") from None
    path = Path(where)
    name = f"driver_{path.stem}"  # a file may be called as a package that it imports
    spec = importlib.util.spec_from_file_location(name, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise VergenceError(f"There is no file {path} with a driver.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
