"""How far off each parameter of a head may be: tolerances by kind, and the covariance they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, displaced_by_distortion
from vergence.geometry.head import HeadCalibration
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.parameters import is_gain, parameter_values


@dataclass(frozen=True)
class Tolerance:
    """Standard deviations of each kind of parameter; lengths in m, angles in rad. 0: exact."""

    focal: float = 0.0
    """Relative; of both focal lengths of a camera together."""
    aspect: float = 0.0
    """Relative; of each focal length by itself."""
    centre_px: float = 0.0
    lens_px: float = 0.0
    """Root mean square over the image of what wrong coefficients of the lens displace."""
    turn_rad: float = 0.0
    """Turn of a mounting about each axis."""
    shift_m: float = 0.0
    stereo_turn_rad: float = 0.0
    """Turn of the cameras to each other at straight gaze, or of the bases."""
    stereo_shift_m: float = 0.0
    epipolar_px: float = 0.0
    """Root mean square over the image of how far points lie from their epipolar lines at straight
    gaze, by wrong lenses and poses together. 0: whatever these make it."""
    gain: float = 0.0
    """Relative; of a joint with several readings, of the factor of each."""
    offset_rad: float = 0.0
    """Of a joint between the first and the last of an eye."""
    axis_turn_rad: float = 0.0
    """Turn of a joint's axis to the one before, about each direction in which it may err."""
    axis_shift_m: float = 0.0


USUAL = Tolerance(
    focal=0.02,
    aspect=1e-4,
    centre_px=0.2,
    lens_px=0.1,
    turn_rad=np.radians(0.5),
    shift_m=3e-3,
    stereo_turn_rad=np.radians(0.3),
    stereo_shift_m=2e-4,
    epipolar_px=0.3,
    gain=0.03,
    offset_rad=np.radians(0.5),
    axis_turn_rad=np.radians(0.1),
    axis_shift_m=3e-4,
)
"""What a calibration that does not state its covariance may be wrong by."""
MOVED = Tolerance(
    focal=0.002,
    aspect=1e-4,
    centre_px=0.3,
    turn_rad=np.radians(0.1),
    shift_m=1e-4,
    stereo_turn_rad=np.radians(0.03),
    stereo_shift_m=5e-5,
    gain=0.002,
)
"""Since the calibration: transport, temperature, screws."""
DRIFT = Tolerance(
    focal=1e-4,
    centre_px=0.01,
    turn_rad=np.radians(0.03),
    shift_m=1e-5,
    stereo_turn_rad=np.radians(0.003),
    stereo_shift_m=5e-6,
    gain=1e-4,
)
"""A random walk, in one minute of running."""
BUMP = Tolerance(
    turn_rad=np.radians(1.5),
    shift_m=1e-3,
)
"""What a camera that something has hit may have moved by."""
UNCALIBRATED = Tolerance(
    focal=0.02,
    centre_px=5.0,
    turn_rad=np.radians(1.5),
    shift_m=3e-3,
    stereo_turn_rad=np.radians(1.0),
    stereo_shift_m=1e-3,
    gain=0.05,
    offset_rad=USUAL.offset_rad,
    axis_turn_rad=USUAL.axis_turn_rad,
    axis_shift_m=USUAL.axis_shift_m,
)
"""What a head may be wrong by that is known from its drawing only, or is not as calibrated. What
the paper's method leaves as designed, it leaves as wrong as the drawing has it."""
_LEAST_FACTOR = 0.1
"""Of a reading in a joint's angle, for its tolerance: zero may be wrong too."""
_LARGEST_COEFFICIENT = 0.01
"""Standard deviation of any combination of a lens's coefficients: some of a rational lens show
nothing, and would change by more than is linear."""


