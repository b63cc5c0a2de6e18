"""Whether readings and images belong together: one table of mistakes, and one way to score them.

Between two views of a board at rest an eye turns by A, as read, and its camera by B, as the images
show: A X = X B with X = R_eye_cam (Park and Martin 1994). Readings that are not what the
description says do not fit. Each row of `MISTAKES` undoes one mistake; the row whose data fit
clearly better than the data as they are is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.calibration.board_numbering import (
    EXACT_RAD,
    MOST_PAIRED,
    fit_turns,
    nearest_numbering,
)
from vergence.calibration.observations import Observations, camera_eyes, most_seen, readable
from vergence.errors import VergenceError, listed
from vergence.findings import Finding, note, void, warning
from vergence.geometry.board import Board
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import (
    EYE_JOINTS,
    EYES,
    Kinematics,
    Side,
    T_base_eye,
    straight_gaze,
)
from vergence.geometry.se3 import angle, inverse, known_poses, nearest_rotation, pose, rotvec
from vergence.stereo.extrinsics import stereo_cameras

LEAST_VIEWS_AT_REST = 6
"""Minimum number of views of a board at rest that can contradict readings or poses."""
LEAST_SPREAD_RAD = 0.02
"""Minimum root mean square turn about the second axis; below it noise of half a degree decides."""
CLEARLY_BETTER = 3.0
"""Ratio of misfits from which data fit clearly better; exchanged eyes that differ by three times
their noise reach it."""
NOISY = 0.45
"""Misfit relative to the turns from which readings are noisy: half a degree at the least spread."""
NOISY_RAD = np.radians(3.0)
"""Misfit that no noise of readings makes [rad]."""
UNRELATED = 0.7
"""Misfit relative to the turns from which readings and images have nothing in common."""
AHEAD = 0.3
"""Minimum cosine between a camera's axis and the eye's x axis; some cameras look aside."""
GAINS = (0.6, 1.6)
"""Range of the gain of a joint that is calibrated; another one means another unit or joint."""
LENGTHS = (0.8, 1.25)
"""Range of the length of a metre in measured poses; other ones are no error of a board's size."""
UNITS = {"degrees": 1 / np.degrees(1), "radians": np.degrees(1)}
"""Gain of readings that are in a unit but stated to be in the other one."""
METRES = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "kilometres": 1e3}
"""Length of one unit [m]."""
UNIT_WITHIN = 0.1
"""Relative tolerance with which a length is recognised as a unit."""
FARTHEST_M = 10.0
"""Distance of an eye from its base beyond which poses are not in metres."""
OUTLIER, OUTLIER_RAD = 6.0, np.radians(1.0)
"""A pose contradicts the others beyond this multiple of the median misfit, and this much."""
MOST_OUTLIERS = 0.25
"""Largest share of such poses; more of them put all poses in doubt."""
ALIKE = 1.2
"""Ratio of misfits up to which two explanations are equally good."""
UPRIGHT = 0.1
"""Difference of cosines up to which cameras are equally upright."""
LEAST_BASELINE_M = 1e-3
"""Minimum distance between the cameras of two eyes."""
MOST_TURNED_DEG = 30.0
"""Between the bases of the eyes; their axes are the head's, as built."""
ASIDE = 0.7
"""Minimum cosine of the angle between the line through the eyes and the head's y axis."""
AS_ONE = 0.2
"""Largest difference of factors, relative to the largest one, of eyes that turn as one."""
USUAL_BASELINE_M = 0.02, 0.5
"""Range of baselines of heads."""
NAMED = 5
"""Number of worst views that a refusal names."""


@dataclass(frozen=True, eq=False)
class EyeViews:
    """Views of one eye's camera before the board that it sees most often at rest."""

    camera: str
    e: int
    """Index of the eye in EYES."""
    rows: np.ndarray
    """(N,) views."""
    T_cam_target: Array
    """(N, 4, 4)."""
    to_left: Array | None
    """(3,) unit vector in frame cam, along the line through both cameras and towards the left one;
    None: no view shows the board to both."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was read, how it is described, and what the images show."""

    kinematics: Kinematics
    readings: Array
    """(V, r)."""
    T_base_eye: Array | None
    """(V, 2, 4, 4) measured poses in place of readings."""
    eyes: tuple[EyeViews, ...]


