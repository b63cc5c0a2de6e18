"""Read datasets of LeRobot, versions 2 and 3: joints in parquet, images there or in videos.

A folder has many episodes. They are read one after another, GAP_S apart, or one alone as
`FOLDER/episode_3`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from vergence.arrays import Array
from vergence.data.images import UNREADABLE, decode_image
from vergence.errors import VergenceError, counted, explain
from vergence.files import file_inside, read_json
from vergence.recordings.recording import Channel, JointSample, Recording
from vergence.recordings.series import Replay, Series, recording_of, unused
from vergence.recordings.stamps import nanoseconds
from vergence.recordings.video import Video, open_video

T = TypeVar("T")
GAP_S = 10.0
"""Time [s] between episodes; readings are not interpolated over it."""
MAX_ROWS = 5_000_000
"""Most rows of a file, two days at 30 Hz; as little as 1 kB of parquet may state more."""
BATCH = 16
"""Images of a parquet file that are in memory at once."""


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
    video_path: str | None = None
    chunks_size: int = 1000


@dataclass(frozen=True, eq=False)
class _Episode:
    """An episode of N rows."""

    data: Path
    rows: np.ndarray
    """(N,) of int, in the file."""
    time_s: Array
    """(N,) since its first row."""
    values: dict[str, Array]
    """By feature (N, C)."""
    videos: dict[str, tuple[Path, float]]
    """By feature the file, and the time [s] in it at which the episode begins."""


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
    with ExitStack() as stack:
        try:
            episodes = list(_episodes(root, info, wanted))
        except (pyarrow.ArrowException, OSError, LookupError, ValueError, TypeError) as error:
            raise VergenceError(
                f"{root} cannot be read as a dataset of LeRobot: {explain(error)}."
            ) from error
        if not episodes:
            count = counted(info.total_episodes, "episode")
            raise VergenceError(f"There is no episode {path}; the dataset has {count}.")
        yield recording_of(path, _series(info, episodes, stack), "a dataset of LeRobot")


def _inside(root: Path, name: str) -> Path:
    return file_inside(root, name, str(root / name)[:300], of="dataset")


def _episodes(root: Path, info: _Info, wanted: int | None) -> Iterator[_Episode]:
    """Read an episode, None: all, except its images."""
    videos = [key for key, feature in info.features.items() if feature.dtype == "video"]
    joints = [key for key, feature in info.features.items() if _is_joints(key, feature)]
    read = lru_cache(1)(partial(_table, columns=("episode_index", "timestamp", *joints)))
    metas = sorted(path.relative_to(root) for path in root.glob("meta/episodes/*/*.parquet"))
    listed = (row for meta in metas for row in _table(_inside(root, str(meta))).to_pylist())
    if not metas:  # before version 3
        indices = range(min(info.total_episodes, MAX_ROWS))
        listed = ({"episode_index": k, "episode_chunk": k // info.chunks_size} for k in indices)

    def file(template: str | None, part: str, key: str = "") -> Path:
        values = {name.removeprefix(f"{part}/"): value for name, value in row.items()}
        values["video_key"] = key
        # `str.format` could be asked for gigabytes of digits.
        field = r"\{(\w+)(?::0?(\d)d)?\}"
        filled = re.sub(
            field, lambda found: str(values[found[1]]).zfill(int(found[2] or 0)), template or ""
        )
        return _inside(root, filled)

    for row in listed:
        if wanted in (None, row["episode_index"]):
            data = file(info.data_path, "data")
            table = read(data)
            index = _matrix(table, "episode_index", data)[:, 0]
            rows = np.flatnonzero(index == row["episode_index"])
            values = {key: _matrix(table, key, data)[rows] for key in ("timestamp", *joints)}
            of_video = {
                key: (
                    file(info.video_path, f"videos/{key}", key),
                    float(row.get(f"videos/{key}/from_timestamp", 0.0)),
                )
                for key in videos
            }
            yield _Episode(data, rows, values.pop("timestamp")[:, 0], values, of_video)


def _is_joints(key: str, feature: _Feature) -> bool:
    return key.startswith("observation.") and feature.dtype.startswith("float")


def _table(file: Path, columns: tuple[str, ...] = ()) -> Any:
    """Read columns of a parquet file, by default all but statistics."""
    from pyarrow import parquet

    with parquet.ParquetFile(file) as opened:
        count, names = opened.metadata.num_rows, opened.schema_arrow.names
        if count > MAX_ROWS:
            raise VergenceError(f"{file} has {count:,} rows; at most {MAX_ROWS:,} are read.")
        if missing := sorted(set(columns) - set(names)):
            raise VergenceError(f"{file} has no column {', '.join(missing)}.")
        chosen = columns or [name for name in names if not name.startswith("stats/")]
        return opened.read(columns=list(chosen), use_threads=False)


def _matrix(table: Any, name: str, file: Path) -> Array:
    """Convert a column of numbers, or of lists of equal lengths, to (N, C)."""
    flat = table[name].combine_chunks()
    while flat.type.num_fields:
        flat = flat.flatten()
    values = flat.to_numpy(zero_copy_only=False).astype(float)
    if flat.null_count or len(values) % max(1, len(table)):
        raise VergenceError(f"{file}: column {name} has empty cells or lists of different lengths.")
    return values.reshape(len(table), -1 if len(table) else 0)


def _series(info: _Info, episodes: list[_Episode], stack: ExitStack) -> Iterator[Series]:
    """Chain the episodes of each feature."""
    begins = [0.0]
    for each in episodes:
        begins.append(begins[-1] + each.time_s.max(initial=0.0) + GAP_S)
    time_s = [begin + each.time_s for begin, each in zip(begins, episodes, strict=False)]
    stamps = nanoseconds(np.concatenate(time_s), "s", "timestamp")
    first = np.cumsum([0, *(len(each.rows) for each in episodes)])

    def locate(k: int) -> tuple[_Episode, int]:
        which = int(np.searchsorted(first, k, side="right")) - 1
        return episodes[which], k - int(first[which])

    for key, feature in info.features.items():
        if _is_joints(key, feature):
            values = np.concatenate([each.values[key] for each in episodes])
            names = _names(key, feature, values.shape[1])
            kind, content = "joints", lambda k, v=values, n=names: JointSample(n, v[k])
        elif feature.dtype == "video":
            video = _latest(open_video, stack)
            kind, content = "images", partial(_frame, locate, key, video, 0.5 / info.fps)
        elif feature.dtype == "image":
            images = _latest(partial(_stored, key), stack)
            kind, content = "images", partial(_stored_image, locate, images)
        else:
            yield unused(key, feature.dtype, len(stamps))
            continue
        yield Series(Channel(key, kind, feature.dtype, len(stamps)), stamps, stamps, content)


def _names(key: str, feature: _Feature, count: int) -> tuple[str, ...]:
    """List the joints of a feature: by their names if there are as many, or by their index."""
    names = feature.names
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
    locate: Callable[[int], tuple[_Episode, int]],
    key: str,
    opened: Callable[[Path], Video],
    tolerance_s: float,
    k: int,
) -> np.ndarray:
    episode, row = locate(k)
    file, begin_s = episode.videos[key]
    video, at_s = opened(file), begin_s + episode.time_s[row]
    index = int(np.argmin(np.abs(video.time_s - at_s)))
    if not abs(video.time_s[index] - at_s) <= tolerance_s:
        raise VergenceError(
            f"{file} has no frame at {at_s:.3f} s; it ends at {video.time_s[-1]:.3f} s."
        )
    return video.frame(index)


@contextmanager
def _stored(key: str, file: Path) -> Iterator[Replay[Any]]:
    """Open the images in a column of a parquet file."""
    from pyarrow import parquet

    with parquet.ParquetFile(file) as opened:
        groups = range(opened.num_row_groups)
        begins = np.cumsum([0, *(opened.metadata.row_group(k).num_rows for k in groups)])[:-1]

        def read_from(begin: int) -> Iterator[tuple[int, Any]]:
            rest = list(groups)[int(np.searchsorted(begins, begin)) :]
            batches = opened.iter_batches(BATCH, rest, [key], use_threads=False)
            cells = (cell for batch in batches for cell in batch.column(0).to_pylist())
            yield from enumerate(cells, begin)

        yield Replay(begins, read_from)


def _stored_image(
    locate: Callable[[int], tuple[_Episode, int]], opened: Callable[[Path], Replay[Any]], k: int
) -> np.ndarray:
    import pyarrow

    episode, row = locate(k)
    where = f"{episode.data}: the image of row {episode.rows[row]}"
    try:
        cell = opened(episode.data)(int(episode.rows[row]))
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise VergenceError(f"{where} cannot be read: {explain(error)}.") from error
    content = cell.get("bytes") if isinstance(cell, dict) else cell
    image = decode_image(content) if isinstance(content, bytes) else None
    if image is None:
        raise VergenceError(f"{where} {UNREADABLE}.")
    return image
