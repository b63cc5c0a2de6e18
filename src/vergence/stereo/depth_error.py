"""The paper's formulas for the error in depth (Eqs. 20-21).

They hold for two parallel cameras, on the optical axis. `uncertainty.locate` holds for any head and
any posture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array


def depth_error(
    depth_m: ArrayLike, baseline_m: ArrayLike, focal_px: ArrayLike, disparity_error_px: ArrayLike
) -> Array:
    """Eq. 20: return the depth error (...,) [m], from the camera centres, by one of disparity."""
    depth, baseline, focal = (np.asarray(a, float) for a in (depth_m, baseline_m, focal_px))
    return depth**2 / (baseline * focal) * np.asarray(disparity_error_px, float)


def disparity_error(focal_px: ArrayLike, orientation_error_rad: ArrayLike) -> Array:
    """Eq. 21: return the error in disparity (...,) [px] of a wrong angle between the cameras."""
    return np.asarray(focal_px, float) * np.tan(np.asarray(orientation_error_rad, float))
