"""Decode image files of unknown origin: their size is checked before memory is taken."""

from __future__ import annotations

import warnings
from collections.abc import Callable
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
_ORIENTATION = 274
"""Tag of the orientation in EXIF and TIFF."""
_STORED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    2: np.fliplr,
    3: lambda image: np.rot90(image, 2),
    4: np.flipud,
    5: lambda image: np.rot90(image[::-1], -1),
    6: np.rot90,
    7: lambda image: np.rot90(image[::-1]),
    8: lambda image: np.rot90(image, -1),
}
"""Turns an image as shown back to its pixels as stored, by their orientation."""


def image_size(content: bytes) -> tuple[int, int] | None:
    """Read width and height [px] in the header of an image file; None if it is damaged."""
    header = _header(content)
    return None if header is None else header[0]


def _header(content: bytes) -> tuple[tuple[int, int], str | None, int] | None:
    """Read size as stored [px], format, and orientation of the pixels that a decoder gives."""
    try:
        with warnings.catch_warnings():  # of odd metadata
            warnings.simplefilter("ignore")
            with Image.open(BytesIO(content), formats=IMAGE_FORMATS) as header:
                # Decoders turn a TIFF by its own tag, and leave other files as they are.
                turned = (
                    int(header.getexif().get(_ORIENTATION, 1)) if header.format == "TIFF" else 1
                )
                width, height = header.size
                size = (height, width) if turned in (5, 6, 7, 8) else (width, height)
                kind = header.format
                header.verify()  # libpng prints a line of its own about a file that is cut off
    except Exception:  # readers raise errors of many kinds for damaged files
        return None
    return size, kind, turned


def decode_image(content: bytes) -> np.ndarray | None:
    """Decode an image file to (H, W, 3), RGB, or (H, W), of uint8 or uint16; None if it is damaged.

    Pixels stay as they are stored, which is how the sensor was read out: orientations by EXIF and
    TIFF would turn their coordinates. Images of more than MAX_IMAGE_AREA_PX count as damaged.
    """
    header = _header(content)
    if header is None or header[0][0] * header[0][1] > MAX_IMAGE_AREA_PX:
        return None
    size, kind, turned = header
    image = _decoded_jpeg(content) if kind == "JPEG" else _decoded(content)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        return None
    image = _STORED.get(turned, np.asarray)(image)
    return np.ascontiguousarray(image) if image.shape[1::-1] == size else None


def _decoded_jpeg(content: bytes) -> np.ndarray | None:
    try:  # OpenCV decodes the same pixels, but prints a line about each damaged file
        with Image.open(BytesIO(content), formats=("JPEG",)) as image:
            return np.asarray(image if image.mode == "L" else image.convert("RGB"))
    except Exception:
        return None


def _decoded(content: bytes) -> np.ndarray | None:
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    return image if image is None or image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


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
