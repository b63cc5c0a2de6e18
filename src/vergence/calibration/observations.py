"""All that a calibration needs: corners of boards in images, and how the eyes stood meanwhile.

`detection.detect_target` makes it from a dataset; whoever has a detector of his own fills it in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np

from vergence.arrays import Array
from vergence.data.timing import TAKEN_UP, Timing, moved_readings, taken_up
from vergence.errors import VergenceError, counted
from vergence.findings import Finding
from vergence.geometry.board import Board
from vergence.geometry.camera import Camera, is_image_size
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, check_camera_name
from vergence.geometry.kinematics import EYES, Kinematics, Side, eye_pose
from vergence.geometry.se3 import inverse, known_poses, mean_pose, rigid_poses

CERTAIN_RAD = 0.04
"""Travel of a joint one way, from which its backlash is taken up [rad]: more than that of hobby
servos (up to one degree) and the range of their noise (three times 0.4 degrees)."""
NO_CORNERS, UNREADABLE_IMAGE = "no-corners", "unreadable-image"
"""Codes of the notes on images that gave no corners."""


@dataclass(frozen=True, eq=False)
class Observations:
    """What the cameras saw of a board with K corners in V views, and what the joints read.

    VergenceError when made of arrays, poses or cameras that cannot be.
    """

    board: Board
    placement: np.ndarray
    """(V,) of int: views with the same number show the board at the same place in the head."""
    eye_angles: Array
    """(V, r) joint readings [rad] in the order of kinematics.readings; of no meaning where
    T_base_eye is given."""
    corners: Mapping[str, Array]
    """By camera: (V, K, 2) pixels in the order of board.corner_points, NaN where not seen."""
    sizes: Mapping[str, tuple[int, int]]
    """By camera: width and height of its images [px]."""
    eyes: Mapping[str, Side] = field(default_factory=dict)
    """By camera, which eye it sits in; left out: as its name begins."""
    kinematics: Kinematics = field(default_factory=Kinematics)
    """How the readings turn the eyes, as designed; the default is the paper's pan and tilt."""
    timing: Timing | None = None
    """When the readings were taken; None: the eyes stood still in all views."""
    T_base_eye: Array | None = None
    """(V, 2, 4, 4) measured poses of the left and the right eye in their bases, for eyes that do
    not pan and tilt; they take the place of the angles."""
    systematic_px: float = 0.0
    """Smooth errors over the image [px] that the corners of all images of a camera are assumed to
    share at least: what is known of how they were found."""
    last_motion: Array | None = None
    """(V, r) sign of the last motion of each reading before it was read: 1, -1, or 0 where it is
    not known; None: found from the readings, if each view was reached from the one before."""
    known_lenses: Mapping[str, tuple[Camera, float]] = field(default_factory=dict)
    """By camera, where intrinsics were known before, and DatasetCamera.intrinsics_std_percent."""
    lines: np.ndarray | None = None
    """(V,) lines of frames.csv; None: views have no lines."""
    findings: tuple[Finding, ...] = ()
    """Notes on what looks unusual in the data, on what was repaired, and on images without corners.
    """

    def __post_init__(self) -> None:
        arrays = {
            "placement": np.asarray(self.placement),
            "eye_angles": np.asarray(self.eye_angles, dtype=float),
            "corners": {name: np.asarray(c, dtype=float) for name, c in self.corners.items()},
        }
        if self.T_base_eye is not None:
            arrays["T_base_eye"] = np.asarray(self.T_base_eye, dtype=float)
        vars(self).update(arrays)
        numbers = self.placement
        whole = numbers.dtype.kind in "biuf" and (numbers == np.round(numbers)).all()
        if numbers.ndim != 1 or not whole:
            raise VergenceError(
                "placement is a whole number for each view, the same where the board stayed in "
                f"its place; found {numbers!r:.80}."
            )
        V, K = len(self.placement), self.board.columns * self.board.rows
        wanted: dict[str, tuple[np.ndarray, tuple[int, ...]]] = {
            "eye_angles": (self.eye_angles, (V, len(self.kinematics.readings)))
        }
        wanted |= {f"corners of {name}": (c, (V, K, 2)) for name, c in self.corners.items()}
        if self.timing is not None:
            wanted["timing.time_s"] = self.timing.time_s, (V,)
            wanted["timing.run"] = self.timing.run, (V,)
        if self.T_base_eye is not None:
            wanted["T_base_eye"] = self.T_base_eye, (V, 2, 4, 4)
        if self.last_motion is not None:
            wanted["last_motion"] = self.last_motion, self.eye_angles.shape
        check_shapes(f"Observations of {counted(K, 'corner')}", V, wanted)
        for name, corners in self.corners.items():
            if np.isinf(corners).any():
                raise VergenceError(
                    f"Corners of {name} are finite pixels, or NaN where not seen; found infinity."
                )
        if self.T_base_eye is not None:
            T, rounded = rigid_poses("T_base_eye", self.T_base_eye)
            vars(self).update(T_base_eye=T, findings=(*self.findings, *rounded))
        self._check_cameras()

    def _check_cameras(self) -> None:
        if not self.corners:
            raise VergenceError("Observations need the corners of a camera; corners is empty.")
        for name in self.corners:
            try:
                check_camera_name(name)
            except ValueError as error:
                why = str(error).rpartition(": ")[2]
                raise VergenceError(f"corners has a camera {name!r:.80}; {why}.") from None
            if not is_image_size(self.sizes.get(name)):
                raise VergenceError(
                    f"sizes needs the width and height of {name}'s images [px], such as "
                    f"(640, 480); found {self.sizes.get(name)!r:.80}."
                )
        for name, eye in self.eyes.items():
            if eye not in EYES:
                raise VergenceError(f"eyes.{name} is {eye!r}; expected left or right.")

    @property
    def eye_motion(self) -> Literal["pan-tilt", "poses", "fixed"]:
        """Whether joints were read, poses of the eyes were measured, or the cameras stand still."""
        if self.T_base_eye is not None:
            return "poses"
        return "pan-tilt" if self.kinematics.readings else "fixed"

    @property
    def at_rest(self) -> np.ndarray:
        """(V,) of bool: in which views the eyes stood still."""
        if self.timing is None:
            return np.ones(len(self.placement), bool)
        return self.timing.run == 0

    def take(self, rows: np.ndarray) -> Observations:
        """Return some of the views, by index or by a mask (V,)."""
        return replace(
            self,
            placement=self.placement[rows],
            eye_angles=self.eye_angles[rows],
            corners={name: corners[rows] for name, corners in self.corners.items()},
            timing=None if self.timing is None else self.timing.take(rows),
            T_base_eye=None if self.T_base_eye is None else self.T_base_eye[rows],
            last_motion=self.last_motions()[rows],
            lines=None if self.lines is None else self.lines[rows],
        )

    def last_motions(self) -> Array:
        """Return last_motion (V, r), found from the readings where it is not given."""
        if self.last_motion is not None:
            return self.last_motion
        turned = taken_up(self.eye_angles, CERTAIN_RAD / self.kinematics.gear_ratios)
        return np.where(np.abs(turned) < TAKEN_UP, 0.0, np.sign(turned))

    def name_of_view(self, row: int) -> str:
        """Name a view by its line of frames.csv, or by its number."""
        return f"view {row}" if self.lines is None else f"line {self.lines[row]}"

    def eye_poses(self, head: HeadCalibration | None = None) -> Array:
        """Return the poses (V, 2, 4, 4) of the left and the right eye in their bases, as read.

        Angles become poses as in a head, None: as designed.
        """
        if self.T_base_eye is not None:
            return self.T_base_eye if head is None else eye_poses(head, self.T_base_eye)
        own = self.kinematics if head is None else head.kinematics
        return np.stack([eye_pose(own, eye, self.eye_angles) for eye in EYES], axis=1)

    def at_image_times(self, head: HeadCalibration) -> Observations:
        """Return the observations with readings at the moments of the images.

        They are moved by the head's time offset, where the eyes moved.
        """
        if self.timing is None:
            return self
        if self.T_base_eye is None:
            angles = moved_readings(self.eye_angles, self.timing, head.time_offset_s)
            return replace(self, eye_angles=angles)
        poses = moved_readings(self.T_base_eye, self.timing, head.time_offset_s)
        return replace(self, T_base_eye=poses)


