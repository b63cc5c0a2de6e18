"""How long work tells how far it is, without knowing who shows it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called as `progress(task, done, total)`: the name of a task, how many of its steps are done, and
how many it has. The first call for a task has done = 0."""


def silent(task: str, done: int, total: int) -> None:
    """Show nothing."""
