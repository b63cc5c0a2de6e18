"""Mutations of every kind of file that is read: each ends in a valid result or in one sentence.

A file is damaged at random (bytes turned, cut, doubled, exchanged, numbers made odd) and read by
the function that the command line calls. What fails is an exception other than VergenceError, a
warning, a sentence of more than one line, more than 5 s or 1 GB, and a result that is not finite or
does not survive being written and read again.

    python benchmarks/mutated_files.py [--count 20000]
"""

from __future__ import annotations

import re
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

import cv2
import numpy as np
import tyro

from simulated_head import random_head
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.files import write_json
from vergence.geometry.board import Chessboard
from vergence.geometry.camera import pinhole
from vergence.geometry.head import HeadCalibration, load_head, save_head
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.geometry.parameters import parameter_values
from vergence.geometry.se3 import pose
from vergence.interchange.formats import ExportFormat, export_head, import_head
from vergence.recordings.bag import Storage, message, write_bag
from vergence.recordings.formats import open_recording
from vergence.recordings.recording import FramePose, JointSample
from vergence.recordings.scan import scan
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.evaluation import Truth, evaluate, load_truth
from vergence.twin.head_model import nominal_head
from vergence.twin.model import as_built_head
from vergence.twin.profile import ErrorProfile, load_profile

EXPORTS: dict[ExportFormat, str] = {
    "opencv": "a.yml", "kalibr": "b.yaml", "ros": "c", "urdf": "d.urdf"
}  # fmt: skip
MOST_S, MOST_BYTES = 5.0, 10**9
TOKENS = (
    b"", b"0", b"-1", b"1e999", b"-1e308", b"1e-320", b"NaN", b"nan", b".nan", b"Infinity",
    b"-.inf", b"null", b"true", b"[]", b"{}", b"[[[[", b'""', b"\0", b"\xff", b"\xef\xbb\xbf",
    b"\n", b",", b'"', b"9" * 400, b"1_000", b"0x10", b"*a", b"&a", b"<<: *a", b"../..",
    b"!!python/object:os.system", "\u0663".encode(), b"%", b"<!DOCTYPE a>", b"&amp;", b"left_wide",
    b"right", b"1:30", b"=1+1", b"- ", b"1", b"2.5", b"-0.01", b"1e-6", b"1e6",
)  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """A valid file, and what reads it."""

    file: Path
    """The one that is damaged."""
    read: Callable[[], Any]
    """Reads it, alone or with those that belong to it, and uses the result."""


