"""`vergence depth`: the depth of every pixel of rectified pairs.

The geometry is a head and its joint readings, or these as corrected by what both eyes see. Pairs
are of a dataset here; `demos.depth` takes them from the twin, and compares them with the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.commands.depth_report import RANGE_M, TITLE, DepthErrors, Summary, as_markdown
from vergence.data.reader import load_dataset
from vergence.data.stereo_rows import stereo_rows
from vergence.errors import VergenceError
from vergence.geometry.camera import unproject
from vergence.geometry.components import stacked
from vergence.geometry.eye_motion import eye_motions, measured
from vergence.geometry.head import HeadCalibration, load_head, reading_stds
from vergence.geometry.se3 import pose
from vergence.progress import Progress, silent
from vergence.self_calibration.frame import locate_seen
from vergence.self_calibration.prior import JOINT_STD_RAD
from vergence.self_calibration.robust_fit import FEWEST
from vergence.self_calibration.sequence import Geometry, initial_seen_geometry, update_geometry
from vergence.self_calibration.state import FrameEstimate
from vergence.stereo.dense_depth import DenseDepth, dense_depth
from vergence.stereo.rectification import RectifiedPair, rectify
from vergence.stereo.uncertainty import LocatedPoints
from vergence.viewer.depth import depth_recording, log_depth
from vergence.viewer.opening import log_report
from vergence.vision.matching.scene_features import match_scene
from vergence.writable import REPORT, check_outputs
from vergence.writing import results_folder, write_json, write_whole

MOST_PAIRS = 1000
_DOUBTED = 4.2
"""Difference of the rows in the median, relative to what the noise of readings makes of it, from
which a calibration is doubted. The noise alone makes a difference of 0.7."""
_LEAST_DOUBTED_RAD = np.radians(0.1)
RESULTS = ("depth.rrd", "depth.json", REPORT)
"""Files in the folder of the results."""


@dataclass(frozen=True, eq=False)
class StereoImages:
    """The images of a pair, and what is known of the moment."""

    time_s: float
    joints: Array
    """Readings [rad], or measured poses (2, 4, 4)."""
    left: np.ndarray
    right: np.ndarray
    seen: FrameEstimate | None = None
    """The geometry that both eyes see; None: it is not asked for."""


PairDepth = tuple[RectifiedPair, DenseDepth]
"""How the images of a pair were rectified, and the depth of its pixels."""


def depth(
    out: Path,
    *,
    dataset: Path,
    calibration: Path,
    pairs: int = 20,
    geometry: Geometry = "joints",
    progress: Progress = silent,
) -> Summary:
    """Compute dense depth of a dataset; write depth.rrd, depth.json and report.md into a folder.

    Args:
        out: the folder.
        dataset: of which the depth is wanted.
        calibration: file of the head.
        pairs: number of pairs at most; they are evenly spaced.
        geometry: by which the pairs are rectified; "seen" learns from all rows of the dataset up to
            each pair.
        progress: is called after each pair.

    Raises:
        VergenceError: an argument is out of range, the dataset or the calibration cannot be read or
            has no stereo pair that can be rectified, or the folder cannot be written.
    """
    check_pairs(pairs)
    check_outputs(folder=out, names=RESULTS, title=TITLE, inputs=[calibration])
    head = load_head(calibration)
    moments, count, left_out = _moments(dataset, head, pairs, geometry)
    found = ((moment, depth_of(moment, head)) for moment in moments)
    with results_folder(out):
        return write_depth(out, head, found, count, left_out=left_out, progress=progress)


def check_pairs(pairs: int) -> None:
    """Raise VergenceError for a number of pairs that cannot be made."""
    if not 1 <= pairs <= MOST_PAIRS:
        raise VergenceError(f"Asked for {pairs} pairs; from 1 to {MOST_PAIRS} can be made.")


def _moments(
    folder: Path, head: HeadCalibration, pairs: int, geometry: Geometry
) -> tuple[Iterator[StereoImages], int, int]:
    """Return the moments of pairs, how many they are, and how many more cannot be rectified."""
    both = stereo_rows(load_dataset(folder), head)
    if geometry == "seen" and measured(both.joints):
        raise VergenceError(f"--geometry seen corrects joint readings; {folder} has poses.")
    left, right = both.cameras
    wanted = np.unique(np.linspace(0, len(both) - 1, pairs).round().astype(int))
    refused = [_refused(head, both.joints[k]) for k in wanted]
    chosen = [int(k) for k, error in zip(wanted, refused, strict=True) if error is None]
    if refused[0] is not None and not chosen:
        raise refused[0]

    before = initial_seen_geometry(head) if geometry == "seen" else None

    def read() -> Iterator[StereoImages]:
        known = before
        for k in chosen if known is None else range(chosen[-1] + 1):
            frame = both.frame(k)
            known = None if known is None else update_geometry(known, frame)
            if k in chosen:
                time_s = frame.time_s - float(both.dataset.time_s[0])
                images = frame.images[left], frame.images[right]
                seen = None if known is None else known.latest
                yield StereoImages(time_s, both.joints[k], *images, seen=seen)

    return read(), len(chosen), len(wanted) - len(chosen)


def _refused(head: HeadCalibration, joints: Array) -> VergenceError | None:
    """Return why a pair cannot be rectified; None: it can."""
    try:
        rectify(head, joints)
    except VergenceError as error:
        return error
    return None


def depth_of(moment: StereoImages, head: HeadCalibration) -> PairDepth:
    """Return the depth of a pair by the geometry that is seen or, where none is, by the joints."""
    seen = moment.seen
    if seen is None:
        return depth_by(moment, head, moment.joints)
    located = partial(locate_seen, seen, pixel_std_px=0.0)
    return depth_by(moment, seen.head, seen.joints, located=located)


def depth_by(
    moment: StereoImages,
    head: HeadCalibration,
    joints: Array,
    *,
    joint_std_rad: float | None = None,
    located: Callable[..., LocatedPoints] | None = None,
) -> PairDepth:
    """Return the depth of a pair by a head and joints; options are those of `dense_depth`."""
    pair, images = rectify(head, joints), (moment.left, moment.right)
    found = dense_depth(pair, *images, joint_std_rad=joint_std_rad, located=located)
    return pair, found


def write_depth(
    out: Path,
    head: HeadCalibration,
    found: Iterable[tuple[StereoImages, PairDepth]],
    count: int,
    *,
    left_out: int = 0,
    errors: Callable[[], dict[str, DepthErrors | None]] = dict,
    progress: Progress = silent,
) -> Summary:
    """Write a recording, a summary and a report of the depth of pairs, one after the other.

    Args:
        out: folder of depth.rrd, depth.json and report.md, a `results_folder`.
        head: the calibration.
        found: pairs with their depths.
        count: how many they are.
        left_out: how many more cannot be rectified.
        errors: is called after the last pair; returns the errors of the depth by geometry, under
            the names that Summary has for them.
        progress: is called after each pair.

    Raises:
        VergenceError: the folder cannot be written.
    """
    shares, stds, rows, noises = [], [], [], []
    progress("dense depth, pairs", 0, count)
    with depth_recording(out / "depth.rrd", head) as rec:
        for k, (moment, (pair, dense)) in enumerate(found):
            near = dense.textured & (dense.depth_m > RANGE_M[0]) & (dense.depth_m < RANGE_M[1])
            stds.append(dense.std_m[near] / dense.depth_m[near])
            shares.append((np.isfinite(dense.depth_m).mean(), dense.textured.mean()))
            rows.append(_row_difference_rad(moment, pair))
            noises.append(_row_noise_rad(pair))
            log_depth(
                rec,
                head if moment.seen is None else moment.seen.head,
                time_s=moment.time_s,
                index=k,
                joints=moment.joints if moment.seen is None else moment.seen.joints,
                pair=pair,
                right=moment.right,
                found=dense,
            )
            progress("dense depth, pairs", k + 1, count)
        matched, textured = np.mean(shares, axis=0)
        relative, known = np.concatenate(stds), np.isfinite(rows)
        apart_rad = float(np.median(np.array(rows)[known])) if known.any() else np.nan
        done = Summary(
            pairs=count,
            left_out=left_out,
            matched=float(matched),
            textured=float(textured),
            median_relative_std=float(np.median(relative)) if relative.size else np.nan,
            row_difference_deg=float(np.degrees(apart_rad)),
            doubt=_doubt(apart_rad, float(np.median(noises))),
            **errors(),
        )
        report = as_markdown(done)
        log_report(rec, report)
    write_json(done, out / "depth.json")
    write_whole(out / REPORT, report)
    return done


def _row_difference_rad(moment: StereoImages, pair: RectifiedPair) -> float:
    """Return how far features are above their row, in the median [rad]; NaN: too few are matched.

    The search for them allows for a geometry that is wrong by some degrees.
    """
    views = pair.left, pair.right
    R_lrect_lcam, R_rrect_rcam = (view.R_rect_cam for view in views)
    matches = match_scene(
        moment.left,
        moment.right,
        left_camera=pair.left.camera,
        right_camera=pair.right.camera,
        T_rcam_lcam=pose(
            R_rrect_rcam.T @ R_lrect_lcam, -R_rrect_rcam.T @ np.array([pair.baseline_m, 0, 0])
        ),
    )
    if len(matches.left) < FEWEST:
        return np.nan
    rays = [
        unproject(view.camera, pixels) @ view.R_rect_cam.T
        for view, pixels in zip(views, (matches.left, matches.right), strict=True)
    ]
    above = [np.arctan2(each[:, 1], each[:, 2]) for each in rays]
    return float(np.nanmedian(np.abs(above[1] - above[0])))


def _row_noise_rad(pair: RectifiedPair) -> float:
    """Return by how much the noise of readings turns the rows of a pair apart [rad].

    Where both eyes share a tilt its readings turn them alike.
    """
    if measured(pair.joints):
        return JOINT_STD_RAD
    head, factors = pair.head, pair.head.kinematics.factors
    stds = reading_stds(head)
    stds = stds if stds.any() else JOINT_STD_RAD / factors
    along = pair.T_lbase_rect[:3, 0]
    axes = along, head.T_rbase_lbase[:3, :3] @ along
    by_readings = np.zeros(len(factors))
    for sign, axis, eye in zip((1, -1), axes, eye_motions(head, pair.joints[None]), strict=True):
        for joint, reading, slope in eye.angle_by_readings:
            turn = stacked(eye.by_angles[joint][:3], (1,))[:, 0]
            by_readings[reading] += sign * slope * float(axis @ turn)
    return float(np.linalg.norm(by_readings * stds))


def _doubt(apart_rad: float, noise_rad: float) -> str | None:
    """Return why a calibration is doubted whose rows are so far apart in the median; None: not.

    Both are medians over the pairs: of what is seen, and of what readings explain.
    """
    if not apart_rad > max(_DOUBTED * noise_rad, _LEAST_DOUBTED_RAD):
        return None
    return (
        f"Features are {np.degrees(apart_rad):.2g} degrees beside their rows: the calibration is "
        "of another head, a camera has turned since, or images and readings are not of the same "
        "moments. The depths are wrong by far more than is stated."
    )
