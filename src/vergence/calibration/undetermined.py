"""What the data of a bundle adjustment do not determine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from vergence.arrays import Array
from vergence.calibration.hand_eye import LEAST_MOTION_RAD
from vergence.calibration.observations import most_seen
from vergence.calibration.outcome import Outcome
from vergence.calibration.residuals import Detections
from vergence.errors import counted, listed
from vergence.estimation.variables import Variables
from vergence.findings import Finding, void, warning
from vergence.geometry.head import parameter_names
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import rotvec

FEW = 6
"""Degrees of freedom below which an estimated noise level is heavy-tailed, and the covariance
optimistic."""
NAMED = 0.3
"""A direction's components of this size, relative to the largest, are named."""
ADVISED = "by at least 0.1 rad, better 0.25"
"""Median stated deviation of the worst axis, 20 views at 0.1 px and 0.1 degrees, board at 0.4 m:
0.92 degrees and 2.6 mm for motion within 0.03 rad, 0.27 and 0.8 within 0.1, 0.10 and 0.3 within
0.25."""

_WORDS = {f"r{axis}": f"rotation about {axis}" for axis in "xyz"}
_WORDS |= {f"t{axis}": f"translation along {axis}" for axis in "xyz"}


def spread(vectors: Array) -> Array:
    """Compute the standard deviations (3,) of vectors (N, 3) along their principal axes."""
    if len(vectors) < 3:
        return np.zeros(3)
    away = vectors - vectors.mean(axis=0)
    return np.linalg.svd(away, compute_uv=False) / np.sqrt(len(vectors))


def doubtful(of: Outcome) -> Iterator[Finding]:
    """Report an estimate that must not be used: it did not converge, or rests on too little."""
    yield from about_one_axis(of.problem.measured.detections, of.found.x)
    if not of.found.converged:
        sentence = (
            "The estimate did not converge, as where no head of this description fits the data, or "
            "the eyes turn too little to tell: check the description of the joints, the order of "
            "their readings, the lens models (`lens`), and the size of the board; let the eyes "
            "turn farther."
        )
        yield void("not-converged", sentence)


def about_one_axis(detections: Detections, x: Variables) -> Iterator[Finding]:
    """Report eyes that turn about one axis only, by their poses."""
    parameters = np.array(parameter_names(x["head"]))[x.shared["head"].free]
    R, turned, eyes = detections.eye_poses(x)[:, :3, :3], {}, {}
    for c in np.unique(detections.camera).tolist():
        name, eye = detections.cameras[c], EYES[detections.eye[c]]
        if x["head"].kinematics.eyes[eye] and f"{name}.T_eye_cam.tx" in parameters:
            mine = np.flatnonzero(detections.camera == c)
            mine = mine[most_seen(detections.board[mine], np.ones(len(mine), bool))]
            turned[name], eyes[name] = R[mine], eye
    yield from little_turned(turned, eyes)


def little_turned(turned: Mapping[str, Array], eyes: Mapping[str, Side]) -> Iterator[Finding]:
    """Report eyes that turn too little about a second axis: cameras may stand along the first.

    By camera: rotations (N, 3, 3) of its eye or of the board that it sees most often at rest, and
    its eye, for which its camera that turns most counts.
    """
    for eye in EYES:
        moves = [
            (*spread(rotvec(np.swapaxes(R[:1], 1, 2) @ R))[1::-1].tolist(), len(R), name)
            for name, R in turned.items()
            if eyes[name] == eye
        ]
        second, first, count, name = max(moves, default=(np.inf, np.inf, 0, ""))
        if second < LEAST_MOTION_RAD:
            where = f"{name}.T_eye_cam"
            sentence = (
                f"{where} is not observable: before a board at rest, in {counted(count, 'view')}, "
                f"the {eye} eye turns by {first:.2g} rad about one axis and by {second:.2g} rad "
                f"about another; turn it {ADVISED} about two axes, in 20 views or more of one "
                "board, which share its number in `placement`."
            )
            yield void("one-axis", sentence, where)


def unobservable(of: Outcome) -> Iterator[Finding]:
    """Name the parameters that the data do not determine, and the motion that is missing."""
    parameters = parameter_names(of.found.x["head"])
    names = [n.removeprefix("camera.").rpartition(".") for n in parameters]
    owner = [before or after for before, _, after in names]
    word = [_WORDS.get(after, after) if before else "" for before, _, after in names]
    for what, rows in (
        ("not observable, and left at the start", of.found.observability.fixed),
        ("poorly observable", of.found.observability.weak),
    ):
        merged: dict[tuple[str, ...], set[int]] = {}
        for row in _sparse(rows):
            large = np.flatnonzero(np.abs(row) > NAMED * np.abs(row).max()).tolist()
            merged.setdefault(tuple(dict.fromkeys(owner[i] for i in large)), set()).update(large)
        for owners, large in merged.items():
            parts = {o: [word[i] for i in sorted(large) if owner[i] == o] for o in owners}
            subject = " together with ".join(f"{o} {listed(parts[o])}".strip() for o in owners)
            sentence = f"{subject}: {what}; {_missing_motion(of)}."
            lost = of.found.converged and what.startswith("not")
            lost = lost and any(owner.endswith("T_eye_cam") for owner in owners)
            make = void if lost else warning
            yield make("unobservable", sentence, ", ".join(owners))


def _sparse(rows: Array) -> Array:
    """Reduce a basis to one of the same space with the zeros that pivoted elimination gives."""
    rows = rows.copy()
    for k in range(len(rows)):
        i, j = np.unravel_index(np.abs(rows[k:]).argmax(), rows[k:].shape)
        rows[[k, k + i]] = rows[[k + i, k]]
        rows[k] /= rows[k, j]
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, j], rows[k])
    return rows


def _missing_motion(of: Outcome) -> str:
    """Describe what to record."""
    board = of.problem.measured.detections.board
    boards = [set(board[of.eyes == eye]) for eye in np.unique(of.eyes)]
    if not set.intersection(*boards):
        return "no board stands where both eyes see it; show the same board to both"
    if not of.readings.level:
        return "show the board to all cameras at once, at several distances and slants"
    return (
        f"turn every joint of each eye {ADVISED}, before boards at rest at several distances and "
        "slants"
    )


def noise(of: Outcome) -> Iterator[Finding]:
    """Name noise levels that were assumed, or rest on few readings."""
    for level in of.reading_levels:
        what = f"the measured {level.name} of the eyes" if of.poses_read else "the joint readings"
        unit = "m" if level.name == "translations" else "rad"
        left = of.found.redundancy[level.name]
        if of.found.assumed[level.name]:
            sentence = (
                f"The noise of {what} cannot be estimated from these views; "
                f"{of.found.levels[level.name]:g} {unit} was assumed: let the eyes look at each "
                "board from several angles."
            )
            yield warning("noise-assumed", sentence, what)
        elif not level.given and left < FEW:
            sentence = (
                f"The noise of {what} rests on {left:.0f} readings more than it takes to fit them: "
                "the stated accuracy is rough; record more views."
            )
            yield warning("noise-roughly-known", sentence, what)
