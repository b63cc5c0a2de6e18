"""The first map of a recording: cameras, eyes, joints, units and the board are guessed from it."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recordings import CHARUCO, held, picture
from vergence.errors import VergenceError
from vergence.files import validated
from vergence.geometry.board import Charuco, Chessboard
from vergence.recordings.first_map import first_map
from vergence.recordings.listing import ChannelListing, Listing
from vergence.recordings.recording import Channel
from vergence.recordings.recording_map import RecordingMap, describe, load_map

GREY = np.full((24, 32), 120, np.uint8)
TIMES = np.arange(20) * 10**8
STEREO = ("/stereo/left/image_raw", "/stereo/right/image_raw")
PAN_TILT = ("left_pan", "left_tilt", "right_pan", "right_tilt")


def listing(
    cameras: tuple[str, ...],
    joints: Mapping[str, float],
    *,
    pictures: tuple[np.ndarray, ...] = (GREY,),
    joint_times: np.ndarray = TIMES,
    frames: Mapping[str, str] | None = None,
) -> Listing:
    """List cameras, and joints that read from minus to plus a number."""
    channels = {
        name: ChannelListing(Channel(name, "images", "Image", 20), TIMES, TIMES, pictures, None, "")
        for name in cameras
    }
    states = Channel("/joint_states", "joints", "JointState", 20)
    channels["/joint_states"] = ChannelListing(states, joint_times, TIMES, (), None, "")
    ranges = {("/joint_states", name): (-most, most) for name, most in joints.items()}
    return Listing(Path("robot.mcap"), channels, ranges, frames or {})


def guessed(found: Listing) -> RecordingMap:
    """Return the first map, with the sides of the board filled in."""
    text = first_map(found).replace('square_m = "?"', "square_m = 0.03")
    mapped = validated(
        tomllib.loads(text.replace('marker_m = "?"', "marker_m = 0.02")), RecordingMap
    )
    describe(mapped, {source.images: (32, 24) for source in mapped.cameras.values()}, {})
    return mapped


@pytest.mark.parametrize(
    ("cameras", "names"),
    [
        (STEREO, "l_eye_pan l_eye_tilt r_eye_pan r_eye_tilt"),
        (("/cam_l/image", "/cam_r/image"), "LeftEyeYaw LeftEyePitch RightEyeYaw RightEyePitch"),
        (("/l_camera/rgb", "/r_camera/rgb"), "lpan ltilt rpan rtilt"),
        (("/cam0/image_raw", "/cam1/image_raw"), "eye.left.yaw eye.left.pitch eye.right.yaw "
         "eye.right.pitch"),
        (("leftcam", "rightcam"), "l_eye_pan eyes_tilt r_eye_pan eyes_tilt"),
        (STEREO, "head_pan_joint head_tilt_joint head_pan_joint head_tilt_joint"),
    ],
)  # fmt: skip
def test_eyes_and_joints_are_recognised_by_their_names(cameras, names):
    columns = dict(zip(PAN_TILT, names.split(), strict=True))
    others = {"l_wrist_pan_joint": 1.0, "r_arm_tilt": 1.0, "left_leg_yaw": 0.3, "jaw": 0.2}
    mapped = guessed(listing(cameras, others | dict.fromkeys(columns.values(), 0.4)))
    assert {name: each.images for name, each in mapped.cameras.items()} == dict(
        zip(("left_wide", "right_wide"), cameras, strict=True)
    )
    assert {name: each.column for name, each in mapped.joints.items()} == columns
    assert {each.unit for each in mapped.joints.values()} == {"rad"}


def test_version_and_vergence_become_kinematics():
    joints = {"neck_pitch": 5, "neck_roll": 2, "neck_yaw": 9, "eyes_tilt": 20, "eyes_vers": 30}
    mapped = guessed(listing(STEREO, joints | {"eyes_verg": 15}))
    assert mapped.kinematics is not None
    assert mapped.kinematics["left"][1].readings == {"eyes_vers": 1, "eyes_verg": -0.5}
    assert mapped.kinematics["right"][0].readings == {"eyes_tilt": 1}
    assert list(mapped.joints) == ["neck_pitch", "neck_roll", "neck_yaw"]
    units = [each.unit for each in (*mapped.readings.values(), *mapped.joints.values())]
    assert units == ["deg"] * 6


def test_channels_that_are_not_the_head_s_cameras_are_left_out():
    others = ("/stereo/left/image_rect", "/stereo/left/image_raw/compressed", "/stereo/left/depth",
              "/left_wrist/image_raw", "/overhead/image_raw")  # fmt: skip
    mapped = guessed(listing((*others, *STEREO), dict.fromkeys(PAN_TILT, 0.3)))
    assert [each.images for each in mapped.cameras.values()] == list(STEREO)


def test_two_cameras_of_an_eye_are_told_apart():
    names = ("/left/fovea/image", "/left/wide/image", "/right/fovea/image", "/right/wide/image")
    mapped = guessed(listing(names, dict.fromkeys(PAN_TILT, 0.3)))
    assert set(mapped.cameras) == {"left_narrow", "left_wide", "right_narrow", "right_wide"}


def test_times_that_cannot_be_those_of_the_stamps_are_taken_from_the_recorder():
    joints = dict.fromkeys(PAN_TILT, 0.3)
    assert guessed(listing(STEREO, joints)).stamps == "header"
    assert guessed(listing(STEREO, joints, joint_times=0 * TIMES)).stamps == "received"
    assert guessed(listing(STEREO, joints, joint_times=TIMES + 10**18)).stamps == "received"
    assert guessed(listing(STEREO, joints, joint_times=2 * TIMES)).max_gap_s == pytest.approx(0.6)


def test_poses_stand_in_for_joints():
    frames = {"l_eye": "head_link", "r_eye": "head_link", "head_link": "torso"}
    mapped = guessed(listing(STEREO, {}, frames=frames))
    assert mapped.poses["right"].eye == "r_eye"


@pytest.mark.parametrize("board", [CHARUCO, Chessboard(columns=6, rows=5, square_m=0.03)])
def test_the_board_is_found_but_not_its_size(board, tmp_path):
    pictures = tuple(picture(board, held(k), (280, 240))[0] for k in range(2))
    found = listing(STEREO, dict.fromkeys(PAN_TILT, 0.3), pictures=(GREY, *pictures))
    (tmp_path / "map.toml").write_text(first_map(found))
    with pytest.raises(VergenceError, match=r"(square_m|marker_m) is not filled in; found '[?]'"):
        load_map(tmp_path / "map.toml")
    shown: Any = guessed(found).board
    assert (shown.columns, shown.rows) == (board.columns, board.rows)
    if isinstance(board, Charuco):
        assert shown.dictionary == board.dictionary


def test_hostile_names_stay_inside_their_strings():
    nasty = 'x"\n[board]\nkind = "chessboard" # \x7f\x00 ☃ \\'
    joints = {f"{name}{nasty}": 0.3 for name in PAN_TILT}
    mapped = guessed(listing((f"/left/{nasty}", f"/right/{nasty}"), joints))
    assert mapped.board is None
    assert mapped.cameras["left_wide"].images == f"/left/{nasty}"
