"""One estimate of a whole head, with a covariance that can be believed.

The paper takes joint readings as exact. Here the true joint angles of every view are unknowns, and
the noise of readings and of corners is estimated as well. `residuals` has the measurements,
`bundle_start` the start, `estimation` the solver.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag, cho_solve

from vergence.arrays import Array, single_blas_thread
from vergence.calibration.backlash import BLOCK, BacklashPrior, mixture_covariance
from vergence.calibration.bundle_findings import bundle_findings
from vergence.calibration.bundle_start import BundleProblem, bundle_problem, with_shared_errors
from vergence.calibration.intrinsics import Intrinsics
from vergence.calibration.moved_boards import (
    FIRST_MOTION,
    SHIFTS,
    TURNS,
    held_boards,
    motion_levels,
    moved_boards,
)
from vergence.calibration.observations import Observations, PoseObservations
from vergence.calibration.outcome import Outcome
from vergence.calibration.pose_errors import SmoothErrors
from vergence.calibration.readings import PLAY, SMOOTH
from vergence.calibration.residuals import Reprojection
from vergence.calibration.systematic_errors import systematic_errors
from vergence.errors import VergenceError
from vergence.estimation.adjustment import Adjustment, adjust
from vergence.estimation.linear import cholesky, eliminate
from vergence.estimation.noise import Level
from vergence.estimation.observability import UNKNOWN
from vergence.estimation.residual import OUTLIER, Levels, Residual
from vergence.estimation.variables import Variables
from vergence.findings import Finding
from vergence.geometry.camera import intrinsics_names
from vergence.geometry.head import (
    HeadCalibration,
    lenses_of,
    main_camera,
    main_pair,
    parameter_names,
)
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYES
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.parameters import camera_columns, redundant_offsets
from vergence.geometry.se3 import POSE

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
FIRST_PX = 0.1
"""Least first noise of a corner [px], or of a measured pose [stated ones]."""
FLOOR_PX = 1e-3
"""No corner is found better than that; keeps exact data from dividing by zero."""
FLOOR_TARGET = 1e-7
"""No pose of a target is measured better than that [rad or m]; the same for poses."""
GENEROUS_JOINT = 0.01
"""First joint noise [rad or m]: large, so that good readings do not pass for outliers before the
level is known."""
USUAL_JOINT = 0.002
"""Assumed where the data do not determine the joint noise [rad or m]: 0.1 degrees."""


@dataclass(frozen=True)
class NoiseModel:
    """Noise that is known before the adjustment; VergenceError for levels that are impossible."""

    pixel_std_px: float | None = None
    """Of one coordinate of a corner, or the factor on the stated deviations of measured poses;
    None: estimated."""
    joint_std: float | Sequence[float] | None = None
    """Of the readings [rad], one number or one of each kind (see `kinematics.reading_kinds`), or,
    for poses, ([rad], [m]); None: estimated, and backlash as well; 0: the readings are exact."""
    outlier: float = OUTLIER
    """Standard deviations beyond which a corner or a reading loses weight."""
    levels: Levels = field(default_factory=dict)
    """Noise levels by name, of an estimate before; they are not estimated again."""

    def __post_init__(self) -> None:
        for name in ("pixel_std_px", "outlier"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise VergenceError(f"{name} is above 0, found {value:g}.")
        std = np.array([] if self.joint_std is None else self.joint_std)
        if not ((std >= 0) & np.isfinite(std)).all():
            raise VergenceError(
                f"joint_std is a standard deviation, 0 or more; found {self.joint_std}."
            )


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
    """Noise of one coordinate of a corner, in a typical image; of measured poses of a target, the
    factor on their stated deviations."""
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
    """Size of the board relative to the stated one: estimated where measured poses of the eyes
    determine lengths, else 1."""
    T_base_eye: Array
    """(V, 2, 4, 4) the true poses of the left and the right eye; NaN where it saw no board."""
    residuals_px: Mapping[str, Array]
    """By camera that sees boards: (V, K, 2) projected minus seen, or (V, 6) of measured poses;
    NaN where not seen."""
    left_out: Mapping[str, np.ndarray]
    """By camera: (V, K) of bool, the corners that contradict the estimate and must not take part in
    later figures, or (V, 6) for measured poses."""
    findings: tuple[Finding, ...]
    """What the data cannot determine, and why; the most severe first."""
    levels: Levels
    """Standard deviation of each noise level, by name."""
    backlash_rad: Mapping[str, tuple[float, float]]
    """By reading, or eye and reading where its joints share one: width of the backlash [rad of the
    reading], positive where the eye lags behind, and its standard deviation."""

    @property
    def accuracy(self) -> Accuracy:
        """The head's accuracy, for its file."""
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
            backlash_rad=dict(self.backlash_rad),
        )


