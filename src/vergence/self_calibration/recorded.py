"""Self-calibration of a recorded dataset: the learned head, and what the recording determined."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vergence.data.dataset import Dataset, stereo_rows
from vergence.errors import VergenceError, counted, listed
from vergence.findings import Finding, by_severity, warning
from vergence.geometry.head import HeadCalibration, states_covariance
from vergence.geometry.kinematics import straight_gaze
from vergence.geometry.parameters import change_between
from vergence.geometry.projection import project_point
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import MOVED_RAD, initial_visual_geometry, update_geometry
from vergence.self_calibration.filter import learned_head
from vergence.self_calibration.prior import Changed
from vergence.self_calibration.state import FilterState
from vergence.stereo.uncertainty import locate

OBSERVED, PARTLY = 0.5, 0.9
"""Learned over prior standard deviation up to which a parameter is observed, or partly observed; a
convention."""
_UNEXPECTED = 4.0
"""Change of a parameter, in prior standard deviations, that is reported; one of 50 reaches it by
chance in one of 300 recordings."""


@dataclass(frozen=True)
class LearnedParameter:
    """Change and standard deviations of one parameter."""

    name: str
    change: float
    """Since the calibration: px, rad, m or a plain number."""
    prior_std: float
    """By the calibration's covariance and what may have changed since."""
    std: float
    """Learned."""

    @property
    def verdict(self) -> Literal["observed", "partly", "not observed"]:
        """How much the recording narrowed the parameter."""
        share = self.std / self.prior_std
        return "observed" if share <= OBSERVED else "partly" if share <= PARTLY else "not observed"


@dataclass(frozen=True, eq=False)
class SelfCalibrationResult:
    """Head as learned from a recording."""

    head: HeadCalibration
    """Learned calibration with its covariance; the original if nothing was learned."""
    parameters: tuple[LearnedParameter, ...]
    frames: int
    """Number of rows that were used."""
    seen: int
    """Number of frames that determined the relative pose of the cameras alone."""
    learned: int
    """Number of frames that updated the parameters, which may include some that are not `seen`."""
    depth_std_m: tuple[float, float] | None
    """Standard deviation of the depth of a point 1 m straight ahead due to the calibration, before
    and after; None: the point is not in front of both cameras."""
    reading_std: float
    """Noise of the readings times their gear factors; assumed if nothing was learned."""
    changed: Changed
    """What was assumed to have changed since the calibration."""
    findings: tuple[Finding, ...]

    def summary(self) -> str:
        """Summarise in a few lines what was learned, and the findings."""
        source = "" if self.learned else " (assumed)"
        lines = [
            f"{counted(self.frames, 'frame')}: {self.seen} determined the relative pose of the "
            f"cameras, and {self.learned} updated the parameters; noise of the readings "
            f"{np.degrees(self.reading_std):.3f} degrees{source}."
        ]
        hidden = [each.name for each in self.parameters if each.verdict == "not observed"]
        if len(hidden) == len(self.parameters):
            lines.append("Nothing that persists is known better than before.")
        elif hidden:
            more = f" and {len(hidden) - 6} more" if len(hidden) > 6 else ""
            lines.append(f"Not observed, as before: {', '.join(hidden[:6])}{more}.")
        if self.depth_std_m is not None:
            before, after = (1e3 * std for std in self.depth_std_m)
            source = {
                "nothing": "by the calibration",
                "little": "by the calibration and what may have moved since",
                "anything": "by usual tolerances",
            }[self.changed]
            learned = f", {after:.3g} mm by what was learned" if self.learned else ""
            lines.append(
                f"Depth of a point 1 m straight ahead: std {before:.3g} mm {source}{learned}."
            )
        lines += [f"{each.severity.capitalize()}: {each}" for each in self.findings]
        return "\n".join(lines)


