"""Files whose form is right and whose content cannot be: the sentence names the field."""

import json
import re
from collections.abc import Callable

import numpy as np
import pytest

from refusals import sentence


def without_neck_point(head: dict) -> None:
    head["neck"]["axes"] = [[0, 0, 1], [0, 1, 0]]
    head["neck"]["points_m"] = [[0, 0, 0]]


def put(*path: str | int, value: object) -> Callable[[dict], None]:
    def change(content: dict) -> None:
        for step in path[:-1]:
            content = content[step]
        content[path[-1]] = value

    return change


CALIBRATIONS = {
    "left.0.gain": put("kinematics", "eyes", "left", 0, "gain", value="nan"),
    "right.1.gain": put("kinematics", "eyes", "right", 1, "gain", value=1e300),
    "joints of the right eye are missing": lambda head: head["kinematics"]["eyes"].pop("right"),
    "kinematics.eyes.left": put("kinematics", "eyes", "left", value=None),
    "have the same axis": put("kinematics", "eyes", "left", 1, "axis", value=[0, 0, 1]),
    "none of the readings": put("kinematics", "readings", value=["left_pan"]),
    "at most 20 readings": put("kinematics", "readings", value=[f"r{k}" for k in range(21)]),
    "not a rotation": put("cameras", "left_wide", "T_eye_cam", 0, 0, value=3),
    "T_rbase_lbase": put("T_rbase_lbase", value=np.diag([-1, -1, -1, 1]).tolist()),
    "expected 4 x 4 numbers, found 2 x 2": put("T_rbase_lbase", value=[[1, 0], [0, 1]]),
    "left_wide.T_eye_cam": put("cameras", "left_wide", "T_eye_cam", 1, 3, value="NaN"),
    "left_wide.eye": put("cameras", "left_wide", "eye", value="third"),
    "last row": put("T_rbase_lbase", 3, 0, value=1e-3),
    "1 to 64 cameras, found 0": put("cameras", value={}),
    "letters, digits": lambda head: head["cameras"].update({"../x": head["cameras"]["left_wide"]}),
    "a point on each axis": without_neck_point,
    "2 joints have a name each": put(
        "neck",
        value={
            "axes": [[0, 0, 1], [0, 1, 0]],
            "points_m": [[0, 0, 0]] * 2,
            "joints": ["neck_yaw"] * 2,
        },
    ),
    "unit vectors": put("neck", value={"axes": [[0, 0, 2]], "points_m": [[0, 0, 0]]}),
    "time_offset_s": put("time_offset_s", value=1e6),
    "covariance": put("accuracy", "covariance", value=[[1.0, 0.0]]),
    "a row and a column": put("accuracy", "parameters", value=["a", "b"]),
    "twice": lambda head: put("accuracy", "parameters", 1, value=head["accuracy"]["parameters"][0])(
        head
    ),
    "is not positive": put("accuracy", "covariance", 2, 2, value=0.0),
    "not symmetric": put("accuracy", "covariance", 0, 1, value=1e-7),
    "positive semidefinite": lambda head: [
        put("accuracy", "covariance", i, j, value=2e-6)(head) for i, j in ((0, 1), (1, 0))
    ],
    "joint_std": put("accuracy", "joint_std", value=[-1]),
    "pixel_std_px": put("accuracy", "pixel_std_px", value=-0.1),
    "focal lengths": put("cameras", "left_wide", "intrinsics", "matrix", 0, 0, value=-300),
    "5 coefficients": put("cameras", "left_wide", "intrinsics", "distortion", value=[0.1] * 4),
    "at most 50,000,000 pixels": lambda head: head["cameras"]["left_wide"]["intrinsics"].update(
        {"width": 20_000, "height": 20_000}
    ),
    "less than or equal to 20000": put("cameras", "left_wide", "intrinsics", "width", value=10**9),
    "format": put("format", value="vergence-head-calibration-9"),
    "unknown field": put("cameras", "left_wide", "colour", value=True),
}


