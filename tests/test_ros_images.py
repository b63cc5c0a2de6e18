"""Images and lenses of ROS messages: each encoding shows the picture that was encoded."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, pinhole, project
from vergence.recordings.ros_images import camera_lens, compressed_image, raw_image

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
    alpha = [np.full((HEIGHT, WIDTH), 77)] if "a8" in encoding or encoding == "8UC4" else []
    return np.stack([*(rgb[..., k] for k in order), *alpha], axis=-1).reshape(HEIGHT, -1)


TOLERANCES = {"bayer": 4, "yuv": 5, "uyv": 5, "yuy": 5}
"""Largest difference [grey levels]; other encodings are exact."""
DEEP = 256
"""Factor of pictures of 16 bits."""


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    "encoding",
    ["mono8", "8UC1", "mono16", "16UC1", "rgb8", "rgb16", "bgr8", "8UC3", "bgr16", "rgba8"]
    + ["bgra8", "8UC4", "yuv422", "uyvy", "yuv422_yuy2", "yuyv"]
    + [f"bayer_{order}{bits}" for order in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)],
)  # fmt: skip
def test_an_encoding_shows_the_picture(encoding: str, big: bool, padding: int):
    picture = smooth_picture()
    rows, deep = encoded(picture, encoding), encoding.endswith("16") or encoding.startswith("16")
    kind = (">u2" if big else "<u2") if deep else np.uint8
    stored = (rows.astype(int) * (DEEP if deep else 1)).astype(kind)
    data = stored.view(np.uint8).reshape(HEIGHT, -1)
    padded = np.pad(data, ((0, 0), (0, padding)), constant_values=255)
    found = raw_image(image_message(encoding, padded, is_bigendian=big), "here")
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
        ({"encoding": "32FC1"}, "encoding '32FC1'; known are mono8"),
        ({"step": WIDTH - 1}, "in rows of 29; mono8 needs 30 bytes a row"),
        ({"height": HEIGHT + 1}, "of 30 x 25 pixels and 720 bytes"),
        ({"height": 0}, "30 x 0 pixels"),
        ({"height": 2**31, "step": 2**31, "width": 2**31}, "images have 1 to 50,000,000 pixels"),
        ({"encoding": "yuv422", "width": 15, "step": 30}, "15 x 24 pixels, a size that yuv422"),
    ],
)
def test_an_impossible_image_is_refused(fields: dict[str, Any], said: str):
    message = image_message("mono8", encoded(smooth_picture(), "mono8"))
    vars(message).update(fields)
    with pytest.raises(VergenceError, match=said):
        raw_image(message, "here")


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


def test_a_compressed_mosaic_and_grey_and_swapped_pictures_are_decoded():
    picture = smooth_picture()
    mosaic = compressed(encoded(picture, "bayer_gbrg8"), "bayer_gbrg8; png compressed ")
    np.testing.assert_allclose(mosaic[2:-2, 2:-2], picture[2:-2, 2:-2], atol=4)
    deep = picture[..., 0].astype(np.uint16) * DEEP
    np.testing.assert_array_equal(compressed(deep, "mono16; png compressed "), deep)
    np.testing.assert_array_equal(compressed(picture, "rgb8; png compressed rgb8"), picture)


def compressed(image: np.ndarray, format: str, suffix: str = ".png") -> np.ndarray:
    data = cv2.imencode(suffix, image)[1].ravel()
    return compressed_image(SimpleNamespace(format=format, data=data), "here")


@pytest.mark.parametrize("data", [b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0" + bytes(99)])
def test_a_damaged_compressed_image_is_refused(data: bytes):
    message = SimpleNamespace(format="jpeg", data=np.frombuffer(data, np.uint8))
    with pytest.raises(VergenceError, match="image of format 'jpeg' that is damaged"):
        compressed_image(message, "here")


def lens_message(camera: Camera, name: str, *, ros1: bool, **fields: Any) -> SimpleNamespace:
    names = ("K", "D") if ros1 else ("k", "d")
    matrix = dict(zip(names, (camera.matrix.ravel(), camera.distortion), strict=True))
    part = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    stated = {"width": camera.width, "height": camera.height, "roi": part} | matrix
    stated |= {"distortion_model": name, "binning_x": 0, "binning_y": 0}
    return SimpleNamespace(**stated | fields)


LENSES = {
    "plumb_bob": pinhole(640, 480, (500, 502), (-0.2, 0.1, 0.001, -0.002, 0.01)),
    "rational_polynomial": pinhole(640, 480, 500, (0.1,) * 8, model="rational"),
    "equidistant": pinhole(640, 480, 300, (0.1, -0.01, 0.002, 0.0), model="fisheye"),
}


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", LENSES)
def test_lenses_of_all_models_are_read(name: str, ros1: bool):
    found = camera_lens(lens_message(LENSES[name], name, ros1=ros1), "here")
    assert (found.size, found.model) == (LENSES[name].size, LENSES[name].model)
    np.testing.assert_array_equal(found.matrix, LENSES[name].matrix)
    np.testing.assert_array_equal(found.distortion, LENSES[name].distortion)


def test_coefficients_of_zero_may_be_missing_or_too_many():
    few, many = np.array([-0.2, 0.1, 0, 0]), np.array([0.1] * 8 + [0.0] * 6)
    short = lens_message(LENSES["plumb_bob"], "plumb_bob", ros1=False, d=few)
    np.testing.assert_array_equal(camera_lens(short, "").distortion, [-0.2, 0.1, 0, 0, 0])
    long = lens_message(LENSES["plumb_bob"], "rational_polynomial", ros1=False, d=many)
    np.testing.assert_array_equal(camera_lens(long, "").distortion, many[:8])
    ideal = lens_message(LENSES["plumb_bob"], "", ros1=False, d=np.zeros(0))
    assert camera_lens(ideal, "").model == "radial-tangential"


def test_a_part_of_the_sensor_with_binned_pixels_has_its_own_lens():
    whole = LENSES["plumb_bob"]
    part = SimpleNamespace(x_offset=100, y_offset=40, width=400, height=300, do_rectify=False)
    message = lens_message(whole, "plumb_bob", ros1=False, roi=part, binning_x=2, binning_y=2)
    found = camera_lens(message, "here")
    assert found.size == (200, 150)
    points = np.array([[0.1, -0.05, 1.0], [-0.2, 0.1, 1.5]])
    # The centre of four pixels 2 i and 2 i + 1 lies at 2 i + 0.5.
    np.testing.assert_allclose(
        2 * project(found, points) + 0.5, project(whole, points) - [100, 40], atol=1e-9
    )


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"k": np.zeros(9)}, "states no lens: its camera matrix is zero"),
        ({"distortion_model": "thin_prism"}, "model 'thin_prism'; known are plumb_bob"),
        ({"width": 0}, "impossible lens: width: .*found 0"),
        ({"d": np.arange(14.0)}, "distortion has 5 coefficients, found 14"),
        ({"k": np.full(9, np.nan)}, "impossible lens: matrix: expected finite numbers"),
    ],
)
def test_an_impossible_lens_is_refused(fields: dict[str, Any], said: str):
    message = lens_message(LENSES["plumb_bob"], "plumb_bob", ros1=False, **fields)
    with pytest.raises(VergenceError, match=said):
        camera_lens(message, "here")
