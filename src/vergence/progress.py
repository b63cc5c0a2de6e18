"""The progress callback of long computations, which do not know who shows it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called as `progress(task, done, total)`: what is being done, how many steps of it are done, and
of how many. The first call for a task has done = 0."""


def silent(task: str, done: int, total: int) -> None:
    """Show nothing."""