@dataclass(frozen=True, eq=False)
class TurnFit:
    """How well the readings of one eye explain the turns of its camera."""

    share: float
    """Median misfit relative to the median turn, at least that of EXACT_RAD; 1 if impossible."""
    turn_rad: float
    """Median turn between two views."""
    misfit_rad: float
    """Median over the views."""
    by_view: Array
    """(N,) misfit of each view [rad]; NaN where nothing was read."""
    names: tuple[str, ...]
    gains: Array
    """By name: the turn in the images relative to that of the reading; of poses the length of
    their metre."""
    symptom: str
    """What is impossible; empty: nothing."""
    upright: float
    """Cosine between the eye's y axis and the direction to the left."""


def fit_gains(kinematics: Kinematics, e: int, readings: Array, turn: Array) -> Array:
    """Estimate by what factor each reading of an eye turns it farther than described.

    Turns (N, 3) of a camera are linear in readings (N, u) of its eye as long as they are small. The
    fit is to three quarters of the views (least trimmed squares), first to those of usual readings.
    """
    used = kinematics.used(EYES[e])
    chain = kinematics.chains[EYES[e]]
    away = np.abs(readings - np.median(readings, axis=0))
    away = (away / np.maximum(np.median(away, axis=0), 1e-9)).max(axis=1)
    kept = away <= np.quantile(away, 1 - MOST_OUTLIERS)
    rows, w = np.column_stack([readings, np.ones(len(readings))]), np.zeros((len(used) + 1, 3))
    for _ in range(10):
        w = np.linalg.lstsq(rows[kept], turn[kept], rcond=None)[0]
        off = np.linalg.norm(turn - rows @ w, axis=1)
        kept = off <= np.quantile(off, 1 - MOST_OUTLIERS)
    w, d = w[:-1], chain.mixing[:, used].T @ chain.axes
    lengths = np.linalg.norm(w, axis=1), np.linalg.norm(d, axis=1)
    moved = readings[kept].std(axis=0)
    # A reading that turns the eye little, by the images and as described, has no gain of its own.
    turned = moved * np.array(lengths)
    still = (turned < 0.1 * turned.max(axis=1, keepdims=True)).all(axis=0)
    w[still] = 0.0
    unit_w, unit_d = (
        x / np.maximum(n, 1e-12)[:, None] for x, n in zip((w, d), lengths, strict=True)
    )
    R = nearest_rotation(unit_w.T @ unit_d)
    return np.where(still, 1.0, (w * (d @ R.T)).sum(axis=1) / lengths[1] ** 2)


def fit_lengths(T_base_eye: Array, T_cam_target: Array, R: Array) -> tuple[float | None, Array]:
    """Fit the metre of measured poses to the motions between views, robustly (L1).

    (R_A - 1) t_X + metre t_A = R t_B is linear in t_X and the metre. Returns its length, None where
    the eye turns about a point, and the median misfit (N,) [m] of each view.
    """
    N = len(T_base_eye)
    paired = np.unique(np.linspace(0, N - 1, MOST_PAIRED).astype(int))
    A = inverse(T_base_eye[paired])[:, None] @ T_base_eye
    B = T_cam_target[paired][:, None] @ inverse(T_cam_target)
    rows = np.concatenate([A[..., :3, :3] - np.eye(3), A[..., :3, 3:]], axis=-1).reshape(-1, 4)
    lengths = np.maximum(np.linalg.norm(rows, axis=0), 1e-6)  # shorter ones are rounding
    about_a_point = np.linalg.cond(rows / lengths) > 1e4
    right = B[..., :3, 3] @ R.T
    if about_a_point:
        right, rows = right - A[..., :3, 3], rows[:, :3]
    weights, off, found = np.ones(rows.shape[0]), np.zeros(A.shape[:2]), np.ones(4)
    for _ in range(10):
        found = np.linalg.lstsq(rows * weights[:, None], right.ravel() * weights)[0]
        off = np.linalg.norm(right - (rows @ found).reshape(right.shape), axis=-1)
        weights = np.repeat(1 / np.sqrt(np.maximum(off.ravel(), 1e-6)), 3)
    off[np.arange(len(paired)), paired] = np.nan
    return None if about_a_point else float(found[3]), np.nanmedian(off, axis=0)


