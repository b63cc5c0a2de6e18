"""Folders of csv, images and videos as recordings."""

import numpy as np
import pytest

from vergence.recordings.formats import open_recording
from vergence.recordings.series import UNITS_NS, files_in, inside, read_stamps
from written_recordings import (
    IMAGE_NS,
    IMAGES,
    JOINT_NS,
    PAN_TILT,
    contents,
    refusal,
    write_csv,
    write_image,
    write_tables,
    write_video,
)


def test_joints_and_images_are_read_with_their_stamps(tmp_path):
    write_tables(tmp_path)
    joints = contents(tmp_path, "joints")
    assert [message.stamp_ns for message, _ in joints] == JOINT_NS.tolist()
    assert {content.names for _, content in joints} == {("pan", "tilt")}
    assert np.array_equal([content.values for _, content in joints], PAN_TILT)
    for name, eye in (("left", "left"), ("right/data/filename", "right")):
        images = contents(tmp_path, name)
        assert [message.stamp_ns for message, _ in images] == IMAGE_NS.tolist()
        assert np.array_equal([content for _, content in images], IMAGES[eye])
    with open_recording(tmp_path) as recording:
        assert set(recording.channels) == {"joints", "left", "right/data/filename"}
        assert recording.channels["joints"].type == "csv, times in ns"
    assert len(contents(tmp_path / "joints.csv")) == len(JOINT_NS)


def test_links_to_folders_are_followed_once(tmp_path):
    (root := tmp_path / "set").mkdir()
    write_tables(root)
    plain = list(files_in(root))
    folder = next(each for each in root.iterdir() if each.is_dir())
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    for name, to in (("zagain", "elsewhere"), ("up", "."), ("elsewhere/loop", "elsewhere")):
        (root / name if "/" not in name else tmp_path / name).symlink_to(tmp_path / to)
    (root / "self").symlink_to(root)
    assert sorted(files_in(root)) == sorted(plain)
    assert all(inside(root, each).is_file() for each in plain)


@pytest.mark.parametrize("unit", UNITS_NS)
def test_units_are_recognised_and_said(tmp_path, unit):
    write_tables(tmp_path, "stamp", UNITS_NS[unit])
    found = [message.stamp_ns for message, _ in contents(tmp_path, "joints")]
    np.testing.assert_allclose(found, JOINT_NS, rtol=0, atol=500)
    with open_recording(tmp_path) as recording:
        assert recording.channels["joints"].type == f"csv, times in {unit}"


@pytest.mark.parametrize(
    ("first", "step", "name", "unit"),
    [
        (1.7e9, 0.1, "t", "s"),
        (1.7e12, 5000, "t", "ms"),
        (1.7e18, 1e7, "t", "ns"),
        (0, 0.033, "t", "s"),
        (0, 1, "time_s", "s"),
        (0, 1000, "stamp [us]", "us"),
        (17, 1, "Timestamp(ms)", "ms"),
        (5, 1, "time.nanoseconds", "ns"),
    ],
)
def test_the_unit_follows_from_name_or_size(first, step, name, unit):
    found, stamps = read_stamps(first + step * np.arange(50), name, "here")
    assert found == unit
    assert np.diff(stamps)[0] == pytest.approx(step * UNITS_NS[unit], abs=300)


def test_a_reading_that_is_missing_is_left_out(tmp_path):
    write_csv(tmp_path / "joints.csv", "t,pan,tilt", ["0.1,1,2", "0.2,,3", "0.3,nan,inf"])
    samples = [content for _, content in contents(tmp_path)]
    assert [each.names for each in samples] == [("pan", "tilt"), ("tilt",), ()]
    assert [each.values.tolist() for each in samples] == [[1, 2], [3], []]


