"""What is not observable, why, and what to record instead: in words."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.adjustment import Adjusted
from vergence.calibration.bundle.problem import BundleProblem, BundleState, eye_poses
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import parameter_names
from vergence.geometry.se3 import rotvec

SMALL_RAD = 0.05
"""Motion below this is small beside the +-0.25 rad of a good recording."""
ADVISED = "by at least 0.1 rad, better 0.25"
"""Median stated deviation of the worst axis, 20 views at 0.1 px and 0.1 degrees, board at 0.4 m:
0.92 degrees and 2.6 mm for motion within 0.03 rad, 0.27 and 0.8 within 0.1, 0.10 and 0.3 within
0.25."""
SENSE = 6.0
"""Motion, as a multiple of the noise of its mean, from which its sense is beyond doubt."""
FEW = 6
"""Degrees of freedom below which an estimated noise level is heavy-tailed, and the covariance
optimistic."""
NAMED = 0.3
"""A direction's components of this size, relative to the largest, are named."""

_WORDS = {
    "rx": "rotation about x",
    "ry": "rotation about y",
    "rz": "rotation about z",
    "tx": "translation along x",
    "ty": "translation along y",
    "tz": "translation along z",
}


def warnings(problem: BundleProblem, found: Adjusted) -> tuple[str, ...]:
    """Return a sentence for everything that the reader of a result must know."""
    observability, noise = found.observability, found.components.noise
    said = []
    for what, rows in (
        ("not observable, and left at the start", observability.fixed),
        ("hardly observable", observability.weak),
    ):
        for subject, eyes in _subjects(problem, rows):
            said.append(f"{subject}: {what}; {_causes(problem, found, eyes)}.")
    for e in np.unique(problem.block_eye):
        said += _senses(problem, found, int(e))
    for k in np.flatnonzero(found.assumed):
        said.append(
            f"The noise of the joint readings cannot be estimated from these views; "
            f"{noise.joint[k]:g} was assumed: let the eyes look at each board from several angles."
        )
    few = ~found.assumed & ~found.given & (found.redundancy < FEW)
    for redundancy in found.redundancy[few]:
        said.append(
            f"The noise of the joint readings rests on {redundancy:.0f} readings more than it "
            "takes to fit them: the stated accuracy is rough; record more views."
        )
    corners = int(np.count_nonzero(problem.seen))
    outliers = corners - np.count_nonzero(found.weights.corner)
    if outliers > 0.01 * corners:
        said.append(
            f"{outliers} of {corners} corners lie beyond {noise.outlier:g} standard deviations of "
            f"{noise.pixel_px:.2g} px and lost their weight: look at the views with the largest "
            "residuals."
        )
    systematic = max(found.systematic_px)
    if systematic > noise.pixel_px:  # the boards' poses may pass it on: the worst camera is named
        camera = problem.cameras[found.systematic_px.index(systematic)]
        whose = "" if len(problem.cameras) == 1 else f" of {camera}"
        said.append(
            f"All images{whose} have a systematic error of {systematic:.2g} px, more than the "
            f"noise of single corners ({noise.pixel_px:.2g} px): the lens departs from its "
            "model, or the board is not flat; look at the residuals over the image."
        )
    if not found.converged:
        said.append("The estimate did not converge: do not trust it.")
    return tuple(dict.fromkeys(said))  # pan and tilt may share one


def contradicting_views(problem: BundleProblem) -> tuple[str, ...]:
    """Return a sentence for each camera some views of which contradict the others."""
    said = []
    for c, camera in enumerate(problem.cameras):
        lost = problem.block_view[problem.block[(problem.camera == c) & ~problem.seen.any(axis=1)]]
        if len(lost):
            subject = "" if len(problem.cameras) == 1 else f" of {camera}"
            said.append(
                f"Views {', '.join(map(str, np.sort(lost)))}{subject} were left out: they show the "
                "board turned against its other views, as when it is numbered from the wrong end."
            )
    return tuple(said)


def _subjects(problem: BundleProblem, rows: Array) -> list[tuple[str, list[int]]]:
    """Return the subjects of directions, merged by their owners, and the eyes concerned."""
    labels = parameter_names(problem.cameras)
    merged: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for row in _sparse(rows):
        parts: dict[str, list[str]] = {}  # dictionaries keep the order of the unknowns
        for i in np.flatnonzero(np.abs(row) > NAMED * np.abs(row).max()):
            owner, part = _words(labels[i])
            parts.setdefault(owner, []).append(part)
        group = merged.setdefault(tuple(parts), {owner: [] for owner in parts})
        for owner, words in parts.items():
            group[owner] += words
    subjects = []
    for owners, parts in merged.items():
        text = " together with ".join(f"{owner} {_list(parts[owner])}".strip() for owner in owners)
        subjects.append((text, sorted({eye for o in owners for eye in _eyes_of(problem, o)})))
    return subjects


def _words(name: str) -> tuple[str, str]:
    """Return the owner of an unknown, and what it is."""
    owner, _, part = name.removeprefix("camera.").rpartition(".")
    return (owner or name, _WORDS.get(part, part if owner else ""))


