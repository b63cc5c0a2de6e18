"""Calibration, stereo and gaze for active heads, and a digital twin to try them on.

`import vergence as vg` gives the names in `__all__`; each is loaded when it is first used, so that
the import itself costs nothing. The twin is `vergence.twin`, recordings and figures are
`vergence.viewer`: neither is loaded by what stands here.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from vergence.calibration.calibrate import CalibrationResult, calibrate
    from vergence.calibration.detection import detect_target
    from vergence.calibration.eye_camera import refine_eye_camera
    from vergence.calibration.observations import Observations
    from vergence.calibration.target_poses import adjust_target_poses
    from vergence.data.dataset import Dataset, Frame
    from vergence.data.reader import load_dataset
    from vergence.data.writer import write_dataset
    from vergence.errors import VergenceError
    from vergence.gaze.foveation import gaze_angles
    from vergence.geometry.board import Charuco, Chessboard
    from vergence.geometry.camera import Camera
    from vergence.geometry.head import HeadCalibration, MountedCamera, load_head, save_head
    from vergence.geometry.joints import Joint
    from vergence.geometry.kinematics import Kinematics
    from vergence.geometry.projection import project_point
    from vergence.interchange.formats import export_head, import_head
    from vergence.stereo.combination import combination
    from vergence.stereo.dense_depth import DenseDepth, dense_depth, point_cloud
    from vergence.stereo.extrinsics import T_rcam_lcam
    from vergence.stereo.rectification import RectifiedPair, rectified_image, rectify
    from vergence.stereo.triangulation import Status, in_body, in_head
    from vergence.stereo.uncertainty import LocatedPoints, locate

__all__ = [
    "CalibrationResult",
    "Camera",
    "Charuco",
    "Chessboard",
    "Dataset",
    "DenseDepth",
    "Frame",
    "HeadCalibration",
    "Joint",
    "Kinematics",
    "LocatedPoints",
    "MountedCamera",
    "Observations",
    "RectifiedPair",
    "Status",
    "T_rcam_lcam",
    "VergenceError",
    "__version__",
    "adjust_target_poses",
    "calibrate",
    "combination",
    "dense_depth",
    "detect_target",
    "export_head",
    "gaze_angles",
    "import_head",
    "in_body",
    "in_head",
    "load_dataset",
    "load_head",
    "locate",
    "point_cloud",
    "project_point",
    "rectified_image",
    "rectify",
    "refine_eye_camera",
    "save_head",
    "write_dataset",
]

# The C library gives large blocks back to the system when they are freed, and the arrays of every
# image are paged in anew: a fifth of the time of self-calibration. glibc stops doing so for blocks
# below the largest one that it has seen freed.
bytes(31 << 20)

_HOMES = {
    "calibration.eye_camera": ("refine_eye_camera",),
    "calibration.target_poses": ("adjust_target_poses",),
    "calibration.calibrate": ("CalibrationResult", "calibrate"),
    "calibration.detection": ("detect_target",),
    "calibration.observations": ("Observations",),
    "data.dataset": ("Dataset", "Frame"),
    "data.reader": ("load_dataset",),
    "data.writer": ("write_dataset",),
    "errors": ("VergenceError",),
    "gaze.foveation": ("gaze_angles",),
    "geometry.board": ("Charuco", "Chessboard"),
    "geometry.camera": ("Camera",),
    "geometry.head": ("HeadCalibration", "MountedCamera", "load_head", "save_head"),
    "geometry.joints": ("Joint",),
    "geometry.kinematics": ("Kinematics",),
    "geometry.projection": ("project_point",),
    "interchange.formats": ("export_head", "import_head"),
    "stereo.combination": ("combination",),
    "stereo.dense_depth": ("DenseDepth", "dense_depth", "point_cloud"),
    "stereo.extrinsics": ("T_rcam_lcam",),
    "stereo.rectification": ("RectifiedPair", "rectified_image", "rectify"),
    "stereo.triangulation": ("Status", "in_body", "in_head"),
    "stereo.uncertainty": ("LocatedPoints", "locate"),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'vergence' has no attribute {name!r}")
    value = getattr(import_module(f"vergence.{_HOME_OF[name]}"), name)
    globals()[name] = value  # found without asking from now on
    return value


def __dir__() -> list[str]:
    return sorted(set(__all__) | set(globals()))
