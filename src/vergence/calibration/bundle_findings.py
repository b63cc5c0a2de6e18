"""What a bundle adjustment shows of its data: what does not fit, and findings on all of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vergence.calibration import undetermined
from vergence.calibration.backlash import BLOCK
from vergence.calibration.moved_boards import HeldBoards
from vergence.calibration.observations import Observations, PoseObservations
from vergence.calibration.outcome import MOST_WRONG, Outcome
from vergence.calibration.priors import BoardSize
from vergence.calibration.readings import PLAY
from vergence.calibration.residuals import Reprojection
from vergence.errors import counted, listed
from vergence.findings import Finding, by_severity, note, warning
from vergence.geometry.kinematics import EYES

SURE = 5.0
"""Standard deviations from which the images of one eye are later than those of the other: far more
than noise makes in any recording."""
LEAST_APART_S = 0.001
"""Least such time that is worth a warning: 0.06 degrees at a rad/s."""
SURE_BACKLASH = 3.0
"""Standard deviations from zero from which backlash is noted."""
SURE_SIZE = 2.0
"""Standard deviations from which another size of the board is noted."""
LOST = 0.02
"""Share of corners without weight that is noted; good ones lose it once in 3000."""
WRONG_VIEW = "wrong-view"
"""Code of the findings on views that were left out."""
MOVED_MM = 0.5
"""Motion of a held board [mm] from which its view is named."""


def bundle_findings(of: Outcome) -> tuple[Finding, ...]:
    """List everything that the reader of a result must know, the most severe first."""
    parts = (
        undetermined.doubtful(of),
        _wrong(of),
        _left_out(of),
        _moved_boards(of),
        undetermined.unobservable(of),
        undetermined.noise(of),
        _lost_corners(of),
        _backlash(of),
        _apart_in_time(of),
        _systematic(of),
        _board_size(of),
    )
    return by_severity(each for part in parts for each in part)


def _left_out(of: Outcome) -> Iterator[Finding]:
    """Name cameras without boards, and views that are of no use."""
    detections, seen = of.problem.measured.detections, of.observations
    images = seen.T_cam_target if isinstance(seen, PoseObservations) else seen.corners
    for c, name in enumerate(detections.cameras):
        if c not in detections.camera:
            yield warning("blind-camera", f"{name} sees no board, and keeps its start.", name)
    shown = np.any([np.isfinite(each).any(axis=(1, 2)) for each in images.values()], axis=0)
    lost = shown & ~of.problem.contradicting.any(axis=0)
    lost[detections.views] = False
    if lost.any():
        where = ", ".join(map(seen.name_of_view, np.flatnonzero(lost).tolist()))
        sentence = f"No image of these boards shows enough corners; left out: {where}."
        severity = note if lost.mean() <= MOST_WRONG else warning
        yield severity("few-corners", sentence, where)


def _wrong(of: Outcome) -> Iterator[Finding]:
    """Name the views whose images contradict others or whose readings lost their weight."""
    wrong, names = of.outliers, of.found.x["head"].kinematics.readings
    postures = of.readings.postures
    messages: dict[int, list[str]] = {}
    cameras = of.problem.measured.detections.cameras
    for b in np.flatnonzero(wrong.readings.any(axis=1)):
        errors = of.found.errors[1][b]
        off = np.where(wrong.readings[b], errors, 0.0)
        if of.poses_read:
            turn, shift = np.linalg.norm(errors[:3]), np.linalg.norm(errors[3:])
            message = (
                f"the pose of the {EYES[postures.eye[b]]} eye is off by {np.degrees(turn):.2g} "
                f"degrees and {1e3 * shift:.2g} mm"
            )
        else:
            message = listed([
                f"{names[postures.columns[b, k]]} is off by {np.degrees(abs(off[k])):.2g} degrees"
                for k in np.flatnonzero(off)
            ])  # fmt: skip
        messages.setdefault(int(postures.view[b]), []).append(message)
    for view in np.flatnonzero(wrong.images.any(axis=0)).tolist():
        shown = listed([cameras[c] for c in np.flatnonzero(wrong.images[:, view])])
        how = "by its pose" if of.poses_read else "wherever the eyes look"
        messages[view] = [
            f"{how}, {shown} cannot show the board as the other views place it; look for an image "
            "or a pose of another moment or camera, and for a board that moved or is numbered from "
            "the wrong end"
        ]
    severity = note if wrong.few else warning
    for view in sorted(messages):
        where, why = of.observations.name_of_view(view), ", ".join(messages[view])
        yield severity(WRONG_VIEW, f"{where.capitalize()} was left out: {why}.", where)


def _moved_boards(of: Outcome) -> Iterator[Finding]:
    """Name the views in which a board that a hand holds moved between the images of the eyes."""
    for residual, errors in zip(of.found.residuals, of.found.errors, strict=True):
        if not isinstance(residual, HeldBoards):
            continue
        detections = of.problem.measured.detections
        view = np.empty(detections.board.max() + 1, np.intp)
        view[detections.board] = detections.views
        shift_mm = 1e3 * np.linalg.norm(errors[:, 3:], axis=1)
        moved = np.flatnonzero(shift_mm > MOVED_MM)
        views = view[residual.before[moved]].tolist()
        if len(moved):
            sentence = (
                f"Boards that were held by hand moved by up to {shift_mm.max():.1f} mm between the "
                f"images of the two eyes, in {counted(len(moved), 'view')}, which the estimate "
                "allows for: trigger both cameras at once, or put the board down."
            )
            where = ", ".join(map(of.observations.name_of_view, views))
            yield note("board-moved", sentence, where)


def _lost_corners(of: Outcome) -> Iterator[Finding]:
    """Report corners of other views that lost their weight, and the view with the most of them."""
    measured = of.problem.measured
    lost, views = of.outliers.corners.sum(axis=1), measured.detections.views
    by_view, seen = np.bincount(views, lost), measured.seen.sum()
    where = of.observations.name_of_view(int(by_view.argmax()))
    if lost.sum() <= LOST * seen:
        return
    what = "corners" if isinstance(measured, Reprojection) else "numbers of measured poses"
    sentence = (
        f"{lost.sum()} of {seen} {what} lie beyond 4 standard deviations and lost their weight, "
        f"{by_view.max():.0f} of them in {where}: the board may have moved, or the image may be "
        "blurred."
    )
    severity = note if lost.sum() <= MOST_WRONG * seen else warning
    yield severity("outlying-corners", sentence, where)


def _backlash(of: Outcome) -> Iterator[Finding]:
    """Note backlash of joints, and play between joints that share a reading."""
    sure = [
        f"{name} {np.degrees(abs(width)):.2g} +- {np.degrees(std):.1g} degrees"
        for name, (width, std) in of.backlash_rad.items()
        if abs(width) > SURE_BACKLASH * std
    ]
    if sure:
        sentence = (
            f"Joints have backlash: {listed(sure)}. The calibration allows for it; readings err by "
            "half of it, to the side of the last motion, unless images correct them "
            "(`SelfCalibrator`)."
        )
        yield note("backlash", sentence)
    for level in of.levels:
        number, std = level.name.removeprefix(PLAY), of.found.levels[level.name]
        if number != level.name and std > of.found.levels.get(f"readings{number}", std):
            sentence = (
                "Joints of the two eyes that share a reading differ by "
                f"{np.degrees(std):.2g} degrees (one standard deviation), as by play in their "
                "linkage; the calibration allows for it."
            )
            yield note("play", sentence)


def _apart_in_time(of: Outcome) -> Iterator[Finding]:
    """Report that one time offset does not fit the images of both eyes.

    The errors of the readings are then proportional to the eye's velocity, and may have passed for
    backlash. The factor, by weighted least squares with both, is how much later than the offset the
    images of that eye are.
    """
    readings, x = of.readings, of.found.x
    posture = of.problem.measured.detections.posture
    owner, eye = np.unique(np.stack([posture, of.eyes]), axis=1)
    if readings.around is None or (np.diff(owner) == 0).any() or len(np.unique(eye)) < 2:
        return  # at rest, one eye, or readings that move both
    rate, errors = readings.rate(x), of.found.errors[1]
    precision = np.array([of.found.levels[name] for name in readings.kinds]) ** -2
    weight = (of.found.linear.weights[1] == 1) * precision
    postures = readings.postures
    backlash = x[BLOCK][postures.joint] * postures.motion / 2 if x[BLOCK].size else 0.0
    late = []
    for e in range(len(EYES)):
        mine, w = eye == e, np.sqrt(weight[eye == e]).ravel()
        by_backlash = np.eye(rate.shape[1]) * postures.motion[mine][:, None]
        rows = np.dstack([rate[mine], by_backlash]).reshape(len(w), -1) * w[:, None]
        inverse = np.linalg.pinv(rows.T @ rows, hermitian=True)
        solution = inverse @ rows.T @ (w * (errors - backlash)[mine].ravel())
        late.append((solution[0], inverse[0, 0]))
    (left, left_variance), (right, right_variance) = late
    apart = float(right - left)
    if abs(apart) < max(SURE * np.sqrt(left_variance + right_variance), LEAST_APART_S):
        return
    late_eye, other = EYES[::-1] if apart > 0 else EYES
    sentence = (
        f"Images of the {late_eye} eye lag behind its joint readings by about "
        f"{1e3 * abs(apart):.2g} ms more than those of the {other} eye, but one time offset stands "
        "for both: trigger all cameras and read all joints at one moment, or leave moving rows out."
    )
    yield warning("eyes-apart-in-time", sentence)


def _systematic(of: Outcome) -> Iterator[Finding]:
    """Report the camera with the largest systematic error; the boards' poses may pass it on."""
    if not isinstance(of.problem.measured, Reprojection):
        return
    worst = max(of.systematic_px, key=lambda name: of.systematic_px[name])
    size, noise = of.systematic_px[worst], of.found.levels[of.problem.measured.level]
    if size > noise:
        sentence = (
            f"All images of {worst} have a systematic error of {size:.2g} px, more than "
            f"the noise of single corners ({noise:.2g} px): the lens departs from its model, which "
            "a richer one may follow (--lens), or the board is not flat; look at the residuals "
            "over the image."
        )
        yield warning("lens-misfit", sentence, worst)


def _board_size(of: Outcome) -> Iterator[Finding]:
    """Note what measured poses of the eyes alone say of the board's size."""
    prior = next((each for each in of.problem.priors if isinstance(each, BoardSize)), None)
    if prior is None or not isinstance(of.observations, Observations):
        return
    information = 1 / of.scale_std**2
    by_poses = max(information - 1 / prior.std**2, 1e-12)
    change, std = (of.found.x["board_scale"] - 1) * information / by_poses, by_poses**-0.5
    if abs(change) > SURE_SIZE * std:
        square_mm = 1e3 * of.observations.board.square_m
        sentence = (
            f"By the eye poses a square of the board measures {square_mm * (1 + change):.3f} +- "
            f"{square_mm * std:.3f} mm, and {square_mm:.3f} +- {square_mm * prior.std:.3f} mm by "
            f"its description; {square_mm * of.found.x['board_scale']:.3f} mm is used. Measure it."
        )
        yield note("board-size", sentence)
