"""Result of a command: a summary for the terminal, markdown for a file, plain values for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vergence.files import as_json, write_whole


@dataclass(frozen=True)
class Report:
    """Result of a command."""

    title: str
    parts: Sequence[str]
    """Paragraphs and tables that the terminal and the file show first."""
    data: Any
    """A dataclass, or plain values, for JSON."""
    details: Sequence[str] = ()
    """What only the file shows."""
    files: str = ""
    """Sentences about written files, which only the terminal shows."""
    shown: AbstractContextManager[Any] = field(default_factory=nullcontext)
    """A block in which the summary is printed, such as that of an open viewer."""

    def summary(self) -> str:
        """Format the text for the terminal."""
        parts = [f"\n{part}\n" if part.startswith("|") else part for part in self.parts]
        return "\n".join(filter(None, [*parts, self.files])).strip("\n")

    def markdown(self) -> str:
        """Format the text of a report.md."""
        return "\n\n".join([f"# {self.title}", *self.parts, *self.details]) + "\n"

    def json(self) -> str:
        """Format the values as JSON."""
        return as_json(self.data)

    def write_json(self, path: Path | None) -> None:
        """Write the values into a file; None: no file was asked for."""
        if path is not None:
            write_whole(path, self.json())
