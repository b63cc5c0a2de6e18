"""Read datasets of LeRobot, versions 2 and 3: joints in parquet, images there or in videos.

A folder has many episodes. They are read one after another, GAP_S apart, or one alone as
`FOLDER/episode_3`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from vergence.arrays import Array
from vergence.data.images import UNREADABLE, decode_image
from vergence.errors import VergenceError, counted, explain
from vergence.files import file_inside, read_json
from vergence.recordings.recording import Channel, Content, JointSample, Kind, Recording
from vergence.recordings.series import Replay, Series, recording_of, unused
from vergence.recordings.stamps import nanoseconds
from vergence.recordings.video import Video, open_video

T = TypeVar("T")
GAP_S = 10.0
"""Time [s] between episodes; readings are not interpolated over it."""
MAX_VALUES = 30_000_000
"""Most numbers that are read; as floats they have 240 MB. A parquet of 1 kB may state more."""
MAX_EPISODES = 100_000
"""Most episodes of a dataset; at half a minute each they are a month."""
MAX_GROUP_BYTES = 2**29
"""Largest group of rows [bytes], which is in memory at once; usual are 100 to 1000 images."""
BATCH = 16
"""Images of a parquet file that are in memory at once."""
_DAMAGED = OSError, ValueError, TypeError, LookupError, ArithmeticError
"""What contents of other types than expected raise."""
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

    def __getitem__(self, name: str) -> Array:
        return self.columns[name][:, 0]


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
    import pyarrow

    root, wanted = _split(path)
    info = read_json(_inside(root, "meta/info.json"), _Info, "a description of a LeRobot dataset")
    try:
        episodes = {
            int(row["episode_index"]): row
            for row in _list(root, info)
            if wanted in (None, row["episode_index"])
        }
        if not episodes:
            count = counted(info.total_episodes, "episode")
            raise VergenceError(f"There is no episode {path}; the dataset has {count}.")
        rows = _read_rows(root, info, episodes)
    except (pyarrow.ArrowException, *_DAMAGED) as error:
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
    names = "episode_index", "timestamp", *joints
    parts: dict[str, list[Array]] = {name: [] for name in names}
    within = dict.fromkeys(_filled(info.data_path, row, "data") for row in episodes.values())
    files, place, left = [_inside(root, name) for name in within], [], MAX_VALUES
    for number, file in enumerate(files):
        table = _table(file, names, left)
        if missing := sorted(set(names) - set(table.column_names)):
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
    from pyarrow import parquet

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
    time_s, episode = rows["timestamp"], rows["episode_index"].astype(int)
    new = np.diff(episode, prepend=episode[:1]) != 0
    begin_s = np.cumsum(np.where(new, np.roll(time_s, 1) + GAP_S, 0.0))
    stamps = nanoseconds(time_s + begin_s, "s", f"{root}: timestamp")
    for key, feature in info.features.items():
        content: Callable[[int], Content]
        kind: Kind = "images"
        if key in rows.columns and key.startswith("observation"):
            kind = "joints"
            content = partial(_joints, rows.columns[key], _names(key, feature, rows.columns[key]))
        elif feature.dtype == "video":
            content = partial(_frame, root, info, rows, key, _latest(open_video, stack))
        elif feature.dtype == "image":
            content = partial(_stored_image, rows, _latest(partial(_stored, key), stack))
        else:
            yield unused(key, feature.dtype, len(stamps))
            continue
        yield Series(Channel(key, kind, feature.dtype, len(stamps)), stamps, stamps, content)


def _joints(values: Array, names: tuple[str, ...], k: int) -> JointSample:
    return JointSample(names, values[k])


def _names(key: str, feature: _Feature, values: Array) -> tuple[str, ...]:
    """List the joints of a feature: by their names if there are as many, or by their index."""
    names, count = feature.names, values.shape[1]
    if isinstance(names, dict):  # such as {"motors": [...]}
        names = [name for part in names.values() if isinstance(part, list) for name in part]
    names = tuple(map(str, names or ()))
    return names if len(set(names)) == count else tuple(f"{key}/{k}" for k in range(count))


def _latest(
    open_file: Callable[[Path], AbstractContextManager[T]], stack: ExitStack
) -> Callable[[Path], T]:
    """Make a function that opens a file and keeps it open until it is asked for another."""
    opened, inner = {}, stack.enter_context(ExitStack())

    def get(file: Path) -> T:
        if file not in opened:
            opened.clear()
            inner.close()
            opened[file] = inner.enter_context(open_file(file))
        return opened[file]

    return get


def _frame(
    root: Path, info: _Info, rows: _Rows, key: str, opened: Callable[[Path], Video], k: int
) -> np.ndarray:
    episode, part = rows.episodes[int(rows["episode_index"][k])], f"videos/{key}"
    file = _inside(root, _filled(info.video_path, episode, part, key))
    at_s = float(episode.get(f"{part}/from_timestamp", 0.0)) + rows["timestamp"][k]
    video = opened(file)
    index = int(np.argmin(np.abs(video.time_s - at_s)))
    if not abs(video.time_s[index] - at_s) <= 0.5 / info.fps:
        raise VergenceError(
            f"{file} has no frame at {at_s:.3f} s; it ends at {video.time_s[-1]:.3f} s."
        )
    return video.frame(index)


@contextmanager
def _stored(key: str, file: Path) -> Iterator[Replay[Any]]:
    """Open the images in a column of a parquet file."""
    from pyarrow import parquet

    with parquet.ParquetFile(file, buffer_size=2**20, pre_buffer=False) as opened:
        groups = range(opened.num_row_groups)
        about = [opened.metadata.row_group(k) for k in groups]
        if max((group.total_byte_size for group in about), default=0) > MAX_GROUP_BYTES:
            raise VergenceError(f"{file} has more than {MAX_GROUP_BYTES:,} bytes in a row group.")
        begins = np.cumsum([0, *(group.num_rows for group in about)])[:-1]

        def read_from(begin: int) -> Iterator[tuple[int, Any]]:
            rest = list(groups)[int(np.searchsorted(begins, begin)) :]
            batches = opened.iter_batches(BATCH, rest, [key], use_threads=False)
            cells = (cell for batch in batches for cell in batch.column(0).to_pylist())
            yield from enumerate(cells, begin)

        yield Replay(begins, read_from)


def _stored_image(rows: _Rows, opened: Callable[[Path], Replay[Any]], k: int) -> np.ndarray:
    import pyarrow

    file, row = rows.files[rows.place[k, 0]], int(rows.place[k, 1])
    where = f"{file}: the image of row {row}"
    try:
        cell = opened(file)(row)
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise VergenceError(f"{where} cannot be read: {explain(error)}.") from error
    content = cell.get("bytes") if isinstance(cell, dict) else cell
    image = decode_image(content) if isinstance(content, bytes) else None
    if image is None:
        raise VergenceError(f"{where} {UNREADABLE}.")
    return image
