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
RANGE_PERCENT = 0.1, 99.9
"""Percentiles between which an image of 16 bits is stretched: hot pixels are fewer, and a board's
squares far more."""


def decode_image(content: bytes) -> np.ndarray | None:
    """Decode an image file to (H, W, 3), RGB, or (H, W), of uint8 or uint16; None if it is damaged.

    Pixels stay as they are stored, which is how the sensor was read out: an orientation by EXIF
    would turn their coordinates. Only TIFFs are turned, by their own tag, as decoders do. Images of
    more than MAX_IMAGE_AREA_PX count as damaged.
    """
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:  # readers raise errors of many kinds for damaged files
        with warnings.catch_warnings():  # of odd metadata
            warnings.simplefilter("ignore")
            with Image.open(BytesIO(content), formats=IMAGE_FORMATS) as header:
                size = header.size
                if size[0] * size[1] > MAX_IMAGE_AREA_PX:
                    return None
                # OpenCV decodes the same pixels, but its libraries print a line about each file
                # that is damaged or cut off.
                if header.format == "JPEG":
                    return np.asarray(header if header.mode == "L" else header.convert("RGB"))
                header.verify()
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except Exception:
        return None
    if image is None or image.dtype not in (np.uint8, np.uint16) or image.shape[1::-1] != size:
        return None
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def to_8_bits(image: np.ndarray, bits: int | None = None) -> np.ndarray:
    """Convert an image of uint8 or uint16 to uint8, by the range that its pixels fill.

    The range is that of RANGE_PERCENT, and of 256 levels at least. `bits` states another: from 0 to
    2^bits - 1.
    """
    if image.dtype == np.uint8:
        return image
    if bits:
        return np.minimum(np.right_shift(image, bits - 8), 255).astype(np.uint8)
    step = 1 + image.shape[0] // 500  # of large images, few rows and columns tell the range
    low, high = np.percentile(image[::step, ::step], RANGE_PERCENT, method="nearest").astype(float)
    levels = max(high - low, 255.0)
    low = max((low + high - levels) / 2, 0.0)
    return cv2.convertScaleAbs(np.maximum(image, int(low)), None, 255 / levels, -low * 255 / levels)