_ESTIMATED = NoiseModel()


@single_blas_thread()
def bundle_adjust(
    start: HeadCalibration,
    observations: Observations | PoseObservations,
    *,
    T_cam_target: Mapping[str, Array] | None = None,
    fixed: Collection[str] | None = None,
    noise: NoiseModel = _ESTIMATED,
    priors: Sequence[Residual] = (),
    intrinsics: Mapping[str, Intrinsics] | None = None,
) -> BundleEstimate:
    """Estimate a whole head at once: lenses, mountings, the pose between the eyes, axes, time.

    Args:
        start: the paper's calibration, or another that is about right.
        observations: readings, and corners or measured poses of a target. Without timing the time
            offset is not estimated.
        T_cam_target: by camera (V, 4, 4) poses of the board in each image, where they were solved
            for before from corners.
        fixed: names of parameters that keep their start; None: fixed_by_default.
        noise: what is known of it.
        priors: other measurements of the head, such as `priors.ParametersPrior`.
        intrinsics: by camera, as images alone determine them. They are kept, and all else is as
            uncertain as they make it; None: readings take part in estimating them.

    Raises:
        VergenceError: an unknown parameter is named, joint_std is that of other readings, a reading
            that is needed is not finite, or there are fewer data than unknowns.
    """
    timed = observations.timing is not None
    known = observations.known_lenses.items()
    kept = {name: lens for name, (lens, percent) in known if percent == 0}
    kept |= {name: each.camera for name, each in (intrinsics or {}).items()}
    if kept:
        cameras = {
            name: replace(mounted, intrinsics=kept.get(name, mounted.intrinsics))
            for name, mounted in start.cameras.items()
        }
        start = replace(start, cameras=cameras)
    fixed = fixed_by_default(start, timed=timed) if fixed is None else fixed
    unknown = set(fixed) - set(parameter_names(start))
    if unknown:
        raise VergenceError(
            f"There is no parameter {min(unknown)!r} to fix; there are, for example, "
            "<camera>.fx, <camera>.T_eye_cam.rx, left.pan_gain and time_offset_s."
        )
    own = {name: intrinsics_names(lens) for name, lens in kept.items()}
    fixed = {*fixed, *(f"{name}.{each}" for name in own for each in own[name])}
    joint_std = noise.joint_std
    given = None if joint_std is None else np.maximum(np.atleast_1d(joint_std), EXACT)
    problem = bundle_problem(
        start,
        observations,
        fixed=fixed,
        T_cam_target=T_cam_target,
        least_blocks=_least_blocks(noise, given),
        backlash=given is None,
    )
    if given is None and problem.measures_eyes:
        problem = with_shared_errors(problem)
    levels = _levels(problem, noise, given)
    known = TURNS in noise.levels
    if known and (apart := held_boards(problem, least=1)) is not None:
        problem = apart
        levels += motion_levels([noise.levels[TURNS], noise.levels[SHIFTS]], given=True)
    solve = partial(adjust, outlier=noise.outlier)
    found = solve((*problem.residuals, *priors), problem.start, levels)
    if given is None and not noise.levels and (apart := moved_boards(problem, found)) is not None:
        problem = apart
        levels += motion_levels(FIRST_MOTION, given=False)
        found = solve((*problem.residuals, *priors), problem.start, levels)
    return _estimate(problem, start, observations, found, levels, intrinsics or {})


def _least_blocks(noise: NoiseModel, joint_std: Array | None) -> float:
    """Return the least number of postures from which each kind of readings has its own level."""
    if joint_std is not None:
        return np.inf if len(joint_std) == 1 else 0
    if noise.levels:  # a part of the views has the levels of all
        return np.inf if "readings" in noise.levels else 0
    return OWN_LEVELS


def _levels(problem: BundleProblem, noise: NoiseModel, joint_std: Array | None) -> list[Level]:
    """List the noise levels: that of the cameras, and those of the readings."""
    every = list(dict.fromkeys(problem.readings.level))
    names = [name for name in every if not name.startswith(PLAY)]
    if joint_std is not None and len(joint_std) not in (1, len(names)):
        raise VergenceError(
            f"joint_std is one number, or {len(names)}, as many as these readings have kinds; "
            f"found {tuple(joint_std.tolist())}."
        )
    measured, postures = problem.measured.level, problem.readings.postures
    if isinstance(measured, tuple):
        of_targets = dict.fromkeys(measured)
        levels = [Level(name, GENEROUS_JOINT, floor=FLOOR_TARGET) for name in of_targets]
    else:
        pixel = FIRST_PX if noise.pixel_std_px is None else noise.pixel_std_px
        levels = [Level(measured, pixel, noise.pixel_std_px is not None, floor=FLOOR_PX)]
    for name in every:
        at = np.array(problem.readings.level) == name
        latent = tuple(np.flatnonzero(postures.tied[at].any(axis=0)).tolist())
        turned = 1.0  # angle of a joint by one radian of its reading
        if postures.T_base_eye_read is None:
            kinematics = problem.start["head"].kinematics
            turned = float(kinematics.gear_ratios[postures.columns[0, list(latent)]].max())
        first, usual = GENEROUS_JOINT / turned, USUAL_JOINT / turned
        if name not in names:
            usual = EXACT
            first = first if joint_std is None else EXACT
        elif joint_std is not None:
            first = float(np.broadcast_to(joint_std, len(names))[names.index(name)])
        levels.append(Level(name, first, joint_std is not None, usual=usual, latent=latent))
    if problem.readings.smooth is not None:
        levels += [Level(name, GENEROUS_JOINT, floor=FLOOR_TARGET) for name in SMOOTH]
    return [
        replace(level, start=noise.levels[level.name], given=True)
        if level.name in noise.levels
        else level
        for level in levels
    ]


