"""Decode the images and lenses of ROS messages. ValueError if a message is damaged or unknown."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from vergence.data.images import decode_image
from vergence.geometry.camera import Camera
from vergence.geometry.lens import COEFFICIENTS
from vergence.interchange.ros import LENS_MODELS

_BAYER = {
    "rggb": cv2.COLOR_BayerBG2RGB,
    "bggr": cv2.COLOR_BayerRG2RGB,
    "gbrg": cv2.COLOR_BayerGR2RGB,
    "grbg": cv2.COLOR_BayerGB2RGB,
}
"""ROS names the first pixels of the first row; OpenCV those of the second row from the second."""
_ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    "mono8": ("u1", 1, None),
    "8UC1": ("u1", 1, None),
    "mono16": ("u2", 1, None),
    "16UC1": ("u2", 1, None),
    "rgb8": ("u1", 3, None),
    "bgr8": ("u1", 3, cv2.COLOR_BGR2RGB),
    "8UC3": ("u1", 3, cv2.COLOR_BGR2RGB),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2RGB),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2RGB),
    "yuv422": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    **{f"bayer_{order}8": ("u1", 1, conversion) for order, conversion in _BAYER.items()},
    **{f"bayer_{order}16": ("u2", 1, conversion) for order, conversion in _BAYER.items()},
}
"""Type, channels and conversion by name of the encoding."""


def raw_image(message: Any) -> np.ndarray:
    """Decode an Image."""
    if message.encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise ValueError(f"its encoding is {message.encoding!r:.40}; known are {known}")
    kind, channels, conversion = _ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = message.height, message.width, message.step
    stored = np.asarray(message.data, np.uint8)[: height * step].reshape(height, step)
    rows = np.ascontiguousarray(stored[:, : width * channels * dtype.itemsize])
    image = rows.view(dtype).astype(kind, copy=False).reshape(height, width, channels)
    image = image[:, :, 0] if channels == 1 else image
    if not image.size:
        raise ValueError("its image has no pixels")
    return image if conversion is None else cv2.cvtColor(image, conversion)


def compressed_image(message: Any) -> np.ndarray:
    """Decode a CompressedImage."""
    image = decode_image(np.asarray(message.data, np.uint8).tobytes())
    if image is None:
        raise ValueError(f"its image of format {message.format!r:.60} is damaged, or far too large")
    return image


def camera_lens(message: Any) -> Camera:
    """Read the lens of a CameraInfo of ROS 1, with K and D, or of ROS 2, with k and d."""
    ros1, name = hasattr(message, "K"), message.distortion_model
    matrix, distortion = (message.K, message.D) if ros1 else (message.k, message.d)
    if not distortion.any() and name not in LENS_MODELS:
        name = "plumb_bob"
    if name not in LENS_MODELS:
        raise ValueError(f"its lens model is {name!r:.40}; known are {', '.join(LENS_MODELS)}")
    needed = len(COEFFICIENTS[LENS_MODELS[name]])
    if not distortion[needed:].any():  # zeros may be missing, or too many
        distortion = np.pad(distortion, (0, needed))[:needed]
    return Camera(
        width=message.width,
        height=message.height,
        matrix=matrix.reshape(3, 3),
        distortion=distortion,
        model=LENS_MODELS[name],
    )