def self_calibrate(
    dataset: Dataset,
    head: HeadCalibration,
    *,
    changed: Changed = "little",
    progress: Progress = silent,
) -> SelfCalibrationResult:
    """Correct a calibration by the images of both eyes, without a board.

    Rows with moving eyes are used or, without any, all rows with images of both main cameras.

    Example:
        result = vg.self_calibrate(vg.load_dataset("later"), vg.load_head("head.json"))
        print(result.summary())
        for parameter in result.parameters:
            print(parameter.name, parameter.verdict, parameter.prior_std, parameter.std)
        vg.save_head(result.head, "learned.json")

    Args:
        dataset: images and joint readings, of another recording than that of the calibration.
        head: the calibration.
        changed: what may have changed since the calibration, see `prior.Changed`.
        progress: is called after each frame.

    Raises:
        VergenceError: the dataset does not fit the calibration (see `stereo_rows`), or has eye
            poses in place of joint readings.
    """
    if dataset.T_base_eye is not None:
        raise VergenceError(
            f"Self-calibration corrects joint readings; {dataset.folder} has poses of the eyes."
        )
    both = stereo_rows(dataset, head)
    moving = dataset.moving[both.rows]
    rows = np.flatnonzero(moving) if moving.any() else np.arange(len(both.rows))
    geometry = initial_visual_geometry(head, cameras=both.cameras, changed=changed)
    before, seen, findings = geometry.state, 0, list[Finding]()
    task = "self-calibration, frames"
    progress(task, 0, len(rows))
    for done, row in enumerate(rows, start=1):
        frame = both.frame(int(row))
        geometry = update_geometry(geometry, frame)
        seen += geometry.latest is not None and geometry.latest.status == "seen"
        if geometry.state.change:
            findings.append(_change_finding(geometry.state, frame.time_s - dataset.time_s[0]))
        progress(task, done, len(rows))
    state = geometry.state
    changes = change_between(state.head, before.head, before.names).tolist()
    stds = (np.sqrt(np.diag(each.covariance)).tolist() for each in (before, state))
    found = SelfCalibrationResult(
        head=learned_head(state) if state.frames else head,
        parameters=tuple(map(LearnedParameter, before.names, changes, *stds)),
        frames=len(rows),
        seen=seen,
        learned=state.frames,
        depth_std_m=_depth_stds(before, state),
        reading_std=state.reading_std,
        changed=changed,
        findings=tuple(findings),
    )
    joints = both.joints[rows] * head.kinematics.gear_ratios
    moved = bool(np.abs(joints - joints[0]).max() >= MOVED_RAD)
    return replace(found, findings=by_severity([*findings, *_doubts(found, head, moved)]))


def _depth_stds(before: FilterState, after: FilterState) -> tuple[float, float] | None:
    stds, point = [], np.array([1.0, 0.0, 0.0])
    for state in (before, after):
        head, straight = learned_head(state), straight_gaze(state.head.kinematics)
        left, right = (project_point(head, c, straight, point)[None] for c in state.cameras)
        located = locate(head, left=left, right=right, joints=straight, cameras=state.cameras)
        if not np.isfinite(located.xyz).all():
            return None
        stds.append(float(np.sqrt(located.calibration_covariance[0, 0, 0])))
    return stds[0], stds[1]


def _change_finding(state: FilterState, time_s: float) -> Finding:
    """Report the change that the last update detected, at a time after the first row."""
    when = f"{time_s:.1f} s after the first row"
    if state.change == "camera turned":
        sentence = (
            f"A camera turned, at the latest {when}; the images do not tell which of the two."
        )
        return warning("camera-turned", sentence, when)
    sentence = (
        "The head is farther from its calibration than the stated covariance allows, as the images "
        f"showed {when}: it was learned anew, from the tolerances of a head that is known from its "
        "drawing only."
    )
    return warning("not-as-calibrated", sentence, when)


def _doubts(found: SelfCalibrationResult, head: HeadCalibration, moved: bool) -> list[Finding]:
    """Report what limits the result of a calibration, and whether the eyes moved."""
    findings = []
    if not states_covariance(head):
        sentence = (
            "The calibration states no covariance: the usual errors of such a procedure are "
            "assumed in its place."
        )
        findings.append(warning("no-covariance", sentence))
    names = [p.name for p in found.parameters if abs(p.change) > _UNEXPECTED * p.prior_std]
    if names and not found.findings:
        sentence = (
            f"{listed(names)} changed by more than {_UNEXPECTED:g} prior standard deviations: "
            "something was moved, exchanged or adjusted since the calibration. If it was repaired, "
            "`--changed anything` drops the accuracy that the calibration states."
        )
        findings.append(warning("parameters-changed", sentence, ", ".join(names)))
    if not found.learned:
        reason = (
            "No frame after the first showed enough of the scene to both eyes where the "
            "calibration expects it, which may be of another head"
            if moved
            else "The eyes did not move, so that nothing that persists can be told from errors of "
            "the readings"
        )
        sentence = f"{reason}: the calibration is returned as it was."
        findings.append(warning("nothing-learned", sentence))
    return findings
