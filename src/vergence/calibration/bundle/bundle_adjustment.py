"""One estimate of everything, with an accuracy that can be believed.

The paper solves step after step and takes joint readings as exact. Here the true joint angles of
every view are unknowns of their own, tied to their readings by the joint noise while the corners
are tied by the pixel noise; both levels of noise are estimated from the same data. The result is
the maximum a posteriori, its covariance, and words for what the data cannot determine.

See `problem` for the unknowns, `solver` for the steps, `variance_components` for the noise levels,
`observability` for what stays fixed, and `diagnostics` for the words.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle import diagnostics
from vergence.calibration.bundle.adjustment import adjust
from vergence.calibration.bundle.initial_state import initial_state
from vergence.calibration.bundle.measured_poses import PoseObservations
from vergence.calibration.bundle.problem import (
    BundleProblem,
    BundleState,
    corner_errors,
    detection_eye_poses,
    detection_eyes,
)
from vergence.calibration.bundle.solver import OUTLIER
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.findings import Finding, by_severity, warning
from vergence.geometry.head import HeadCalibration, main_pair
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYES, GEARED, Kinematics, reading_kinds
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.parameter_names import POSE
from vergence.geometry.parameters import parameter_names, redundant_offsets

SHOWN_SYSTEMATIC = 0.3
"""Systematic errors, relative to the noise of corners, that are no chance: of 36 simulated cameras
without any, in recordings of 60 views, they seemed to be 0.15 at most."""
EXACT = 1e-8
"""Joint noise [rad or m] that stands for exact readings."""
OWN_LEVELS = 24
"""Eyes times views from which each kind of reading has a noise of its own. Of 38 simulated heads
with 14 views, whose pan was read to 0.02 degrees and whose tilt to 0.3, depth then erred by 1.02
times what is stated, and with one level for both by 0.38 times; where both were read alike nothing
changed."""


@dataclass(frozen=True, eq=False)
class BundleEstimate:
    """The result of bundle_adjust."""

    head: HeadCalibration
    """With its time offset; without its accuracy, which `accuracy` states."""
    parameters: tuple[str, ...]
    """Names of the c parameters of the head, such as left_wide.fx, left_wide.T_eye_cam.rx,
    T_rbase_lbase.tz, left.pan_gain, time_offset_s; px, rad, m, s. See geometry.parameters."""
    covariance: Array
    """(c, c) in the order of parameters; zero for what was fixed by choice."""
    pixel_std_px: float
    """Noise of one coordinate of a corner, in a typical image."""
    camera_std_px: Mapping[str, float]
    """By camera: noise of one coordinate of a corner, rms over all of its images; empty for
    measured poses of a target."""
    systematic_px: Mapping[str, float]
    """By camera, where they show: systematic errors beyond those assumed of the detector; see
    Accuracy.systematic_px."""
    joint_std: tuple[float, ...]
    """Noise of the readings, see Accuracy.joint_std."""
    T_lbase_target: Mapping[int, Array]
    """By number of the placement: where the board stood."""
    board_scale: float
    """Size of the board relative to the stated one: estimated where measured poses of the eyes know
    lengths, else 1."""
    T_base_eye: Array
    """(V, 2, 4, 4) the true poses of the left and the right eye; NaN where it saw no board."""
    residuals_px: Mapping[str, Array]
    """By camera that sees boards: (V, K, 2) projected minus seen; NaN where not seen."""
    findings: tuple[Finding, ...]
    """What the data cannot determine, and why; the most severe first."""
    cost: float
    """-2 log of the restricted likelihood at these noise levels, but for a constant."""

    @property
    def accuracy(self) -> Accuracy:
        """What is known of the head's accuracy, for its file."""
        estimated = np.flatnonzero(np.diag(self.covariance) > 0)
        covariance = self.covariance[np.ix_(estimated, estimated)]
        return Accuracy(
            method="bundle",
            parameters=tuple(self.parameters[i] for i in estimated),
            covariance=(covariance + covariance.T) / 2,
            pixel_std_px=self.pixel_std_px,
            camera_std_px=dict(self.camera_std_px),
            joint_std=self.joint_std,
            findings=self.findings,
            systematic_px=dict(self.systematic_px),
        )


