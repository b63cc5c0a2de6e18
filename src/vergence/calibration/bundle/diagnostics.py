"""What is not observable, why, and what to record instead: in words."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.adjustment import Adjusted
from vergence.calibration.bundle.eye_motion_diagnostics import doubtful_senses, missing_motion
from vergence.calibration.bundle.problem import (
    BundleProblem,
    detection_eyes,
    joint_rates,
    reading_residuals,
    refit_trajectory,
)
from vergence.errors import counted, listed
from vergence.findings import Finding, void, warning
from vergence.geometry.kinematics import EYES
from vergence.geometry.lens import COEFFICIENTS

FEW = 6
"""Degrees of freedom below which an estimated noise level is heavy-tailed, and the covariance
optimistic."""
SURE = 5.0
"""Standard deviations from which the images of one eye are later than those of the other: far more
than noise makes in any recording."""
LEAST_APART_S = 0.001
"""Least such time that is worth a warning: 0.06 degrees at a rad/s."""
LOST, LOST_IN_ONE_VIEW = 0.02, 0.01
"""Share of corners without weight that is reported, where they are scattered over the views, which
robust weights deal with, and where most of them are in one view."""
NOISY, NOISY_RAD = 5.0, np.radians(0.2)
"""Ratio of the noise of readings to that of all others, and noise, from which they are doubted."""
MOST_NAMED = 3
"""Most readings that lost their weight and are named one by one; the rest are counted."""
NAMED = 0.3
"""A direction's components of this size, relative to the largest, are named."""

_WORDS = {f"r{axis}": f"rotation about {axis}" for axis in "xyz"}
_WORDS |= {f"t{axis}": f"translation along {axis}" for axis in "xyz"}
_UNCONVERGED = (
    "The estimate did not converge, as where no head of this description fits the data, or the "
    "eyes turn too little to tell: check the description of the joints, the order of their "
    "readings, the lens models (`lens`), and the size of the board; let the eyes turn farther."
)


def findings(problem: BundleProblem, found: Adjusted) -> tuple[Finding, ...]:
    """Return everything that the reader of a result must know."""
    noise = found.noise
    said = [] if found.converged else [void("not-converged", _UNCONVERGED)]
    for e in np.unique(detection_eyes(problem)):
        said += doubtful_senses(problem, found, int(e))
    said += _noisy_readings(problem, found) + _unobservable(problem, found)
    said += [
        warning(
            "noise-assumed",
            f"The noise of {what} cannot be estimated from these views; {level:g} {unit} was "
            "assumed: let the eyes look at each board from several angles.",
            what,
        )
        for level, (what, unit), assumed in zip(
            noise.levels[1:], _kinds_of_noise(problem, found), found.assumed, strict=True
        )
        if assumed
    ]
    said += [
        warning(
            "noise-roughly-known",
            f"The noise of the joint readings rests on {redundancy:.0f} readings more than it "
            "takes to fit them: the stated accuracy is rough; record more views.",
        )
        for redundancy in found.redundancy[~found.assumed & ~found.given & (found.redundancy < FEW)]
    ]
    corners, lost = int(np.count_nonzero(problem.seen)), int(found.outliers.sum())
    by_view = np.bincount(problem.block_view[problem.block], found.outliers)
    in_one_view = by_view.max() > lost / 2
    if lost > (LOST_IN_ONE_VIEW if in_one_view else LOST) * corners:
        look = "look at the views with the largest residuals"
        if in_one_view:
            look = (
                f"{by_view.max():.0f} of them are in view {by_view.argmax()}: the board may have "
                "moved, or the image may be blurred"
            )
        what, unit = "corners", f"{noise.pixel_px:.2g} px"
        if problem.measured is not None:
            what, unit = "pairs of numbers of measured poses", f"{noise.pixel_px:.2g} stated ones"
        sentence = (
            f"{lost} of {corners} {what} lie beyond {noise.outlier:g} standard deviations of "
            f"{unit} and lost their weight: {look}."
        )
        where = f"view {by_view.argmax()}" if in_one_view else ""
        said.append(warning("outlying-corners", sentence, where))
    said += _lost_readings(problem, found)
    said += _apart_in_time(problem, found)
    systematic = max(found.systematic_px)
    if systematic > noise.pixel_px:  # the boards' poses may pass it on: the worst camera is named
        worst = found.systematic_px.index(systematic)
        whose = _of_camera(problem, worst)
        sentence = (
            f"All images{whose} have a systematic error of {systematic:.2g} px, more than the "
            f"noise of single corners ({noise.pixel_px:.2g} px): the lens departs from its "
            "model, which a richer one may follow (--lens), or the board is not flat; look at the "
            "residuals over the image."
        )
        said.append(warning("lens-misfit", sentence, problem.cameras[worst]))
    return tuple(dict.fromkeys(said))  # pan and tilt may share one


