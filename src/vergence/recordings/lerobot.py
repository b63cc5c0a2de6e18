"""Read datasets of LeRobot, versions 2 and 3: joints in parquet, images there or in videos.

A folder has many episodes. They are read one after another, GAP_S apart, or one alone as
`FOLDER/episode_3`.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from pyarrow import ArrowException, parquet

from vergence.arrays import Array
from vergence.data.images import UNREADABLE, decode_image
from vergence.errors import VergenceError, counted, explain
from vergence.files import file_inside, read_json
from vergence.recordings.recording import Content, JointSample, Kind, Recording
from vergence.recordings.series import Series, readings, recording_of, series, unused
from vergence.recordings.stamps import nanoseconds
from vergence.recordings.video import Video, open_latest

GAP_S = 10.0
"""Time [s] between episodes; readings are not interpolated over it."""
MAX_VALUES = 30_000_000
"""Most numbers that are read; as floats they have 240 MB. A parquet of 1 kB may state more."""
MAX_EPISODES = 100_000
"""Most episodes of a dataset; at half a minute each they are a month."""
MAX_GROUP_BYTES = 2**29
"""Largest group of rows [bytes], which is in memory at once; usual are 100 to 1000 images."""
_DAMAGED = ArrowException, OSError, ValueError, TypeError, LookupError, ArithmeticError
"""What damaged parquet raises, and contents of other types than expected."""
_FIELD = re.compile(r"\{(\w+)(?::0?(\d)d)?\}")
"""A field in a template of file names; `str.format` could be asked for gigabytes of digits."""


@dataclass(frozen=True)
class _Feature:
    dtype: str
    names: Any = None


@dataclass(frozen=True)
class _Info:
    """What is read of meta/info.json."""

    fps: float
    total_episodes: int
    features: dict[str, _Feature]
    data_path: str
    video_path: str = ""
    chunks_size: int = 1000


@dataclass(frozen=True, eq=False)
class _Rows:
    """N rows of a dataset without their images."""

    columns: dict[str, Array]
    """By feature (N, C)."""
    files: list[Path]
    place: np.ndarray
    """(N, 2) of int: which file, and the row in it."""
    episodes: dict[int, dict[str, Any]]
    """By index, what is known of an episode."""


def _split(path: Path) -> tuple[Path, int | None]:
    """Split a path into a dataset's folder and the index of an episode; None: all episodes."""
    match = re.fullmatch(r"episode_(\d{1,9})", path.name)
    return (path.parent, int(match[1])) if match and not path.exists() else (path, None)


