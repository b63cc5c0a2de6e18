"""Datasets of LeRobot as recordings."""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from vergence.recordings.formats import open_recording
from written_recordings import IMAGES, contents, refusal, write_lerobot

VERSIONS = [("v2.0", True), ("v2.1", False), ("v3.0", True), ("v3.0", False)]
LEFT = "observation.images.left"


@pytest.mark.parametrize(("version", "videos"), VERSIONS)
def test_an_episode_is_read_in_any_order(tmp_path, version, videos):
    if videos:
        pytest.importorskip("av")
    write_lerobot(tmp_path / "set", version, videos=videos)
    assert "has 3 episodes: name one, such as " in refusal(tmp_path / "set")
    assert "has 3 episodes" in refusal(tmp_path / "set" / "episode_3")
    with open_recording(tmp_path / "set" / "episode_1") as recording:
        usable = {name for name, each in recording.channels.items() if each.kind != "other"}
        assert usable == {"observation.state", LEFT, LEFT.replace("left", "right")}
        samples = [each.decode() for each in recording.read(["observation.state"], None, None)]
        assert {sample.names for sample in samples} == {("pan.pos", "tilt.pos")}
        assert [sample.values.tolist() for sample in samples] == [[1, row] for row in range(4)]
        messages = list(recording.read([LEFT], None, None))
        np.testing.assert_allclose([m.stamp_ns for m in messages], np.arange(4) * 2e7, atol=100)
        for k in (0, 1, 3, 2, 0):
            image = messages[k].decode()
            expected = IMAGES["left"][(3 + k) % 4]  # after three rows of the episode before
            assert np.abs(image.astype(int) - expected).mean() <= (15 if videos else 0)
        third = messages[2].received_ns
        assert len(list(recording.read([LEFT], third, third + 1))) == 1


def test_a_dataset_of_one_episode_needs_no_name_of_it(tmp_path):
    write_lerobot(tmp_path / "set", "v2.1", videos=False, episodes=1)
    assert len(contents(tmp_path / "set", "observation.state")) == 3


def changed(folder: Path, **values: object) -> Path:
    info = json.loads((folder / "meta/info.json").read_text())
    (folder / "meta/info.json").write_text(json.dumps(info | values))
    return folder


def rewritten(folder: Path, change) -> Path:
    file = next(folder.glob("data/*/*.parquet"))
    parquet.write_table(change(parquet.read_table(file)), file)
    return folder


def claiming(folder: Path) -> Path:
    """Write many more rows than are read, in few bytes."""
    file = next(folder.glob("data/*/*.parquet"))
    table = pyarrow.table({"episode_index": np.zeros(34_000_000, np.int8)})
    parquet.write_table(table, file, compression="zstd")
    return folder


def shorter_lists(table):
    lists = [row[: 1 + k % 2] for k, row in enumerate(table["observation.state"].to_pylist())]
    return table.set_column(0, "observation.state", pyarrow.array(lists))


def damaged_images(table):
    cells = [{"bytes": b"\x89PNG", "path": "../secret.png"}] * len(table)
    return table.set_column(table.schema.get_field_index(LEFT), LEFT, pyarrow.array(cells))


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda f: changed(f, data_path="../../{episode_index}.parquet"), "leads out of"),
        (lambda f: changed(f, data_path="{chunk_index:0999999999d}"), "missing"),
        (lambda f: changed(f, data_path="{no_such_field}"), "no_such_field"),
        (lambda f: changed(f, features=3), "cannot be read as a dataset of LeRobot"),
        (lambda f: changed(f, features={}), "no images and no joint readings"),
        (lambda f: rewritten(f, lambda t: t.drop_columns(["timestamp"])), "timestamp"),
        (lambda f: rewritten(f, shorter_lists), "cannot be read as a dataset of LeRobot"),
        (lambda f: rewritten(f, damaged_images), "is not a readable image"),
        (claiming, "more than 536,870,912 bytes"),
    ],
)
def test_a_damaged_dataset_is_refused_in_one_sentence(tmp_path, damage, says):
    write_lerobot(tmp_path / "set", "v3.0", videos=False)
    assert says in refusal(damage(tmp_path / "set") / "episode_0")


def test_a_video_that_is_too_short_or_missing_is_named(tmp_path):
    pytest.importorskip("av")
    write_lerobot(tmp_path / "set", "v2.1", videos=True)
    short, long = sorted(tmp_path.glob(f"set/videos/chunk-000/{LEFT}/*.mp4"))
    long.write_bytes(short.read_bytes())
    episode = tmp_path / "set" / "episode_1"
    assert "has no frames at some times of episode 1" in refusal(episode)
    long.write_bytes(short.read_bytes()[:500])
    assert "cannot be read as a video" in refusal(episode)
    long.unlink()
    assert "missing" in refusal(episode)


def test_a_video_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    write_lerobot(tmp_path / "set", "v2.1", videos=True)
    monkeypatch.setitem(sys.modules, "av", None)
    assert "pip install 'vergence[video]'" in refusal(tmp_path / "set" / "episode_0")
