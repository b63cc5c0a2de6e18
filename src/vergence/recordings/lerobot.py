"""Read an episode of a dataset of LeRobot, version 2 or 3, named as FOLDER/episode_3."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import parquet

from vergence.arrays import Array
from vergence.data.images import UNREADABLE, decode_image
from vergence.errors import VergenceError, counted, explain
from vergence.files import parse_json, read_parsed
from vergence.recordings import series
from vergence.recordings.recording import Content, Recording
from vergence.recordings.series import Series, nanoseconds
from vergence.recordings.video import open_video

MAX_BYTES = 2**29
"""Most that is unpacked at once [bytes], with 16 a number; a parquet of 1 kB may state any size."""
_FIELD = re.compile(r"\{(\w+)(?::0?(\d)d)?\}")
"""A field in a template of file names; `str.format` could be asked for gigabytes of digits."""


def _split(path: Path) -> tuple[Path, int | None]:
    """Split a path into a dataset's folder and the index of an episode, if it names one."""
    match = re.fullmatch(r"episode_(\d{1,9})", path.name)
    return (path.parent, int(match[1])) if match and not os.path.exists(path) else (path, None)


def recognise(path: Path) -> bool:
    """Test whether a path is a dataset of LeRobot, or an episode of one."""
    return os.path.isfile(_split(path)[0] / "meta" / "info.json")


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open an episode; VergenceError if it is damaged, or none of several is named."""
    root, index = _split(path)
    file = series.inside(root, "meta/info.json")
    info = read_parsed(file, "a description of a LeRobot dataset", dict, parse_json)
    with ExitStack() as stack:
        try:
            if not (index or 0) < info["total_episodes"] < (2 if index is None else 10**9):
                count = counted(info["total_episodes"], "episode")
                raise VergenceError(f"{root} has {count}: name one, such as {root / 'episode_0'}.")
            every = list(_channels(root, info, index or 0, stack))
        except VergenceError:
            raise
        except Exception as error:  # of pyarrow, and of contents of other types
            what = f"{root} cannot be read as a dataset of LeRobot"
            raise VergenceError(f"{what}: {explain(error)}.") from error
        yield series.recording_of(path, every)


def _channels(root: Path, info: dict, index: int, stack: ExitStack) -> Iterator[Series]:
    chunk = index // info.get("chunks_size", 1000)
    known: dict[str, Any] = {"episode_index": index, "episode_chunk": chunk}
    for meta in sorted(root.glob("meta/episodes/*/*.parquet")):  # since version 3
        _, table, rows = _rows(root, str(meta.relative_to(root)), index, stack)
        known.update(*table.take(rows).to_pylist())
    opened, table, rows = _rows(root, _filled(info["data_path"], known, "data"), index, stack)
    time_s = _matrix(table["timestamp"].take(rows))[:, 0]
    stamps = nanoseconds(time_s, "s", f"{root}: timestamp")
    for key, feature in info["features"].items():
        kind = feature["dtype"]
        if kind == "video":
            part = f"videos/{key}"
            name = _filled(info["video_path"], {**known, "video_key": key}, part)
            shown_s, frame = stack.enter_context(open_video(series.inside(root, name)))
            at_s = known.get(f"{part}/from_timestamp", 0.0) + time_s
            nearest = np.searchsorted((shown_s[1:] + shown_s[:-1]) / 2, at_s)
            if np.abs(shown_s[nearest] - at_s).max(initial=0) > 0.5 / info["fps"]:
                raise VergenceError(f"{name} has no frames at some times of episode {index}.")
            content = partial(lambda frame, nearest, k: frame(int(nearest[k])), frame, nearest)
            yield Series(key, "images", kind, stamps, content)
        elif kind == "image":
            yield Series(key, "images", kind, stamps, _images(opened, key, rows))
        elif key.startswith("observation") and kind.startswith("float"):
            values = _matrix(table[key].take(rows))
            names = _names(key, feature.get("names"), values.shape[1])
            yield Series(key, "joints", kind, stamps, partial(series.readings, names, values))
        else:
            yield series.unused(key, kind)


def _filled(template: str, known: Mapping[str, Any], part: str) -> str:
    """Fill in a template of file names with what is known of a part of an episode."""
    values = {name.removeprefix(f"{part}/"): value for name, value in known.items()}
    return _FIELD.sub(lambda field: str(values[field[1]]).zfill(int(field[2] or 0)), template)


def _rows(root: Path, name: str, index: int, stack: ExitStack) -> tuple[Any, Any, np.ndarray]:
    """Open a parquet file, read its columns without images, and find the rows of an episode."""
    file = series.inside(root, name)
    opened = stack.enter_context(parquet.ParquetFile(file))
    about, schema = opened.metadata, opened.schema_arrow
    groups = [about.row_group(k) for k in range(about.num_row_groups)]
    numbers = sum(g.column(k).num_values for g in groups for k in range(about.num_columns))
    if max(16 * numbers, *(group.total_byte_size for group in groups), 0) > MAX_BYTES:
        raise VergenceError(f"{file} takes more than {MAX_BYTES:,} bytes when it is unpacked.")
    names = [each.name for each in schema if not pyarrow.types.is_struct(each.type)]
    table = opened.read(names, use_threads=False)
    return opened, table, np.flatnonzero(table["episode_index"].to_numpy() == index)


def _matrix(column: Any) -> Array:
    """Convert a column of numbers, or of lists of equal lengths, to (N, C)."""
    return np.array(column.to_pylist(), float).reshape(len(column), -1)


def _names(key: str, names: Any, count: int) -> tuple[str, ...]:
    """List the joints of a feature: by their names if there are as many, or by their index."""
    if isinstance(names, dict):  # such as {"motors": [...]}
        names = [name for part in names.values() if isinstance(part, list) for name in part]
    names = tuple(map(str, names or ()))
    return names if len(set(names)) == count else tuple(f"{key}/{k}" for k in range(count))


def _images(opened: Any, key: str, rows: np.ndarray) -> Callable[[int], Content]:
    """Make a function that reads images in a column of parquet, a group of rows at a time."""
    sizes = (opened.metadata.row_group(k).num_rows for k in range(opened.num_row_groups))
    ends = np.cumsum([*sizes])
    group = lru_cache(1)(lambda k: opened.read_row_group(k, [key], use_threads=False).column(0))

    def read(k: int) -> Content:
        number = int(np.searchsorted(ends, rows[k], side="right"))
        try:
            image = decode_image(group(number)[rows[k] - ends[number]].as_py()["bytes"])
        except Exception:  # of pyarrow, and of contents of other types
            image = None
        if image is None:
            raise VergenceError(f"{key} of row {rows[k]} {UNREADABLE}.")
        return image

    return read
