"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table


def print_table(title: str, heading: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table whose first column is of words, the others of numbers."""
    shown = Table(title=escape(title))
    for k, name in enumerate(heading):
        shown.add_column(escape(name), justify="right" if k else "left")
    for row in rows:
        shown.add_row(*map(escape, row))
    Console().print(shown)