def _kinds_of_noise(problem: BundleProblem, found: Adjusted) -> list[tuple[str, str]]:
    """Return what each of the levels of joint noise is of, and its unit."""
    if problem.T_base_eye_read is not None:
        return [("the eyes' measured rotations", "rad"), ("their measured places", "m")]
    return [("the joint readings", "rad")] * len(found.assumed)


def _noisy_readings(problem: BundleProblem, found: Adjusted) -> list[Finding]:
    """Return a warning of readings that are far noisier than all others, relative to their joints.

    Joints in another order than described turn like noise: by the square of the angles.
    """
    if problem.T_base_eye_read is not None:
        return []
    kinematics, group = found.state.head.kinematics, found.noise.group
    kinds = [problem.block_columns[:, group == k] for k in range(int(group.max()) + 1)]
    turned = [
        level * kinematics.factors[kind].max()
        for level, kind in zip(found.noise.levels[1:], kinds, strict=True)
    ]
    worst = int(np.argmax(turned))
    others = max((turned[k] for k in range(len(turned)) if k != worst), default=np.inf)
    if turned[worst] < max(NOISY * others, NOISY_RAD):
        return []
    names = listed([kinematics.readings[r] for r in np.unique(kinds[worst])])
    sentence = (
        f"The noise of {names} is {np.degrees(turned[worst]):.2g} degrees of a joint, that of "
        f"other readings {np.degrees(others):.2g} at most: check the encoder, and in `kinematics` "
        "the order of the joints of each eye and their axes."
    )
    return [warning("noisy-readings", sentence, names)]


def _lost_readings(problem: BundleProblem, found: Adjusted) -> list[Finding]:
    """Return a warning of each of the readings that lost their weight, the worst ones first."""
    off = found.lost_readings
    if problem.T_base_eye_read is not None:
        turn, shift = (np.linalg.norm(off[:, k], axis=1) for k in (slice(0, 3), slice(3, 6)))
        worst = np.argsort(-(turn / found.noise.joint[0] + shift / found.noise.joint[3]))
        lost = [
            (
                int(b),
                f"the pose of an eye is off by {np.degrees(turn[b]):.2g} degrees and "
                f"{1e3 * shift[b]:.2g} mm",
            )
            for b in worst.tolist()
            if turn[b] + shift[b] > 0
        ]
    else:
        names = found.state.head.kinematics.readings
        order = np.argsort(-np.abs(off), axis=None)
        places = zip(*np.unravel_index(order, off.shape), strict=True)
        lost = [
            (
                int(b),
                f"{names[problem.block_columns[b, k]]} is off by "
                f"{np.degrees(abs(off[b, k])):.2g} degrees",
            )
            for b, k in places
            if off[b, k]
        ]
    said = [
        warning(
            "outlying-reading",
            f"View {problem.block_view[b]}: {what}, and lost its weight.",
            f"view {problem.block_view[b]}",
        )
        for b, what in lost[:MOST_NAMED]
    ]
    if len(lost) > MOST_NAMED:
        rest = f"{counted(len(lost) - MOST_NAMED, 'more reading')} lost their weight."
        said.append(warning("outlying-reading", rest))
    return said


