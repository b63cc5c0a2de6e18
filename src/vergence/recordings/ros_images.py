"""Decode the images and lenses of ROS messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from vergence.data.images import decode_image
from vergence.errors import VergenceError, explain
from vergence.geometry.camera import MAX_IMAGE_AREA_PX, Camera, is_image_size
from vergence.geometry.lens import COEFFICIENTS
from vergence.interchange.ros import LENS_MODELS

_ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    "mono8": ("u1", 1, None),
    "8UC1": ("u1", 1, None),
    "mono16": ("u2", 1, None),
    "16UC1": ("u2", 1, None),
    "rgb8": ("u1", 3, None),
    "rgb16": ("u2", 3, None),
    "bgr8": ("u1", 3, cv2.COLOR_BGR2RGB),
    "8UC3": ("u1", 3, cv2.COLOR_BGR2RGB),
    "bgr16": ("u2", 3, cv2.COLOR_BGR2RGB),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2RGB),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2RGB),
    "8UC4": ("u1", 4, cv2.COLOR_BGRA2RGB),
    # ROS names the first pixels of the first row; OpenCV those of the second row from the second.
    "bayer_rggb8": ("u1", 1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": ("u1", 1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": ("u1", 1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": ("u1", 1, cv2.COLOR_BayerGB2RGB),
    "bayer_rggb16": ("u2", 1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr16": ("u2", 1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg16": ("u2", 1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg16": ("u2", 1, cv2.COLOR_BayerGB2RGB),
    "yuv422": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
}
"""Type, channels and conversion by name of the encoding."""


def raw_image(message: Any, where: str) -> np.ndarray:
    """Decode an Image; VergenceError for an unknown encoding, missing bytes or too many pixels."""
    if message.encoding not in _ENCODINGS:
        raise VergenceError(
            f"{where} has images in the encoding {message.encoding!r:.40}; known are "
            f"{', '.join(_ENCODINGS)}."
        )
    kind, channels, conversion = _ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = message.height, message.width, message.step
    row_bytes = dtype.itemsize * channels * width
    data = np.asarray(message.data, np.uint8)
    _check_size(width, height, where)
    if step < row_bytes or len(data) < step * (height - 1) + row_bytes:
        raise VergenceError(
            f"{where} has an image of {width} x {height} pixels and {len(data)} bytes in rows of "
            f"{step}; {message.encoding} needs {row_bytes} bytes a row."
        )
    if step == row_bytes:
        rows = data[: height * row_bytes]
    else:
        rows = np.lib.stride_tricks.as_strided(data, (height, row_bytes), (step, 1))
    image = np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)
    image = image.astype(kind, copy=False)
    image = image[:, :, 0] if channels == 1 else image
    try:
        return image if conversion is None else cv2.cvtColor(image, conversion)
    except cv2.error:
        raise VergenceError(
            f"{where} has an image of {width} x {height} pixels, a size that {message.encoding} "
            "cannot have."
        ) from None


def compressed_image(message: Any, where: str) -> np.ndarray:
    """Decode a CompressedImage; VergenceError if it is damaged or has too many pixels.

    Its format is that of the file, or as image_transport writes it: "rgb8; jpeg compressed bgr8".
    """
    sent, _, stored = (part.strip() for part in message.format.partition(";"))
    image = decode_image(np.asarray(message.data, np.uint8).tobytes())
    if image is None:
        raise VergenceError(
            f"{where} has an image of format {message.format!r:.60} that is damaged, or far too "
            "large."
        )
    if image.ndim == 2:
        mosaic = _ENCODINGS[sent][2] if sent.startswith("bayer") and sent in _ENCODINGS else None
        return image if mosaic is None else cv2.cvtColor(image, mosaic)
    return image[..., ::-1] if "compressed rgb" in stored else image


def _check_size(width: int, height: int, where: str) -> None:
    if not is_image_size((width, height)):
        raise VergenceError(
            f"{where} has an image of {width} x {height} pixels; images have 1 to "
            f"{MAX_IMAGE_AREA_PX:,} pixels."
        )


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
        width, height = size.tolist()
        return Camera(
            width=width,
            height=height,
            matrix=matrix,
            distortion=distortion,
            model=LENS_MODELS[name],
        )
    except ValueError as error:
        raise VergenceError(f"{where} has an impossible lens: {explain(error)}.") from None