def _estimate(
    problem: BundleProblem,
    start: HeadCalibration,
    observations: Observations | PoseObservations,
    found: Adjustment,
    levels: Sequence[Level],
    intrinsics: Mapping[str, Intrinsics],
) -> BundleEstimate:
    x, measured, names = found.x, found.residuals[0], tuple(start.cameras)
    detections = problem.measured.detections
    T_base_eye = np.full((len(observations.placement), 2, 4, 4), np.nan)
    T_base_eye[detections.views, detections.eyes] = detections.eye_poses(x)
    covariance, camera_px = found.observability.covariance, {}
    c = len(covariance)
    lenses, by_lenses, scale_std = _consider(found, intrinsics)
    if intrinsics:
        of_lenses = np.asarray(block_diag(*(each.covariance for each in intrinsics.values())))
        covariance = covariance + (by_lenses @ of_lenses @ by_lenses.T)[:c, :c]
    systematic: dict[str, float] = {}
    pixel_px = found.levels[levels[0].name]
    prior = next((each for each in found.residuals if isinstance(each, BacklashPrior)), None)
    if prior is not None:
        covariance = covariance + mixture_covariance(found, prior)[:c, :c]
    if isinstance(measured, Reprojection):
        basis = follows = found.observability.basis
        weights = found.levels
        if intrinsics:  # the lenses were fitted to images alone, before boards of any pose
            basis, follows = lenses, by_lenses
            weights = {**weights, **{k: UNKNOWN * weights[k] for k in problem.readings.level}}
        systematic, added = systematic_errors(found, basis, follows, weights)
        covariance = covariance + added[:c, :c]
        for k, name in enumerate(names):
            scales = measured.noise_scale[detections.camera == k]
            rms = np.sqrt(np.mean(scales**2)) if len(scales) else 1.0
            camera_px[name] = pixel_px * float(rms)
    backlash = {} if prior is None else _backlash(problem, x, prior)
    outcome = Outcome(observations, problem, found, levels, systematic, scale_std, backlash)
    joint_std = _joint_std(problem, found)
    smooth = next((each for each in problem.priors if isinstance(each, SmoothErrors)), None)
    head = replace(x["head"], neck=start.neck, pose_errors={})
    if smooth is not None:
        joint_std = smooth.remaining_std(found.levels, np.array(joint_std))
        head = replace(head, pose_errors=smooth.of_eyes(x))
        covariance = covariance + smooth.in_constants(x, found.levels)
    assumed_px = measured.systematic_px if isinstance(measured, Reprojection) else 0.0
    return BundleEstimate(
        head=head,
        parameters=parameter_names(start),
        covariance=covariance,
        pixel_std_px=pixel_px,
        camera_std_px=camera_px,
        systematic_px={
            name: float(np.sqrt(px**2 - assumed_px**2))
            for name, px in systematic.items()
            if px > max(SHOWN_SYSTEMATIC * pixel_px, assumed_px)
        },
        joint_std=tuple(joint_std),
        T_lbase_target={int(p): x["boards"][k] for k, p in enumerate(problem.placements)},
        board_scale=x["board_scale"],
        T_base_eye=T_base_eye,
        residuals_px=_residuals(problem, found, len(T_base_eye)),
        left_out=outcome.left_out(),
        findings=bundle_findings(outcome),
        levels=found.levels,
        backlash_rad=backlash,
    )


