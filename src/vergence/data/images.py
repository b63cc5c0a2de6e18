"""Image files as a dataset has them."""

from __future__ import annotations

import warnings
from io import BytesIO

import cv2
import numpy as np
from PIL import Image

MAX_IMAGE_BYTES = 256 * 2**20
IMAGE_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "PPM", "WEBP")
UNREADABLE = f"is not a readable image ({', '.join(IMAGE_FORMATS)}), or far too large"


def image_size(content: bytes) -> tuple[int, int] | None:
    """Return width and height [px] by the header of an image file; None: not of IMAGE_FORMATS."""
    try:
        with warnings.catch_warnings():  # of odd metadata; large images are refused by the caller
            warnings.simplefilter("ignore")
            with Image.open(BytesIO(content), formats=IMAGE_FORMATS) as image:
                return image.size
    except Exception:  # its readers raise errors of many kinds on damaged headers
        return None


def decode_image(content: bytes, size: tuple[int, int]) -> np.ndarray | None:
    """Return an image file of a known size as (H, W, 3) uint8, RGB; None if it cannot be read."""
    try:
        # As the sensor was read out: an EXIF orientation would turn the pixel coordinates.
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    if image is None or image.shape[1::-1] != size:
        return None
    if image.dtype == np.uint16:  # of which cameras of 10 or 12 bits fill the lower ones only
        unused = max(0, int(image.max()).bit_length() - 8)
        image = np.right_shift(image, unused).astype(np.uint8)
    if image.dtype != np.uint8:
        return None
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
