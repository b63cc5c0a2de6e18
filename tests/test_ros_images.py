"""Images and lenses of ROS messages: each encoding shows the picture that was encoded."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from vergence.geometry.camera import Camera, pinhole
from vergence.recordings.ros import camera_lens, compressed_image, raw_image

HEIGHT, WIDTH = 24, 30


def smooth_picture() -> np.ndarray:
    """A picture (H, W, 3) of uint8 whose colours change slowly, each in another direction."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    red, green = 60 + 5 * u, 200 - 3 * u - 2 * v
    return np.stack([red, green, 40 + 3 * v], axis=-1).astype(np.uint8)


def luma_and_chroma(rgb: np.ndarray) -> np.ndarray:
    """Convert to Y, U and V of ITU-R BT.601 in the range of video, (..., 3) of float."""
    by_rgb = np.array(
        [[65.738, 129.057, 25.064], [-37.945, -74.494, 112.439], [112.439, -94.154, -18.285]]
    )
    return rgb @ by_rgb.T / 256 + [16, 128, 128]


def encoded(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Encode a picture as rows (H, n) of numbers."""
    if encoding.startswith("bayer"):
        pattern = encoding.removeprefix("bayer_")[:4]
        mosaic = np.empty((HEIGHT, WIDTH), np.uint8)
        for k, colour in enumerate(pattern):
            part = slice(k // 2, None, 2), slice(k % 2, None, 2)
            mosaic[part] = rgb[..., "rgb".index(colour)][part]
        return mosaic
    if encoding in ("yuv422", "uyvy", "yuv422_yuy2", "yuyv"):
        y, u, v = np.moveaxis(luma_and_chroma(rgb.astype(float)), -1, 0)
        u, v = ((c[:, ::2] + c[:, 1::2]) / 2 for c in (u, v))
        order = [u, y[:, ::2], v, y[:, 1::2]]
        if encoding in ("yuv422_yuy2", "yuyv"):
            order = [y[:, ::2], u, y[:, 1::2], v]
        return np.round(np.stack(order, axis=-1)).astype(np.uint8).reshape(HEIGHT, -1)
    if encoding in ("mono8", "8UC1", "mono16", "16UC1"):
        return rgb[..., 1]
    order = {"r": [0, 1, 2], "b": [2, 1, 0], "8": [2, 1, 0]}[encoding[0]]
    alpha = [np.full((HEIGHT, WIDTH), 77)] if "a8" in encoding else []
    return np.stack([*(rgb[..., k] for k in order), *alpha], axis=-1).reshape(HEIGHT, -1)


TOLERANCES = {"bayer": 4, "yuv": 5, "uyv": 5, "yuy": 5}
"""Largest difference [grey levels]; other encodings are exact."""
DEEP = 256
"""Factor of pictures of 16 bits."""


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    "encoding",
    ["mono8", "8UC1", "mono16", "16UC1", "rgb8", "bgr8", "8UC3", "rgba8", "bgra8"]
    + ["yuv422", "uyvy", "yuv422_yuy2", "yuyv"]
    + [f"bayer_{order}{bits}" for order in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)],
)  # fmt: skip
def test_an_encoding_shows_the_picture(encoding: str, big: bool, padding: int):
    picture = smooth_picture()
    rows, deep = encoded(picture, encoding), encoding.endswith("16") or encoding.startswith("16")
    kind = (">u2" if big else "<u2") if deep else np.uint8
    stored = (rows.astype(int) * (DEEP if deep else 1)).astype(kind)
    data = stored.view(np.uint8).reshape(HEIGHT, -1)
    padded = np.pad(data, ((0, 0), (0, padding)), constant_values=255)
    found = raw_image(image_message(encoding, padded, is_bigendian=big))
    assert found.dtype == (np.uint16 if deep else np.uint8)
    expected = picture[..., 1] if found.ndim == 2 else picture
    assert (found.ndim == 2) == (encoding in ("mono8", "8UC1", "mono16", "16UC1"))
    tolerance = TOLERANCES.get(encoding[:5], TOLERANCES.get(encoding[:3], 0))
    inner = slice(2, -2), slice(2, -2)
    error = found[inner] / (DEEP if deep else 1) - expected[inner].astype(float)
    assert np.abs(error).max() <= tolerance


def image_message(encoding: str, rows: np.ndarray, **fields: Any) -> SimpleNamespace:
    stated = {"height": HEIGHT, "width": WIDTH, "step": rows.shape[1], "is_bigendian": 0} | fields
    return SimpleNamespace(encoding=encoding, data=rows.ravel(), **stated)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"encoding": "32FC1"}, "encoding is '32FC1'; known are mono8"),
        ({"step": WIDTH - 1}, "reshape"),
        ({"height": HEIGHT + 1}, "reshape"),
        ({"height": 0}, "no pixels"),
        ({"height": 2**31, "step": 2**31, "width": 2**31}, "reshape"),
        ({"encoding": "yuv422", "width": 15, "step": 30}, "OpenCV"),
    ],
)
def test_an_impossible_image_is_refused(fields: dict[str, Any], said: str):
    message = image_message("mono8", encoded(smooth_picture(), "mono8"))
    vars(message).update(fields)
    with pytest.raises((ValueError, cv2.error), match=said):
        raw_image(message)


@pytest.mark.parametrize(
    ("format", "suffix", "tolerance"),
    [
        ("png", ".png", 0),
        ("rgb8; png compressed bgr8", ".png", 0),
        ("jpeg", ".jpg", 8),
        ("rgb8; jpeg compressed bgr8", ".jpg", 8),
    ],
)
def test_a_compressed_image_shows_the_picture(format: str, suffix: str, tolerance: int):
    picture = smooth_picture()
    found = compressed(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), format, suffix)
    assert np.abs(found.astype(int) - picture).max() <= tolerance


def compressed(image: np.ndarray, format: str, suffix: str = ".png") -> np.ndarray:
    data = cv2.imencode(suffix, image)[1].ravel()
    return compressed_image(SimpleNamespace(format=format, data=data))


@pytest.mark.parametrize("data", [b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0" + bytes(99)])
def test_a_damaged_compressed_image_is_refused(data: bytes):
    message = SimpleNamespace(format="jpeg", data=np.frombuffer(data, np.uint8))
    with pytest.raises(ValueError, match="image of format 'jpeg' is damaged"):
        compressed_image(message)


def lens_message(camera: Camera, name: str, *, ros1: bool, **fields: Any) -> SimpleNamespace:
    names = ("K", "D") if ros1 else ("k", "d")
    matrix = dict(zip(names, (camera.matrix.ravel(), camera.distortion), strict=True))
    stated = {"width": camera.width, "height": camera.height, "distortion_model": name}
    return SimpleNamespace(**stated | matrix | fields)


LENSES = {
    "plumb_bob": pinhole(640, 480, (500, 502), (-0.2, 0.1, 0.001, -0.002, 0.01)),
    "rational_polynomial": pinhole(640, 480, 500, (0.1,) * 8, model="rational"),
    "equidistant": pinhole(640, 480, 300, (0.1, -0.01, 0.002, 0.0), model="fisheye"),
}


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", LENSES)
def test_lenses_of_all_models_are_read(name: str, ros1: bool):
    found = camera_lens(lens_message(LENSES[name], name, ros1=ros1))
    assert (found.size, found.model) == (LENSES[name].size, LENSES[name].model)
    np.testing.assert_array_equal(found.matrix, LENSES[name].matrix)
    np.testing.assert_array_equal(found.distortion, LENSES[name].distortion)


def test_coefficients_of_zero_may_be_missing_or_too_many():
    few, many = np.array([-0.2, 0.1, 0, 0]), np.array([0.1] * 8 + [0.0] * 6)
    short = lens_message(LENSES["plumb_bob"], "plumb_bob", ros1=False, d=few)
    np.testing.assert_array_equal(camera_lens(short).distortion, [-0.2, 0.1, 0, 0, 0])
    long = lens_message(LENSES["plumb_bob"], "rational_polynomial", ros1=False, d=many)
    np.testing.assert_array_equal(camera_lens(long).distortion, many[:8])
    ideal = lens_message(LENSES["plumb_bob"], "", ros1=False, d=np.zeros(0))
    assert camera_lens(ideal).model == "radial-tangential"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"k": np.zeros(9)}, "focal lengths are positive"),
        ({"distortion_model": "thin_prism"}, "model is 'thin_prism'; known are plumb_bob"),
        ({"width": 0}, "greater than 0"),
        ({"d": np.arange(14.0)}, "8 distortion coefficients, .*; found 14"),
        ({"k": np.full(9, np.nan)}, "expected finite numbers"),
    ],
)
def test_an_impossible_lens_is_refused(fields: dict[str, Any], said: str):
    message = lens_message(LENSES["plumb_bob"], "plumb_bob", ros1=False, **fields)
    with pytest.raises(ValueError, match=said):
        camera_lens(message)
