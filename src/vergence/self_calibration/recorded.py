"""Self-calibration of a recording: what it shows of a head, how well, and what it cannot show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vergence.data.dataset import Dataset
from vergence.data.stereo_rows import stereo_rows
from vergence.errors import VergenceError, counted, listed
from vergence.findings import Finding, warning
from vergence.geometry.head import HeadCalibration, states_covariance
from vergence.geometry.kinematics import straight_gaze
from vergence.geometry.parameters import change_between
from vergence.geometry.projection import project_point
from vergence.progress import Progress, silent
from vergence.self_calibration.keyframe import TURNED_RAD
from vergence.self_calibration.learning import learned_head
from vergence.self_calibration.prior import Changed
from vergence.self_calibration.sequence import MOVED_RAD, initial_seen_geometry, update_geometry
from vergence.self_calibration.state import FrameEstimate, SelfCalibration
from vergence.stereo.extrinsics import camera_poses
from vergence.stereo.uncertainty import locate

OBSERVED, PARTLY = 0.5, 0.9
"""Learned standard deviation over the prior one, up to which a parameter was observed or partly."""
FAR = 4.0
"""Change of a parameter, in prior standard deviations, beyond which it is named: by chance one of
fifty reaches this in one of three hundred recordings at most."""
LEAST_VERGENCE_RAD = float(np.radians(3))
"""Change of vergence below which focal lengths and gains hardly show between the eyes."""
_MOST_UNSEEN = 0.3
"""Share of the frames that showed little, from which it is said."""
_POINT_M = np.array([1.0, 0.0, 0.0])
"""Straight ahead of the left eye's base: where the accuracy is stated."""


@dataclass(frozen=True)
class LearnedParameter:
    """What a recording showed of one parameter."""

    name: str
    change: float
    """Since the calibration: px, rad, m, or a plain number."""
    prior_std: float
    """Before: by the calibration's covariance and what may have changed since."""
    std: float
    """After."""

    @property
    def verdict(self) -> Literal["observed", "partly", "not observed"]:
        """By how much the recording has narrowed it."""
        share = self.std / self.prior_std
        return "observed" if share <= OBSERVED else "partly" if share <= PARTLY else "not observed"


@dataclass(frozen=True, eq=False)
class RecordedSelfCalibration:
    """A head as a recording shows it."""

    head: HeadCalibration
    """The learned calibration with its covariance; the given one where nothing could be learned."""
    parameters: tuple[LearnedParameter, ...]
    frames: int
    """Rows that were used."""
    seen: int
    """Frames that determined the relative pose of the cameras by themselves."""
    learned: int
    """Frames that updated the parameters, some of which may not be among `seen`."""
    depth_std_m: tuple[float, float] | None
    """Standard deviation of the depth of a point 1 m straight ahead, by the calibration alone,
    before and after; None: it is not in front of both cameras."""
    joint_std_rad: float
    """Noise of a reading, times its factor, as estimated; as assumed if nothing was learned."""
    changed: Changed
    """What was taken to have changed since the calibration."""
    findings: tuple[Finding, ...]