def fit_eye(evidence: Evidence, views: EyeViews) -> TurnFit:
    """Fit what was read of an eye to the turns of its camera."""
    kinematics, eye = evidence.kinematics, EYES[views.e]
    used = kinematics.used(eye)
    by_view, upright = np.full(len(views.rows), np.nan), 0.0
    if evidence.T_base_eye is not None:
        T = evidence.T_base_eye[views.rows, views.e]
        known = known_poses(T)
        names: tuple[str, ...] = (f"the poses of the {eye} eye",)
        R, by_view[known], turn = fit_turns(T[known, :3, :3], views.T_cam_target[known, :3, :3])
        metre, _ = fit_lengths(T[known], views.T_cam_target[known], R)
        far = float(np.median(np.linalg.norm(T[known][:, :3, 3], axis=1)))
        if metre is None:  # nothing but the distance of the point shows the unit
            metre = 1.0 if far < FARTHEST_M else METRES["millimetres"]
        if np.nanmedian(by_view) > NOISY * turn:
            metre = 1.0  # of other poses lengths mean nothing
        gains, limits, symptom = np.array([metre]), LENGTHS, ""
    else:
        readings = evidence.readings[views.rows]
        known = np.asarray(np.isfinite(readings[:, used]).all(axis=1))
        if known.sum() < LEAST_VIEWS_AT_REST:
            return TurnFit(1.0, 1.0, 1.0, by_view, (), np.array([]), "too few are known", 0.0)
        R_cam = views.T_cam_target[known, :3, :3]
        names = tuple(kinematics.readings[r] for r in used)
        gains, limits = (
            fit_gains(kinematics, views.e, readings[known][:, used], turns(R_cam)),
            GAINS,
        )
        fits = []
        for factors in (np.ones(len(used)), gains):  # the linear fit is rough for large turns
            scaled = np.zeros((int(known.sum()), readings.shape[1]))
            scaled[:, used] = readings[known][:, used] * factors
            fits.append(fit_turns(T_base_eye(kinematics, eye, scaled)[:, :3, :3], R_cam))
        R, by_view[known], turn = min(fits, key=lambda each: float(np.median(each[1])))
        side = None if views.to_left is None else float(R[1] @ views.to_left)
        upright = float(R[1] @ [-1.0, 0.0, 0.0]) if side is None else side
        symptom = ""
        if R[0, 2] < AHEAD:
            symptom = f"by them {views.camera} would look backwards or aside out of its eye"
        elif side is not None and side < 0:
            symptom = f"by them {views.camera} would stand on the wrong side of the other eye"
    wrong = (gains < limits[0]) | (gains > limits[1])
    if wrong.any():
        k = int(np.argmax(wrong))
        symptom = f"{views.camera} turns by {gains[k]:.3g} times the readings of {names[k]}"
        if evidence.T_base_eye is not None:
            symptom = (
                f"by the images of {views.camera} a length of 1 in them measures {gains[0]:.4g} m"
            )
    misfit = float(np.nanmedian(by_view))
    share = 1.0 if symptom else max(misfit, EXACT_RAD) / turn
    return TurnFit(share, turn, misfit, by_view, names, gains, symptom, upright)


def turns(R_cam_target: Array) -> Array:
    """Return the turns (N, 3) of a camera from the view in the middle of all [rad]."""
    R = R_cam_target
    middle = R[angle(R[:, None] @ np.swapaxes(R, 1, 2)).sum(axis=1).argmin()]
    return rotvec(middle @ np.swapaxes(R, 1, 2))  # the board at rest turns by the inverse


# The mistakes. Each yields what was mistaken, in words, and the evidence without the mistake.

Variants = Iterator[tuple[str, Evidence]]


def _with_columns(evidence: Evidence, change: Array) -> Evidence:
    return replace(evidence, readings=evidence.readings @ change)


def _table(evidence: Evidence) -> str:
    """Name the table of dataset.json that describes the readings."""
    return "joints" if set(evidence.kinematics.readings) <= set(EYE_JOINTS) else "readings"


