"""Files made with intent, and files damaged at random: a valid result or one sentence, in time.

The kinds of files, how they are read and what is done with the result stand in the benchmark
`mutated_files`, which tries many more.
"""

import contextlib
import json
import os
import re
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mutated_files import Kind, attempt, kinds, mutated
from vergence.errors import VergenceError

MUTATIONS = 40  # of each kind
JSON_KINDS = ("dataset.json", "calibration", "truth", "opencv .json")
YAML_KINDS = ("opencv .yml", "kalibr", "ros")
TEXT_KINDS = (*JSON_KINDS, *YAML_KINDS, "opencv .xml", "profile", "frames.csv")
IMAGE_KINDS = ("png", "jpeg")
KINDS = (*TEXT_KINDS, *IMAGE_KINDS)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    return kinds(tmp_path_factory.mktemp("files"))


@contextlib.contextmanager
def replaced(kind: Kind, change: Callable[[Path], object]) -> Iterator[None]:
    """Put something else in the place of a file in a `with` block."""
    kept = kind.file.with_name("kept-" + kind.file.name + ".kept")
    kind.file.rename(kept)
    try:
        change(kind.file)
        yield
    finally:
        with contextlib.suppress(FileNotFoundError):
            kind.file.rmdir() if kind.file.is_dir() else kind.file.unlink()
        kept.rename(kind.file)


def sentence(kind: Kind, content: bytes | Callable[[Path], object]) -> str:
    """Return the one sentence with which other content is refused, in less than 5 s."""
    change = content if callable(content) else lambda path: path.write_bytes(content)
    began = time.perf_counter()
    with replaced(kind, change), pytest.raises(VergenceError) as refused:
        kind.read()
    assert time.perf_counter() - began < 5
    said = str(refused.value)
    assert "\n" not in said
    assert len(said) < 1500
    return said


def test_what_is_made_is_read(made):
    assert set(made) == set(KINDS)
    for kind in made.values():
        assert attempt(kind, kind.file.read_bytes()) == "read"


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_files_damaged_at_random_are_read_or_refused(made, name):
    kind = made[name]
    content = kind.file.read_bytes()
    for seed in range(MUTATIONS):
        end = attempt(kind, mutated(content, np.random.default_rng([seed, KINDS.index(name)])))
        assert end in ("read", "refused"), f"seed {seed}: {end}"


def link_to(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(300 * 2**20)


@pytest.mark.parametrize("name", KINDS)
def test_what_is_no_file_of_reasonable_size_is_refused(made, name):
    kind = made[name]
    leads_out = "leads out of the dataset's folder"
    for change, says in (
        (os.mkfifo, "not a regular file|no such file"),
        (link_to("/dev/zero"), f"not a regular file|{leads_out}"),
        (link_to("/dev/tty0"), f"not a regular file|{leads_out}|Cannot read|no such file"),
        (link_to("nowhere"), "No such file|no such file|There is no"),
        (lambda path: path.symlink_to(path.name), "Too many|There is no|not a possible file name"),
        (Path.mkdir, "directory|regular file|no such file"),
        (sparse, "too large"),
    ):
        assert re.search(says, sentence(kind, change)), change


@pytest.mark.parametrize("name", TEXT_KINDS)
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0" * 1000,
        b"\xff\xfe{\0}\0",
        b"[" * 200_000,
        b"{" * 200_000,
        b'{"a":' * 20_000,
        b"a: " * 50_000,
        b"<a>" * 20_000,
        b"a = " + b"[" * 60_000,
        b"a." * 30_000 + b"b = 1",
        b"9" * 60_000,
        b"time_s," + b"9" * 60_000 + b"x",
        b"\n" * 200_000,
        b'"' * 100_001,
        b"- " * 60_000,
        b"? " * 60_000,
        b"!!int 1\n",
        b"!!timestamp x\n",
        b"!!binary x\n",
        b"!!python/object/apply:os.system [ls]\n",
        b"--- a\n--- b\n",
        b"%YAML 9.9\n---\na: 1\n",
        b"=" * 1000,
        b"null",
        b"[[[]]]",
        b"-",
        b"\xef\xbb\xbf",
        "\u2028".encode() * 1000,
    ],
    ids=range(28),
)
def test_text_that_is_none_of_these_files_is_refused(made, name, content):
    if name == "profile" and content in (b"", b"\xef\xbb\xbf"):
        assert attempt(made[name], content) == "read"  # a perfect head
        return
    sentence(made[name], content)