def self_calibrate_dataset(
    dataset: Dataset,
    head: HeadCalibration,
    *,
    changed: Changed = "little",
    progress: Progress = silent,
) -> RecordedSelfCalibration:
    """Return what the images of both eyes show of a head that was calibrated before.

    Rows with moving eyes are used or, where there are none, all rows that both eyes see.

    Args:
        dataset: images and joint readings.
        head: its calibration.
        changed: what may have changed since the calibration: nothing, if the images were taken
            right after it; little; or anything, so that its covariance no longer holds.
        progress: is called after each frame.

    Raises:
        VergenceError: the dataset does not fit the calibration (see `stereo_rows`), or it has eye
            poses in place of joint readings.
    """
    if dataset.T_base_eye is not None:
        raise VergenceError(
            f"Self-calibration corrects joint readings; {dataset.folder} has poses of the eyes."
        )
    both = stereo_rows(dataset, head)
    moving = dataset.moving[both.rows]
    chosen = np.flatnonzero(moving) if moving.any() else np.arange(len(both))
    geometry = initial_seen_geometry(head, cameras=both.cameras, changed=changed)
    before, seen, changes = geometry.known, 0, []
    task, vergence = "self-calibration, frames", []
    progress(task, 0, len(chosen))
    for k, row in enumerate(chosen):
        frame = both.frame(int(row))
        geometry = update_geometry(geometry, frame)
        latest = geometry.latest
        if latest is not None:
            seen += latest.status == "seen"
            vergence.append(_vergence(latest))
        if geometry.learned_s == frame.time_s:
            changes += _changes(geometry.known, frame.time_s - dataset.time_s[0])
        progress(task, k + 1, len(chosen))
    joints = both.joints[chosen] * head.kinematics.factors
    turned_rad = float(np.ptp(joints, axis=0).max())
    known = geometry.known
    findings = _about_frames(head, len(chosen), seen) + changes
    if not known.frames:
        moved = np.abs(joints - joints[0]).max() >= MOVED_RAD
        reason = (
            "No frame after the first showed enough of the scene to both eyes where the "
            "calibration expects it"
            if moved
            else "The eyes did not move, so that nothing that persists can be told from errors of "
            "the readings"
        )
        sentence = f"{reason}: the calibration is returned as it was."
        findings.append(warning("nothing-learned", sentence))
    elif np.ptp(vergence) < LEAST_VERGENCE_RAD and turned_rad < TURNED_RAD:
        sentence = (
            f"The eyes moved in parallel, by {np.degrees(turned_rad):.1f} degrees: focal lengths "
            "and gains hardly show, unless vergence changes by "
            f"{np.degrees(LEAST_VERGENCE_RAD):.0f} degrees or an eye turns by "
            f"{np.degrees(TURNED_RAD):.0f}."
        )
        findings.append(warning("parallel-motion", sentence))
    parameters = _parameters(before, known)
    far = [each for each in parameters if abs(each.change) > FAR * each.prior_std]
    if far and not changes:
        sentence = (
            f"{listed([each.name for each in far])} changed by more than {FAR:g} prior standard "
            "deviations: something was moved, exchanged or adjusted since the calibration. If it "
            "was repaired, `--changed anything` drops the accuracy that the calibration states."
        )
        where = ", ".join(each.name for each in far)
        findings.append(warning("parameters-changed", sentence, where))
    return RecordedSelfCalibration(
        head=learned_head(known) if known.frames else head,
        parameters=parameters,
        frames=len(chosen),
        seen=seen,
        learned=known.frames,
        depth_std_m=_depth_stds(before, known),
        joint_std_rad=known.joint_std_rad,
        changed=changed,
        findings=tuple(findings),
    )


def _vergence(seen: FrameEstimate) -> float:
    """Return the angle [rad] between a frame's optical axes, in the plane of the baseline."""
    left, right = camera_poses(seen.head, seen.joints, cameras=seen.cameras)
    views, baseline = (left[:3, 2], right[:3, 2]), right[:3, 3] - left[:3, 3]
    normal = np.cross(views[0] + views[1], baseline)
    sine = np.cross(*views) @ normal / max(float(np.linalg.norm(normal)), 1e-12)
    return float(np.arctan2(sine, views[0] @ views[1]))


def _parameters(before: SelfCalibration, after: SelfCalibration) -> tuple[LearnedParameter, ...]:
    changes = change_between(after.head, before.head, before.names).tolist()
    stds = (np.sqrt(np.diag(state.covariance)) for state in (before, after))
    return tuple(
        LearnedParameter(name, change, float(prior), float(std))
        for name, change, prior, std in zip(before.names, changes, *stds, strict=True)
    )


def _depth_stds(before: SelfCalibration, after: SelfCalibration) -> tuple[float, float] | None:
    found = []
    for state in (before, after):
        head, straight = learned_head(state), straight_gaze(state.head.kinematics)
        left, right = (project_point(head, c, straight, _POINT_M)[None] for c in state.cameras)
        where = locate(head, left=left, right=right, joints=straight, cameras=state.cameras)
        if not np.isfinite(where.xyz).all():
            return None
        found.append(float(np.sqrt(where.calibration_covariance[0, 0, 0])))
    return found[0], found[1]


def _changes(known: SelfCalibration, time_s: float) -> list[Finding]:
    """Return warnings of what the last frame, at a time since the first, showed to have changed."""
    when = f"{time_s:.1f} s after the first row"
    if known.bumped:
        sentence = (
            f"A camera turned, at the latest {when}; the images do not tell which of the two."
        )
        return [warning("camera-turned", sentence, when)]
    if known.uncalibrated:
        sentence = (
            "The head is farther from its calibration than the stated covariance allows, as the "
            f"images showed {when}: it was learned anew, from the tolerances of a head that is "
            "known from its drawing only."
        )
        return [warning("not-as-calibrated", sentence, when)]
    return []


def _about_frames(head: HeadCalibration, frames: int, seen: int) -> list[Finding]:
    found = []
    if not states_covariance(head):
        sentence = (
            "The calibration states no covariance: the usual errors of such a procedure are "
            "assumed in its place."
        )
        found.append(warning("no-covariance", sentence))
    if seen == 0:
        sentence = (
            "No frame agrees with the calibration: it may be of another head, or images and "
            "readings are not of the same moments. In all of them the prior stands."
        )
        found.append(warning("no-frame-agrees", sentence))
    elif seen < (1 - _MOST_UNSEEN) * frames:
        sentence = (
            f"Only {seen} of {counted(frames, 'frame')} determined the relative pose of the "
            "cameras; in the others it comes from the prior, in part or wholly."
        )
        found.append(warning("few-frames-agree", sentence))
    return found
