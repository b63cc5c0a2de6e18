"""From corners and readings to the residuals and unknowns of a bundle adjustment."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.backlash import BLOCK, backlash_block, backlash_prior
from vergence.calibration.observations import Observations, PoseObservations
from vergence.calibration.pose_errors import (
    SmoothErrors,
    at_postures,
    pose_errors_block,
    smooth_functions,
)
from vergence.calibration.postures import postures_of, readings_of_joints
from vergence.calibration.priors import (
    BOARD_SCALE,
    LAST_ASSUMED,
    BoardSize,
    ParametersPrior,
    board_scale_block,
    boards_block,
    head_block,
    known_lens_std,
    lens_priors,
)
from vergence.calibration.readings import PLAY, Readings, readings_of
from vergence.calibration.residuals import (
    TARGET_SHIFTS,
    TARGET_TURNS,
    TARGETS,
    Detections,
    Reprojection,
    TargetPoses,
)
from vergence.errors import VergenceError
from vergence.estimation.linear import linearise
from vergence.estimation.residual import Residual
from vergence.estimation.variables import Latent, Variables
from vergence.geometry.board import corner_points
from vergence.geometry.camera import intrinsics_names
from vergence.geometry.head import HeadCalibration, parameter_names
from vergence.geometry.kinematics import (
    EYES,
    GEARED,
    Kinematics,
    joint_names,
    reading_kinds,
)
from vergence.geometry.se3 import inverse, known_poses
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, determines_pose, seen_corners

CANDIDATES = 12
"""Views from which the start of a board's place is chosen."""
FAR = 50.0
"""Largest error with which a corner [px], or a number of a measured pose [standard deviations],
votes on a board's place; far beyond the errors of a good start."""
MEASURING_M = 0.02
"""Standard deviation of an eye's place from which measured poses, good to a fraction of a
millimetre, determine lengths better than a printed board does."""
CONTRADICTS, ALIKE_M, ALIKE_PX = 10.0, 1e-3, 1.0
"""Multiple of the median distance, of boards and of corners, from which a view contradicts others,
and distances that contradict nothing: those of single images, and of starts that are good."""


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """What a bundle adjustment estimates, and from what."""

    measured: Reprojection | TargetPoses
    """What the cameras saw."""
    readings: Readings
    priors: tuple[Residual, ...]
    start: Variables
    placements: np.ndarray
    """(P,) the numbers of the boards' placements."""
    contradicting: np.ndarray
    """(C, V) of bool: images left out, since no turn of the eye puts the board where others do."""

    @property
    def measures_eyes(self) -> bool:
        """Whether images show how far measured poses of the eyes err."""
        poses = self.readings.postures.T_base_eye_read is not None
        return poses and isinstance(self.measured, Reprojection)

    @property
    def residuals(self) -> tuple[Residual, ...]:
        """All residuals, those of the cameras first."""
        return self.measured, self.readings, *self.priors