def kinds(folder: Path) -> dict[str, Kind]:
    """Write a valid file of each kind into a new folder, and return them with their readers."""
    head = stated_head()
    calibration = folder / "calibration.json"
    save_head(head, calibration)
    small_dataset(folder / "set", head)
    made = {
        "dataset.json": Kind(folder / "set" / "dataset.json", lambda: use_dataset(folder / "set")),
        "frames.csv": Kind(folder / "set" / "frames.csv", lambda: use_dataset(folder / "set")),
        "png": Kind(folder / "set/images/00000_left_wide.png", lambda: use_dataset(folder / "set")),
        "calibration": Kind(calibration, lambda: use_head(load_head(calibration))),
    }
    small_dataset(folder / "jpeg", head)
    png = folder / "jpeg/images/00000_left_wide.png"
    png.write_bytes(cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    made["jpeg"] = Kind(png, lambda: use_dataset(folder / "jpeg"))
    truth = folder / "truth.json"
    write_json(true_of(head), truth)
    made["truth"] = Kind(truth, lambda: finite(evaluate(head, load_truth(truth))))
    profile = folder / "mine.toml"
    shipped = Path(sys.modules["vergence.twin"].__file__ or "").parent / "profiles" / "paper.toml"
    profile.write_bytes(shipped.read_bytes())
    made["profile"] = Kind(profile, lambda: use_profile(load_profile(str(profile))))
    chain, info = folder / "camchain.yaml", folder / "info"
    export_head(head, chain, "kalibr")
    made["kalibr"] = Kind(chain, lambda: use_head(import_head(chain, "kalibr", template=head)))
    export_head(head, info, "ros")
    made["ros"] = Kind(
        info / "left_wide.yaml", lambda: use_head(import_head(info, "ros", template=head))
    )
    return made | bags(folder)


def bags(folder: Path) -> dict[str, Kind]:
    """Write a bag in each storage with all kinds of content."""
    camera, rng, messages = pinhole(16, 12, 20.0), np.random.default_rng(3), []
    for k in range(12):
        now = 10**18 + k * 10**8
        sample = JointSample(("pan", "tilt"), np.array([0.1 * k, 0.2]))
        poses = (FramePose("base", "eye", pose(t=[0.01 * k, 0, 0])),)
        image = rng.integers(0, 255, (12, 16), np.uint8)
        content = {"i": image, "i/compressed": image, "c": camera, "j": sample, "tf": poses}
        messages += [message(f"/{name}", now, each) for name, each in content.items()]
    made = {}
    for storage in get_args(Storage):
        path = folder / ("small.bag" if storage == "ros1" else storage)
        write_bag(path, messages, storage=storage)
        files = [path] if storage == "ros1" else sorted(path.iterdir())
        for file in files:
            name = f"{storage} {file.suffix}"
            made[name] = Kind(file, lambda path=path: use_recording(path))
    return made


def use_recording(path: Path) -> None:
    """Scan a whole recording."""
    with open_recording(path) as recording:
        finite(*(track.values for track in scan(recording).joints.values()))


def stated_head() -> HeadCalibration:
    """Return a head without skew and k3, with an accuracy."""
    head = random_head(np.random.default_rng(1))
    names = tuple(parameter_values(head))
    return replace(head, accuracy=Accuracy("bundle", names, np.diag(np.full(len(names), 1e-6))))


def true_of(head: HeadCalibration) -> Truth:
    """Return a truth with that head."""
    return Truth(
        head=replace(head, accuracy=None),
        time_offset_s=0.0,
        eye_angles=np.zeros((3, 4)),
        T_lbase_target={0: np.eye(4)},
        board=Chessboard(columns=6, rows=5, square_m=0.03),
        seed=1,
        lens="2.8mm",
        profile=load_profile("paper"),
    )


def small_dataset(folder: Path, head: HeadCalibration) -> None:
    """Write a dataset of four frames whose images show nothing."""
    cameras = {name: DatasetCamera(mounted.eye, 64, 48) for name, mounted in head.cameras.items()}
    joints = {name: DatasetJoint(column=name, unit="rad") for name in EYE_JOINTS}
    board = Chessboard(columns=6, rows=5, square_m=0.03)
    rng = np.random.default_rng(2)
    rows = [
        DatasetRow(
            Frame(
                time_s=10.0 + k,
                joint_time_s=10.01 + k,
                eye_angles=rng.uniform(-0.3, 0.3, 4),
                neck_angles=np.zeros(3),
                images={name: rng.integers(0, 255, (48, 64, 3), np.uint8) for name in cameras},
            ),
            placement=k // 2,
        )
        for k in range(4)
    ]
    write_dataset(folder, Description(cameras=cameras, board=board, joints=joints), rows)


def use_dataset(folder: Path) -> None:
    """Read a dataset and all its images."""
    dataset = load_dataset(folder)
    finite(dataset.time_s, dataset.joint_time_s, dataset.neck_angles, dataset.description)
    finite(dataset.eye_angles if dataset.T_base_eye is None else dataset.T_base_eye)
    for row in range(len(dataset)):
        for camera, image in dataset.frame(row).images.items():
            stated = dataset.description.cameras[camera]
            assert image.shape == (stated.height, stated.width, 3)


def use_head(head: HeadCalibration) -> None:
    """Export a head to every format, save it, and locate a point with it."""
    finite(head)
    with TemporaryDirectory() as folder:
        for format_name, name in EXPORTS.items():
            try:
                export_head(head, Path(folder) / name, format_name)
            except VergenceError:  # for example a skew, for which it has no field
                continue
            files = (Path(folder) / name).rglob("*") if name == "c" else [Path(folder) / name]
            for file in files:
                assert not re.search(r"\b(nan|inf)\b", file.read_text(), re.IGNORECASE), file
        save_head(head, Path(folder) / "saved.json")
        again = load_head(Path(folder) / "saved.json")
        np.testing.assert_equal(parameter_values(again), parameter_values(head))
    pairs = [[n for n, c in head.cameras.items() if c.eye == eye][:1] for eye in ("left", "right")]
    if all(pairs):
        triangulate_at(
            head,
            left=np.array([[30.0, 20.0]]),
            right=np.array([[29.0, 20.0]]),
            joints=np.zeros(4),
            cameras=(pairs[0][0], pairs[1][0]),
        )


def use_profile(profile: ErrorProfile) -> None:
    """Build heads with the imperfections of a profile."""
    for seed in range(3):
        finite(as_built_head(nominal_head("2.8mm"), profile, seed))


def finite(*values: Any) -> None:
    """Raise AssertionError where a number in a result is not finite, at any depth."""
    for value in values:
        if is_dataclass(value):
            finite(*(getattr(value, each.name) for each in fields(value)))
        elif isinstance(value, Mapping):
            finite(*value.values())
        elif isinstance(value, tuple | list):
            finite(*value)
        elif isinstance(value, float | np.ndarray):
            assert np.isfinite(value).all(), f"a number is not finite: {value}"


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with one to three damages, most of them small."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        kind, at = rng.integers(11), int(rng.integers(len(data) + 1))
        length = int(rng.integers(1, 2 ** rng.integers(1, 9)))
        span = slice(at, at + length)
        if kind == 0:
            data[span] = rng.bytes(len(data[span]))
        elif kind == 1:
            del data[span]
        elif kind == 2:
            data[at:at] = data[span] * int(rng.integers(1, 20))
        elif kind == 3:
            del data[at:]
        elif kind == 4:
            data[at:at] = TOKENS[rng.integers(len(TOKENS))]
        elif kind == 5:
            lines = bytes(data).split(b"\n")
            a, b = rng.integers(len(lines), size=2)
            lines[a], lines[b] = lines[b], lines[a]
            data = bytearray(b"\n".join(lines))
        else:
            numbers = [*re.finditer(rb"-?\d[\d.eE+-]*|\"[^\"]{0,40}\"", bytes(data))]
            if numbers:
                old = numbers[rng.integers(len(numbers))]
                data[old.start() : old.end()] = TOKENS[rng.integers(len(TOKENS))]
    return bytes(data)


def attempt(kind: Kind, content: bytes) -> str:
    """Return how reading a file with that content ends: "read", "refused", or what went wrong."""
    original = kind.file.read_bytes()
    kind.file.write_bytes(content)
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            kind.read()
        end = "read"
    except VergenceError as error:
        end = "refused" if "\n" not in str(error) else f"not one sentence: {error}"
    except Exception:
        end = traceback.format_exc(limit=-3)
    finally:
        kind.file.write_bytes(original)
    took = time.perf_counter() - began
    return end if took < MOST_S else f"took {took:.1f} s ({end})"


def main(count: int = 20_000, first: int = 0) -> None:
    """Print how the mutations end, by kind of file, and every failure.

    Args:
        count: number of mutations.
        first: seed of the first.
    """
    if sys.platform == "linux":  # more memory raises MemoryError
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (3 * MOST_BYTES, resource.RLIM_INFINITY))
    ends: dict[str, Counter[str]] = {}
    with TemporaryDirectory() as folder:
        made = kinds(Path(folder))
        for seed in range(first, first + count):
            name = list(made)[seed % len(made)]
            content = mutated(made[name].file.read_bytes(), np.random.default_rng(seed))
            end = attempt(made[name], content)
            short = end if end in ("read", "refused") else "failed"
            ends.setdefault(name, Counter())[short] += 1
            if short == "failed":
                print(f"{name}, seed {seed}:\n{end}", flush=True)
    print("| kind | read | refused | failed |\n|---|---|---|---|")
    for name, of_kind in ends.items():
        print(f"| {name} | {of_kind['read']} | {of_kind['refused']} | {of_kind['failed']} |")


if __name__ == "__main__":
    tyro.cli(main)