@pytest.mark.parametrize("name", JSON_KINDS)
def test_json_without_end_or_number_is_refused(made, name):
    text = made[name].file.read_text()
    assert "repeated" in sentence(made[name], text.replace("{", '{"x": 1, "x": 2,', 1).encode())
    many = ",".join(f'"k{k}": {k}' for k in range(100_000))
    said = sentence(made[name], text.replace("{", "{" + many + ",", 1).encode())
    assert re.search("keys|too large", said)
    number = re.compile(r"(?<![\w\"])-?\d+\.\d+")
    for odd in ("NaN", "-Infinity", "1e999", "1" + "0" * 400, "9" * 5000, '"x"', "[]", "{}"):
        sentence(made[name], number.sub(odd, text, count=1).encode())


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "\n".join(
    f"{b}: &{b} [*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a}]"
    for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)
MERGES = "a: &a {x: 1}\n" + "\n".join(f"b{k}: {{<<: [*a, *a, *a]}}" for k in range(1000))


@pytest.mark.parametrize("name", YAML_KINDS)
def test_yaml_that_stands_for_more_than_it_says_is_refused(made, name):
    text = made[name].file.read_text()
    for more in (BOMB, MERGES, "<<: {a: 1}\n<<: {a: 2}", "a: &a [*a]"):
        assert re.search("alias|repeated", sentence(made[name], f"{text}\n{more}\n".encode()))
    for odd in (".nan", "-.inf", "1e999", "1:30", "0x10", "~", "[1, 2]", "{a: 1}", "9" * 5000):
        changed = re.sub(r"(?<=[ \[])\d+\.\d{3,}", odd, text, count=1)
        assert changed != text
        sentence(made[name], changed.encode())


def test_xml_with_entities_is_refused(made):
    bomb = '<!DOCTYPE a [<!ENTITY a "' + "x" * 1000 + '"><!ENTITY b "' + "&a;" * 1000 + '">]>'
    outside = '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    for declared in (bomb, outside):
        text = f"<?xml version='1.0'?>{declared}<opencv_storage><cameras>&a;</cameras>"
        said = sentence(made["opencv .xml"], f"{text}</opencv_storage>".encode())
        assert "document type" in said


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
    "axes has for each eye": lambda head: head.update(axes={"left": {}}, kinematics=None),
    "not a rotation": put("cameras", "left_wide", "T_eye_cam", 0, 0, value=3),
    "T_rbase_lbase": put("T_rbase_lbase", value=np.diag([-1, -1, -1, 1]).tolist()),
    "last row": put("T_rbase_lbase", 3, 0, value=1e-3),
    "1 to 64 cameras, found 0": put("cameras", value={}),
    "letters, digits": lambda head: head["cameras"].update({"../x": head["cameras"]["left_wide"]}),
    "a point on each axis": without_neck_point,
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
    "Unexpected keyword": put("cameras", "left_wide", "colour", value=True),
}


@pytest.mark.parametrize("says", CALIBRATIONS)
def test_an_impossible_calibration_is_refused_by_the_field(made, says):
    kind = made["calibration"]
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
def test_an_impossible_profile_is_refused_by_the_field(made, text):
    assert PROFILES[text] in sentence(made["profile"], text.encode())


def test_a_table_without_end_is_refused(made):
    kind = made["frames.csv"]
    lines = kind.file.read_text().splitlines()
    wide = [",".join([line, *(f"_{k}" for k in range(20_000))]) for line in lines]
    assert "more than 1000 columns" in sentence(kind, "\n".join(wide).encode())
    long = [lines[0], *[lines[1]] * 120_000]
    assert "100000 rows" in sentence(kind, "\n".join(long).encode())
    first = lines[1].split(",")
    for cell, says in (
        ("9" * 60_000 + "x", "over 4096 characters"),
        ("9" * 4000, "not a finite number"),
        ("1" + "_0" * 50, "not a finite number"),
        ("1e400", "not a finite number"),
        ("0x1p3", "not a finite number"),
        ("\N{ARABIC-INDIC DIGIT THREE}", "not a finite number"),
        ("=1+1", "not a finite number"),
        ("1.0f", "not a finite number"),
        ("--1", "not a finite number"),
        ("1 2", "not a finite number"),
        ("\0", "."),
    ):
        row = ",".join([cell, *first[1:]])
        assert re.search(says, sentence(kind, "\n".join([lines[0], row]).encode())), cell


