"""Calibration, stereo and gaze for active heads, and a digital twin to try them on.

`import vergence as vg` gives the names in `__all__`. Each is loaded at its first use, so that the
command line starts quickly. The twin is `vergence.twin`; recordings and figures are
`vergence.viewer`.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:  # for type checkers; `_MODULES` is made of these imports
    from vergence.calibration.calibrate import CalibrationResult as CalibrationResult
    from vergence.calibration.calibrate import calibrate as calibrate
    from vergence.calibration.observations import Observations as Observations
    from vergence.data.dataset import Dataset as Dataset
    from vergence.data.dataset import Frame as Frame
    from vergence.data.description import DatasetCamera as DatasetCamera
    from vergence.data.description import DatasetJoint as DatasetJoint
    from vergence.data.description import Description as Description
    from vergence.data.reader import load_dataset as load_dataset
    from vergence.data.writer import DatasetRow as DatasetRow
    from vergence.data.writer import write_dataset as write_dataset
    from vergence.errors import VergenceError as VergenceError
    from vergence.gaze.controller import run_gaze as run_gaze
    from vergence.gaze.controller import step_gaze as step_gaze
    from vergence.gaze.foveation import gaze_angles as gaze_angles
    from vergence.gaze.state import GazeSettings as GazeSettings
    from vergence.gaze.state import initial_gaze_state as initial_gaze_state
    from vergence.gaze.state import look_at as look_at
    from vergence.geometry.board import AprilGrid as AprilGrid
    from vergence.geometry.board import Charuco as Charuco
    from vergence.geometry.board import Chessboard as Chessboard
    from vergence.geometry.board import CircleGrid as CircleGrid
    from vergence.geometry.camera import Camera as Camera
    from vergence.geometry.head import HeadCalibration as HeadCalibration
    from vergence.geometry.head import load_head as load_head
    from vergence.geometry.head import save_head as save_head
    from vergence.geometry.projection import project_point as project_point
    from vergence.interchange.formats import export_head as export_head
    from vergence.interchange.formats import import_head as import_head
    from vergence.self_calibration.calibrator import SelfCalibrator as SelfCalibrator
    from vergence.self_calibration.recorded import self_calibrate as self_calibrate
    from vergence.stereo.dense_depth import DenseDepth as DenseDepth
    from vergence.stereo.dense_depth import dense_depth as dense_depth
    from vergence.stereo.dense_depth import point_cloud as point_cloud
    from vergence.stereo.rectification import rectified_image as rectified_image
    from vergence.stereo.rectification import rectify as rectify
    from vergence.stereo.triangulation import Status as Status
    from vergence.stereo.triangulation import in_body as in_body
    from vergence.stereo.triangulation import in_head as in_head
    from vergence.stereo.uncertainty import LocatedPoints as LocatedPoints
    from vergence.stereo.uncertainty import locate as locate

_MODULES = {
    alias.name: node.module
    for node in ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
    if isinstance(node, ast.ImportFrom) and str(node.module).startswith("vergence.")
    for alias in node.names
}
__all__ = ["__version__", *_MODULES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Load a public name at its first use."""
    if name not in _MODULES:
        raise AttributeError(f"module 'vergence' has no attribute {name!r}")
    value = getattr(import_module(str(_MODULES[name])), name)
    globals()[name] = value  # found without this function from now on
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