def _apart_in_time(problem: BundleProblem, found: Adjusted) -> list[Finding]:
    """Return a warning if one time offset does not fit the images of both eyes.

    The errors of the readings are then proportional to the eye's velocity. The factor, by weighted
    least squares, is by how much later than the offset the images of that eye are.
    """
    own, e = np.unique(np.stack([problem.block, detection_eyes(problem)]), axis=1)
    if problem.around is None or (np.diff(own) == 0).any() or len(np.unique(e)) < 2:
        return []  # at rest, one eye, or readings that move both
    moving = refit_trajectory(problem, found.state)
    weight = (found.lost_readings == 0) / found.noise.joint**2
    rate = joint_rates(moving, found.state)
    errors = reading_residuals(moving, found.state)
    information, late = (
        np.bincount(e, (weight * rate * each).sum(axis=1)) for each in (rate, errors)
    )
    if not (information > 0).all():
        return []
    apart = float(np.diff(late / information)[0])
    if abs(apart) < max(SURE * np.sqrt((1 / information).sum()), LEAST_APART_S):
        return []
    late_eye, other = EYES[::-1] if apart > 0 else EYES
    sentence = (
        f"Images of the {late_eye} eye lag behind its joint readings by about "
        f"{1e3 * abs(apart):.2g} ms more than those of the {other} eye, but one time offset stands "
        "for both: trigger all cameras and read all joints at one moment, or leave moving rows out."
    )
    return [warning("eyes-apart-in-time", sentence)]


def contradicting_views(problem: BundleProblem) -> tuple[Finding, ...]:
    """Return a warning for each camera some views of which contradict the others."""
    said = []
    for c in range(len(problem.cameras)):
        lost = problem.block_view[problem.block[(problem.camera == c) & ~problem.seen.any(axis=1)]]
        if len(lost):
            where = f"{', '.join(map(str, np.sort(lost)))}{_of_camera(problem, c)}"
            sentence = (
                f"Views {where} were left out: they show the board turned against its other "
                "views, as when it is numbered from the wrong end, or one of few corners is wrong."
            )
            said.append(warning("turned-views", sentence, f"views {where}"))
    return tuple(said)


def _of_camera(problem: BundleProblem, c: int) -> str:
    return "" if len(problem.cameras) == 1 else f" of {problem.cameras[c]}"


def _unobservable(problem: BundleProblem, found: Adjusted) -> list[Finding]:
    """Return a warning for each set of owners whose parameters the data hardly determine."""
    names = [n.removeprefix("camera.").rpartition(".") for n in problem.parameters]
    owner = [before or after for before, _, after in names]
    word = [_WORDS.get(after, after) if before else "" for before, _, after in names]
    # Numerator and denominator of a rational lens nearly cancel; what that leaves open is in the
    # covariance, and in the map of the lens.
    cancelling = {
        f"{camera}.{name}"
        for camera in problem.cameras
        if f"{camera}.k6" in problem.parameters
        for name in COEFFICIENTS["rational"]
    }
    said = []
    for what, rows in (
        ("not observable, and left at the start", found.observability.fixed),
        ("hardly observable", found.observability.weak),
    ):
        merged: dict[tuple[str, ...], set[int]] = {}
        for row in _sparse(rows):
            large = np.flatnonzero(np.abs(row) > NAMED * np.abs(row).max()).tolist()
            if all(problem.parameters[i] in cancelling for i in large):
                continue
            merged.setdefault(tuple(dict.fromkeys(owner[i] for i in large)), set()).update(large)
        for owners, large in merged.items():
            parts = {o: [word[i] for i in sorted(large) if owner[i] == o] for o in owners}
            subject = " together with ".join(f"{o} {listed(parts[o])}".strip() for o in owners)
            eyes = sorted({eye for o in owners for eye in _eyes_of(problem, o)})
            sentence = f"{subject}: {what}; {missing_motion(problem, found, eyes)}."
            said.append(warning("unobservable", sentence, ", ".join(owners)))
    return said


def _eyes_of(problem: BundleProblem, owner: str) -> list[int]:
    camera = owner.removesuffix(".T_eye_cam")
    if camera in problem.cameras:
        return [int(problem.eye[problem.cameras.index(camera)])]
    if owner in EYES:
        return [EYES.index(owner)]
    return np.unique(problem.eye).tolist()


def _sparse(rows: Array) -> Array:
    """Return a basis of the same space with the zeros that pivoted elimination gives."""
    rows = rows.copy()
    for k in range(len(rows)):
        i, j = np.unravel_index(np.abs(rows[k:]).argmax(), rows[k:].shape)
        rows[[k, k + i]] = rows[[k + i, k]]
        rows[k] /= rows[k, j]
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, j], rows[k])
    return rows
