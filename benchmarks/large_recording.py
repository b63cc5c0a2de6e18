"""Time and memory of importing a large bag, beside reading it with rosbags alone.

A head rests 36 times before a board; two cameras of 640 x 480 take 30 images a second, and four
joints are read at 100 Hz. The library alone reads and deserialises all messages. The import also
compares all images, finds the board in those that it chooses, and writes a dataset.

    python benchmarks/large_recording.py [--gigabytes 2] [--storage mcap]
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tyro
from rosbags.highlevel import AnyReader

from drawn_card import WIDE, draw_card, sample_slopes
from vergence.data.description import DatasetJoint
from vergence.geometry.board import Chessboard
from vergence.geometry.kinematics import EYE_JOINTS, EYES
from vergence.geometry.se3 import pose, rotation
from vergence.recordings.bag import Storage, message, write_bag
from vergence.recordings.import_recording import import_recording
from vergence.recordings.recording import JointSample, Message
from vergence.recordings.recording_map import CameraSource, RecordingMap

BOARD = Chessboard(columns=7, rows=6, square_m=0.03)
LEAST_RATIO, MOST_MB = 0.5, 600
"""Bars: speed over that of the library alone, and resident memory [MB]."""
RESTS, MOVES = 36, 12
"""Rests of the head, and images of each motion between them."""
NOISY = 6
"""Images of each rest that have other noise."""
IMAGE_NS, JOINTS_NS, BEGIN_NS = 33_333_333, 10_000_000, 1_700_000_000_000_000_000


def picture() -> np.ndarray:
    """Draw the board with a margin of one square, 32 picture elements a square."""
    v, u = np.mgrid[: BOARD.rows + 3, : BOARD.columns + 3]
    inside = (u > 0) & (v > 0) & (u < BOARD.columns + 2) & (v < BOARD.rows + 2)
    squares = np.where(inside & ((u + v) % 2 == 0), 20, 230).astype(np.uint8)
    return np.kron(squares, np.ones((32, 32), np.uint8))


def rests() -> list[dict[str, list[np.ndarray]]]:
    """Draw the images of each rest by camera."""
    rng, slopes, card = np.random.default_rng(0), sample_slopes(WIDE), picture()
    width_m, drawn = card.shape[1] / 32 * BOARD.square_m, []
    for _ in range(RESTS):
        turn = rng.uniform(-0.4, 0.4, 3)
        centre = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.6)])
        images = {}
        for eye, shift in zip(EYES, (0.03, -0.03), strict=True):
            T = pose(t=[shift, 0, 0]) @ pose(rotation(turn), centre)
            clean = draw_card(WIDE, card, T, width_m, slopes=slopes, blur_px=0.6)[..., 0]
            noise = rng.normal(0, 2, (NOISY, *clean.shape))
            images[eye] = list(np.clip(clean + noise, 0, 255).astype(np.uint8))
        drawn.append(images)
    return drawn


def messages(total_bytes: float) -> Iterator[Message]:
    """Yield what the head records, in order of time."""
    drawn, rng = rests(), np.random.default_rng(1)
    postures = rng.uniform(-0.3, 0.3, (RESTS + 1, 4))
    each = round(total_bytes / (RESTS * 2 * WIDE.width * WIDE.height))
    joint_ns = 0
    for k in range(RESTS * each):
        rest, phase = divmod(k, each)
        now_ns = k * IMAGE_NS
        while joint_ns <= now_ns + IMAGE_NS:
            at, past = divmod(joint_ns / IMAGE_NS, each)
            part = np.clip((past - (each - MOVES)) / MOVES, 0, 1)
            values = postures[int(at)] + part * (postures[int(at) + 1] - postures[int(at)])
            sample = JointSample(EYE_JOINTS, values)
            yield message("/joints", BEGIN_NS + joint_ns, sample)
            joint_ns += JOINTS_NS
        shift = 6 * max(0, phase - (each - MOVES))
        for eye in EYES:
            image = np.roll(drawn[rest][eye][k % NOISY], shift, axis=1)
            yield message(f"/{eye}", BEGIN_NS + now_ns, image)


def read_alone(path: Path) -> float:
    """Read and deserialise all messages with the library; return the time [s]."""
    began = time.perf_counter()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
    return time.perf_counter() - began


def read_and_import(path: Path) -> float:
    """Import the bag into a dataset in its folder; return the time of reading all of it [s]."""
    cameras = {f"{eye}_wide": CameraSource(eye, f"/{eye}") for eye in EYES}
    joints = {name: DatasetJoint(column=name, unit="rad") for name in EYE_JOINTS}
    steps: dict[str, list[float]] = {}

    def progress(task: str, done: int, total: int) -> None:
        now = time.perf_counter()
        steps.setdefault(task, [now, now])[1] = now

    mapped = RecordingMap(cameras=cameras, board=BOARD, joints=joints)
    found = import_recording(path, mapped, path.parent / "set", progress=progress)
    print(
        f"{len(found)} frames, {found.moving.sum()} in motion, {len(set(found.placement))} places"
    )
    print(", ".join(f"{task} {end - begin:.1f} s" for task, (begin, end) in steps.items()))
    return next(end - begin for begin, end in steps.values())


def measured(work: Callable[[Path], float], path: Path) -> tuple[float, float, float]:
    """Return what work returns, its whole time [s] and its peak of resident memory [MB]."""
    began = time.perf_counter()
    reading_s = work(path)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return reading_s, time.perf_counter() - began, peak_mb


def alone(work: Callable[[Path], float], path: Path) -> tuple[float, float, float]:
    """Measure work in a process of its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(measured, work, path).result()


def main(gigabytes: float = 2.0, storage: Storage = "mcap") -> None:
    """Print time and memory of both.

    Args:
        gigabytes: size of the recording, which is written into the temporary folder.
        storage: kind of bag.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / ("a.bag" if storage == "ros1" else "a")
        write_bag(path, messages(gigabytes * 1e9), storage=storage)
        library_s, _, library_mb = alone(read_alone, path)
        reading_s, import_s, import_mb = alone(read_and_import, path)
        again_s, _, _ = alone(read_alone, path)
    library_s = (library_s + again_s) / 2
    print(f"{storage}, {gigabytes:g} GB: the library {library_s:.1f} s, {library_mb:.0f} MB")
    print(f"imported in {import_s:.1f} s, {import_mb:.0f} MB (bar {MOST_MB})")
    print(f"speed of reading {library_s / reading_s:.2f} of the library's (bar {LEAST_RATIO})")
    print(f"speed of the whole import {library_s / import_s:.2f}")


if __name__ == "__main__":
    tyro.cli(main)