def bundle_adjust(
    start: HeadCalibration,
    observations: Observations | PoseObservations,
    *,
    T_cam_target: Mapping[str, Array] | None = None,
    points: Array | None = None,
    fixed: Collection[str] | None = None,
    pixel_std_px: float | None = None,
    joint_std: float | Sequence[float] | None = None,
    own_levels_from: float = OWN_LEVELS,
    outlier: float = OUTLIER,
) -> BundleEstimate:
    """Estimate a whole head at once: lenses, mountings, the pose between the eyes, axes, time.

    Args:
        start: the paper's calibration, or another that is about right.
        observations: readings, and corners or measured poses of a target. Without timing the time
            offset is not estimated.
        T_cam_target: by camera (V, 4, 4) poses of the board in each image, where they were solved
            for before from corners.
        points: (K, 3) corners in frame target [m]; None: those of the board.
        fixed: names of parameters that keep their start; None: fixed_by_default.
        pixel_std_px: noise of one coordinate of a corner; None: estimated.
        joint_std: noise of the readings [rad], one number or one of each kind (see
            `kinematics.reading_kinds`), or, for poses, ([rad], [m]); None: estimated; 0: the
            readings are exact.
        own_levels_from: eyes times views from which each kind of reading has a noise of its own.
        outlier: standard deviations beyond which a corner or a reading loses weight.

    Raises:
        VergenceError: an unknown parameter is named, joint_std is that of other readings, a reading
            that is needed is not finite, or there are fewer data than unknowns.
    """
    timed = observations.timing is not None
    fixed = fixed_by_default(start, timed=timed) if fixed is None else fixed
    unknown = set(fixed) - set(parameter_names(start))
    if unknown:
        raise VergenceError(
            f"There is no parameter {min(unknown)!r} to fix; there are, for example, "
            "left_wide.fx, left_wide.T_eye_cam.rx, left.pan_gain and time_offset_s."
        )
    problem, state, numbers = initial_state(
        start,
        observations,
        fixed=fixed,
        points=points,
        T_cam_target=T_cam_target,
    )
    given = None if joint_std is None else np.maximum(np.atleast_1d(joint_std), EXACT)
    least_blocks = own_levels_from if given is None else np.inf if len(given) == 1 else 0
    group = _noise_groups(problem, start.kinematics, least_blocks)
    groups = int(group.max()) + 1
    if given is not None and len(given) not in (1, groups):
        raise VergenceError(
            f"joint_std is one number, or {groups}, as many as these readings have kinds; found "
            f"{joint_std}."
        )
    levels = None if given is None else np.broadcast_to(given, groups)
    found = adjust(
        problem, state, group, pixel_std_px=pixel_std_px, joint_std=levels, outlier=outlier
    )
    T_base_eye = np.full((len(observations.placement), 2, 4, 4), np.nan)
    views = problem.block_view[problem.block]
    T_base_eye[views, detection_eyes(problem)] = detection_eye_poses(problem, found.state)
    return BundleEstimate(
        head=replace(found.state.head, neck=start.neck),
        parameters=problem.parameters,
        covariance=found.observability.covariance,
        pixel_std_px=found.noise.pixel_px,
        camera_std_px={}
        if isinstance(observations, PoseObservations)
        else dict(zip(problem.cameras, found.camera_px, strict=True)),
        systematic_px={
            name: float(np.sqrt(px**2 - problem.systematic_px**2))
            for name, px in zip(problem.cameras, found.systematic_px, strict=True)
            if px > max(SHOWN_SYSTEMATIC * found.noise.pixel_px, problem.systematic_px)
        },
        joint_std=tuple(map(float, found.noise.levels[1:])),
        T_lbase_target=dict(zip(numbers.tolist(), found.state.T_lbase_target, strict=True)),
        board_scale=found.state.board_scale,
        T_base_eye=T_base_eye,
        residuals_px=_residuals(problem, found.state, len(T_base_eye)),
        findings=by_severity(
            (
                *_left_out(problem, observations),
                *diagnostics.contradicting_views(problem),
                *diagnostics.findings(problem, found),
            )
        ),
        cost=found.cost,
    )


def _residuals(problem: BundleProblem, state: BundleState, views: int) -> dict[str, Array]:
    """Return by camera the errors (V, K, 2) of its corners; NaN where not seen."""
    errors = np.where(problem.seen[..., None], corner_errors(problem, state), np.nan)
    found = {}
    for c, name in enumerate(problem.cameras):
        mine = problem.camera == c
        if mine.any():
            found[name] = np.full((views, *errors.shape[1:]), np.nan)
            found[name][problem.block_view[problem.block[mine]]] = errors[mine]
    return found


