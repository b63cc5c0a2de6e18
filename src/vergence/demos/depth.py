"""Dense depth while the eyes move: of the twin, with its error, or of a dataset.

The geometry is a head and its joint readings; the truth, which only the twin knows, is used for the
errors alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.camera import normalise, project
from vergence.geometry.head import HeadCalibration, load_head, main_pair
from vergence.geometry.kinematics import NECK_JOINTS
from vergence.geometry.projection import stereo_cameras, stereo_poses
from vergence.geometry.se3 import transform
from vergence.progress import Progress, silent
from vergence.stereo.dense_depth import DenseDepth, dense_depth
from vergence.stereo.rectification import (
    RectifiedPair,
    rectified_pixels,
    rectified_points,
    rectify,
)
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene import Scene
from vergence.twin.simulated_robot import calibrate_twin
from vergence.viewer.depth import depth_recording, log_depth
from vergence.viewer.opening import log_report, markdown_table
from vergence.writing import check_outputs, results_folder, write_json, write_whole

RANGE_M = (0.5, 1.5)
"""Distances at which errors are stated."""
STEP_S = 9.0
"""Time between two pairs of the divergent motion: no divisor of its periods."""
MOST_PAIRS = 1000
_GRID_PX = 16  # between the points whose rows are compared


@dataclass(frozen=True, eq=False)
class StereoImages:
    """The images of a pair, and what is known of the moment."""

    time_s: float
    joints: Array
    """Readings [rad], or measured poses (2, 4, 4)."""
    left: np.ndarray
    right: np.ndarray
    truth: Truth | None = None
    """Of the twin."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What the twin knows."""

    head: HeadCalibration
    eye_angles: Array
    """(4,) [rad]."""
    depth_m: Array
    """(H, W) along the optical axis of the left camera."""


@dataclass(frozen=True)
class Errors:
    """Errors of depth at RANGE_M where there is texture, over all pairs."""

    median_relative: float
    wrong: float
    """Share of the pixels that are wrong by more than a fifth."""
    within_two_std: float
    """Share of the others whose error is within two standard deviations."""
    pixels: int
    vertical_rms_px: float
    """Of the rows of a point in the two rectified images."""


@dataclass(frozen=True)
class Summary:
    """What dense depth came to; written as JSON."""

    pairs: int
    matched: float
    """Share of the rectified pixels that have a depth."""
    textured: float
    """Share that has one which texture determines well."""
    median_relative_std: float
    """Stated standard deviation over depth, of textured pixels at RANGE_M."""
    joints: Errors | None
    """By the calibration and the joint readings; None: the truth is not known."""
    true_geometry: Errors | None
    """By the true head and the true angles: what the matching itself leaves."""


def depth(
    out: Path,
    *,
    dataset: Path | None = None,
    calibration: Path | None = None,
    profile: ErrorProfile,
    scene: Scene = "room",
    seed: int = 0,
    pairs: int = 20,
    progress: Progress = silent,
) -> Summary:
    """Compute dense depth, and write depth.rrd, depth.json and report.md into a folder.

    Args:
        out: the folder.
        dataset: of which the depth is wanted; None: of the twin, over the divergent motion.
        calibration: file of the head; None: the twin is calibrated first, by the paper's method.
        profile: of the twin.
        scene: of the twin.
        seed: of the twin.
        pairs: number of pairs; of a dataset at most so many, evenly spaced.
        progress: is called after each pair.

    Raises:
        VergenceError: an argument is out of range, the dataset or the calibration cannot be read or
            has no stereo pair, or the folder cannot be written.
    """
    if not 1 <= pairs <= MOST_PAIRS:
        raise VergenceError(f"Asked for {pairs} pairs; from 1 to {MOST_PAIRS} can be made.")
    if dataset is not None and calibration is None:
        raise VergenceError(
            "Depth of a dataset needs --calibration FILE, which `vergence calibrate` makes of it."
        )
    check_outputs(folder=out, inputs=[calibration] if calibration else [])
    given = None if calibration is None else load_head(calibration)
    if dataset is not None and given is not None:
        moments, count = _of_dataset(dataset, given, pairs)
        return _measure(out, given, None, moments, count, progress)
    with _twin(profile, scene, seed, given) as (twin, head, joint_std):
        return _measure(out, head, joint_std, _of_twin(twin, pairs), pairs, progress)