def bundle_problem(
    start: HeadCalibration,
    observations: Observations | PoseObservations,
    *,
    fixed: Collection[str],
    T_cam_target: Mapping[str, Array] | None = None,
    least_blocks: float = np.inf,
    backlash: bool = False,
) -> BundleProblem:
    """Set up the bundle adjustment of a head.

    The best board pose of each placement is its start; parameters of cameras that see no board keep
    theirs. `least_blocks` is that of reading_levels; other arguments and errors are those of
    `bundle_adjust`.
    """
    cameras, V, corners, points = start.cameras, len(observations.placement), np.zeros(0), None
    if isinstance(observations, PoseObservations):
        T = _stacked(observations.T_cam_target, cameras, (V, 4, 4))
        seen = np.repeat(known_poses(T)[..., None], 6, axis=2)
    else:
        points = corner_points(observations.board)
        corners = _stacked(observations.corners, cameras, (V, len(points), 2))
        seen, solved = seen_corners(corners), T_cam_target or {}
        T = np.stack([
            solved[name] if name in solved else board_poses(each.intrinsics, corners[c], points)
            for c, (name, each) in enumerate(cameras.items())
        ])  # fmt: skip
    if not seen.any():
        raise VergenceError(f"None of {', '.join(cameras)} sees a board.")
    placed = seen.any(axis=2) if points is None else determines_pose(points, seen)
    # A placement without one view that determines the board's pose is of no use.
    numbers = np.unique(observations.placement[placed.any(axis=0)])
    image = np.nonzero(seen.any(axis=2) & np.isin(observations.placement, numbers))
    camera, view = image
    eye = np.array([EYES.index(each.eye) for each in cameras.values()], dtype=np.intp)
    posture, postures = postures_of(start.kinematics, observations, view, eye[camera])
    board = np.searchsorted(numbers, observations.placement[view])
    detections = Detections(tuple(cameras), eye, camera, board, posture, postures)
    seen = seen[image]
    if isinstance(observations, PoseObservations):
        whitening, level = observations.whitening, TARGETS
        if whitening is None:
            whitening = dict.fromkeys(cameras, np.tile(np.eye(6), (V, 1, 1)))
            level = (TARGET_TURNS,) * 3 + (TARGET_SHIFTS,) * 3
        measured = TargetPoses(
            detections=detections,
            T_cam_target=T[image],
            whitening=_stacked(whitening, cameras, (V, 6, 6))[image],
            seen=seen,
            level=level,
        )
    else:
        assert points is not None
        measured = Reprojection(
            detections=detections,
            pixels=np.where(seen[..., None], corners[image], 0.0),
            seen=seen,
            points=points,
            noise_scale=np.ones(len(camera)),
            systematic_px=observations.systematic_px,
        )
    priors: list[Residual] = []
    ratios = start.kinematics.gear_ratios[readings_of_joints(postures)]
    if len(ratios) and backlash:
        priors.append(backlash_prior(ratios))
    for name, mounted in cameras.items():
        last = LAST_ASSUMED.get(mounted.intrinsics.model)
        priors += lens_priors(mounted.intrinsics, f"{name}.{last}" not in fixed, name)
        if name in observations.known_lenses and f"{name}.fx" not in fixed:
            lens, percent = observations.known_lenses[name]
            known = {**cameras, name: replace(mounted, intrinsics=lens)}
            priors.append(
                ParametersPrior(
                    names=tuple(f"{name}.{each}" for each in intrinsics_names(lens)),
                    head=replace(start, cameras=known),
                    covariance=np.diag(known_lens_std(lens, percent) ** 2),
                )
            )
    offset_s = start.time_offset_s if "time_offset_s" in fixed else 0.0
    head = replace(start, time_offset_s=offset_s, accuracy=None)
    sized = isinstance(measured, Reprojection) and _measures_lengths(observations.T_base_eye)
    x = Variables(
        {
            "head": head_block(head, _free(start, fixed, detections)),
            "boards": boards_block(np.tile(np.eye(4), (len(numbers), 1, 1))),
            "board_scale": board_scale_block(free=sized),
            BLOCK: backlash_block(ratios, free=backlash),
        },
        Latent(postures.as_read, postures.reading.shape[1]),
    )
    x, wrong = _place_boards(measured, x, T[image])
    measured = replace(measured, seen=measured.seen & ~wrong[:, None])
    contradicting = np.zeros((len(cameras), V), bool)
    contradicting[camera[wrong], view[wrong]] = True
    level = reading_levels(detections, start.kinematics, least_blocks)
    readings = readings_of(observations, start.kinematics, postures, level)
    if len(ratios) and backlash:
        priors.append(replace(readings, unknown=True, seen=False))
    if sized and isinstance(observations, Observations):
        board = observations.board
        std = BOARD_SCALE if board.square_std_m is None else board.square_std_m / board.square_m
        priors.append(BoardSize(std=std))
    return BundleProblem(measured, readings, tuple(priors), x, numbers, contradicting)


def with_shared_errors(problem: BundleProblem) -> BundleProblem:
    """Let neighbouring postures share a part of the errors of measured poses."""
    measured, x, postures = problem.measured, problem.start, problem.readings.postures
    by_images = linearise([measured], x, [measured.error(x)], [measured.seen.astype(float)])
    functions = smooth_functions(postures, by_images.ll[0])
    return replace(
        problem,
        readings=replace(problem.readings, smooth=at_postures(functions, postures)),
        priors=(SmoothErrors(functions=functions), *problem.priors),
        start=replace(x, shared={**x.shared, "pose_errors": pose_errors_block(functions)}),
    )


def _stacked(
    by_camera: Mapping[str, Array], cameras: Collection[str], shape: tuple[int, ...]
) -> Array:
    """Stack arrays of a shape (C, ...), NaN where a camera has none."""
    return np.stack([by_camera.get(name, np.full(shape, np.nan)) for name in cameras])


def reading_levels(
    detections: Detections, kinematics: Kinematics, least_blocks: float
) -> tuple[str, ...]:
    """Name the noise level (n,) of each latent unknown.

    From some number of postures on each kind of reading has a level, below it all share one, unless
    some are read before a gear, or another one, than others. Where a reading moves both eyes, such
    as their vergence, one eye shows a sum of readings only: postures of one eye do not count. Of
    measured poses rotations have one level, and translations another.
    """
    postures = detections.postures
    if postures.T_base_eye_read is not None:
        return ("rotations",) * 3 + ("translations",) * 3
    if not kinematics.readings:
        return ()
    blocks = len(postures.reading)
    if set(kinematics.used("left")) & set(kinematics.used("right")):
        left, right = (detections.posture[detections.eyes == e] for e in range(len(EYES)))
        blocks = len(np.intersect1d(left, right))
    few = blocks < least_blocks
    kinds = np.array(reading_kinds(kinematics))[postures.columns[0]]
    numbers = np.unique(kinds, return_inverse=True)[1].tolist()
    together = few and kinematics.gear_ratios.max() < GEARED * kinematics.gear_ratios.min()
    return tuple(
        f"{PLAY} {k}" if own == 1 else "readings" if together else f"readings {k}"
        for k, own in zip(numbers, postures.own.tolist(), strict=True)
    )