def check_noise(joint_std: float | tuple[float, float] | None, **above_zero: float | None) -> None:
    """Raise VergenceError unless noise of readings is 0 or more, and named values are above 0."""
    for name, value in above_zero.items():
        if value is not None and not value > 0:
            raise VergenceError(f"{name} is above 0, found {value:g}.")
    levels = np.array([] if joint_std is None else joint_std)
    if levels.size and not ((levels >= 0) & np.isfinite(levels)).all():
        raise VergenceError(f"joint_std is a standard deviation, 0 or more; found {joint_std}.")


def _noise_groups(
    problem: BundleProblem, kinematics: Kinematics, least_blocks: float
) -> np.ndarray:
    """Return (n,) the group of each latent unknown, whose readings have noise of one level.

    From some number of blocks on each kind of reading is a group, below it all are one, unless some
    stand before a gear, or another one, than others. Where a reading moves both eyes, such as their
    vergence, one eye shows a sum of readings only: such blocks do not count. Of measured poses
    rotations are one, and translations another.
    """
    if problem.T_base_eye_read is not None:
        return np.array([0, 0, 0, 1, 1, 1])
    blocks = len(problem.reading)
    if set(kinematics.used("left")) & set(kinematics.used("right")):
        left, right = (problem.block[problem.eye[problem.camera] == e] for e in range(len(EYES)))
        blocks = len(np.intersect1d(left, right))
    few = blocks < least_blocks
    if few and kinematics.factors.max() < GEARED * kinematics.factors.min():
        return np.zeros(problem.reading.shape[1], dtype=int)
    kinds = np.array(reading_kinds(kinematics))[problem.block_columns[0]]
    return np.unique(kinds, return_inverse=True)[1]


def _left_out(
    problem: BundleProblem, observations: Observations | PoseObservations
) -> list[Finding]:
    """Return warnings of cameras without boards, and on views that are of no use."""
    if isinstance(observations, PoseObservations):
        detections = observations.T_cam_target
    else:
        detections = observations.corners
    said = [
        warning("blind-camera-kept", f"{name} sees no board, and keeps its start.", name)
        for c, name in enumerate(problem.cameras)
        if c not in problem.camera
    ]
    seen = np.any([np.isfinite(d).any(axis=(1, 2)) for d in detections.values()], axis=0)
    lost = np.setdiff1d(np.flatnonzero(seen), problem.block_view)
    if len(lost):
        views = ", ".join(map(str, lost))
        sentence = f"Views {views} were left out: no image of these boards shows enough corners."
        said.append(warning("few-corners", sentence, f"views {views}"))
    return said


def fixed_by_default(start: HeadCalibration, *, timed: bool) -> set[str]:
    """Return the names of the parameters that bundle_adjust does not touch unless asked to.

    - Offsets of an eye's first and last joint: an offset of tilt is a turn of T_eye_cam, one of
      pan a turn of the base frame, and no image distinguishes them.
    - Distortion coefficients that are zero at the start: they are not in the lens model.
    - The time offset, where the eyes stood still.
    - Where the other eye is, for a head of one eye.
    """
    fixed = redundant_offsets(start.kinematics)
    for camera, mounted in start.cameras.items():
        lens = mounted.intrinsics
        values = zip(COEFFICIENTS[lens.model], lens.distortion, strict=True)
        fixed |= {f"{camera}.{name}" for name, value in values if value == 0}
    if main_pair(start) is None:
        fixed |= {f"T_rbase_lbase.{name}" for name in POSE}
    return fixed if timed else fixed | {"time_offset_s"}


def covariance_of(estimate: BundleEstimate, name: str) -> Array:
    """Return the covariance of one parameter, or of all that have the name before their last dot.

    For example (6, 6) of "left_wide.T_eye_cam" and "T_rbase_lbase", (9, 9) of "left_wide".
    VergenceError if no parameter has this name.
    """
    parameters = enumerate(estimate.parameters)
    chosen = [i for i, each in parameters if name in (each, each.rpartition(".")[0])]
    if not chosen:
        raise VergenceError(f"No parameter is called {name!r}; see BundleEstimate.parameters.")
    return estimate.covariance[np.ix_(chosen, chosen)]
