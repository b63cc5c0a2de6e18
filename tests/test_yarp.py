"""Folders of yarpdatadumper as recordings."""

import numpy as np
import pytest

from vergence.recordings.formats import open_recording
from written_recordings import (
    IMAGE_NS,
    IMAGES,
    JOINT_NS,
    PAN_TILT,
    contents,
    refusal,
    seconds,
    write_image,
    write_port,
    write_video,
    write_yarp,
)


@pytest.mark.parametrize("two_stamps", [False, True])
def test_ports_are_read_as_they_were_dumped(tmp_path, two_stamps):
    write_yarp(tmp_path, two_stamps=two_stamps)
    read = contents(tmp_path)
    received = [message.received_ns for message, _ in read]
    assert received == sorted(received)
    latency = 2_000_000 if two_stamps else 0
    for name, stamps in (("head", JOINT_NS), ("cam/left", IMAGE_NS), ("cam/right", IMAGE_NS)):
        of_port = [(message, content) for message, content in read if message.channel == name]
        np.testing.assert_allclose([m.stamp_ns for m, _ in of_port], stamps, rtol=0, atol=500)
        apart = [m.received_ns - m.stamp_ns for m, _ in of_port]
        np.testing.assert_allclose(apart, latency, atol=1000)
        if name == "head":
            assert {content.names for _, content in of_port} == {("head/0", "head/1")}
            assert np.array_equal([content.values for _, content in of_port], PAN_TILT)
        else:
            found = [content for _, content in of_port]
            assert np.array_equal(found, IMAGES[name.removeprefix("cam/")])


def test_one_port_and_a_span_of_it_are_read(tmp_path):
    write_yarp(tmp_path)
    with open_recording(tmp_path / "cam" / "left") as recording:
        stamp = [each.stamp_ns for each in recording.read(["left"], None, None)][2]
        (message,) = recording.read(["left"], stamp, stamp + 1)
        assert np.array_equal(message.decode(), IMAGES["left"][2])


def test_numbers_of_lists_are_counted_and_words_are_not(tmp_path):
    """As of the port stateExt:o of a robot: positions, velocities, each with their state."""
    lines = ['4 1452882025.277218 (12.068511 nan -3.88e-05) [ok] (1 2.5 0.0) [ok] "at 7 rest"']
    write_port(tmp_path / "state", "Bottle", lines)
    ((_, content),) = contents(tmp_path)
    assert content.names == tuple(f"state/{k}" for k in (0, 2, 3, 4, 5))
    assert content.values.tolist() == [12.068511, -3.88e-05, 1, 2.5, 0]


def test_stamps_of_a_simulated_clock_are_told_apart_by_the_info_only(tmp_path):
    write_port(tmp_path / "port", "Bottle", ["1 0.5 0.502 30.5"], "tx+rx")
    write_port(tmp_path / "twin", "Bottle", ["1 0.5 0.502 30.5"], "tx")
    assert contents(tmp_path, "port")[0][1].values.tolist() == [30.5]
    assert contents(tmp_path, "twin")[0][1].values.tolist() == [0.502, 30.5]


def test_a_video_of_the_dumper_is_read(tmp_path):
    pytest.importorskip("av")
    stamps = [IMAGE_NS[0] - 20_000_000, *IMAGE_NS]  # the first image came before the video began
    lines = [f"{k} {seconds(t)} frame_{k:08d}" for k, t in enumerate(stamps)]
    write_port(tmp_path / "left", "Image; Video:avi(huffyuv)", lines)
    write_video(tmp_path / "left/video.avi", IMAGES["left"], codec="huffyuv")
    codes = "".join(f"{20 * k}\n" for k in range(4))
    (tmp_path / "left/timecodes.log").write_text(f"# timecode format v2\n{codes}")
    read = contents(tmp_path)
    assert np.array_equal([content for _, content in read], IMAGES["left"])
    np.testing.assert_allclose([m.stamp_ns for m, _ in read], IMAGE_NS, rtol=0, atol=500)
    (tmp_path / "left/timecodes.log").write_text("# timecode format v2\n0\n20\n")
    assert "more frames in its video than time codes" in refusal(tmp_path)


def test_a_last_line_that_is_cut_off_is_left_out_and_named(tmp_path):
    write_yarp(tmp_path)
    file = tmp_path / "head" / "data.log"
    file.write_bytes(file.read_bytes()[:-4])
    assert sum(message.channel == "head" for message, _ in contents(tmp_path)) == 11
    with open_recording(tmp_path) as recording:
        assert "last line" in recording.channels["head"].type


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("5 1700000000.2 1.5", "line 2 has other numbers than the first line"),
        ("5", "line 2: a number, a stamp in seconds"),
        ("5 nan 1 2", "line 2: a number, a stamp"),
        ("5 99999999999999 1 2", "not a time in s"),
        ("", "line 2: a number, a stamp"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, line, says):
    write_port(tmp_path / "head", "Bottle", ["4 1700000000.1 1.5 2.5", line])
    assert says in refusal(tmp_path)


def test_images_outside_of_the_recording_are_not_read(tmp_path):
    write_image(tmp_path / "secret.png", IMAGES["left"][0])
    inside = tmp_path / "recording"
    write_port(inside / "left", "Image", ["4 1700000000.1 00000000.png [rgb]"])
    assert "missing" in refusal(inside)
    (inside / "left" / "00000000.png").symlink_to(tmp_path / "secret.png")
    assert "leads out of the recording's folder" in refusal(inside)
    (inside / "left" / "data.log").write_text("4 1700000000.1 ../../secret.png\n")
    assert "without numbers or images" in refusal(inside)  # the dumper names no folder
    (inside / "left" / "data.log").unlink()
    (inside / "left" / "data.log").symlink_to("/dev/zero")
    assert "leads out" in refusal(inside)
