"""The documents as the tests read them: links, headings, blocks of code, commands."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("models/*/*.md"),
        *ROOT.glob("benchmarks/*.md"),
    )
)


@dataclass(frozen=True)
class Block:
    """A block of code in a document."""

    language: str
    """As it stands behind the fence; empty for indented blocks, which hold commands or formulas."""
    text: str


def read(document: str) -> str:
    """Return a document by its path in the repository."""
    return (ROOT / document).read_text(encoding="utf-8")


def blocks(document: str) -> Iterator[Block]:
    """Yield the fenced and indented blocks of a document."""
    fenced = re.compile(r"^```(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    text = read(document)
    for language, code in fenced.findall(text):
        yield Block(language, code)
    for code in re.findall(r"(?<=\n\n)(?: {4}.*\n|\n(?= {4}))+", fenced.sub("", text)):
        yield Block("", re.sub("^ {4}", "", code, flags=re.MULTILINE))


def prose(document: str) -> str:
    """Return a document without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", read(document), flags=re.MULTILINE | re.DOTALL)


def commands(document: str) -> Iterator[list[str]]:
    """Yield the command lines in blocks that are not of another language, as lists of words."""
    for block in blocks(document):
        if block.language in ("", "sh", "bash", "console"):
            for line in block.text.splitlines():
                if re.match(r"(\.venv/bin/)?(vergence|make|python|rerun|pip)\s", line):
                    yield shlex.split(line, comments=True)


def inline_commands(document: str) -> Iterator[list[str]]:
    """Yield the command lines that stand in the prose, as lists of words."""
    for code in re.findall(r"`([^`\n]+)`", prose(document)):
        if re.match(r"(\.venv/bin/)?(vergence|make|python)\s", code):
            yield shlex.split(code)


def links(document: str) -> Iterator[tuple[str, str]]:
    """Yield path and anchor of each link within the repository; either may be empty."""
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(document))
    targets += re.findall(r'(?:src|href)="([^"]+)"', prose(document))
    for target in targets:
        if not re.match(r"[a-z]+:", target):
            path, _, anchor = target.partition("#")
            yield path, anchor


def anchors(document: str) -> set[str]:
    """Return the anchors of a document's headings, as GitHub and the site make them."""
    headings = re.findall(r"^#{1,6} (.*)$", prose(document), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in plain}


def first(document: str, language: str) -> str:
    """Return the first block of a language in a document."""
    return next(block.text for block in blocks(document) if block.language == language)
