"""Chunks of a sweep over designs: computed on all cores or a cluster, and kept in files.

Finished chunks are files of their own in the folder of results, named by what they depend on: a run
that was stopped, and a sweep that shares designs with an earlier one, compute only what is missing.
Processes that compute import this module, so that it imports nothing that draws.
"""

from __future__ import annotations

import hashlib
import math
import os
import threading
import time
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import cast

import joblib
import numpy as np

from vergence import __version__
from vergence.accuracy.design_settings import DesignSettings, chunks
from vergence.accuracy.design_sweep import Sweep, assemble, chunk_shape, compute_chunk
from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.progress import Progress, silent
from vergence.reading import read_bytes
from vergence.writing import whole_file

TIMEOUT_S = 10
HEADER_BYTES = 1024
"""Most bytes of a file of an array before its numbers; numpy writes 128."""


def sweep(
    settings: DesignSettings,
    folder: Path,
    *,
    jobs: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> Sweep:
    """Return a sweep, whose chunks are read from a folder or else computed and written there."""
    each = list(chunks(settings))
    files = [folder / f"{digest(chunk)}.npy" for chunk in each]
    kept = [read_chunk(file, chunk_shape(chunk)) for file, chunk in zip(files, each, strict=True)]
    found = {k: known for k, known in enumerate(kept) if known is not None}
    missing = [(k, each[k]) for k in range(len(each)) if k not in found]
    progress("sweeping designs", len(found), len(each))
    if missing:
        try:
            for k, values in _computed(missing, jobs, cluster):
                with whole_file(files[k]) as part, part.open("wb") as file:
                    np.save(file, values)
                found[k] = values
                progress("sweeping designs", len(found), len(each))
        except KeyboardInterrupt as stop:  # the names of their files would say nothing
            stop.add_note(
                f"{len(found)} of {len(each)} parts finished; the same command goes on from there"
            )
            raise
    return assemble(settings, [found[k] for k in range(len(each))])


def digest(chunk: DesignSettings) -> str:
    """Return a name for all that a chunk depends on, the code included; prices do not matter."""
    text = f"{_code()} {chunk.designs.model_dump_json()} {chunk.workspace.model_dump_json()}"
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


@cache
def _code() -> str:
    """Return a digest of this package: what other code has computed is computed again."""
    found = hashlib.blake2b(__version__.encode(), digest_size=12)
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        found.update(file.read_bytes())
    return found.hexdigest()


def read_chunk(file: Path, shape: tuple[int, ...]) -> Array | None:
    """Return what an earlier run has written; None if there are no floats of this shape."""
    try:
        content = read_bytes(file, HEADER_BYTES + 8 * math.prod(shape))
        values = np.load(BytesIO(content), allow_pickle=False)
    except (VergenceError, ValueError, EOFError, MemoryError, zipfile.BadZipFile):
        return None
    right = isinstance(values, np.ndarray) and (values.dtype, values.shape) == (np.float64, shape)
    return values if right else None


def _computed(
    missing: list[tuple[int, DesignSettings]], jobs: int, cluster: str | None
) -> Iterable[tuple[int, Array]]:
    """Yield the numbers and values of chunks as they are finished."""
    parent = os.getpid() if cluster is None else None
    tasks = [joblib.delayed(_numbered)(k, chunk, parent) for k, chunk in missing]
    with _backend(cluster):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        yield from cast(Iterable[tuple[int, Array]], parallel(tasks))


def _numbered(k: int, chunk: DesignSettings, parent: int | None) -> tuple[int, Array]:
    """Compute a chunk, in a process that ends with its parent; None: it belongs to a cluster."""
    if parent not in (None, os.getpid()):
        _end_with(parent)
    return k, compute_chunk(chunk)


@cache
def _end_with(parent: int | None) -> None:
    """Let this process end when its parent was killed; joblib's would wait for work for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _backend(cluster: str | None) -> Iterator[None]:
    """Let joblib use a Dask cluster in a `with` block; None: processes of this machine."""
    if cluster is None:
        yield
        return
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]  # optional
    except ImportError:
        raise VergenceError(
            "A cluster needs Dask, which is not installed; `pip install 'vergence[cluster]'` "
            "installs it."
        ) from None
    try:
        client = Client(cluster, timeout=TIMEOUT_S)
    except (OSError, ValueError, TypeError) as error:
        raise VergenceError(
            f"No Dask scheduler answers at {cluster!r}, which should be like "
            f"tcp://192.168.1.10:8786 ({type(error).__name__})."
        ) from None
    with client, joblib.parallel_config(backend="dask"):
        yield