def _signs(evidence: Evidence, _: list[TurnFit]) -> Variants:
    of_eyes = [evidence.kinematics.used(EYES[views.e]) for views in evidence.eyes]
    chosen = {frozenset(pick) for used in of_eyes for n in (1, 2) for pick in combinations(used, n)}
    chosen.add(frozenset().union(*of_eyes))
    for columns in sorted(chosen, key=sorted):
        factors = np.where(np.isin(np.arange(evidence.readings.shape[1]), list(columns)), -1.0, 1.0)
        names = [evidence.kinematics.readings[r] for r in sorted(columns)]
        keys = listed([f"{_table(evidence)}.{name}.sign" for name in names])
        counts = "counts" if len(names) == 1 else "count"
        what = f"{listed(names)} {counts} the other way; set {keys} to the opposite"
        yield what, replace(evidence, readings=evidence.readings * factors)


def _exchanged_readings(evidence: Evidence, _: list[TurnFit]) -> Variants:
    names = evidence.kinematics.readings
    for pair in combinations(range(len(names)), 2):
        order = list(range(len(names)))
        order[pair[0]], order[pair[1]] = pair[::-1]
        yield (
            f"{names[pair[0]]} and {names[pair[1]]} are exchanged",
            replace(evidence, readings=evidence.readings[:, order]),
        )


def _exchanged_eyes(evidence: Evidence, _: list[TurnFit]) -> Variants:
    if len(evidence.eyes) < 2:
        return
    of_images = replace(evidence, eyes=tuple(map(_of_other_eye, evidence.eyes)))
    yield "left and right are exchanged in the images", of_images
    what, read = "eye poses", None
    if evidence.T_base_eye is not None:
        read = {"T_base_eye": evidence.T_base_eye[:, ::-1]}
    elif order := _other_eyes_readings(evidence.kinematics):
        what, read = "columns of the joint readings", {"readings": evidence.readings[:, order]}
    if read is not None:
        yield f"left and right are exchanged in the {what}", replace(evidence, **read)
        both = replace(of_images, **read)
        yield f"left and right are exchanged in both the images and the {what}", both


def _of_other_eye(views: EyeViews) -> EyeViews:
    return replace(views, e=1 - views.e, to_left=None if views.to_left is None else -views.to_left)


def _other_eyes_readings(kinematics: Kinematics) -> list[int] | None:
    """Return the columns with those of left and right exchanged; None: they are not alike."""
    left, right = (kinematics.used(eye) for eye in EYES)
    if set(left) & set(right) or len(left) != len(right):
        return None
    order = list(range(len(kinematics.readings)))
    for a, b in zip(left, right, strict=True):
        order[a], order[b] = b, a
    return order


def _units(evidence: Evidence, fits: list[TurnFit]) -> Variants:
    """Other units, gears and factors: readings and lengths times the gains that the images show."""
    if evidence.T_base_eye is not None:
        metre = float(np.median([fit.gains[0] for fit in fits]))
        if metre < 0:
            what = "their coordinates are left-handed, or their translations point the other way"
        else:
            near = [u for u, m in METRES.items() if abs(metre / m - 1) < UNIT_WITHIN]
            what = f"they are in {near[0]}; give metres" if near else "check their unit"
            what += "" if near else ", and board.square_m"
        T = evidence.T_base_eye.copy()
        T[..., :3, 3] *= metre
        yield what, replace(evidence, T_base_eye=T)
        return
    factors, said = np.ones(evidence.readings.shape[1]), []
    for fit in fits:
        for name, gain in zip(fit.names, fit.gains, strict=True):
            k = evidence.kinematics.readings.index(name)
            if GAINS[0] < gain < GAINS[1] or gain <= 0 or factors[k] != 1:
                continue
            factors[k] = gain
            is_in = [u for u, g in UNITS.items() if GAINS[0] < gain / g < GAINS[1]]
            if is_in:
                unit = {"degrees": "deg", "radians": "rad"}[is_in[0]]
                said.append(
                    f"{name}: they are {is_in[0]}; set {_table(evidence)}.{name}.unit to {unit}"
                )
            else:
                said.append(f"{name}: check its unit, its gear or factor, and its column")
    if said:
        yield "; ".join(said), replace(evidence, readings=evidence.readings * factors)


