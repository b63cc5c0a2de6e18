"""Detection of a square marker of the ArUco or AprilTag families.

The centre of a square is where its diagonals intersect, in every perspective image too: unlike the
mean of the four corners it does not depend on the marker's slant. Lenses bend the diagonals, so
that they are intersected in undistorted coordinates.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import marker_family
from vergence.geometry.camera import Camera, normalise, project
from vergence.vision.detector import Detection, Detector, windows
from vergence.vision.exposure import grey_levels

_LEAST_STD_PX, _STD_MODULES = 0.05, 0.6
"""Standard deviation of a marker's centre: at least the first, and the second divided by the width
of a module [px], because the corners of a small marker are refined by fewer pixels. Simulated
images with a noise of three grey levels give less, see tests/test_marker.py."""
_REFINED_WINDOW = 0.5
"""Half the side of the window in which a corner is refined, in modules of the marker: it must not
reach the next edge."""


def marker_detector(dictionary: str, marker_id: int) -> Detector:
    """Return a detector of one marker, which finds its centre.

    The marker is black on white with a margin, at least as wide as one of its modules, and a module
    must be about three pixels wide in the image. If the marker is seen several times, the largest
    one counts.

    Args:
        dictionary: OpenCV's name of the family, such as DICT_4X4_50 or DICT_APRILTAG_36H11.
        marker_id: number of the marker in it.

    Raises:
        VergenceError: there is no such dictionary, or no such marker in it.
    """
    family = marker_family(dictionary, marker_id)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.relativeCornerRefinmentWinSize = _REFINED_WINDOW
    finder = cv2.aruco.ArucoDetector(family, parameters)
    modules = family.markerSize + 2  # with the black frame

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        grey = grey_levels(image)
        for rows, columns in windows(grey, near):
            corners = _largest(finder, np.ascontiguousarray(grey[rows, columns]), marker_id)
            if corners is not None:
                centre = _centre(corners + np.array([columns.start, rows.start]), camera)
                module_px = np.sqrt(_area(corners)) / modules
                std_px = float(np.hypot(_LEAST_STD_PX, _STD_MODULES / module_px))
                return None if centre is None else Detection(centre, std_px)
        return None

    return detect


def _largest(finder: cv2.aruco.ArucoDetector, grey: np.ndarray, marker_id: int) -> Array | None:
    """Return the corners (4, 2) [px] of the largest marker with a number; None: there is none."""
    found, ids, _ = finder.detectMarkers(grey)
    if ids is None:
        return None
    own: list[Array] = [
        corners.reshape(4, 2).astype(float)
        for corners, number in zip(found, ids.ravel(), strict=True)
        if number == marker_id
    ]
    return max(own, key=_area, default=None)


def _area(corners: Array) -> float:
    """Return the area [px^2] of a quadrangle with corners (4, 2) [px]."""
    return float(cv2.contourArea(corners.astype(np.float32)))


def _centre(corners: Array, camera: Camera) -> Array | None:
    """Return the pixel (2,) where the diagonals of a square with corners (4, 2) [px] intersect.

    None where a corner lies beyond the reach of the lens model.
    """
    xy = normalise(camera, corners)
    a, b, c, d = np.concatenate([xy, np.ones((4, 1))], axis=1)
    meet = np.cross(np.cross(a, c), np.cross(b, d))
    if not np.isfinite(meet).all() or meet[2] == 0:
        return None
    return project(camera, meet / meet[2])