def test_a_video_has_the_stamps_of_a_csv(tmp_path):
    pytest.importorskip("av")
    write_tables(tmp_path)
    images = np.empty((40, 48, 64, 3), np.uint8)
    images[:] = 6 * np.arange(40)[:, None, None, None]
    write_video(tmp_path / "wide.mkv", images, codec="libx264rgb")  # B-frames, few key frames
    stamps = JOINT_NS[0] + np.sort(np.random.default_rng(3).integers(0, 10**9, 40))
    rows = [f"{k},{t}" for k, t in enumerate(stamps)]
    write_csv(tmp_path / "wide_timestamps.csv", "frame,stamp", rows)
    with open_recording(tmp_path) as recording:
        assert recording.channels["wide"].count == 40
        assert "wide_timestamps" not in recording.channels
        of_frame = {each.stamp_ns: each.decode for each in recording.read(["wide"], None, None)}
        for k in (0, 1, 2, 39, 20, 21, 3):
            frame = of_frame[int(stamps[k])]()
            assert isinstance(frame, np.ndarray)
            assert np.abs(frame.astype(int) - 6 * k).max() <= 2
    write_csv(tmp_path / "wide_timestamps.csv", "stamp", [str(t) for t in stamps[1:]])
    assert "wide has 40 images, but 39 stamps" in refusal(tmp_path)


def test_images_numbered_by_frames_need_a_csv(tmp_path):
    write_tables(tmp_path)
    for k, image in enumerate(IMAGES["left"]):
        write_image(tmp_path / "third" / f"{k + 8}.png", image)
    with open_recording(tmp_path) as recording:
        assert recording.channels["third"].kind == "other"
        assert "numbers of frames" in recording.channels["third"].type
    write_csv(tmp_path / "third" / "stamps.csv", "stamp", [str(t) for t in IMAGE_NS])
    assert np.array_equal([content for _, content in contents(tmp_path, "third")], IMAGES["left"])
    write_csv(tmp_path / "third" / "stamps.csv", "stamp", [str(t) for t in IMAGE_NS[1:]])
    assert "third has 4 images, but 3 stamps" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "Empty CSV"),
        ("pan,tilt\n1,2\n", "csv without a column of times"),
        ("time,pan\n0.1,1\n0.2\n", "Expected 2 columns, got 1"),
        ("time,pan\n0.1,1\n0.2,on\n", "Failed to parse string: 'on'"),
        ("time,pan\n0.1,1\n,2\n", "stamp 2 is nan"),
        ("time,pan\n0.1,1\n1e30,2\n", "stamp 2 is 1e+30, not a time in s"),
        ("time,pan\n1,1\n2,2\n", "as numbers of frames are"),
        ("time,pan,pan\n0.1,1,2\n", "two columns have one name"),
        ("time,pan\n0.1,\0\n", "csv of times without numbers"),
        ("time,image\n0.1,../secret.png\n", "leads out of the recording's folder"),
        ("time,image\n0.1,none.png\n", "missing"),
        ("time,image\n0.1,link.png\n", "leads out of the recording's folder"),
        ("time,image\n0.1,joints.csv.png\n", "not a readable image"),
        (f"time,image\n0.1,{'a' * 5000}.png\n", "not a possible file name"),
    ],
)
def test_a_bad_csv_is_refused_in_one_sentence(tmp_path, text, says):
    write_image(tmp_path / "secret.png", IMAGES["left"][0])
    folder = tmp_path / "recording"
    folder.mkdir()
    (folder / "joints.csv").write_text(text)
    (folder / "joints.csv.png").write_text(text)
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    assert says in refusal(folder / "joints.csv")


def test_sizes_are_checked_before_memory_is_taken(tmp_path):
    with (tmp_path / "joints.csv").open("wb") as file:
        file.truncate(20 * 2**30)
    assert "too large" in refusal(tmp_path)
    (tmp_path / "joints.csv").write_bytes(b"," * 4000 + b"\n" * 10_000)
    assert "at most 20,000,000 cells are read" in refusal(tmp_path)
