"""Dense depth while the eyes move: of the twin, with its error, or of a dataset.

The geometry is a head and its joint readings, or these as corrected by what both eyes see; the
truth, which only the twin knows, is used for the errors alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.data.reader import load_dataset
from vergence.data.stereo_rows import stereo_rows
from vergence.demos.depth_errors import RANGE_M, Errors, Truth, depth_errors, summed
from vergence.demos.experiment import learned_from_room
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, load_head, main_pair
from vergence.geometry.neck import NECK_JOINTS
from vergence.progress import Progress, silent
from vergence.self_calibration.frame import SelfCalibrated, locate_seen
from vergence.self_calibration.sequence import Geometry, see, seen_geometry
from vergence.stereo.dense_depth import DenseDepth, dense_depth
from vergence.stereo.rectification import RectifiedPair, rectify
from vergence.stereo.uncertainty import LocatedPoints
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene.room import Scene
from vergence.twin.simulated_robot import calibrate_twin
from vergence.viewer.depth import depth_recording, log_depth
from vergence.viewer.opening import log_report
from vergence.writing import check_outputs, markdown_table, results_folder, write_json, write_whole

STEP_S = 9.0
"""Time between two pairs of the divergent motion: no divisor of its periods."""
MOST_PAIRS = 1000


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
    seen: SelfCalibrated | None = None
    """The geometry that both eyes see; None: it is not asked for."""


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
    seen: Errors | None
    """By the geometry that both eyes see; None: it was not asked for, or the truth is not known."""
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
    geometry: Geometry = "joints",
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
        geometry: of which the pairs are rectified. That which is seen is learned from all images of
            a dataset until then; the twin looks around first.
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
        moments, count = _of_dataset(dataset, given, pairs, geometry)
        return _measure(out, given, None, moments, count, progress)
    with _twin(profile, scene, seed, given) as (twin, head, joint_std):
        moments = _of_twin(twin, pairs, head if geometry == "seen" else None)
        return _measure(out, head, joint_std, moments, pairs, progress)


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


def _of_twin(twin: Twin, pairs: int, looks: HeadCalibration | None) -> Iterator[StereoImages]:
    """Yield pairs; where a head is given, with the geometry that it sees."""
    left, right = main_pair(twin.truth) or ("", "")
    geometry = None if looks is None else learned_from_room(twin, seen_geometry(looks))
    twin.restart(1)
    for k in range(pairs):
        posture = straight_neck(eye_angles("divergent", np.array(STEP_S * k)))
        twin.advance(twin.time_s + 0.5, posture)
        angles = twin.true_angles()[len(NECK_JOINTS) :]
        frame = twin.capture((left, right))
        geometry = None if geometry is None else see(geometry, frame)
        yield StereoImages(
            time_s=STEP_S * k,
            joints=frame.eye_angles,
            left=frame.images[left],
            right=frame.images[right],
            truth=Truth(twin.truth, angles, twin.true_depth(left)),
            seen=None if geometry is None else geometry.latest,
        )


def _of_dataset(
    folder: Path, head: HeadCalibration, pairs: int, geometry: Geometry
) -> tuple[Iterator[StereoImages], int]:
    both = stereo_rows(load_dataset(folder), head)
    if geometry == "seen" and both.joints.ndim > 2:
        raise VergenceError(f"--geometry seen corrects joint readings; {folder} has poses.")
    left, right = both.cameras
    chosen = np.unique(np.linspace(0, len(both) - 1, pairs).round().astype(int))

    def read() -> Iterator[StereoImages]:
        known = seen_geometry(head) if geometry == "seen" else None
        for k in chosen if known is None else range(chosen[-1] + 1):
            frame = both.frame(int(k))
            known = None if known is None else see(known, frame)
            if k in chosen:
                time_s = frame.time_s - float(both.dataset.time_s[0])
                images = frame.images[left], frame.images[right]
                seen = None if known is None else known.latest
                yield StereoImages(time_s, both.joints[k], *images, seen=seen)

    return read(), len(chosen)


def _measure(
    out: Path,
    head: HeadCalibration,
    joint_std: float | None,
    moments: Iterator[StereoImages],
    count: int,
    progress: Progress,
) -> Summary:
    shares, stds, by_joints, by_sight, by_truth = [], [], [], [], []
    progress("dense depth, pairs", 0, count)
    with results_folder(out):
        with depth_recording(out / "depth.rrd", head) as rec:
            for k, moment in enumerate(moments):
                found = _found(moment, head, moment.joints, joint_std)
                if moment.truth is not None:
                    by_joints.append(depth_errors(*found, moment.truth))
                    by_truth.append(_with_true_geometry(moment, moment.truth))
                now, joints, seen = head, moment.joints, moment.seen
                if seen is not None:
                    now, joints = seen.head, seen.joints
                    located = partial(locate_seen, seen, pixel_std_px=0.0)
                    found = _found(moment, now, joints, None, located)
                    if moment.truth is not None:
                        by_sight.append(depth_errors(*found, moment.truth))
                pair, dense = found
                near = dense.textured & (dense.depth_m > RANGE_M[0]) & (dense.depth_m < RANGE_M[1])
                stds.append(dense.std_m[near] / dense.depth_m[near])
                shares.append((np.isfinite(dense.depth_m).mean(), dense.textured.mean()))
                log_depth(
                    rec,
                    now,
                    time_s=moment.time_s,
                    index=k,
                    joints=joints,
                    pair=pair,
                    right=moment.right,
                    found=dense,
                )
                progress("dense depth, pairs", k + 1, count)
            matched, textured = np.mean(shares, axis=0)
            relative = np.concatenate(stds)
            done = Summary(
                pairs=count,
                matched=float(matched),
                textured=float(textured),
                median_relative_std=float(np.median(relative)) if relative.size else np.nan,
                joints=summed(by_joints),
                seen=summed(by_sight),
                true_geometry=summed(by_truth),
            )
            report = as_markdown(done)
            log_report(rec, report)
        write_json(done, out / "depth.json")
        write_whole(out / "report.md", report)
    return done


def _found(
    moment: StereoImages,
    head: HeadCalibration,
    joints: Array,
    joint_std: float | None = None,
    located: Callable[..., LocatedPoints] | None = None,
) -> tuple[RectifiedPair, DenseDepth]:
    pair, images = rectify(head, joints), (moment.left, moment.right)
    return pair, dense_depth(head, joints, pair, *images, joint_std_rad=joint_std, located=located)


def _with_true_geometry(moment: StereoImages, truth: Truth) -> tuple[Array, Array, float]:
    return depth_errors(*_found(moment, truth.head, truth.eye_angles), truth)


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
            ("seen by both eyes", done.seen),
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