def _orders_of_joints(evidence: Evidence, _: list[TurnFit]) -> Variants:
    eyes = evidence.kinematics.eyes
    most = max(map(len, eyes.values()))
    for order in list(permutations(range(most)))[1:] if most < 4 else ():
        for changed in (EYES, EYES[:1], EYES[1:]):
            if any(len(eyes[eye]) != most for eye in changed):
                continue
            other: dict[Side, tuple[Joint, ...]] = {
                eye: tuple(eyes[eye][k] for k in order) for eye in changed
            }
            kinematics = Kinematics({**eyes, **other}, evidence.kinematics.readings)
            names = " before ".join(joint.name for joint in other[changed[0]])
            what = f"the turns fit {names}; describe the joints in this order by `kinematics`"
            yield what, replace(evidence, kinematics=kinematics)


def _shifted_rows(evidence: Evidence, _: list[TurnFit]) -> Variants:
    for by, when in ((-1, "late"), (1, "early")):
        end = -1 if by < 0 else 0
        readings = np.roll(evidence.readings, by, axis=0)
        readings[end] = np.nan
        moved = replace(evidence, readings=readings)
        if evidence.T_base_eye is not None:
            T = np.roll(evidence.T_base_eye, by, axis=0)
            T[end] = np.nan
            moved = replace(moved, T_base_eye=T)
        yield f"they stand one row too {when}", moved


def _other_poses(evidence: Evidence, _: list[TurnFit]) -> Variants:
    """Poses of the base in the eye, transposed rotations, and quaternions in another order."""
    T = evidence.T_base_eye
    assert T is not None
    yield "they are inverted (T_eye_base)", replace(evidence, T_base_eye=inverse(T))
    known = known_poses(T)
    numbers = Rotation.from_matrix(T[known][:, :3, :3]).as_quat()
    for what, R in (
        ("their rotations are transposed", np.swapaxes(T[known][:, :3, :3], 1, 2)),
        *(
            (
                "their quaternions are in another order (x, y, z, w or w, x, y, z)",
                Rotation.from_quat(np.roll(numbers, by, axis=1)).as_matrix(),
            )
            for by in (1, -1)
        ),
    ):
        other = T.copy()
        other[known] = pose(R, T[known][:, :3, 3])
        yield what, replace(evidence, T_base_eye=other)


def _lost_readings(evidence: Evidence, fits: list[TurnFit]) -> Variants:
    """One reading is of nothing that turns the eye: the images give what it should have been."""
    for views, fit in zip(evidence.eyes, fits, strict=True):
        used = evidence.kinematics.used(EYES[views.e])
        chain = evidence.kinematics.chains[EYES[views.e]]
        read = evidence.readings[views.rows]
        turned = turns(views.T_cam_target[:, :3, :3])
        known = np.isfinite(read[:, used]).all(axis=1)
        for name, r in zip(fit.names, used, strict=True):
            others = np.column_stack(
                [read[known][:, [u for u in used if u != r]], np.ones(known.sum())]
            )
            left = turned[known] - others @ np.linalg.lstsq(others, turned[known])[0]
            U, s, _ = np.linalg.svd(left, full_matrices=False)
            size = np.linalg.norm(chain.mixing[:, r] @ chain.axes)
            moved = np.std(read[known, r])
            for sign in (1, -1):
                readings = evidence.readings.copy()
                readings[views.rows[known], r] = sign * U[:, 0] * s[0] / size
                what = (
                    f"{name}, which changes by {moved:.2g} rad, has no part in them: check its "
                    "column and its sensor"
                )
                yield what, replace(evidence, readings=readings)


MISTAKES: tuple[tuple[str, str, Callable[[Evidence, list[TurnFit]], Variants]], ...] = (
    ("wrong-sign", "readings", _signs),
    ("exchanged-readings", "readings", _exchanged_readings),
    ("exchanged-eyes", "both", _exchanged_eyes),
    ("wrong-unit", "both", _units),
    ("order-of-joints", "readings", _orders_of_joints),
    ("shifted-rows", "both", _shifted_rows),
    ("other-poses", "poses", _other_poses),
)
"""By code the mistakes that can be undone, and whether they are of readings or of poses."""
LAST_RESORT = (("lost-reading", "readings", _lost_readings),)
"""Explanations that are tried last, since they give up part of the data."""


def explanation(evidence: Evidence) -> tuple[list[str], Evidence]:
    """Find the mistakes that explain the data clearly better, one after the other.

    Returns what they are, and the evidence without them.
    """
    said: list[str] = []
    for _ in range(3):
        found = _best(evidence, MISTAKES) or _best(evidence, LAST_RESORT)
        if found is None:
            break
        said.append(found[0])
        evidence = found[1]
    return said, evidence


