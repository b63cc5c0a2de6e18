"""Files of recordings that are damaged at random: read, or refused in one sentence."""

from pathlib import Path

import numpy as np
import pytest

from mutated_files import Kind, attempt, mutated, use_recording
from written_recordings import (
    IMAGE_NS,
    IMAGES,
    refusal,
    write_csv,
    write_lerobot,
    write_tables,
    write_video,
    write_yarp,
)

MUTATIONS = 12
"""Damaged copies of each file; more take too long."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("av")
    root = tmp_path_factory.mktemp("written")
    write_yarp(root / "yarp", two_stamps=True)
    write_tables(root / "tables")
    write_video(root / "tables/wide.mkv", IMAGES["left"], codec="libx264rgb")
    write_csv(root / "tables/wide.csv", "stamp", [str(t) for t in IMAGE_NS])
    write_lerobot(root / "v3", "v3.0", videos=True)
    write_lerobot(root / "v2", "v2.1", videos=False, episodes=1)
    return root


@pytest.mark.parametrize(
    ("source", "file"),
    [
        ("yarp", "head/data.log"),
        ("yarp", "cam/left/data.log"),
        ("yarp", "cam/left/00000001.ppm"),
        ("tables", "joints.csv"),
        ("tables", "right/data.csv"),
        ("tables", "wide.mkv"),
        ("v3/episode_1", "../data/chunk-000/file-000.parquet"),
        ("v3/episode_1", "../meta/episodes/chunk-000/file-000.parquet"),
        ("v3/episode_1", "../meta/info.json"),
        ("v3/episode_1", "../videos/observation.images.left/chunk-000/file-000.mp4"),
        ("v2", "data/chunk-000/episode_000000.parquet"),
    ],
)
def test_files_damaged_at_random_are_read_or_refused(written, source, file):
    path = Path(str(written / source / file).replace("episode_1/../", ""))
    content, kind = path.read_bytes(), Kind(path, lambda: use_recording(written / source))
    for seed in range(MUTATIONS):
        end = attempt(kind, mutated(content, np.random.default_rng([seed, len(file)])))
        assert end in ("read", "refused"), f"seed {seed}: {end}"
    assert attempt(kind, content) == "read"


def test_a_playlist_does_not_lead_to_other_files(written):
    """FFmpeg would open the files and addresses that it names."""
    video = written / "tables" / "wide.mkv"
    content = video.read_bytes()
    for text in ("#EXTM3U\n#EXTINF:10,\n/dev/zero\n", "ffconcat version 1.0\nfile '/dev/zero'\n"):
        video.write_text(text)
        assert "cannot be read as a video" in refusal(written / "tables")
    video.write_bytes(content)
