"""The sentence with which a file is refused, for tests of damaged and impossible files."""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mutated_files import Kind
from vergence.errors import VergenceError


@contextlib.contextmanager
def replaced(kind: Kind, change: Callable[[Path], object]) -> Iterator[None]:
    """Put something else in the place of a file in a `with` block."""
    kept = kind.file.with_name("kept-" + kind.file.name + ".kept")
    kind.file.rename(kept)
    try:
        change(kind.file)
        yield
    finally:
        with contextlib.suppress(FileNotFoundError):
            kind.file.rmdir() if kind.file.is_dir() else kind.file.unlink()
        kept.rename(kind.file)


def sentence(kind: Kind, content: bytes | Callable[[Path], object]) -> str:
    """Return the one sentence with which other content is refused, in 5 s of processor time.

    And in a minute by the clock, which a reader that waits for a pipe would exceed.
    """
    change = content if callable(content) else lambda path: path.write_bytes(content)
    began = time.perf_counter(), time.process_time()
    with replaced(kind, change), pytest.raises(VergenceError) as refused:
        kind.read()
    assert time.process_time() - began[1] < 5
    assert time.perf_counter() - began[0] < 60
    said = str(refused.value)
    assert "\n" not in said
    assert len(said) < 1500
    return said
