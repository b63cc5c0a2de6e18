"""One estimate of everything, with an accuracy that can be believed.

The paper solves step after step and takes joint readings as exact. Here the true joint angles of
every view are unknowns of their own, tied to their readings by the joint noise while the corners
are tied by the pixel noise; both levels of noise are estimated from the same data. The result is
the maximum a posteriori, its covariance, and words for what the data cannot determine.

See `problem` for the unknowns, `solver` for the steps, `noise` for the levels of noise and
`observability` for what is held.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.eye_camera import park_martin
from vergence.calibration.noise import Components, estimate_noise
from vergence.calibration.observability import Observability, describe, observe
from vergence.calibration.problem import (
    AXES,
    PER_CAMERA,
    Problem,
    State,
    calibration_size,
    corner_errors,
    eye_poses,
    names,
    rulers,
)