@contextmanager
def _twin(
    profile: ErrorProfile, scene: Scene, seed: int, given: HeadCalibration | None
) -> Iterator[tuple[Twin, HeadCalibration, float | None]]:
    with Twin(profile, seed=seed, scene=scene) as twin:
        if given is not None:
            yield twin, given, None
        else:
            settings = calibrate_twin(twin, seed)
            yield twin, settings.calibration, settings.joint_std_rad


def _of_twin(twin: Twin, pairs: int) -> Iterator[StereoImages]:
    twin.restart(1)
    left, right = main_pair(twin.truth) or ("", "")
    for k in range(pairs):
        posture = straight_neck(eye_angles("divergent", np.array(STEP_S * k)))
        twin.advance(twin.time_s + 0.5, posture)
        angles = twin.true_angles()[len(NECK_JOINTS) :]
        frame = twin.capture((left, right))
        yield StereoImages(
            time_s=STEP_S * k,
            joints=frame.eye_angles,
            left=frame.images[left],
            right=frame.images[right],
            truth=Truth(twin.truth, angles, twin.true_depth(left)),
        )


def _of_dataset(
    folder: Path, head: HeadCalibration, pairs: int
) -> tuple[Iterator[StereoImages], int]:
    data = load_dataset(folder)
    left, right = (name for name in main_pair(head) or ("", ""))
    stereo_cameras(head, None)  # refuses a head without a pair
    for name in (left, right):
        if name not in data.files:
            raise VergenceError(
                f"The calibration's main cameras are {left} and {right}; {folder} has "
                f"{', '.join(data.files)}."
            )
    both = [k for k in range(len(data)) if data.files[left][k] and data.files[right][k]]
    if not both:
        raise VergenceError(f"No row of {folder} has images of both {left} and {right}.")
    chosen = [both[i] for i in np.unique(np.linspace(0, len(both) - 1, pairs).round().astype(int))]

    def read() -> Iterator[StereoImages]:
        for row in chosen:
            images = data.frame(row).images
            joints = data.eye_angles[row] if data.T_base_eye is None else data.T_base_eye[row]
            time_s = float(data.time_s[row] - data.time_s[0])
            yield StereoImages(time_s, joints, images[left], images[right])

    return read(), len(chosen)


def _measure(
    out: Path,
    head: HeadCalibration,
    joint_std: float | None,
    moments: Iterator[StereoImages],
    count: int,
    progress: Progress,
) -> Summary:
    shares, stds, by_joints, by_truth = [], [], [], []
    progress("dense depth, pairs", 0, count)
    with results_folder(out):
        with depth_recording(out / "depth.rrd", head) as rec:
            for k, seen in enumerate(moments):
                pair = rectify(head, seen.joints)
                found = dense_depth(
                    head, seen.joints, pair, seen.left, seen.right, joint_std_rad=joint_std
                )
                near = found.textured & (found.depth_m > RANGE_M[0]) & (found.depth_m < RANGE_M[1])
                stds.append(found.std_m[near] / found.depth_m[near])
                shares.append((np.isfinite(found.depth_m).mean(), found.textured.mean()))
                if seen.truth is not None:
                    by_joints.append(_errors(head, seen.joints, pair, found, seen.truth))
                    by_truth.append(_with_true_geometry(seen, seen.truth))
                log_depth(
                    rec,
                    head,
                    time_s=seen.time_s,
                    index=k,
                    joints=seen.joints,
                    pair=pair,
                    right=seen.right,
                    found=found,
                )
                progress("dense depth, pairs", k + 1, count)
            matched, textured = np.mean(shares, axis=0)
            relative = np.concatenate(stds)
            done = Summary(
                pairs=count,
                matched=float(matched),
                textured=float(textured),
                median_relative_std=float(np.median(relative)) if relative.size else np.nan,
                joints=_summed(by_joints),
                true_geometry=_summed(by_truth),
            )
            report = as_markdown(done)
            log_report(rec, report)
        write_json(done, out / "depth.json")
        write_whole(out / "report.md", report)
    return done