@dataclass(frozen=True, eq=False)
class PoseObservations:
    """Poses of a target that cameras measured in V views: `Observations` for devices that do so."""

    T_cam_target: Mapping[str, Array]
    """By camera: (V, 4, 4); NaN where none was measured."""
    whitening: Mapping[str, Array] | None
    """By camera: (V, 6, 6), see residuals.TargetPoses; None: no deviations are stated."""
    placement: np.ndarray
    """As those that follow, see Observations."""
    eye_angles: Array
    T_base_eye: Array | None
    timing: ClassVar[None] = None
    known_lenses: ClassVar[Mapping[str, tuple[Camera, float]]] = {}

    def last_motions(self) -> Array:
        """Return zeros (V, r): the views come in any order."""
        return np.zeros_like(self.eye_angles)

    def name_of_view(self, row: int) -> str:
        """Name a view by its number."""
        return f"view {row}"


def check_shapes(
    what: str, views: int, wanted: Mapping[str, tuple[np.ndarray, tuple[int, ...]]]
) -> None:
    """Raise a VergenceError for an array that has not the shape stated by its name."""
    for name, (array, shape) in wanted.items():
        if np.shape(array) != shape:
            raise VergenceError(
                f"{what} in {counted(views, 'view')} need {name} of shape {shape}, found "
                f"{np.shape(array)}."
            )


