"""OpenCV's FileStorage (.yml, .yaml or .json): the fields of the calibration file, for C++.

They are those of docs/calibration_file.md without `accuracy`. Matrices are cv::Mat, and lists of
numbers cv::Mat of one row. In keys, _ stands for characters that keys cannot have. Lens models are
radial-tangential (cv::projectPoints with 5 numbers), rational (with 8) and fisheye
(cv::fisheye::projectPoints).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydantic import TypeAdapter

from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.geometry.head import HeadCalibration
from vergence.interchange.serialization import check_cameras

SUFFIXES = (".yml", ".yaml", ".json")


def save(head: HeadCalibration, path: Path) -> None:
    """Write a head without its accuracy with cv2.FileStorage.

    VergenceError if a camera has skew, which OpenCV's functions ignore, the suffix is not one of
    SUFFIXES, or the file cannot be written.
    """
    check_cameras(head, "OpenCV's camera model")
    if path.suffix not in SUFFIXES:
        raise VergenceError(
            "OpenCV tells the format of a file by its suffix, and heads are in one of "
            f"{', '.join(SUFFIXES)}; found {path.name!r}."
        )
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(f"head{path.suffix}", flags)  # the suffix chooses the format
    content = TypeAdapter(HeadCalibration).dump_python(head, exclude={"accuracy"})
    for key, value in content.items():
        _write(storage, key, value)
    write_whole(path, storage.releaseAndGetString())


def _write(storage: cv2.FileStorage, key: str, value: Any) -> None:
    numbers = isinstance(value, list) and len(value) and not isinstance(value[0], (str, dict))
    if isinstance(value, dict):
        storage.startWriteStruct(key, cv2.FileNode_MAP)
        for name, part in value.items():
            _write(storage, re.sub(r"\W", "_", name), part)
        storage.endWriteStruct()
    elif numbers:
        storage.write(key, np.atleast_2d(np.array(value, float)))
    elif isinstance(value, (list, tuple)):
        storage.startWriteStruct(key, cv2.FileNode_SEQ)
        for part in value:
            _write(storage, "", part)
        storage.endWriteStruct()
    else:
        storage.write(key, value)
