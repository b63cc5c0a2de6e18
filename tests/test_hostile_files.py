"""Files made with intent, and files damaged at random: a valid result or one sentence, in time.

The kinds of files, how they are read and what is done with the result stand in the benchmark
`mutated_files`, which tries many more. `test_impossible_contents` has files of the right form.
"""

import os
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mutated_files import attempt, mutated
from refusals import sentence

MUTATIONS = 20  # of each kind
JSON_KINDS = ("dataset.json", "calibration", "truth")
YAML_KINDS = ("kalibr", "ros")
TEXT_KINDS = (*JSON_KINDS, *YAML_KINDS, "profile", "frames.csv")
IMAGE_KINDS = ("png", "jpeg")
KINDS = (*TEXT_KINDS, *IMAGE_KINDS)
BAG_KINDS = ("ros1 .bag", "ros2 .db3", "ros2 .yaml", "mcap .mcap", "mcap .yaml")
"""test_bad_bags has what is in their place."""
ALL_KINDS = (*KINDS, *BAG_KINDS)


def test_what_is_made_is_read(sound_files):
    assert set(sound_files) == set(ALL_KINDS)
    for kind in sound_files.values():
        assert attempt(kind, kind.file.read_bytes()) == "read"


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_KINDS)
def test_files_damaged_at_random_are_read_or_refused(sound_files, name):
    kind = sound_files[name]
    content = kind.file.read_bytes()
    for seed in range(MUTATIONS):
        end = attempt(kind, mutated(content, np.random.default_rng([seed, ALL_KINDS.index(name)])))
        assert end in ("read", "refused"), f"seed {seed}: {end}"


def link_to(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(300 * 2**20)


@pytest.mark.parametrize("name", KINDS)
def test_what_is_no_file_of_reasonable_size_is_refused(sound_files, name):
    kind = sound_files[name]
    leads_out = "leads out of the dataset's folder"
    for change, says in (
        (os.mkfifo, "not a regular file"),
        (link_to("/dev/zero"), f"not a regular file|{leads_out}"),
        (link_to("/dev/tty0"), f"not a regular file|{leads_out}|Cannot read"),
        (link_to("nowhere"), "No such file|is missing|There is no"),
        (lambda path: path.symlink_to(path.name), "Too many|There is no|not a possible file name"),
        (Path.mkdir, "a folder|directory|regular file"),
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
        b'{"a":' * 20_000,
        b"a: " * 50_000,
        b"<a>" * 20_000,
        b"a." * 30_000 + b"b = 1",
        b"time_s," + b"9" * 60_000 + b"x",
        b'"' * 100_001,
        b"- " * 60_000,
        b"!!int 1\n",
        b"!!python/object/apply:os.system [ls]\n",
        b"%YAML 9.9\n---\na: 1\n",
        b"null",
        b"\xef\xbb\xbf",
    ],
    ids=range(16),
)
def test_text_that_is_none_of_these_files_is_refused(sound_files, name, content):
    if name == "profile" and content in (b"", b"\xef\xbb\xbf"):
        assert attempt(sound_files[name], content) == "read"  # a perfect head
        return
    sentence(sound_files[name], content)


@pytest.mark.parametrize("name", JSON_KINDS)
def test_json_without_end_or_number_is_refused(sound_files, name):
    kind = sound_files[name]
    text = kind.file.read_text()
    assert "repeated" in sentence(kind, text.replace("{", '{"x": 1, "x": 2,', 1).encode())
    many = ",".join(f'"k{k}": {k}' for k in range(100_000))
    said = sentence(kind, text.replace("{", "{" + many + ",", 1).encode())
    assert re.search("keys|too large", said)
    number = re.compile(r"(?<![\w\"])-?\d+\.\d+")
    for odd in ("NaN", "-Infinity", "1e999", "1" + "0" * 400, "9" * 5000, '"x"', "[]", "{}"):
        sentence(kind, number.sub(odd, text, count=1).encode())


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "\n".join(
    f"{b}: &{b} [*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a}]"
    for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)
MERGES = "a: &a {x: 1}\n" + "\n".join(f"b{k}: {{<<: [*a, *a, *a]}}" for k in range(1000))


@pytest.mark.parametrize("name", YAML_KINDS)
def test_yaml_that_stands_for_more_than_it_says_is_refused(sound_files, name):
    kind = sound_files[name]
    text = kind.file.read_text()
    for more in (BOMB, MERGES, "a: &a [*a]"):
        assert re.search("alias", sentence(kind, f"{text}\n{more}\n".encode()))
    for odd in (".nan", "-.inf", "1e999", "1:30", "0x10", "~", "[1, 2]", "{a: 1}", "9" * 5000):
        changed = re.sub(r"(?<=[ \[])\d+\.\d{3,}", odd, text, count=1)
        assert changed != text
        sentence(kind, changed.encode())


def test_a_table_without_end_is_refused(sound_files):
    kind = sound_files["frames.csv"]
    lines = kind.file.read_text().splitlines()
    wide = [",".join([line, *(f"_{k}" for k in range(2000))]) for line in lines]
    assert "more than 1000 columns" in sentence(kind, "\n".join(wide).encode())
    long = [lines[0], *[lines[1]] * 120_000]
    assert "100000 rows" in sentence(kind, "\n".join(long).encode())
    first = lines[1].split(",")
    for cell, says in (
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
def test_an_image_is_refused_by_its_header(sound_files, image):
    content, says = IMAGES[image]
    assert re.search(says, sentence(sound_files["png"], content))