def _free(start: HeadCalibration, fixed: Collection[str], detections: Detections) -> np.ndarray:
    """Find which parameters (c,) of a head may change.

    Fixed are those fixed by choice, those of a camera or eye that saw no board, and the joints
    where poses were measured in place of their angles.
    """
    blind = {name for c, name in enumerate(detections.cameras) if c not in detections.camera}
    blind |= {side for e, side in enumerate(EYES) if e not in detections.eyes}
    joints: set[str] = set()
    if detections.postures.T_base_eye_read is not None:
        joints = {name for eye in EYES for name in joint_names(start.kinematics, eye)}
    return np.array([
        name not in fixed and name.partition(".")[0] not in blind and name not in joints
        for name in parameter_names(start)
    ])  # fmt: skip


def _measures_lengths(T_base_eye: Array | None) -> bool:
    """Check whether measured eye poses determine lengths, and with them the size of the board.

    Angles do not, nor poses of eyes that turn about a point: the stated board then sets the scale.
    """
    if T_base_eye is None:
        return False
    spread = np.nanstd(T_base_eye[..., :3, 3], axis=0)
    return bool(np.linalg.norm(spread, axis=-1).max() > MEASURING_M)


def _place_boards(
    measured: Reprojection | TargetPoses, x: Variables, T_cam_target: Array
) -> tuple[Variables, np.ndarray]:
    """Start each board where its best view puts it, and find (M,) the views that contradict this.

    A wrong reading turns the eye, which the adjustment finds out. What no turn of the eye explains
    is a wrong image, as one of another moment, turned, or numbered from the wrong end. Where it is
    not the smaller part of the views of a placement, all of them are wrong.
    """
    detections, head, P = measured.detections, x["head"], len(x["boards"])
    mounts = np.stack([mounted.T_eye_cam for mounted in head.cameras.values()])
    right = detections.eyes == 1
    T_base_lbase = np.where(right[:, None, None], head.T_rbase_lbase, np.eye(4))
    T_base_cam = detections.eye_poses(x) @ mounts[detections.camera]
    found = inverse(T_base_lbase) @ T_base_cam @ T_cam_target
    known = known_poses(found)
    offers = [np.flatnonzero(known & (detections.board == p)) for p in range(P)]
    if not P or not all(len(offer) for offer in offers):
        raise VergenceError(
            f"A board whose place is to be found needs {LEAST_CORNERS} corners in one image, not "
            "all on one line."
        )
    best, lowest, chosen = x["boards"], np.full(P, np.inf), np.zeros(P, np.intp)
    for k in range(CANDIDATES):
        # Spread over the views, so that one bad stretch cannot be all there is to choose from.
        offer = np.array([offer[k * len(offer) // CANDIDATES] for offer in offers])
        errors = measured.error(_with_boards(x, found[offer]))
        lengths = np.linalg.norm(errors.reshape(len(errors), -1, measured.together), axis=-1)
        votes = np.minimum(np.nan_to_num(lengths, nan=np.inf), FAR).sum(axis=1)
        total = np.bincount(detections.board, votes, P)
        better = total < lowest
        best = np.where(better[:, None, None], found[offer], best)
        chosen, lowest = np.where(better, offer, chosen), np.minimum(lowest, total)
    x = _with_boards(x, best)
    # How far from the centre of the eye's motion, or of a measured eye, the other pose puts it.
    T_moved = T_base_lbase @ found @ inverse(T_base_lbase @ best[detections.board])
    if detections.postures.T_base_eye_read is not None:
        T_base_eye = detections.eye_poses(x)
        T_moved = inverse(T_base_eye) @ T_moved @ T_base_eye
    moved_m = np.linalg.norm(T_moved[:, :3, 3], axis=1)
    errors = measured.error(x)
    # The pose by a few corners may put the others behind the camera.
    wrong = ~np.isfinite(errors).all(axis=1)
    others = np.setdiff1d(np.flatnonzero(known & ~wrong), chosen)
    if len(others):
        far = moved_m > max(CONTRADICTS * np.median(moved_m[others]), ALIKE_M)
        if isinstance(measured, Reprojection):
            sizes = np.linalg.norm(errors.reshape(*measured.seen.shape, 2), axis=-1)
            off_px = np.nanmedian(np.where(measured.seen, sizes, np.nan), axis=1)
            far &= off_px > max(CONTRADICTS * np.median(off_px[others]), ALIKE_PX)
        wrong |= far
    counts = [np.bincount(detections.board, each, P) for each in (wrong, ~wrong)]
    outvoted = (counts[0] > 0) & (counts[0] >= counts[1])
    return x, wrong | outvoted[detections.board]


def _with_boards(x: Variables, T: Array) -> Variables:
    return replace(x, shared={**x.shared, "boards": replace(x.shared["boards"], value=T)})
