"""Bags: what is written is read again, in each storage."""

from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, pinhole
from vergence.geometry.se3 import pose, rotation
from vergence.recordings.bag import Storage, message, write_bag
from vergence.recordings.formats import open_recording
from vergence.recordings.recording import FramePose, JointSample, Message

BEGIN_NS = 1_700_000_000_123_456_789
STORAGES = get_args(Storage)


def contents(frames: int = 3) -> Iterator[Message]:
    """All kinds of content, in order of receipt, 30 frames a second."""
    rng = np.random.default_rng(5)
    fisheye = pinhole(64, 48, (50, 51), (0.1, 0.2, 0.3, 0.4), model="fisheye")
    for k in range(frames):
        now = BEGIN_NS + k * 33_333_333
        grey, rgb = rng.integers(0, 256, (48, 64)), rng.integers(0, 256, (48, 63, 3))
        yield message("/left/image_raw", now, grey.astype(np.uint8))
        yield message("/left/depth", now, (grey * 200).astype(np.uint16))
        yield message("/right/image_raw/compressed", now, rgb.astype(np.uint8))
        yield message("/left/camera_info", now, fisheye)
        yield message("/joints", now, JointSample(("pan", "tilt"), np.array([k / 3, -2.0])))
        T = pose(rotation(np.array([0.1, -0.2, 0.3 * k])), [1.0, 2.0, 3.0])
        yield message("/tf", now, (FramePose("base", "eye", T), FramePose("eye", "cam", T)))
        late = now + 20_000_000
        yield message("/right/image_raw", now, rgb.astype(np.uint8), received_ns=late)


def bag_name(storage: str) -> str:
    return "a.bag" if storage == "ros1" else "a"


def assert_same(content: object, other: object) -> None:
    assert type(content) is type(other)
    if isinstance(content, Camera) and isinstance(other, Camera):
        assert (content.size, content.model) == (other.size, other.model)
        np.testing.assert_array_equal(content.matrix, other.matrix)
        np.testing.assert_array_equal(content.distortion, other.distortion)
    elif isinstance(content, JointSample) and isinstance(other, JointSample):
        assert content.names == other.names
        np.testing.assert_array_equal(content.values, other.values)
    elif isinstance(content, tuple) and isinstance(other, tuple):
        for one, two in zip(content, other, strict=True):
            assert (one.parent, one.child) == (two.parent, two.child)
            np.testing.assert_allclose(one.T_parent_child, two.T_parent_child, atol=1e-14)
    else:
        np.testing.assert_array_equal(content, other)  # type: ignore[arg-type]


@pytest.mark.parametrize("storage", STORAGES)
def test_what_is_written_is_read(tmp_path: Path, storage: Storage):
    path = tmp_path / bag_name(storage)
    write_bag(path, contents(), storage=storage)
    with open_recording(path) as recording:
        assert {channel.count for channel in recording.channels.values()} == {3}
        found = list(recording.read(list(recording.channels), None, None))
        for one, two in zip(found, contents(), strict=True):
            times = one.channel, one.stamp_ns, one.received_ns
            assert times == (two.channel, two.stamp_ns, two.received_ns)
            assert_same(one.decode(), two.decode())
        later = list(recording.read(["/joints"], BEGIN_NS + 1, BEGIN_NS + 60_000_000))
    assert [(each.channel, each.stamp_ns - BEGIN_NS) for each in later] == [("/joints", 33_333_333)]


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_is_not_overwritten(tmp_path: Path, storage: Storage):
    path = tmp_path / bag_name(storage)
    write_bag(path, contents(1), storage=storage)
    with pytest.raises(VergenceError, match="already exists"):
        write_bag(path, contents(1), storage=storage)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
