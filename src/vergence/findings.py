"""What was noticed about data or about a result, each time as one sentence with its severity."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

Severity = Literal["void", "warning", "note"]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Finding:
    """One thing that the user should know about his data or about a result."""

    severity: Severity
    """void: do not use the result; warning: do not trust it blindly; note: good to know."""
    code: Annotated[str, Field(pattern="^[a-z0-9]+(-[a-z0-9]+)*$")]
    """Name of the check in kebab case, which a program can test."""
    where: str
    """Camera, view, row or reading that it concerns; empty: the data as a whole."""
    sentence: str
    """What was found, and what to do about it."""

    def __str__(self) -> str:
        return self.sentence


def void(code: str, sentence: str, where: str = "") -> Finding:
    """Make a finding that forbids the use of a result."""
    return Finding("void", code, where, sentence)


def warning(code: str, sentence: str, where: str = "") -> Finding:
    """Make a finding that makes a result doubtful."""
    return Finding("warning", code, where, sentence)


def note(code: str, sentence: str, where: str = "") -> Finding:
    """Make a finding that leaves a result as good as it is."""
    return Finding("note", code, where, sentence)


def select(
    findings: Iterable[Finding], *severities: Severity, code: str | None = None
) -> tuple[Finding, ...]:
    """Select findings by severity, and by code where one is given."""
    return tuple(
        each for each in findings if each.severity in severities and code in (None, each.code)
    )


def by_severity(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort findings, the most severe first, and drop repeated ones."""
    order = ("void", "warning", "note")
    return tuple(sorted(dict.fromkeys(findings), key=lambda each: order.index(each.severity)))
