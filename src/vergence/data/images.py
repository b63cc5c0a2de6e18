"""Decode image files of unknown origin: their size is checked before memory is taken."""

from __future__ import annotations

import warnings
from io import BytesIO

import cv2
import numpy as np
from PIL import Image

from vergence.geometry.camera import MAX_IMAGE_AREA_PX

IMAGE_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "PPM", "WEBP")
UNREADABLE = f"is not a readable image ({', '.join(IMAGE_FORMATS)}), or far too large"
MAX_IMAGE_BYTES = 256 * 2**20
"""Largest image file [bytes]; unpacked, 50 megapixels of RGB have 150 MB, of 16 bits 300 MB."""


def image_size(content: bytes) -> tuple[int, int] | None:
    """Read width and height [px] in the header of an image file; None if it is damaged."""
    try:
        with warnings.catch_warnings():  # of odd metadata
            warnings.simplefilter("ignore")
            with Image.open(BytesIO(content), formats=IMAGE_FORMATS) as header:
                size = header.size
                header.verify()  # libpng prints a line of its own about a file that is cut off
    except Exception:  # readers raise errors of many kinds for damaged files
        return None
    return size


def decode_image(content: bytes) -> np.ndarray | None:
    """Decode an image file to (H, W, 3), RGB, or (H, W), of uint8 or uint16; None if it is damaged.

    Images of more than MAX_IMAGE_AREA_PX count as damaged.
    """
    size = image_size(content)
    if size is None or size[0] * size[1] > MAX_IMAGE_AREA_PX:
        return None
    # As the sensor was read out: an EXIF orientation would turn the pixel coordinates.
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    if image is None or image.shape[1::-1] != size or image.dtype not in (np.uint8, np.uint16):
        return None
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def to_8_bits(image: np.ndarray, bits: int | None = None) -> np.ndarray:
    """Convert an image of uint8 or uint16 to uint8; None: as many bits as its brightest pixel."""
    if image.dtype == np.uint8:
        return image
    bits = bits or max(8, int(image.max()).bit_length())
    return np.minimum(np.right_shift(image, bits - 8), 255).astype(np.uint8)