def png(width: int, height: int, depth: int = 8, *more: bytes) -> bytes:
    """Return a PNG whose header states a size, and that has hardly any data."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0))
    end = chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunk(b"zTXt", text) for text in more) + end


IMAGES = {
    "a PNG of 32000 x 32000": (png(32_000, 32_000, 1), "readable image .*, or far too large"),
    "a PNG of 2^31 pixels": (png(2**31 - 1, 2**31 - 1), "readable|pixels"),
    "a PNG of no size": (png(0, 48), "readable|pixels"),
    "a PNG with nearly no data": (png(64, 48), "not a readable image"),
    "a PNG with a text that unpacks to 1 GB": (
        png(64, 48, 8, b"a\0\0" + zlib.compress(b"\0" * 10**8)),
        "not a readable image",
    ),
    "a BMP of negative size": (
        b"BM" + struct.pack("<IHHIIiiHH6I", 100, 0, 0, 54, 40, -64, 48, 1, 24, *6 * [0]),
        "readable|pixels",
    ),
    "a JPEG of 65535 x 65535": (
        b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff\x03" + b"\x01\x11\0" * 3 + b"\xff\xd9",
        "readable|65535",
    ),
    "a PPM of endless width": (b"P6 " + b"9" * 30 + b" 1 255\n", "readable|pixels"),
    "a PPM without data": (b"P6 64 48 255\n", "readable"),
    "a TIFF whose directory is a circle": (
        b"II*\0\x08\0\0\0" + struct.pack("<H", 0) + struct.pack("<I", 8),
        "readable",
    ),
    "a TIFF of 2^31 pixels": (
        b"II*\0\x08\0\0\0"
        + struct.pack("<HHHIIHHII", 2, 256, 4, 1, 2**31 - 1, 257, 4, 1, 2**31 - 1)
        + b"\0" * 4,
        "readable|pixels",
    ),
    "a GIF": (b"GIF89a\x40\0\x30\0\0\0\0;", "not a readable image"),
    "an SVG": (b'<svg width="64" height="48"/>', "not a readable image"),
    "a WEBP with a wrong length": (b"RIFF\xff\xff\xff\xffWEBPVP8 ", "not a readable image"),
    "an EPS": (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 48\n", "not a readable image"),
    "nothing": (b"", "not a readable image"),
    "text": (b"not an image", "not a readable image"),
}


@pytest.mark.parametrize("image", IMAGES)
def test_an_image_is_refused_by_its_header(made, image):
    content, says = IMAGES[image]
    assert re.search(says, sentence(made["png"], content))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"camera_model": "omni"}, "camera_model"),
        ({"distortion_model": "fov"}, "distortion_model"),
        ({"distortion_coeffs": "[0.1]"}, "distortion_coeffs has 1 numbers"),
        ({"intrinsics": "[1, 2, 3]"}, "intrinsics"),
        ({"intrinsics": "[-300, 300, 320, 240]"}, "focal lengths"),
        ({"resolution": "[640]"}, "resolution"),
        ({"resolution": "[0, 480]"}, "resolution"),
        ({"resolution": "[1000000, 480]"}, "width|resolution"),
        ({"rostopic": "/left_narrow/image"}, "a second time"),
        ({"rostopic": "/nobody/image"}, "No camera is called 'nobody'"),
    ],
)
def test_an_impossible_camchain_is_refused(made, change, says):
    text = made["kalibr"].file.read_text()
    for field, value in change.items():
        text = re.sub(rf"(?m)^  {field}:.*(\n  - .*)*", f"  {field}: {value}", text, count=1)
    assert re.search(says, sentence(made["kalibr"], text.encode()))


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
        ("rows: 3", "rows: 4", "a matrix of 4 x 3 has 9 numbers"),
        ("rows: 3", "rows: -3", "a matrix of -3 x 3"),
        ("cols: 5", "cols: 99999999999999999999", "a matrix of 1 x"),
        ("data:", "date:", "rows, cols and data"),
        ("camera_matrix", "camera_matrx", "camera_matrix"),
    ],
)
def test_an_impossible_camera_info_is_refused(made, old, new, says):
    text = made["ros"].file.read_text()
    assert old in text
    assert says in sentence(made["ros"], text.replace(old, new, 1).encode())


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("vergence-head-opencv-2", "vergence-head-opencv-9", "format"),
        ("right_narrow", "left", "not the name of an eye"),
        ("offset_rad", "offset_read", "offset_rad"),
        ("left_pan,", "", "1"),
        ("T_rbase_lbase", "T_rbase", "T_rbase_lbase"),
        ("image_width", "image_with", "image_width"),
        ("640", "64000000", "width"),
        ("480", "0", "image_height"),
        ("camera_matrix", "camera_matrices", "camera_matrix"),
        ("time_offset_s", "time_offset_s_", "."),
        ("rows", "rose", "matrix"),
    ],
)
def test_an_impossible_opencv_file_is_refused_or_read_without_the_field(
    made, suffix, old, new, says
):
    kind = made[f"opencv {suffix}"]
    text = kind.file.read_text()
    assert old in text
    content = text.replace(old, new).encode()
    if old == "time_offset_s":  # which may be missing
        assert attempt(kind, content) == "read"
    else:
        assert says in sentence(kind, content)
