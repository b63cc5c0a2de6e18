"""The first map of a recording: cameras, eyes, joints and units are guessed from it."""

import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from vergence.errors import VergenceError
from vergence.files import validated
from vergence.geometry.camera import pinhole
from vergence.recordings.first_map import first_map
from vergence.recordings.recording import (
    Channel,
    Content,
    JointSample,
    Kind,
    Message,
    Recording,
)
from vergence.recordings.recording_map import RecordingMap, describe, load_map
from vergence.recordings.scan import Scan, scan

GREY = np.full((24, 32), 120, np.uint8)
STEREO = ("/stereo/left/image_raw", "/stereo/right/image_raw")
PAN_TILT = ("left_pan", "left_tilt", "right_pan", "right_tilt")


def recorded(
    cameras: tuple[str, ...],
    joints: Mapping[str, float],
    *,
    channel: str = "/joint_states",
    lenses: tuple[str, ...] = (),
) -> Scan:
    """Return cameras, and joints that read from -x to x."""
    values = np.array([*joints.values()])
    content: dict[str, tuple[Content, ...]] = dict.fromkeys(cameras, (GREY,))
    content[channel] = tuple(JointSample(tuple(joints), sign * values) for sign in (-1, 1))
    kinds: dict[str, Kind] = {name: "images" for name in cameras}
    kinds[channel] = "joints"
    for name in lenses:
        kinds[name], content[name] = "lens", (pinhole(32, 24, 30.0),)

    def read(names, start, stop):
        for name in names:
            for k, each in enumerate(content[name]):
                yield Message(name, k, k, lambda each=each: each)

    channels = {name: Channel(name, kind, "", len(content[name])) for name, kind in kinds.items()}
    return scan(Recording(Path("robot.mcap"), channels, read))


def guessed(found: Scan) -> RecordingMap:
    """Return the first map, with the board filled in."""
    text = first_map(found)
    for name, value in (("columns", 7), ("rows", 6), ("square_m", 0.03)):
        text = text.replace(f'{name} = "?"', f"{name} = {value}")
    mapped = validated(tomllib.loads(text), RecordingMap)
    describe(mapped, {source.images: (32, 24) for source in mapped.cameras.values()}, {})
    return mapped


@pytest.mark.parametrize(
    ("cameras", "names"),
    [
        (STEREO, "l_eye_pan l_eye_tilt r_eye_pan r_eye_tilt"),
        (("/cam_l/image", "/cam_r/image"), "LeftEyeYaw LeftEyePitch RightEyeYaw RightEyePitch"),
        (("/l_camera/rgb", "/r_camera/rgb"), "l_pan l_tilt r_pan r_tilt"),
        (("/cam0/image_raw", "/cam1/image_raw"), "eye.left.yaw eye.left.pitch eye.right.yaw "
         "eye.right.pitch"),
        (("icub/cam/left", "icub/cam/right"), "l_eye_pan eyes_tilt r_eye_pan eyes_tilt"),
        (STEREO, "head_pan_joint head_tilt_joint head_pan_joint head_tilt_joint"),
    ],
)  # fmt: skip
def test_eyes_and_joints_are_recognised_by_their_names(cameras, names):
    columns = dict(zip(PAN_TILT, names.split(), strict=True))
    others = {"l_wrist_pan_joint": 1.0, "r_arm_tilt": 1.0, "left_leg_yaw": 0.3, "jaw": 0.2}
    mapped = guessed(recorded(cameras, others | dict.fromkeys(columns.values(), 0.4)))
    assert {name: each.images for name, each in mapped.cameras.items()} == dict(
        zip(("left_wide", "right_wide"), cameras, strict=True)
    )
    assert {name: each.column for name, each in mapped.joints.items()} == columns
    assert {each.unit for each in mapped.joints.values()} == {"rad"}


def test_joints_of_the_neck_and_degrees_are_recognised():
    names = ["neck_pitch", "neck_yaw", "left_pan", "eyes_tilt", "right_pan", "arm"]
    mapped = guessed(recorded(STEREO, dict.fromkeys(names, 20.0) | {"head_3": 900.0}))
    assert [*mapped.joints] == [*PAN_TILT, "neck_pitch", "neck_yaw"]
    assert {each.unit for each in mapped.joints.values()} == {"deg"}


def test_joints_without_names_are_left_to_the_user():
    numbers = {f"icub/head/state:o/{k}": 20.0 for k in range(6)}
    text = first_map(recorded(("left", "right"), numbers, channel="icub/head/state:o"))
    assert text.count('column = "?", unit = "deg"') == 4


def test_channels_that_are_not_the_head_s_cameras_are_left_out():
    others = ("/stereo/left/image_rect", "/stereo/left/image_raw/compressed", "/stereo/left/depth",
              "/left_wrist/image_raw", "/overhead/image_raw")  # fmt: skip
    lenses = tuple(name.replace("image_raw", "camera_info") for name in STEREO)
    found = recorded((*others, *STEREO), dict.fromkeys(PAN_TILT, 0.3), lenses=lenses)
    mapped = guessed(found)
    assert [each.images for each in mapped.cameras.values()] == list(STEREO)
    assert [each.lens for each in mapped.cameras.values()] == list(lenses)


def test_two_cameras_of_an_eye_are_told_apart():
    names = ("/left/fovea/image", "/left/wide/image", "/right/fovea/image", "/right/wide/image")
    mapped = guessed(recorded(names, dict.fromkeys(PAN_TILT, 0.3)))
    assert set(mapped.cameras) == {"left_narrow", "left_wide", "right_narrow", "right_wide"}


def test_what_is_not_filled_in_is_named(tmp_path):
    (tmp_path / "map.toml").write_text(first_map(recorded(STEREO, dict.fromkeys(PAN_TILT, 0.3))))
    with pytest.raises(VergenceError, match=r"board\.chessboard\.columns: .*found '[?]'"):
        load_map(tmp_path / "map.toml")


def test_hostile_names_stay_inside_their_strings():
    nasty = '"\n[board]\nkind = "chessboard" # \x7f\x00 ☃ \\'
    joints = {f"{name}{nasty}": 0.3 for name in PAN_TILT}
    mapped = guessed(recorded((f"/left/{nasty}", f"/right/{nasty}"), joints))
    assert mapped.cameras["left_wide"].images == f"/left/{nasty}"
