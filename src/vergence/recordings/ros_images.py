"""Decode the images and lenses of ROS messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from vergence.errors import VergenceError, explain
from vergence.geometry.camera import Camera
from vergence.geometry.lens import COEFFICIENTS
from vergence.interchange.ros import LENS_MODELS

_ENCODINGS: dict[str, tuple[type, int, int | None]] = {
    "mono8": (np.uint8, 1, None),
    "8UC1": (np.uint8, 1, None),
    "mono16": (np.uint16, 1, None),
    "16UC1": (np.uint16, 1, None),
    "rgb8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, cv2.COLOR_BGR2RGB),
    "bgr8": (np.uint8, 3, cv2.COLOR_BGR2RGB),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2RGB),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2RGB),
    # ROS names the first pixels of the first row; OpenCV those of the second row from the second.
    "bayer_rggb8": (np.uint8, 1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (np.uint8, 1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (np.uint8, 1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (np.uint8, 1, cv2.COLOR_BayerGB2RGB),
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2),
}
"""Type, channels and conversion by name of the encoding."""


def raw_image(message: Any, where: str) -> np.ndarray:
    """Decode an Image; VergenceError for an unknown encoding or missing bytes."""
    if message.encoding not in _ENCODINGS:
        raise VergenceError(
            f"{where} has images in the encoding {message.encoding!r:.40}; known are "
            f"{', '.join(_ENCODINGS)}."
        )
    dtype, channels, conversion = _ENCODINGS[message.encoding]
    height, width, step = message.height, message.width, message.step
    size = np.dtype(dtype).itemsize * channels * width
    data = np.asarray(message.data, np.uint8)
    if step < size or len(data) < step * (height - 1) + size:
        raise VergenceError(
            f"{where} has an image of {width} x {height} pixels and {len(data)} bytes in rows of "
            f"{step}; {message.encoding} needs {size} bytes a row."
        )
    rows = np.lib.stride_tricks.as_strided(data, (height, size), (step, 1))
    image = np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)
    if message.is_bigendian and dtype is np.uint16:
        image = image.byteswap()
    image = image[:, :, 0] if channels == 1 else image
    return image if conversion is None else cv2.cvtColor(image, conversion)


def compressed_image(message: Any, where: str) -> np.ndarray:
    """Decode a CompressedImage; VergenceError if it is damaged."""
    data = np.frombuffer(bytes(message.data), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR) if len(data) else None
    if image is None:
        raise VergenceError(f"{where} has a damaged image of format {message.format!r:.40}.")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def camera_lens(message: Any, where: str) -> Camera:
    """Read the lens of a CameraInfo of ROS 1 or ROS 2, for the images as they are sent.

    The matrix is for the whole sensor; the images may be a part of it, or its pixels binned.
    VergenceError without a calibration, or for a lens model that is not known.
    """
    matrix = np.array(getattr(message, "k" if hasattr(message, "k") else "K"), float).reshape(3, 3)
    distortion = np.array(getattr(message, "d" if hasattr(message, "d") else "D"), float).ravel()
    if not matrix.any():
        raise VergenceError(f"{where} states no lens: its camera matrix is zero.")
    name = message.distortion_model
    if not distortion.any() and name not in LENS_MODELS:
        name = "plumb_bob"
    if name not in LENS_MODELS:
        raise VergenceError(
            f"{where} has the lens model {name!r:.40}; known are {', '.join(LENS_MODELS)}."
        )
    part, bins = message.roi, np.maximum([message.binning_x, message.binning_y], 1)
    whole = np.array([message.width, message.height])
    size = np.where([part.width, part.height], [part.width, part.height], whole) // bins
    corner = np.array([part.x_offset, part.y_offset]) + (bins - 1) / 2
    matrix[:2, 2] -= corner
    matrix[:2] /= bins[:, None]
    needed = len(COEFFICIENTS[LENS_MODELS[name]])
    if len(distortion) < needed or not distortion[needed:].any():  # such as those of a thin prism
        distortion = np.pad(distortion, (0, needed))[:needed]
    try:
        return Camera(*size.tolist(), matrix, distortion, LENS_MODELS[name])
    except ValueError as error:
        raise VergenceError(f"{where} has an impossible lens: {explain(error)}.") from None