def _eyes_of(problem: BundleProblem, owner: str) -> list[int]:
    camera = owner.removesuffix(".T_eye_cam")
    if camera in problem.cameras:
        return [int(problem.eye[problem.cameras.index(camera)])]
    if owner in EYES:
        return [EYES.index(owner)]
    return [0, 1] if len(problem.cameras) > 1 else [int(problem.eye[0])]


def _causes(problem: BundleProblem, found: Adjusted, eyes: list[int]) -> str:
    """Return what the motion of the eyes lacks."""
    present = [e for e in eyes if (problem.block_eye == e).any()]
    if len(eyes) == 2 and not _placements_of_both(problem):
        return "no board stands where both eyes see it; show the same board to both"
    causes = [cause for e in present for cause in _motion(problem, found, e)]
    if causes:
        return ", ".join(causes)
    return (
        "the views do not distinguish it from other unknowns; record more of them, with pan and "
        "tilt moved by 0.25 rad and boards at several distances and slants"
    )


def _placements_of_both(problem: BundleProblem) -> bool:
    eye = problem.eye[problem.camera]
    return bool(set(problem.placement[eye == 0]) & set(problem.placement[eye == 1]))


def _motion(problem: BundleProblem, found: Adjusted, eye: int) -> list[str]:
    """Return what is wrong with the motion of one eye before boards at rest."""
    whose = _whose(problem, eye)
    blocks, which = _views(problem, eye)
    if np.bincount(which).max() < 2:
        return [f"{whose} sees each board in one view only; let it move before a board at rest"]
    if problem.T_base_eye_read is not None:
        return _turning(problem, found.state, blocks, which, whose)
    away = _away(found.state.latent[blocks], which)
    noise = found.components.noise
    causes = []
    for k, joint in enumerate(("pan", "tilt")):
        rms, reach = np.sqrt((away[:, k] ** 2).mean()), np.abs(away[:, k]).max()
        level = noise.joint[noise.group[k]]
        if rms <= 1.5 * level:
            causes.append(
                f"all {joint} motion of {whose} ({reach:.2g} rad) is no larger than its noise "
                f"({level:.2g} rad); move {joint} {ADVISED}"
            )
        elif reach < SMALL_RAD:
            causes.append(
                f"{joint} of {whose} moves by {reach:.2g} rad only; move {joint} {ADVISED}"
            )
    together = np.linalg.svd(away, compute_uv=False)[-1] / np.sqrt(len(away))
    if not causes and together < SMALL_RAD / 3:
        causes.append(f"pan and tilt of {whose} move together; move one without the other")
    return causes


def _senses(problem: BundleProblem, found: Adjusted, eye: int) -> list[str]:
    """Return a sentence for each joint whose motion is so small that its sense is uncertain.

    A mounting turned about the other axis by half a turn then fits as well: no covariance, which
    describes one solution only, can show it.
    """
    blocks, which = _views(problem, eye)
    if problem.T_base_eye_read is not None or np.bincount(which).max() < 2:
        return []
    length = np.linalg.norm(_away(found.state.latent[blocks], which), axis=0)
    noise = found.components.noise
    return [
        f"Readings of {joint} of {_whose(problem, eye)} hardly follow its motion: the noise is "
        f"{level:.2g} rad, and even the sense of the motion is uncertain; do not trust the result."
        for joint, size, level in zip(
            ("pan", "tilt"), length, noise.joint[noise.group], strict=True
        )
        if size < SENSE * level
    ]


def _views(problem: BundleProblem, eye: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the blocks in which an eye sees boards, and before which placement it does."""
    mine = problem.eye[problem.camera] == eye
    pairs = np.unique(np.stack([problem.block[mine], problem.placement[mine]]), axis=1)
    return pairs[0], np.unique(pairs[1], return_inverse=True)[1]


def _away(angles: Array, which: np.ndarray) -> Array:
    """Return the angles (N, 2) less their mean before each placement."""
    counts = np.bincount(which)
    means = np.stack([np.bincount(which, column) / counts for column in angles.T], axis=-1)
    return angles - means[which]


def _whose(problem: BundleProblem, eye: int) -> str:
    return "the eye" if len(problem.cameras) == 1 else f"the {EYES[eye]} eye"


def _turning(
    problem: BundleProblem, state: BundleState, blocks: np.ndarray, which: np.ndarray, whose: str
) -> list[str]:
    """Return what the rotations of general eye poses lack."""
    R = eye_poses(problem, state)[blocks, :3, :3]
    first = np.unique(which, return_index=True)[1]
    turns = rotvec(np.swapaxes(R[first][which], 1, 2) @ R)
    reach = np.linalg.svd(turns, compute_uv=False) / np.sqrt(len(turns))
    if reach[0] < SMALL_RAD:
        return [f"{whose} turns by {reach[0]:.2g} rad only; turn it {ADVISED}"]
    if reach[1] < SMALL_RAD:
        return [
            f"all turns of {whose} share one axis to within {reach[1]:.2g} rad; "
            f"turn it about another axis as well, {ADVISED}"
        ]
    return []


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


def _list(words: list[str]) -> str:
    order = list(_WORDS.values())
    words = sorted(set(words), key=lambda word: order.index(word) if word in order else -1)
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
