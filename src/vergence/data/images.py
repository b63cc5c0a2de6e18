"""Decode the image files of a dataset."""

from __future__ import annotations

import warnings
from io import BytesIO

import cv2
import numpy as np
from PIL import Image

MAX_IMAGE_BYTES = 256 * 2**20
"""Largest image file; 50 million pixels of 16 bits in three colours have 300 MB unpacked."""
IMAGE_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "PPM", "WEBP")
UNREADABLE = f"is not a readable image ({', '.join(IMAGE_FORMATS)}), or far too large"


def image_size(content: bytes) -> tuple[int, int] | None:
    """Read width and height [px] from the header; None for a file that is not a whole image."""
    try:
        with warnings.catch_warnings():  # of odd metadata
            warnings.simplefilter("ignore")
            with Image.open(BytesIO(content), formats=IMAGE_FORMATS) as image:
                size = image.size
                image.verify()  # libpng prints a line of its own about a file that is cut off
                return size
    except Exception:  # readers raise errors of many kinds for damaged files
        return None


def decode_image(content: bytes, size: tuple[int, int]) -> np.ndarray | None:
    """Decode an image of a known size to (H, W, 3) RGB, uint8 or uint16; None if it is damaged."""
    try:
        # As the sensor was read out: an EXIF orientation would turn the pixel coordinates.
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    if image is None or image.shape[1::-1] != size or image.dtype not in (np.uint8, np.uint16):
        return None
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def filled_bits(image: np.ndarray) -> int:
    """Estimate the bits that a camera fills from an image: 8, 10, 12, 14 or 16."""
    return max(8, -(-int(image.max()).bit_length() // 2) * 2)


def eight_bits(image: np.ndarray, bits: int) -> np.ndarray:
    """Convert an image that fills a number of bits to uint8; brighter values become white."""
    return np.minimum(image >> (bits - 8), 255).astype(np.uint8)
