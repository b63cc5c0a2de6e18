"""Sweep over designs in chunks, on all cores or a cluster, with finished chunks kept in files.

Files are named by all that their chunk depends on: a run that was stopped, or a sweep that shares
designs with an earlier one, computes only what is missing.
"""

from __future__ import annotations

import hashlib
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from io import BytesIO
from pathlib import Path

import joblib
import numpy as np

from vergence.accuracy.design_settings import DesignSettings, chunks
from vergence.accuracy.design_sweep import Sweep, assemble, chunk_shape, compute_chunk
from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.files import read_bytes, whole_file
from vergence.parallel import run_tasks
from vergence.progress import Progress, silent

TIMEOUT_S = 10
"""Time [s] within which the scheduler of a cluster must answer."""
HEADER_BYTES = 1024
"""Largest header of a .npy file [bytes]; numpy writes 128."""


def sweep(
    settings: DesignSettings,
    folder: Path,
    *,
    jobs: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> Sweep:
    """Sweep designs: read finished chunks from a folder, and write the others there."""
    each = list(chunks(settings))
    files = [folder / f"{digest(chunk)}.npy" for chunk in each]
    kept = [read_chunk(file, chunk_shape(chunk)) for file, chunk in zip(files, each, strict=True)]
    found = {k: values for k, values in enumerate(kept) if values is not None}
    missing = [(k, each[k]) for k in range(len(each)) if k not in found]
    progress("sweeping designs", len(found), len(each))

    def keep(result: tuple[int, Array]) -> None:
        k, values = result
        with whole_file(files[k]) as part, part.open("wb") as file:
            np.save(file, values)
        found[k] = values
        progress("sweeping designs", len(found), len(each))

    try:
        with _backend(cluster):
            run_tasks([partial(_numbered, k, chunk) for k, chunk in missing], keep, jobs=jobs)
    except KeyboardInterrupt as stop:
        stop.add_note(
            f"{len(found)} of {len(each)} parts finished; the same command goes on from there"
        )
        raise
    return assemble(settings, [found[k] for k in range(len(each))])


def digest(chunk: DesignSettings) -> str:
    """Hash what a chunk depends on, with the code and without the prices."""
    text = f"{_code()} {chunk.designs.model_dump_json()} {chunk.workspace.model_dump_json()}"
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


@cache
def _code() -> str:
    """Hash this package's source files."""
    found = hashlib.blake2b(digest_size=12)
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        found.update(file.read_bytes())
    return found.hexdigest()


def read_chunk(file: Path, shape: tuple[int, ...]) -> Array | None:
    """Read a finished chunk; None if the file has no floats of this shape."""
    try:
        content = read_bytes(file, HEADER_BYTES + 8 * math.prod(shape))
        values = np.load(BytesIO(content), allow_pickle=False)
    except (VergenceError, ValueError, EOFError, MemoryError, zipfile.BadZipFile):
        return None
    right = isinstance(values, np.ndarray) and (values.dtype, values.shape) == (np.float64, shape)
    return values if right else None


def _numbered(k: int, chunk: DesignSettings, progress: Progress) -> tuple[int, Array]:
    return k, compute_chunk(chunk)


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