def camera_eyes(observations: Observations) -> dict[str, Side]:
    """Return by camera its eye; VergenceError if neither `eyes` nor the camera's name says it."""
    found: dict[str, Side] = {}
    for name in observations.corners:
        begins: Side | None = next((eye for eye in EYES if name.startswith(eye)), None)
        eye = observations.eyes.get(name) or begins
        if eye is None:
            raise VergenceError(
                f"Which eye does {name} sit in? Observations.eyes says it, or a name that begins "
                "with left or right."
            )
        found[name] = eye
    return found


def missing_reading(eye: Side | None, where: str) -> VergenceError:
    """Make the error for a view without the joint readings, or the pose, of an eye that sees.

    None: of both eyes, whose readings are needed together.
    """
    who, its = ("An eye sees", "a") if eye is None else (f"The {eye} eye sees", "its")
    return VergenceError(
        f"{who} a board in {where}, but {its} joint reading is not finite; leave the view out."
    )


def readable(observations: Observations, eye: Side) -> np.ndarray:
    """Return (V,) of bool: in which views all joint readings, or the pose, of an eye are known."""
    if observations.T_base_eye is not None:
        finite = known_poses(observations.T_base_eye[:, EYES.index(eye)])
    else:
        used = observations.kinematics.used(eye)
        finite = np.isfinite(observations.eye_angles[:, used]).all(axis=1)
    return np.asarray(finite)


def most_seen(placement: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Select the views (N,) of the placement (V,) that has most known ones (V,), perhaps none."""
    views = np.flatnonzero(known)
    if not len(views):
        return views
    numbers, counts = np.unique(placement[views], return_counts=True)
    return views[placement[views] == numbers[counts.argmax()]]


def base_by_boards(T_lbase_target: Array, T_rbase_target: Array) -> Array | None:
    """Compute T_rbase_lbase (4, 4) by boards that both eyes have placed; None: they share no board.

    The boards' poses (V, 4, 4) in both bases are those of `mean_placed`.
    """
    between = T_rbase_target @ inverse(T_lbase_target)
    known = known_poses(between)
    return mean_pose(between[known]) if known.any() else None


def mean_placed(T_base_target: Array, placement: np.ndarray) -> Array:
    """Return for each view where its board stands by all views (V, 4, 4) of its placement.

    It is the mean of the poses that are not NaN, and NaN where all of them are.
    """
    known = known_poses(T_base_target)
    mean = np.full_like(T_base_target, np.nan)
    for each in np.unique(placement[known]):
        mean[placement == each] = mean_pose(T_base_target[known & (placement == each)])
    return mean
