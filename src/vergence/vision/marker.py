"""Detect a square marker of the ArUco or AprilTag families.

The centre of a square is the intersection of its diagonals, in every perspective image too; the
mean of its corners depends on the slant. The diagonals are intersected in undistorted coordinates.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import marker_family
from vergence.geometry.camera import Camera, normalise, project
from vergence.vision.detector import Detection, Detector, windows
from vergence.vision.exposure import grey_levels


def marker_detector(dictionary: str, marker_id: int) -> Detector:
    """Make a detector of the centre of one marker.

    The marker is black on white with a margin of at least one module; a module is at least about
    three pixels wide in the image. Of several copies the largest counts.

    Args:
        dictionary: OpenCV's name of the family, such as DICT_4X4_50 or DICT_APRILTAG_36H11.
        marker_id: number of the marker in it.

    VergenceError if the dictionary is unknown, or does not contain the marker.
    """
    family = marker_family(dictionary, marker_id)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.relativeCornerRefinmentWinSize = 0.5  # modules: it excludes the next edge
    finder = cv2.aruco.ArucoDetector(family, parameters)
    modules = family.markerSize + 2  # with the black frame

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        grey = grey_levels(image)
        for rows, columns in windows(grey, near):
            quads, ids, _ = finder.detectMarkers(np.ascontiguousarray(grey[rows, columns]))
            numbers = () if ids is None else ids.ravel()
            copies = [q for q, number in zip(quads, numbers, strict=False) if number == marker_id]
            if copies:
                largest = max(copies, key=cv2.contourArea)
                corners = np.add(largest.reshape(4, 2), [columns.start, rows.start], dtype=float)
                module_px = np.sqrt(cv2.contourArea(largest)) / modules
                centre = _centre(corners, camera)
                # Above the errors at a noise of 3 grey levels: see tests/test_marker.py.
                std_px = float(np.hypot(0.05, 0.6 / module_px))
                return None if centre is None else Detection(centre, std_px)
        return None

    return detect


def _centre(corners: Array, camera: Camera) -> Array | None:
    """Compute the pixel (2,) of the centre of a square with corners (4, 2) [px].

    None where a corner lies beyond the lens model.
    """
    xy = normalise(camera, corners)
    a, b, c, d = np.concatenate([xy, np.ones((4, 1))], axis=1)
    meet = np.cross(np.cross(a, c), np.cross(b, d))
    if not np.isfinite(meet).all() or meet[2] == 0:
        return None
    return project(camera, meet / meet[2])