def _consider(
    found: Adjustment, intrinsics: Mapping[str, Intrinsics]
) -> tuple[Array, Array, float]:
    """Let lenses that were kept be uncertain: the consider parameters of Schmidt (1966).

    Returns directions (G, l) of the lenses, how all shared unknowns follow them (G, l), and the
    standard deviation of the size of the board.
    """
    x, basis = found.x, found.observability.basis
    columns = [camera_columns(x["head"], name)[each.free] for name, each in intrinsics.items()]
    lenses = np.eye(x.size)[:, np.concatenate([np.zeros(0, dtype=int), *columns])]
    both = found.linear.onto(np.concatenate([basis, lenses], axis=1))
    S, F = eliminate(both, found.levels).schur, basis.shape[1]
    free, row = cholesky(S[:F, :F]), basis[x.columns("board_scale")[0]]
    follows = lenses - basis @ cho_solve(free, S[:F, F:])
    return lenses, follows, float(np.sqrt(row @ cho_solve(free, row)))


def _joint_std(problem: BundleProblem, found: Adjustment) -> list[float]:
    """Compute the noise of each kind of readings, with play, and backlash of unknown sign."""
    postures, level = problem.readings.postures, np.array(problem.readings.level)
    std = {}
    for name in dict.fromkeys(problem.readings.level):
        if name.startswith(PLAY):
            continue
        of_kind = postures.joint[:, postures.tied[level == name].any(axis=0)]
        widths = found.x[BLOCK][np.unique(of_kind)] if len(found.x[BLOCK]) else np.zeros(1)
        std[name] = np.sqrt(found.levels[name] ** 2 + (widths**2).mean() / 4)
    for name in set(problem.readings.level) - set(std):
        own = name.replace(PLAY, "readings")
        own = own if own in std else "readings"
        std[own] = np.hypot(std[own], found.levels[name] / 2)
    return [float(each) for each in std.values()]


def _backlash(
    problem: BundleProblem, x: Variables, prior: BacklashPrior
) -> dict[str, tuple[float, float]]:
    postures, readings = problem.readings.postures, x["head"].kinematics.readings
    first = np.unique(postures.joint, return_index=True)[1]
    reading = postures.columns.ravel()[first]
    own = np.broadcast_to(postures.own, postures.joint.shape).ravel()[first]
    names = [
        readings[r] if e < 0 else f"{EYES[e]}_{readings[r]}"
        for r, e in zip(reading, own, strict=True)
    ]
    pairs = zip(x[BLOCK].tolist(), np.sqrt(np.diag(prior.covariance)).tolist(), strict=True)
    return dict(zip(names, pairs, strict=True))


def _residuals(problem: BundleProblem, found: Adjustment, views: int) -> dict[str, Array]:
    """Collect by camera the errors (V, K, 2) of its corners, or (V, 6); NaN where not seen."""
    measured, detections = problem.measured, problem.measured.detections
    seen = np.repeat(measured.seen, measured.together, axis=1)
    errors = np.where(seen, found.errors[0], np.nan)
    if isinstance(measured, Reprojection):
        errors = errors.reshape(*measured.pixels.shape)
    residuals = {}
    for c, name in enumerate(detections.cameras):
        mine = detections.camera == c
        if mine.any():
            residuals[name] = np.full((views, *errors.shape[1:]), np.nan)
            residuals[name][detections.views[mine]] = errors[mine]
    return residuals


def fixed_by_default(start: HeadCalibration, *, timed: bool) -> set[str]:
    """Name the parameters that bundle_adjust does not touch unless asked to.

    - Offsets of an eye's first and last joint: an offset of tilt is a turn of T_eye_cam, one of
      pan a turn of the base frame, and no image distinguishes them.
    - Distortion coefficients that are zero at the start: they are not in the lens model.
    - The time offset, where the eyes stood still.
    - Where the other eye is, for a head of one eye.
    - Where the main camera sits in an eye without joints: it stands for the eye's base.
    """
    fixed = redundant_offsets(start.kinematics)
    for camera, mounted in start.cameras.items():
        lens = mounted.intrinsics
        values = zip(COEFFICIENTS[lens.model], lens.distortion, strict=True)
        fixed |= {f"{camera}.{name}" for name, value in values if value == 0}
    if main_pair(start) is None:
        fixed |= {f"T_rbase_lbase.{name}" for name in POSE}
    for eye, joints in start.kinematics.eyes.items():
        if not joints and (own := lenses_of(start, eye)):
            fixed |= {f"{main_camera(own)}.T_eye_cam.{name}" for name in POSE}
    return fixed if timed else fixed | {"time_offset_s"}


def covariance_of(estimate: BundleEstimate, name: str) -> Array:
    """Look up the covariance of one parameter, or of all that have the name before their last dot.

    For example (6, 6) of "left_wide.T_eye_cam" and "T_rbase_lbase", (9, 9) of "left_wide".
    VergenceError if no parameter has this name.
    """
    parameters = enumerate(estimate.parameters)
    chosen = [i for i, each in parameters if name in (each, each.rpartition(".")[0])]
    if not chosen:
        raise VergenceError(f"No parameter is called {name!r}; see BundleEstimate.parameters.")
    return estimate.covariance[np.ix_(chosen, chosen)]