def _best(evidence: Evidence, table: tuple) -> tuple[str, Evidence] | None:
    """Return the mistake whose undoing explains the data best; None: none does clearly better."""
    kind = "readings" if evidence.T_base_eye is None else "poses"
    before = [fit_eye(evidence, views) for views in evidence.eyes]
    tried = []
    for _, of, variants in table:
        for what, other in variants(evidence, before) if of in (kind, "both") else ():
            after = [
                fit if _unchanged(evidence, other, k) else fit_eye(other, other.eyes[k])
                for k, fit in enumerate(before)
            ]
            tried.append(
                (_score(before) - _score(after), sum(f.upright for f in after), what, other)
            )
    best = max((gain for gain, *_ in tried), default=0.0)
    if best < np.log(CLEARLY_BETTER):
        return None
    near = [each for each in tried if each[0] > best - np.log(ALIKE)]
    upright = max(each[1] for each in near)
    alike = [each for each in near if each[1] > upright - UPRIGHT]
    return ", or ".join(what for *_, what, _ in alike), alike[0][3]


def _unchanged(a: Evidence, b: Evidence, k: int) -> bool:
    """Return whether two evidences are the same for one eye."""
    used = a.kinematics.used(EYES[a.eyes[k].e])
    same = a.kinematics is b.kinematics and a.T_base_eye is b.T_base_eye
    readings = (each.readings[:, used] for each in (a, b))
    return same and a.eyes[k] is b.eyes[k] and np.array_equal(*readings, equal_nan=True)


def _score(fits: list[TurnFit]) -> float:
    """Return the log of the misfits; for normal noise a log likelihood per view and axis."""
    return float(np.log([fit.share for fit in fits]).sum())


def check_readings_and_images(
    observations: Observations, T_cam_target: Mapping[str, Array]
) -> tuple[Observations, list[Finding]]:
    """Refuse readings or measured poses that the images contradict, and say what they seem to be.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known. Moving rows
    are not compared, since a time offset looks like another row. Returns the observations without
    the corners of single views whose measured pose contradicts the others, and findings on them.
    """
    evidence = evidence_of(observations, T_cam_target)
    fits = [fit_eye(evidence, views) for views in evidence.eyes]
    if any(fit.symptom or fit.misfit_rad > CLEARLY_BETTER * EXACT_RAD for fit in fits):
        aligned = _aligned(evidence, observations.board)
        others = [fit_eye(aligned, views) for views in aligned.eyes]
        if _score(others) < _score(fits):
            evidence, fits = aligned, others
        said, explained = explanation(aligned)
        pairs = list(zip(evidence.eyes, fits, strict=True))
        if said:
            after = max(fit_eye(explained, views).misfit_rad for views in explained.eyes)
            cause = f"{'; '.join(said)}. They then fit to {np.degrees(after):.2f} degrees."
            limit = after * CLEARLY_BETTER
            wrong = [each for each in pairs if each[1].symptom or each[1].misfit_rad > limit]
            raise VergenceError(f"{_symptoms(evidence, wrong or pairs)}: {cause}")
        wrong = [each for each in pairs if _is_wrong(each[1])]
        if wrong:
            raise VergenceError(
                f"{_symptoms(evidence, wrong)}. No usual mistake explains it: they may be of other "
                "moments or another eye, the board may have moved, or the eye may have a joint "
                "that is not described; check the axes of its joints. The largest differences: "
                f"{_worst(observations, *max(wrong, key=lambda each: each[1].misfit_rad))}."
            )
    findings = _eyes_alike(evidence, fits)
    if evidence.T_base_eye is None:
        return observations, findings
    without, odd = _without_odd_poses(observations, evidence, fits)
    return without, [*findings, *odd]


