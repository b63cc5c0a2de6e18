"""`vergence depth`: the depth of every pixel of rectified pairs, and its report.

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
from vergence.writing import markdown_table, results_folder, write_json, write_whole

RANGE_M = (0.5, 1.5)
"""Distances at which accuracy is stated."""
MOST_PAIRS = 1000
_DOUBTED = 4.2
"""Difference of the rows in the median, relative to what the noise of readings makes of it, from
which a calibration is doubted. The noise alone makes a difference of 0.7."""
_LEAST_DOUBTED_RAD = np.radians(0.1)
TITLE = "# Dense depth"
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


@dataclass(frozen=True)
class DepthErrors:
    """Errors of depth at RANGE_M where there is texture, over all pairs."""

    median_relative: float
    wrong: float
    """Share of the pixels that are wrong by more than a fifth."""
    within_two_std: float
    """Share of the others whose error is within two standard deviations."""
    pixels: int
    vertical_rms_px: float
    """Difference of the rows of a point in the two rectified images."""


@dataclass(frozen=True)
class Summary:
    """What dense depth came to; written as JSON."""

    pairs: int
    left_out: int
    """Rows that were chosen too, but at whose postures the views cannot be rectified."""
    matched: float
    """Share of the rectified pixels that have a depth."""
    textured: float
    """Share that has one which texture determines well."""
    median_relative_std: float
    """Stated standard deviation over depth, of textured pixels at RANGE_M."""
    row_difference_deg: float
    """By how much the rows of a matched feature differ in the rectified images, in the median of
    the features and of the pairs; NaN: none showed enough of them."""
    doubt: str | None
    """Why the calibration is doubted; None: it is not."""
    joints: DepthErrors | None = None
    """By the calibration and the joint readings; None: the truth is not known."""
    seen: DepthErrors | None = None
    """By the geometry that both eyes see; None: it was not asked for, or the truth is not known."""
    true_geometry: DepthErrors | None = None
    """By the true head and the true angles: what the matching itself leaves."""


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


def as_markdown(done: Summary) -> str:
    """Return the report."""
    where = f"{RANGE_M[0]} to {RANGE_M[1]} m"
    left_out, stated = "", f"None of these is at {where}."
    if done.left_out:
        left_out = (
            f" {done.left_out} more cannot be rectified: the two views do not overlap, or an eye "
            "looks along the line from one camera to the other."
        )
    if np.isfinite(done.median_relative_std):
        stated = (
            f"At {where} the stated standard deviation of these is "
            f"{100 * done.median_relative_std:.1f} % in the median."
        )
    lines = [
        TITLE,
        "",
        f"{done.pairs} {'pair' if done.pairs == 1 else 'pairs'}.{left_out} "
        f"{100 * done.matched:.0f} % of the rectified pixels have a depth, "
        f"{100 * done.textured:.0f} % one that texture determines well. {stated}",
        "",
        f"A feature is {done.row_difference_deg:.2g} degrees beside its row in the median."
        if np.isfinite(done.row_difference_deg)
        else "Too few features are matched to compare the rows of the two images.",
        "",
    ]
    if done.doubt is not None:
        lines += [f"Warning: {done.doubt}", ""]
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
        lines += [f"Errors at {where} where there is texture:", ""]
        lines += [markdown_table(heading, rows), ""]
    return "\n".join(lines)