def recognise(path: Path) -> bool:
    """Test whether a path is a dataset of LeRobot, or an episode of one."""
    return (_split(path)[0] / "meta" / "info.json").is_file()


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a dataset or one of its episodes; VergenceError if it is damaged."""
    root, wanted = _split(path)
    info = read_json(_inside(root, "meta/info.json"), _Info, "a description of a LeRobot dataset")
    try:
        listed = {int(row["episode_index"]): row for row in _list(root, info)}
        episodes = {k: row for k, row in listed.items() if wanted in (None, k)}
        if not episodes:
            count = counted(len(listed), "episode")
            raise VergenceError(f"There is no episode {path}; the dataset has {count}.")
        rows = _read_rows(root, info, episodes)
    except _DAMAGED as error:
        what = f"{root} cannot be read as a dataset of LeRobot"
        raise VergenceError(f"{what}: {explain(error)}.") from error
    with ExitStack() as stack:
        yield recording_of(path, _series(root, info, rows, stack), "a dataset of LeRobot")


def _inside(root: Path, name: str) -> Path:
    return file_inside(root, name, str(root / name)[:300], of="dataset")


def _filled(template: str, row: Mapping[str, Any], part: str, key: str = "") -> str:
    """Fill in a template of file names with what is known of a part of an episode."""
    values = {name.removeprefix(f"{part}/"): value for name, value in row.items()}
    values["video_key"] = key
    return _FIELD.sub(lambda field: str(values[field[1]]).zfill(int(field[2] or 0)), template)


def _list(root: Path, info: _Info) -> Iterator[dict[str, Any]]:
    """Yield what is known of each episode; before version 3 this follows from its index."""
    metas = sorted(path.relative_to(root) for path in root.glob("meta/episodes/*/*.parquet"))
    for meta in metas:
        known = "episode_index", "data/", "videos/"
        yield from _table(_inside(root, str(meta)), known, 20 * MAX_EPISODES).to_pylist()
    for k in () if metas else range(min(info.total_episodes, MAX_EPISODES)):
        yield {"episode_index": k, "episode_chunk": k // info.chunks_size}


def _read_rows(root: Path, info: _Info, episodes: dict[int, dict[str, Any]]) -> _Rows:
    """Read all of some episodes but their images."""
    joints = (
        key
        for key, feature in info.features.items()
        if key.startswith("observation") and feature.dtype.startswith("float")
    )
    parts: dict[str, list[Array]] = {key: [] for key in ("episode_index", "timestamp", *joints)}
    within = dict.fromkeys(_filled(info.data_path, row, "data") for row in episodes.values())
    files, place, left = [_inside(root, name) for name in within], [], MAX_VALUES
    for number, file in enumerate(files):
        table = _table(file, tuple(parts), left)
        if missing := sorted(parts.keys() - table.column_names):
            raise VergenceError(f"{file} has no column {', '.join(missing)}.")
        of_row = _matrix(table["episode_index"], file)[:, 0]
        chosen = np.flatnonzero(np.isin(of_row, list(episodes)))
        for name, part in parts.items():
            part.append(_matrix(table[name], file)[chosen])
            left -= part[-1].size
        place.append(np.stack([np.full(len(chosen), number), chosen], axis=-1))
    columns = {name: np.concatenate(part) for name, part in parts.items()}
    return _Rows(columns, files, np.concatenate(place), episodes)


def _table(file: Path, prefixes: tuple[str, ...], most_values: int) -> Any:
    """Read columns of a parquet file by the beginnings of their names."""
    with parquet.ParquetFile(file) as opened:
        about = opened.metadata
        groups = [about.row_group(k) for k in range(about.num_row_groups)]
        columns = [group.column(k) for group in groups for k in range(about.num_columns)]
        count = sum(c.num_values for c in columns if c.path_in_schema.startswith(prefixes))
        if count > most_values:
            raise VergenceError(
                f"{file} has {count:,} numbers; at most {MAX_VALUES:,} are read: name an episode, "
                "such as FOLDER/episode_0."
            )
        names = [name for name in opened.schema_arrow.names if name.startswith(prefixes)]
        return opened.read(columns=names, use_threads=False)


def _matrix(column: Any, file: Path) -> Array:
    """Convert a column of numbers, or of lists of equal lengths, to (N, C)."""
    flat = column.combine_chunks()
    while flat.type.num_fields:
        flat = flat.flatten()
    values = flat.to_numpy(zero_copy_only=False).astype(float)
    if flat.null_count or len(values) % max(1, len(column)):
        raise VergenceError(f"{file} has empty cells, or lists of different lengths.")
    return values.reshape(len(column), -1 if len(column) else 1)


def _series(root: Path, info: _Info, rows: _Rows, stack: ExitStack) -> Iterator[Series]:
    """Make a channel of each feature, with the episodes one after another."""
    time_s, episode = (rows.columns[name][:, 0] for name in ("timestamp", "episode_index"))
    new = np.diff(episode, prepend=episode[:1]) != 0
    begin_s = np.cumsum(np.where(new, np.roll(time_s, 1) + GAP_S, 0.0))
    stamps = nanoseconds(time_s + begin_s, "s", f"{root}: timestamp")

    def joints(names: tuple[str, ...], values: Array, k: int) -> JointSample:
        return readings(names, values[k])

    def frame(key: str, opened: Callable[[Path], Video], k: int) -> np.ndarray:
        row, part = rows.episodes[int(episode[k])], f"videos/{key}"
        file = _inside(root, _filled(info.video_path, row, part, key))
        at_s = float(row.get(f"{part}/from_timestamp", 0.0)) + time_s[k]
        shown_s = opened(file).time_s
        index = int(np.argmin(np.abs(shown_s - at_s)))
        if not abs(shown_s[index] - at_s) <= 0.5 / info.fps:
            last = f"its last is at {shown_s[-1]:.3f} s"
            raise VergenceError(f"{file} has no frame at {at_s:.3f} s; {last}.")
        return opened(file).frame(index)

    for key, feature in info.features.items():
        kind: Kind = "images"
        if key in rows.columns and key.startswith("observation"):
            kind, names = "joints", _names(key, feature, rows.columns[key])
            content = partial(joints, names, rows.columns[key])
        elif feature.dtype == "video":
            content = partial(frame, key, open_latest(stack))
        elif feature.dtype == "image":
            content = _image_reader(rows, key)
        else:
            yield unused(key, feature.dtype, len(stamps))
            continue
        yield series(key, kind, feature.dtype, stamps, content)


def _names(key: str, feature: _Feature, values: Array) -> tuple[str, ...]:
    """List the joints of a feature: by their names if there are as many, or by their index."""
    names, count = feature.names, values.shape[1]
    if isinstance(names, dict):  # such as {"motors": [...]}
        names = [name for part in names.values() if isinstance(part, list) for name in part]
    names = tuple(map(str, names or ()))
    return names if len(set(names)) == count else tuple(f"{key}/{k}" for k in range(count))


def _image_reader(rows: _Rows, key: str) -> Callable[[int], Content]:
    """Make a function that reads images in a column of parquet, a group of rows at a time."""

    @lru_cache(1)
    def begins(file: Path) -> list[int]:
        with parquet.ParquetFile(file) as opened:
            about = opened.metadata
            sizes = [about.row_group(k).num_rows for k in range(about.num_row_groups)]
        return np.cumsum([0, *sizes]).tolist()

    @lru_cache(1)
    def group(file: Path, number: int) -> Any:
        with parquet.ParquetFile(file) as opened:
            if opened.metadata.row_group(number).total_byte_size > MAX_GROUP_BYTES:
                raise ValueError(f"its group of rows has more than {MAX_GROUP_BYTES:,} bytes")
            return opened.read_row_group(number, columns=[key], use_threads=False).column(0)

    def read(k: int) -> np.ndarray:
        file, row = rows.files[rows.place[k, 0]], int(rows.place[k, 1])
        where = f"{file}: {key} of row {row}"
        try:
            number = bisect_right(begins(file), row) - 1
            cell = group(file, number)[row - begins(file)[number]].as_py()
            image = decode_image(cell["bytes"])
        except _DAMAGED as error:
            raise VergenceError(f"{where} is damaged: {explain(error)}.") from error
        if image is None:
            raise VergenceError(f"{where} {UNREADABLE}.")
        return image

    return read