def evidence_of(observations: Observations, T_cam_target: Mapping[str, Array]) -> Evidence:
    """Collect for each eye the views of its camera that sees one board at rest most often."""
    found: dict[int, EyeViews] = {}
    poses = {
        name: np.where(observations.at_rest[:, None, None], T, np.nan)
        for name, T in T_cam_target.items()
    }
    for name, eye in camera_eyes(observations).items():
        e, read = EYES.index(eye), readable(observations, eye)
        rows = most_seen(observations.placement, known_poses(poses[name]) & read)
        if len(rows) < LEAST_VIEWS_AT_REST or (e in found and len(rows) <= len(found[e].rows)):
            continue
        if observations.T_base_eye is None and not observations.kinematics.used(eye):
            continue
        T = poses[name][rows]
        spread = np.linalg.svd(turns(T[:, :3, :3]), compute_uv=False) / np.sqrt(len(rows))
        if spread[1] >= LEAST_SPREAD_RAD:
            found[e] = EyeViews(name, e, rows, T, None)
    if len(found) == 2:
        found = _facing_each_other(found, poses)
    return Evidence(
        observations.kinematics,
        observations.eye_angles,
        observations.T_base_eye,
        tuple(found[e] for e in sorted(found)),
    )


def _facing_each_other(
    found: Mapping[int, EyeViews], poses: Mapping[str, Array]
) -> dict[int, EyeViews]:
    """Add in which direction the left camera stands; VergenceError if both stand in one place."""
    T = poses[found[1].camera] @ inverse(poses[found[0].camera])
    T = T[known_poses(T)]
    if not len(T):
        return dict(found)
    # A board that is still numbered from the wrong end moves the camera, but not in most views.
    to_left = {0: np.median(-inverse(T)[:, :3, 3], axis=0), 1: np.median(T[:, :3, 3], axis=0)}
    if min(np.linalg.norm(t) for t in to_left.values()) < LEAST_BASELINE_M:
        raise VergenceError(
            f"By the images {found[0].camera} and {found[1].camera} stand in the same place: is "
            "one set of images there twice?"
        )
    return {
        e: replace(views, to_left=to_left[e] / np.linalg.norm(to_left[e]))
        for e, views in found.items()
    }


def _aligned(evidence: Evidence, board: Board) -> Evidence:
    """Number the boards alike by the images alone, since what was read may be wrong."""
    eyes = []
    for views in evidence.eyes:
        T = views.T_cam_target.copy()
        T[:, :3, :3] = nearest_numbering(T[:, :3, :3], board)
        eyes.append(replace(views, T_cam_target=T))
    return replace(evidence, eyes=tuple(eyes))


def _is_wrong(fit: TurnFit) -> bool:
    """Return whether no noise explains how little was read and seen agree."""
    share = fit.misfit_rad / fit.turn_rad
    noisy = share > NOISY
    return (
        (bool(fit.symptom) and not noisy)
        or share > UNRELATED
        or (noisy and fit.misfit_rad > NOISY_RAD)
    )


def _symptoms(evidence: Evidence, wrong: list[tuple[EyeViews, TurnFit]]) -> str:
    """Say how what was read differs from the images."""
    read, said = "readings" if evidence.T_base_eye is None else "poses", []
    for views, fit in wrong:
        differ = (
            f"they differ by {np.degrees(fit.misfit_rad):.2g} degrees in the median from the turns "
            f"of {views.camera} before a board at rest"
        )
        said.append(f"the {read} of the {EYES[views.e]} eye ({fit.symptom or differ})")
    return f"Images contradict {listed(said)}"


def _worst(observations: Observations, views: EyeViews, fit: TurnFit) -> str:
    """Name the views that differ most, with their misfits."""
    worst = np.argsort(-np.nan_to_num(fit.by_view))[:NAMED]
    names = [observations.name_of_view(int(row)) for row in views.rows[worst]]
    off_deg = np.degrees(fit.by_view[worst])
    return ", ".join(f"{n} ({off:.2g} degrees)" for n, off in zip(names, off_deg, strict=True))


def _eyes_alike(evidence: Evidence, fits: list[TurnFit]) -> list[Finding]:
    """Note eyes that moved so much alike that exchanged readings would not show."""
    order = _other_eyes_readings(evidence.kinematics)
    if len(evidence.eyes) < 2 or evidence.T_base_eye is not None or order is None:
        return []
    other = replace(evidence, readings=evidence.readings[:, order])
    gain = _score(fits) - _score([fit_eye(other, views) for views in other.eyes])
    if gain < -np.log(ALIKE):
        return []
    sentence = (
        "Both eyes moved so much alike that exchanged readings of left and right would not show; "
        "let the eyes verge in some of the views."
    )
    return [note("eyes-alike", sentence)]