def tolerance_covariance(
    head: HeadCalibration, names: tuple[str, ...], tolerance: Tolerance
) -> Array:
    """Return the covariance (P, P) of parameters that are wrong by tolerances."""
    relative, focal, factors = _relative_covariance(tuple(head.cameras), names, tolerance)
    scale = np.ones(len(names))
    for k, camera, axis in focal:
        scale[k] = head.camera(camera).intrinsics.matrix[axis, axis]
    values = parameter_values(head) if factors else {}
    for k in factors:
        scale[k] = max(abs(values[names[k]] or 0.0), _LEAST_FACTOR)
    C = relative * scale * scale[:, None]
    if not tolerance.lens_px:
        return C
    for name, mounted in head.cameras.items():
        lens = [f"{name}.{each}" for each in COEFFICIENTS[mounted.intrinsics.model]]
        own = [k for k, each in enumerate(names) if each in lens]
        if own:
            free = [lens.index(names[k]) for k in own]
            C[np.ix_(own, own)] = _of_lens(mounted.intrinsics, free, tolerance.lens_px)
    return C


def _of_lens(camera: Camera, free: Sequence[int], lens_px: float) -> Array:
    """Return the covariance (n, n) of some coefficients of a lens (free: which of them).

    Together they displace the image by lens_px, root mean square over the image; each by itself is
    less certain.
    """
    shown = len(free) * displaced_by_distortion(camera)[np.ix_(free, free)] / lens_px**2
    whole = shown + np.eye(len(free)) / _LARGEST_COEFFICIENT**2
    return np.asarray(np.linalg.inv(whole), float)


@lru_cache(maxsize=64)
def _relative_covariance(
    cameras: tuple[str, ...], names: tuple[str, ...], tolerance: Tolerance
) -> tuple[Array, list[tuple[int, str, int]], list[int]]:
    """Return the covariance (P, P) before it is scaled, and which parameters are to be scaled.

    Errors of focal lengths, and of the factors of joints with several readings, are relative to
    their values, so that their variances are to be multiplied by the squares of these.

    Returns:
        The covariance, without coefficients of lenses (see `_of_lens`); of each focal length its
        row, its camera, and 0 for fx or 1 for fy; and the rows of the factors.
    """
    C = np.diag([_std(cameras, name, tolerance) ** 2 for name in names])
    focal = []
    for k, name in enumerate(names):
        owner, _, rest = name.partition(".")
        if owner in cameras and rest in ("fx", "fy"):
            focal.append((k, owner, ("fx", "fy").index(rest)))
        if rest == "fx" and f"{owner}.fy" in names:
            other = names.index(f"{owner}.fy")
            C[k, other] = C[other, k] = tolerance.focal**2
    factors = [k for k, name in enumerate(names) if is_gain(name) and not name.endswith("_gain")]
    return C, focal, factors


def _std(cameras: tuple[str, ...], name: str, tolerance: Tolerance) -> float:
    owner, _, rest = name.partition(".")
    last = rest.rpartition(".")[2]
    if owner in cameras and not rest.startswith("T_eye_cam"):
        both = float(np.hypot(tolerance.focal, tolerance.aspect))
        of_lens = {"fx": both, "fy": both, "cx": tolerance.centre_px, "cy": tolerance.centre_px}
        return of_lens.get(rest, 0.0)
    if owner in cameras:
        return tolerance.turn_rad if last[0] == "r" else tolerance.shift_m
    if owner == "T_rbase_lbase":
        return tolerance.stereo_turn_rad if last[0] == "r" else tolerance.stereo_shift_m
    if is_gain(name):
        return tolerance.gain
    of_joint = {
        "offset_rad": tolerance.offset_rad,
        "nonorthogonality_rad": tolerance.axis_turn_rad,
        "inclination_rad": tolerance.axis_turn_rad,
        "axis_distance_m": tolerance.axis_shift_m,
        "slide_m": tolerance.axis_shift_m,
    }
    return next((std for end, std in of_joint.items() if rest.endswith(f"_{end}")), 0.0)
