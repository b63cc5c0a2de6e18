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
    """Return an image file of a known size as (H, W, 3) RGB; None if it cannot be read.

    uint8, or uint16 for an image of which a pixel has 16 bits.
    """
    if not _is_whole(content):
        return None
    try:
        # As the sensor was read out: an EXIF orientation would turn the pixel coordinates.
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    if image is None or image.shape[1::-1] != size:
        return None
    if image.dtype not in (np.uint8, np.uint16):
        return None
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _is_whole(content: bytes) -> bool:
    """Return whether the checksums of an image file are right, where its format has any.

    libpng would print a line of its own on standard error for a PNG file that is cut off.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(BytesIO(content), formats=IMAGE_FORMATS) as image:
                image.verify()
    except Exception:  # as in image_size
        return False
    return True


def filled_bits(image: np.ndarray) -> int:
    """Return how many bits a camera seems to fill by one of its images: 8, 10, 12, 14 or 16."""
    return max(8, -(-int(image.max()).bit_length() // 2) * 2)


def eight_bits(image: np.ndarray, bits: int) -> np.ndarray:
    """Return an image that fills a number of bits as uint8; brighter values become white."""
    return np.minimum(image >> (bits - 8), 255).astype(np.uint8)
