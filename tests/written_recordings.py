"""Small recordings of two cameras and two joints, written in the documented form of each format."""

import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from vergence.errors import VergenceError
from vergence.recordings.formats import open_recording
from vergence.recordings.recording import Content, Message

START_NS = 1_700_000_000_123_456_000
JOINT_NS = START_NS + np.arange(12) * 10_000_000
IMAGE_NS = START_NS + 15_000_000 + np.arange(4) * 20_000_000
PAN_TILT = np.round(np.random.default_rng(0).normal(0, 10, (12, 2)), 6)
IMAGES = {
    eye: np.random.default_rng(seed).integers(0, 256, (4, 24, 32, 3), dtype=np.uint8)
    for seed, eye in enumerate(("left", "right"))
}
"""By camera (4, 24, 32, 3), RGB."""


def seconds(time_ns: int) -> str:
    return f"{time_ns // 10**9}.{time_ns % 10**9 // 1000:06d}"


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def write_port(folder: Path, kind: str, lines: list[str], stamp: str = "rx") -> None:
    """Write a folder of yarpdatadumper."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "info.log").write_text(
        f"Type: {kind};\nStamp: {stamp};\n[{seconds(START_NS)}] /icub/{folder.name} [connected]\n"
    )
    (folder / "data.log").write_text("".join(f"{line}\n" for line in lines))


def write_yarp(folder: Path, *, two_stamps: bool = False) -> None:
    """Write a folder of ports: head and two cameras; received 2 ms after it was sent."""

    def stamps(time_ns: int) -> str:
        return seconds(time_ns) + (f" {seconds(time_ns + 2_000_000)}" if two_stamps else "")

    which = "tx+rx" if two_stamps else "rx"
    rows = zip(JOINT_NS.tolist(), PAN_TILT.tolist(), strict=True)
    lines = [f"{k} {stamps(t)} {pan} {tilt}" for k, (t, (pan, tilt)) in enumerate(rows)]
    write_port(folder / "head", "Bottle", lines, which)
    for eye, images in IMAGES.items():
        lines = [f"{7 + k} {stamps(t)} {k:08d}.ppm [rgb]" for k, t in enumerate(IMAGE_NS.tolist())]
        write_port(folder / "cam" / eye, "Image", lines, which)
        for k, image in enumerate(images):
            write_image(folder / "cam" / eye / f"{k:08d}.ppm", image)


def write_csv(path: Path, header: str, rows: list[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *rows, ""]))


def write_video(path: Path, images: np.ndarray, *, codec: str, rate: int = 50) -> None:
    """Write a video whose frames are decoded as they were: of a codec without loss."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as video:
        stream = video.add_stream(codec, rate=rate)
        stream.height, stream.width, stream.pix_fmt = *images.shape[1:3], "rgb24"
        for image in images:
            video.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        video.mux(stream.encode())


def write_tables(folder: Path, time: str = "time_ns", unit_ns: int = 1) -> None:
    """Write joints in a csv, images of the left eye in a folder, and a list of those of the right.

    Left images are named by their stamps, those of the right eye are in a folder of their own.
    """
    joints = zip(JOINT_NS.tolist(), PAN_TILT.tolist(), strict=True)
    rows = [f"{t / unit_ns if unit_ns > 1 else t!r},{pan},{tilt}" for t, (pan, tilt) in joints]
    write_csv(folder / "joints.csv", f"{time},pan,tilt", rows)
    for t, image in zip(IMAGE_NS.tolist(), IMAGES["left"], strict=True):
        write_image(folder / "left" / f"{t}.png", image)
    rows = [f"{t},{k}.png" for k, t in enumerate(IMAGE_NS.tolist())]
    write_csv(folder / "right" / "data.csv", "#timestamp [ns],filename", rows)
    for k, image in enumerate(IMAGES["right"]):
        write_image(folder / "right" / "data" / f"{k}.png", image)