def _with_true_geometry(seen: StereoImages, truth: Truth) -> tuple[Array, Array, float]:
    pair = rectify(truth.head, truth.eye_angles)
    found = dense_depth(truth.head, truth.eye_angles, pair, seen.left, seen.right)
    return _errors(truth.head, truth.eye_angles, pair, found, truth)


def _errors(
    head: HeadCalibration, joints: Array, pair: RectifiedPair, found: DenseDepth, truth: Truth
) -> tuple[Array, Array, float]:
    """Return relative errors (N,), the same over the stated std (N,), and the rows' error [px].

    Compared is the depth along the left camera's axis, at the pixel of its own image.
    """
    view = pair.left
    size = found.depth_m.shape[::-1]
    pixels = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).astype(float)
    points = rectified_points(pair, pixels, found.disparity_px) @ view.R_rect_cam
    true_m = cv2.remap(
        truth.depth_m.astype(np.float32),
        view.map_x,
        view.map_y,
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    near = found.textured & (true_m > RANGE_M[0]) & (true_m < RANGE_M[1])
    error_m = points[near][:, 2] - true_m[near]
    return error_m / true_m[near], error_m / found.std_m[near], _row_rms(pair, truth)


def _row_rms(pair: RectifiedPair, truth: Truth) -> float:
    """Return the root mean square [px] of the difference of a true point's rows in the pair."""
    left, right = (mounted.intrinsics for mounted in stereo_cameras(truth.head, None))
    v, u = np.mgrid[: left.height : _GRID_PX, : left.width : _GRID_PX]
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)
    xy = normalise(left, pixels)
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=-1)
    points *= truth.depth_m[v, u].reshape(-1, 1)
    _, T_rcam_lcam = stereo_poses(truth.head, truth.eye_angles)
    opposite = project(right, transform(T_rcam_lcam, points))
    inside = ((opposite >= 0) & (opposite <= [right.width - 1, right.height - 1])).all(axis=-1)
    rows = [
        rectified_pixels(pair, view, at[inside])[:, 1]
        for view, at in ((pair.left, pixels), (pair.right, opposite))
    ]
    return float(np.sqrt(np.nanmean((rows[0] - rows[1]) ** 2)))


def _summed(found: list[tuple[Array, Array, float]]) -> Errors | None:
    if not found:
        return None
    relative, standardised = (np.concatenate([each[k] for each in found]) for k in (0, 1))
    wrong = np.abs(relative) > 0.2
    within = np.abs(standardised[~wrong]) < 2
    return Errors(
        median_relative=float(np.median(np.abs(relative))) if relative.size else np.nan,
        wrong=float(wrong.mean()) if relative.size else np.nan,
        within_two_std=float(within.mean()) if within.size else np.nan,
        pixels=len(relative),
        vertical_rms_px=float(np.sqrt(np.mean([each[2] ** 2 for each in found]))),
    )


def as_markdown(done: Summary) -> str:
    """Return the report."""
    lines = [
        "# Dense depth",
        "",
        f"{done.pairs} pairs. {100 * done.matched:.0f} % of the rectified pixels have a depth, "
        f"{100 * done.textured:.0f} % one that texture determines well. At {RANGE_M[0]} to "
        f"{RANGE_M[1]} m the stated standard deviation of these is "
        f"{100 * done.median_relative_std:.1f} % in the median.",
        "",
    ]
    rows = [
        (
            name,
            f"{100 * e.median_relative:.2f}",
            f"{100 * e.wrong:.1f}",
            f"{100 * e.within_two_std:.0f}",
            f"{e.vertical_rms_px:.2f}",
        )
        for name, e in (
            ("calibration and joints", done.joints),
            ("true geometry", done.true_geometry),
        )
        if e is not None
    ]
    if rows:
        heading = (
            "geometry | median error [%] | wrong by a fifth [%] | others within two std [%] | "
            "rows, rms [px]"
        )
        lines += [f"Errors at {RANGE_M[0]} to {RANGE_M[1]} m where there is texture:", ""]
        lines += [markdown_table(heading, rows), ""]
    return "\n".join(lines)
