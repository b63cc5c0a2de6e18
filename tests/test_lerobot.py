"""Datasets of LeRobot as recordings."""

import json
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
def test_episodes_are_read_one_after_another_and_alone(tmp_path, version, videos):
    if videos:
        pytest.importorskip("av")
    write_lerobot(tmp_path / "set", version, videos=videos)
    with open_recording(tmp_path / "set") as recording:
        usable = {name for name, each in recording.channels.items() if each.kind != "other"}
    assert usable == {"observation.state", LEFT, LEFT.replace("left", "right")}
    every = contents(tmp_path / "set", "observation.state", LEFT)
    joints = [(message, content) for message, content in every if message.channel != LEFT]
    assert {content.names for _, content in joints} == {("pan.pos", "tilt.pos")}
    expected = [[episode, row] for episode in range(3) for row in range(3 + episode)]
    assert [content.values.tolist() for _, content in joints] == expected
    stamps = np.array([message.stamp_ns for message, _ in joints])
    begins = [0, 3, 7]
    assert (np.diff(stamps)[[2, 6]] >= 10**10).all()
    images = [content for message, content in every if message.channel == LEFT]
    assert len(images) == len(expected)
    for k, image in enumerate(images):
        assert np.abs(image.astype(int) - IMAGES["left"][k % 4]).mean() <= (15 if videos else 0)
    alone = contents(tmp_path / "set" / "episode_1", "observation.state")
    assert [content.values.tolist() for _, content in alone] == expected[3:7]
    np.testing.assert_allclose(
        [message.stamp_ns for message, _ in alone], stamps[3:7] - stamps[begins[1]], atol=1000
    )
    assert "There is no episode" in refusal(tmp_path / "set" / "episode_7")


@pytest.mark.parametrize(("version", "videos"), VERSIONS[-2:])
def test_images_are_read_in_any_order(tmp_path, version, videos):
    write_lerobot(tmp_path / "set", version, videos=videos)
    with open_recording(tmp_path / "set") as recording:
        in_order = [m.decode() for m in recording.read([LEFT], None, None)]
        again = list(recording.read([LEFT], None, None))
        for k in (11, 0, 7, 8, 3, 2):
            assert np.array_equal(again[k].decode(), in_order[k])
        third = again[3].received_ns
        assert len(list(recording.read([LEFT], third, third + 1))) == 1


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
    table = pyarrow.table({"episode_index": np.zeros(31_000_000, np.int8)})
    parquet.write_table(table, file, compression="zstd")
    return folder


def truncated(folder: Path) -> Path:
    file = next(folder.glob("data/*/*.parquet"))
    file.write_bytes(file.read_bytes()[:-100])
    return folder


def linked(folder: Path) -> Path:
    file = next(folder.glob("data/*/*.parquet"))
    file.rename(folder.parent / "outside.parquet")
    file.symlink_to(folder.parent / "outside.parquet")
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
        (
            lambda f: changed(f, data_path="../../{episode_index}.parquet"),
            "leads out of the dataset",
        ),
        (lambda f: changed(f, data_path="/etc/{chunk_index}"), "leads out of"),
        (lambda f: changed(f, data_path="{chunk_index:0999999999d}"), "missing"),
        (lambda f: changed(f, data_path="{no_such_field}"), "no_such_field"),
        (lambda f: changed(f, features=3), "features"),
        (lambda f: changed(f, features={}), "without images and joint readings"),
        (lambda f: rewritten(f, lambda t: t.drop_columns(["timestamp"])), "no column timestamp"),
        (lambda f: rewritten(f, shorter_lists), "lists of different lengths"),
        (lambda f: rewritten(f, damaged_images), "is not a readable image"),
        (claiming, "31,000,000 numbers"),
        (truncated, "cannot be read as a dataset"),
        (linked, "leads out of"),
    ],
)
def test_a_damaged_dataset_is_refused_in_one_sentence(tmp_path, damage, says):
    write_lerobot(tmp_path / "set", "v3.0", videos=False)
    assert says in refusal(damage(tmp_path / "set"))


def test_a_video_that_is_too_short_or_missing_is_named(tmp_path):
    pytest.importorskip("av")
    write_lerobot(tmp_path / "set", "v2.1", videos=True)
    short, long = sorted(tmp_path.glob(f"set/videos/chunk-000/{LEFT}/*.mp4"))
    long.write_bytes(short.read_bytes())
    assert "has no frame at 0.060 s" in refusal(tmp_path / "set")
    long.write_bytes(short.read_bytes()[:500])
    assert "cannot be read as a video" in refusal(tmp_path / "set")
    long.unlink()
    assert "missing" in refusal(tmp_path / "set")


def test_a_video_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    write_lerobot(tmp_path / "set", "v2.1", videos=True)
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    assert "pip install 'vergence[video]'" in refusal(tmp_path / "set")