def write_lerobot(folder: Path, version: str, *, videos: bool, episodes: int = 3) -> None:
    """Write episodes of 3, 4, ... rows at 50 Hz, whose images are those of IMAGES in a circle.

    Readings are the episode and the row. Images are in videos, or in the tables.
    """
    info = {
        "codebase_version": version, "robot_type": "head", "total_episodes": episodes, "fps": 50,
        "chunks_size": 2, "features": {
            "action": {"dtype": "float32", "shape": [2], "names": ["pan.pos", "tilt.pos"]},
            "observation.state": {"dtype": "float32", "shape": [2],
                                  "names": {"motors": ["pan.pos", "tilt.pos"]}},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            "episode_index": {"dtype": "int64", "shape": [1], "names": None},
            **{f"observation.images.{eye}": {"dtype": "video" if videos else "image",
                                             "shape": [24, 32, 3]} for eye in IMAGES},
        },
    }  # fmt: skip
    file = "chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}"
    info |= {"video_path": f"videos/{file}.mp4"}
    info |= {"data_path": f"data/{file}.parquet".replace("/{video_key}", "")}
    if version == "v3.0":
        file = "chunk-{chunk_index:03d}/file-{file_index:03d}"
        info |= {"data_path": f"data/{file}.parquet"}
        info |= {"video_path": f"videos/{{video_key}}/{file}.mp4"}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info))
    columns: dict[str, list] = {}
    metas, frames, first = [], {eye: [] for eye in IMAGES}, 0
    for episode in range(episodes):
        rows = range(3 + episode)
        at = {"chunk_index": 0, "file_index": 0} if version == "v3.0" else {
            "episode_chunk": episode // 2, "episode_index": episode}  # fmt: skip
        content = {
            "observation.state": [[float(episode), float(row)] for row in rows],
            "timestamp": pyarrow.array([row / 50 for row in rows], pyarrow.float32()).to_pylist(),
            "episode_index": [episode for _ in rows],
        }
        meta = {"episode_index": episode, "length": len(rows), "stats/timestamp/max": [1.0]}
        meta |= {f"data/{name}": index for name, index in at.items()}
        for eye, images in IMAGES.items():
            key, shown = f"observation.images.{eye}", images[[(first + row) % 4 for row in rows]]
            if videos:
                meta |= {f"videos/{key}/{name}": index for name, index in at.items()}
                meta[f"videos/{key}/from_timestamp"] = first / 50
                frames[eye] += list(shown)
                path = folder / info["video_path"].format(video_key=key, **at)
                if version != "v3.0" or episode == episodes - 1:
                    write_video(path, np.array(frames[eye]), codec="libx264rgb")
                    frames[eye].clear()
            else:
                files = [cv2.imencode(".png", image[..., ::-1])[1].tobytes() for image in shown]
                content[key] = [{"bytes": each, "path": f"{k}.png"} for k, each in enumerate(files)]
        for name, cells in content.items():
            columns.setdefault(name, []).extend(cells)
        metas.append(meta)
        first += len(rows)
        path = folder / info["data_path"].format(**at)
        path.parent.mkdir(parents=True, exist_ok=True)
        if version != "v3.0" or episode == episodes - 1:
            parquet.write_table(pyarrow.table(columns), path, row_group_size=5)
            columns = {}
    if version == "v3.0":
        path = folder / "meta/episodes/chunk-000/file-000.parquet"
        path.parent.mkdir(parents=True)
        parquet.write_table(pyarrow.Table.from_pylist(metas), path)


def contents(path: Path, *names: str) -> list[tuple[Message, Content]]:
    """Read channels of a recording; without names all that can be used."""
    with open_recording(path) as recording:
        chosen = names or [n for n, each in recording.channels.items() if each.kind != "other"]
        return [(each, each.decode()) for each in recording.read(chosen, None, None)]


def refusal(path: Path) -> str:
    with pytest.raises(VergenceError) as refused:
        contents(path)
    assert "\n" not in str(refused.value)
    return str(refused.value)