def _without_odd_poses(
    observations: Observations, evidence: Evidence, fits: list[TurnFit]
) -> tuple[Observations, list[Finding]]:
    """Leave out single views whose measured pose contradicts the others, and name them."""
    assert evidence.T_base_eye is not None
    corners, findings = dict(observations.corners), []
    eyes = camera_eyes(observations)
    for views, fit in zip(evidence.eyes, fits, strict=True):
        odd = fit.by_view > max(OUTLIER * fit.misfit_rad, OUTLIER_RAD)
        if odd.mean() > MOST_OUTLIERS:
            continue
        for k in np.flatnonzero(odd):
            row = int(views.rows[k])
            where = f"{observations.name_of_view(row)}, {EYES[views.e]} eye"
            sentence = (
                f"{observations.name_of_view(row).capitalize()}: the pose of the {EYES[views.e]} "
                f"eye differs by {np.degrees(fit.by_view[k]):.2g} degrees from what "
                f"{views.camera} shows in the other views, and was left out: is it that of another "
                "row?"
            )
            findings.append(warning("odd-pose", sentence, where))
            for name in corners:
                if EYES.index(eyes[name]) == views.e:
                    corners[name] = corners[name].copy()
                    corners[name][row] = np.nan
    return replace(observations, corners=corners), findings


def implausible_geometry(head: HeadCalibration) -> list[Finding]:
    """Find eyes that a calibration puts where a head with joint readings cannot have them."""
    if len({mounted.eye for mounted in head.cameras.values()}) < 2:
        return []
    findings = []
    across, t = np.degrees(angle(head.T_rbase_lbase[:3, :3])), eye_shift(head)
    if across > MOST_TURNED_DEG:
        sentence = (
            f"T_rbase_lbase: the bases of the eyes are turned by {across:.0f} degrees against each "
            "other, though the joints of both turn about the head's axes: check the signs of one "
            "eye's readings, which is of which joint, and that they are zero at straight gaze."
        )
        findings.append(void("bases-turned", sentence, "T_rbase_lbase"))
    baseline = float(np.linalg.norm(t))
    if t[1] < ASIDE * baseline:
        ahead, aside, above = 1e3 * t
        sentence = (
            f"T_rbase_lbase puts the left eye {aside:.0f} mm to the left of the right one, "
            f"{ahead:.0f} mm ahead of it and {above:.0f} mm above: check which images and readings "
            "are left and right, and the signs of the joints; if one eye does stand above the "
            "other, describe by `kinematics` a head that lies on its side (docs/other_joints.md)."
        )
        findings.append(void("eyes-not-beside", sentence, "T_rbase_lbase"))
    if not USUAL_BASELINE_M[0] <= baseline <= USUAL_BASELINE_M[1]:
        sentence = (
            f"The eyes came out {1e3 * baseline:.1f} mm apart: if they are not, the board's "
            "squares have another size than the dataset says."
        )
        findings.append(warning("odd-baseline", sentence))
    return findings


def eye_shift(head: HeadCalibration) -> Array:
    """Compute where the left eye stands from the right one (3,) [m], looking straight ahead.

    Along the axes of the right eye's base; the length is the baseline.
    """
    left, right = stereo_cameras(head, None)
    kinematics = head.kinematics
    T_lbase_leye, T_rbase_reye = eye_poses(head, straight_gaze(kinematics))
    mixing = [kinematics.chains[eye].mixing for eye in EYES]
    as_one = mixing[0].shape == mixing[1].shape and bool(
        (np.abs(mixing[0] - mixing[1]) <= AS_ONE * np.abs(mixing[0]).max(initial=0.0)).all()
    )
    left_end, right_end = (
        joints[-1].point_m if joints else np.zeros(3)
        for joints in (kinematics.eyes[eye] for eye in EYES)
    )
    if as_one or not np.array_equal(left_end, right_end):
        # A pair that turns as one, or joints elsewhere: the eyes are where their cameras are.
        T_lbase_leye, T_rbase_reye = T_lbase_leye @ left.T_eye_cam, T_rbase_reye @ right.T_eye_cam
    return (head.T_rbase_lbase @ T_lbase_leye)[:3, 3] - T_rbase_reye[:3, 3]