@pytest.mark.parametrize("says", CALIBRATIONS)
def test_an_impossible_calibration_is_refused_by_the_field(sound_files, says):
    kind = sound_files["calibration"]
    content = json.loads(kind.file.read_text())
    CALIBRATIONS[says](content)
    assert says in sentence(kind, json.dumps(content).encode())


PROFILES = {
    "[axes]\ndistance_mm = [1e308, 0.0]": "axes.distance_mm",
    "[axes]\nnonorthogonality_deg = [0.0, 1e308]": "axes.nonorthogonality_deg",
    "[mounting]\nrotation_deg = 1e308": "mounting.rotation_deg",
    "[mounting]\ntranslation_mm = 1e308": "mounting.translation_mm",
    "[mounting]\nbase_translation_mm = inf": "mounting.base_translation_mm",
    "[optics]\nfocal_percent = 1e4": "optics.focal_percent",
    "[optics]\nprincipal_px = 1e9": "optics.principal_px",
    "[joints]\ncounts_per_turn = 1" + "0" * 400: "joints.counts_per_turn",
    "[joints]\ngain_percent = [-100.0, 0.0, 0.0, 0.0]": "joints.gain_percent",
    "[joints]\noffset_deg = [1e308, 0, 0, 0]": "joints.offset_deg",
    "[joints]\nnoise_deg = nan": "joints.noise_deg",
    "[by_hand]\nfocal_percent_28 = -100": "by_hand.focal_percent_28",
    "[by_hand]\nroll_deg = 1e308": "by_hand.roll_deg",
    "[by_hand]\naxial_mm = 1e308": "by_hand.axial_mm",
    "[calibration]\nsquare_percent = 60": "calibration.square_percent",
    "a = " + "[" * 5000 + "]" * 5000: "nested too deeply",
    "x = 1979-05-27T07:32:00": "x",
    'fitted = [{name = "a"}]': "fitted",
}


@pytest.mark.parametrize("text", PROFILES, ids=range(len(PROFILES)))
def test_an_impossible_profile_is_refused_by_the_field(sound_files, text):
    assert PROFILES[text] in sentence(sound_files["profile"], text.encode())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"camera_model": "omni"}, "camera_model"),
        ({"distortion_model": "fov"}, "distortion_model"),
        ({"distortion_coeffs": "[0.1]"}, "4 at least are stated; found 1"),
        ({"intrinsics": "[1, 2, 3]"}, "intrinsics"),
        ({"intrinsics": "[-300, 300, 320, 240]"}, "focal lengths"),
        ({"resolution": "[640]"}, "resolution"),
        ({"resolution": "[0, 480]"}, "resolution"),
        ({"resolution": "[1000000, 480]"}, "width|resolution"),
        ({"rostopic": "/left_narrow/image"}, "No camera is called .cam0"),
        ({"rostopic": "/nobody/image"}, "No camera is called 'nobody'"),
    ],
)
def test_an_impossible_camchain_is_refused(sound_files, change, says):
    text = sound_files["kalibr"].file.read_text()
    for field, value in change.items():
        text = re.sub(rf"(?m)^  {field}:.*(\n  - .*)*", f"  {field}: {value}", text, count=1)
    assert re.search(says, sentence(sound_files["kalibr"], text.encode()))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("plumb_bob", "fisheye", "distortion_model"),
        ("camera_name: left_wide", "camera_name: ''", "camera_name"),
        ("camera_name: left_wide", "camera_name: right_wide", "also describes"),
        ("camera_name: left_wide", "camera_name: ../x", "No camera is called"),
        ("image_width: 640", "image_width: 0", "image_width"),
        ("image_width: 640", "image_width: 64000000", "width"),
        ("image_height: 480", "image_height: -1", "image_height"),
        ("data:", "date:", "camera_matrix.data"),
        ("camera_matrix", "camera_matrx", "camera_matrix"),
    ],
)
def test_an_impossible_camera_info_is_refused(sound_files, old, new, says):
    text = sound_files["ros"].file.read_text()
    assert old in text
    assert says in sentence(sound_files["ros"], text.replace(old, new, 1).encode())
