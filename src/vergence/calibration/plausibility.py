"""Whether readings and images belong together: one table of mistakes, and one score for them.

Between two views of a board at rest an eye turns by A, as read, and its camera by B, as the images
show: A X = X B with X = R_eye_cam (Park and Martin 1994). Readings or measured poses that are not
as described do not fit. Each row of `MISTAKES` undoes one mistake; the row after which the data fit
clearly better is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array, nearest_rotation
from vergence.calibration.board_numbering import (
    EXACT_RAD,
    LEAST_SPREAD_RAD,
    MOST_TURNED_RAD,
    fit_turns,
    nearest_numbering,
)
from vergence.calibration.observations import Observations, camera_eyes, most_seen, readable
from vergence.errors import VergenceError, listed
from vergence.findings import Finding, void, warning
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import (
    EYE_JOINTS,
    EYES,
    Kinematics,
    Side,
    eye_pose,
    straight_gaze,
)
from vergence.geometry.se3 import angle, inverse, known_poses, pose, rotvec
from vergence.stereo.extrinsics import stereo_cameras

LEAST_VIEWS = 6
"""Minimum number of views of a board at rest that can contradict what was read."""
CLEARLY_BETTER, ALIKE = 3.0, 1.2
"""Ratios of misfits from which data fit clearly better, and up to which they fit alike."""
NOISY, UNRELATED = 0.45, 0.7
"""Misfits relative to the turns from which readings are noisy (half a degree at the least spread),
and from which they have nothing to do with the images."""
NOISY_RAD = np.radians(3.0)
"""Misfit that no noise of readings makes."""
AHEAD = 0.3
"""Minimum cosine between a camera's axis and the eye's x axis; some cameras look aside."""
UPRIGHT = 0.1
"""Difference of cosines up to which cameras are equally upright."""
GAINS, LENGTHS = (0.6, 1.6), (0.8, 1.25)
"""Ranges of the gain of a joint, and of the length of a metre in measured poses, that are
calibrated; others mean another unit or joint."""
UNITS = {"degrees": np.radians(1), "radians": np.degrees(1)}
"""Gains of readings that are in a unit and described in the other one."""
METRES = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
"""Lengths of units [m]."""
UNIT_WITHIN = 0.1
"""Relative tolerance with which a length is recognised as a unit."""
FARTHEST_M = 10.0
"""Distance of an eye from its base beyond which poses are not in metres."""
TRIMMED = 0.25
"""Share of the views that a fit leaves out: more than are ever wrong."""
LEAST_BASELINE_M = 1e-3
"""Minimum distance between the cameras of two eyes."""
ASIDE = 0.7
"""Minimum cosine between the line through the eyes and the head's y axis, of heads as built."""
USUAL_BASELINE_M = 0.02, 0.5
"""Range of baselines of heads."""
NAMED = 5
"""Number of worst views that a refusal names."""


@dataclass(frozen=True, eq=False)
class EyeViews:
    """N views of one eye's camera before the board that it sees most often at rest."""

    camera: str
    e: int
    """Index of the eye in EYES."""
    rows: np.ndarray
    """(N,) views."""
    T_cam_target: Array
    """(N, 4, 4)."""
    to_left: Array | None
    """(3,) unit vector in frame cam from the right camera towards the left one; None: no view shows
    the board to both."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was read in V views, how it is described, and what the images show."""

    kinematics: Kinematics
    readings: Array
    """(V, r)."""
    T_base_eye: Array | None
    """(V, 2, 4, 4) measured poses in place of readings."""
    eyes: tuple[EyeViews, ...]


@dataclass(frozen=True, eq=False)
class TurnFit:
    """How well what was read of one eye explains the turns of its camera."""

    turn_rad: float
    """Median turn between two views."""
    by_view: Array
    """(N,) misfit of each view [rad]; NaN where nothing was read."""
    gains: Mapping[str, float]
    """By reading how far the eye turns relative to it; of poses the length of their metre."""
    symptom: str
    """What is impossible; empty: nothing."""
    upright: float = 0.0
    """Cosine between the eye's y axis and the direction to the left."""

    @property
    def misfit_rad(self) -> float:
        """Median misfit of the views."""
        return float(np.nanmedian(self.by_view))

    @property
    def share(self) -> float:
        """Misfit relative to the turn; 1 if something is impossible."""
        return 1.0 if self.symptom else max(self.misfit_rad, EXACT_RAD) / self.turn_rad


def fit_eye(evidence: Evidence, views: EyeViews) -> TurnFit:
    """Fit what was read of an eye to the turns of its camera."""
    by_view = np.full(len(views.rows), np.nan)
    if evidence.T_base_eye is not None:
        T = evidence.T_base_eye[views.rows, views.e]
        known = known_poses(T)
        T, T_cam = T[known], views.T_cam_target[known]
        R, by_view[known], turn = fit_turns(T[:, :3, :3], T_cam[:, :3, :3])
        # Of poses that do not fit lengths mean nothing.
        metre = _metre(T, T_cam, R) if np.nanmedian(by_view) < NOISY * turn else 1.0
        symptom = f"by the images of {views.camera} a length of 1 in them measures {metre:.4g} m"
        possible = LENGTHS[0] < metre < LENGTHS[1]
        return TurnFit(turn, by_view, {"poses": metre}, "" if possible else symptom)
    kinematics, eye = evidence.kinematics, EYES[views.e]
    used, readings = kinematics.used(eye), evidence.readings[views.rows]
    known = np.asarray(np.isfinite(readings[:, used]).all(axis=1))
    if known.sum() < LEAST_VIEWS:
        return TurnFit(1.0, np.ones(len(known)), {}, "too few are known")
    readings, R_cam = readings[known], views.T_cam_target[known, :3, :3]
    gains, fits = _gains(kinematics, eye, readings[:, used], turns(R_cam)), []
    for factors in (1.0, gains):  # the linear fit of the gains is rough for large turns
        scaled = np.zeros_like(readings)
        scaled[:, used] = readings[:, used] * factors
        fits.append(fit_turns(eye_pose(kinematics, eye, scaled)[:, :3, :3], R_cam))
    R, by_view[known], turn = min(fits, key=lambda fit: np.median(fit[1]))
    to_left = np.array([-1.0, 0.0, 0.0]) if views.to_left is None else views.to_left
    upright, symptom = float(R[1] @ to_left), ""
    if R[0, 2] < AHEAD:
        symptom = f"by them {views.camera} would look backwards or aside out of its eye"
    elif views.to_left is not None and upright < 0:
        symptom = f"by them {views.camera} would stand on the wrong side of the other eye"
    of_names = {kinematics.readings[r]: float(g) for r, g in zip(used, gains, strict=True)}
    for name, gain in of_names.items():
        if not GAINS[0] < gain < GAINS[1]:
            symptom = f"{views.camera} turns by {gain:.3g} times the readings of {name}"
    return TurnFit(turn, by_view, of_names, symptom, upright)


def _gains(kinematics: Kinematics, eye: Side, readings: Array, turn: Array) -> Array:
    """Estimate how far each reading (N, u) of an eye turns it, relative to the description.

    Turns (N, 3) of a camera are linear in the readings as long as they are small. The fit starts
    from the views of usual readings.
    """
    away = np.abs(readings - np.median(readings, axis=0))
    off = (away / np.maximum(np.median(away, axis=0), 1e-9)).max(axis=1)
    rows = np.column_stack([readings, np.ones(len(readings))])
    w, kept = _trimmed(rows[:, None], turn[:, None], off)
    chain = kinematics.chains[eye]
    w, d = w[:-1], chain.mixing[:, kinematics.used(eye)].T @ chain.axes
    lengths = np.linalg.norm([w, d], axis=2)
    # A reading that turns the eye little, by the images and as described, has no gain of its own.
    turned = readings[kept].std(axis=0) * lengths
    still = (turned < 0.1 * turned.max(axis=1, keepdims=True)).all(axis=0)
    w[still] = 0.0
    R = nearest_rotation((w / np.maximum(lengths[0], 1e-12)[:, None]).T @ (d / lengths[1][:, None]))
    return np.where(still, 1.0, (w * (d @ R.T)).sum(axis=1) / lengths[1] ** 2)


def _metre(T_base_eye: Array, T_cam_target: Array, R: Array) -> float:
    """Measure the metre of measured poses (N, 4, 4) by the images, in metres.

    A board at rest stands at R_base_eye (R t_cam_target + t_X) + metre t_base_eye = p in all views,
    which is linear in t_X, the metre, and p. Where the eye turns about a point nothing but the
    distance of that point shows another unit.
    """
    R_base_eye, t_base_eye = T_base_eye[:, :3, :3], T_base_eye[:, :3, 3:]
    at_rest = np.broadcast_to(np.eye(3), R_base_eye.shape)
    rows = np.concatenate([-R_base_eye, -t_base_eye, at_rest], axis=2)
    lengths = np.maximum(np.linalg.norm(rows.reshape(-1, 7), axis=0), 1e-6)  # shorter is rounding
    if np.linalg.cond(rows.reshape(-1, 7) / lengths) > 1e4:
        far = float(np.median(np.linalg.norm(t_base_eye, axis=1)))
        return 1.0 if far < FARTHEST_M else METRES["millimetres"]
    right = R_base_eye @ R @ T_cam_target[:, :3, 3:]
    return float(_trimmed(rows, right, np.zeros(len(rows)))[0][3, 0])


def _trimmed(rows: Array, right: Array, off: Array) -> tuple[Array, np.ndarray]:
    """Solve rows (N, a, k) @ x = right (N, a, m) by least trimmed squares.

    The fit is to the share of views that it fits best, first to those of the smallest `off` (N,).
    Returns x (k, m) and which views (N,) it is to.
    """
    k, m = rows.shape[-1], right.shape[-1]
    x, kept = np.zeros((k, m)), off > np.inf
    for _ in range(10):
        kept = off <= np.quantile(off, 1 - TRIMMED)
        x = np.linalg.lstsq(rows[kept].reshape(-1, k), right[kept].reshape(-1, m))[0]
        off = np.linalg.norm(right - rows @ x, axis=(1, 2))
    return np.asarray(x, dtype=float), kept


def turns(R_cam_target: Array) -> Array:
    """Return the turns (N, 3) of a camera from the view in the middle of all [rad]."""
    R = R_cam_target
    middle = R[angle(R[:, None] @ np.swapaxes(R, 1, 2)).sum(axis=1).argmin()]
    return rotvec(middle @ np.swapaxes(R, 1, 2))  # the board at rest turns by the inverse


# The mistakes. Each yields what was mistaken, in words, and the evidence without the mistake.

Variants = Iterator[tuple[str, Evidence]]


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
    exchanged = [
        replace(views, e=1 - views.e, to_left=None if views.to_left is None else -views.to_left)
        for views in evidence.eyes
    ]
    of_images = replace(evidence, eyes=tuple(exchanged))
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
    """Other units, gears and factors: the readings times the gains that the images show."""
    factors, said = np.ones(evidence.readings.shape[1]), []
    for name, gain in {name: gain for fit in fits for name, gain in fit.gains.items()}.items():
        if GAINS[0] < gain < GAINS[1] or gain <= 0:
            continue
        factors[evidence.kinematics.readings.index(name)] = gain
        cure = "check its unit, its gear or factor, and its column"
        for unit, of_unit in UNITS.items():
            if GAINS[0] < gain / of_unit < GAINS[1]:
                cure = f"they are {unit}; set {_table(evidence)}.{name}.unit to {unit[:3]}"
        said.append(f"{name}: {cure}")
    if said:
        yield "; ".join(said), replace(evidence, readings=evidence.readings * factors)


def _lengths(evidence: Evidence, fits: list[TurnFit]) -> Variants:
    """Other units of length: the translations of the poses in metres of the images."""
    metre = float(np.median([fit.gains["poses"] for fit in fits]))
    what = "check their unit, and board.square_m"
    if metre < 0:
        what = "their coordinates are left-handed, or their translations point the other way"
    for unit, of_unit in METRES.items():
        if abs(metre / of_unit - 1) < UNIT_WITHIN:
            what = f"they are in {unit}; give metres"
    assert evidence.T_base_eye is not None
    T = evidence.T_base_eye.copy()
    T[..., :3, 3] *= metre
    yield what, replace(evidence, T_base_eye=T)


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


def _other_rows(evidence: Evidence, _: list[TurnFit]) -> Variants:
    """Rows of other images: of the next ones, or of images that are sorted by names as text."""
    count = len(evidence.readings)
    rows, T = np.arange(count), evidence.T_base_eye
    orders = [("they stand one row too late", rows + 1), ("they stand one row too early", rows - 1)]
    for first in (0, 1):
        as_text = sorted(rows, key=lambda row, first=first: str(row + first))
        orders.append(("the images are sorted as text (1, 10, 2)", np.array(as_text)))
    for what, order in orders:
        lost = (order < 0) | (order >= count)
        readings, poses = (x if x is None else x[order % count] for x in (evidence.readings, T))
        for each in (readings, poses):
            if each is not None:
                each[lost] = np.nan
        yield what, replace(evidence, readings=readings, T_base_eye=poses)


def _other_poses(evidence: Evidence, _: list[TurnFit]) -> Variants:
    """Poses of the base in the eye, transposed rotations, and quaternions in another order."""
    T = evidence.T_base_eye
    assert T is not None
    yield "they are inverted (T_eye_base)", replace(evidence, T_base_eye=inverse(T))
    known = known_poses(T)
    R, t = T[known][:, :3, :3], T[known][:, :3, 3]
    numbers = Rotation.from_matrix(R).as_quat()
    order = "their quaternions are in another order (x, y, z, w or w, x, y, z)"
    for what, other in (
        ("their rotations are transposed", np.swapaxes(R, 1, 2)),
        (order, Rotation.from_quat(np.roll(numbers, 1, axis=1)).as_matrix()),
        (order, Rotation.from_quat(np.roll(numbers, -1, axis=1)).as_matrix()),
    ):
        poses = T.copy()
        poses[known] = pose(other, t)
        yield what, replace(evidence, T_base_eye=poses)


Mistake = Callable[[Evidence, list[TurnFit]], Variants]
MISTAKES: Mapping[str, tuple[Mistake, ...]] = {
    "readings": (
        _signs,
        _exchanged_readings,
        _exchanged_eyes,
        _units,
        _orders_of_joints,
        _other_rows,
    ),
    "poses": (_exchanged_eyes, _lengths, _other_rows, _other_poses),
}
"""By what was read: the mistakes that can be undone."""


def _explain(evidence: Evidence) -> tuple[list[str], Evidence]:
    """Find the mistakes that explain the data clearly better, one after the other.

    Returns what they are, and the evidence without them.
    """
    said: list[str] = []
    kind = "readings" if evidence.T_base_eye is None else "poses"
    for _ in range(3):
        found = _best(evidence, MISTAKES[kind])
        if found is None:
            break
        said.append(found[0])
        evidence = found[1]
    return said, evidence


def _best(evidence: Evidence, table: tuple[Mistake, ...]) -> tuple[str, Evidence] | None:
    """Return the mistake whose undoing explains the data best; None: none does clearly better."""
    before = [fit_eye(evidence, views) for views in evidence.eyes]
    tried = []
    for what, other in (each for mistake in table for each in mistake(evidence, before)):
        after = [fit_eye(other, views) for views in other.eyes]
        better = _score(before) - _score(after)
        tried.append((better, sum(fit.upright for fit in after), what, other))
    best = max((better for better, *_ in tried), default=0.0)
    if best < np.log(CLEARLY_BETTER):
        return None
    tried = [each for each in tried if each[0] > best - np.log(ALIKE)]
    upright = max(each[1] for each in tried)
    tried = [each for each in tried if each[1] > upright - UPRIGHT]
    return ", or ".join(dict.fromkeys(what for *_, what, _ in tried)), tried[0][3]


def _score(fits: list[TurnFit]) -> float:
    """Return the log of the misfits; for normal noise a log likelihood per view and axis."""
    return float(np.log([fit.share for fit in fits]).sum())


def check_readings_and_images(
    observations: Observations, T_cam_target: Mapping[str, Array]
) -> None:
    """Refuse readings or measured poses that the images contradict, and say what they seem to be.

    T_cam_target has by camera the poses (V, 4, 4) of the board, NaN where not known. Moving rows
    are not compared, since a time offset looks like another row.
    """
    evidence = evidence_of(observations, T_cam_target)
    fits = [fit_eye(evidence, views) for views in evidence.eyes]
    if any(fit.symptom or fit.misfit_rad > CLEARLY_BETTER * EXACT_RAD for fit in fits):
        aligned = _aligned(evidence, observations)
        others = [fit_eye(aligned, views) for views in aligned.eyes]
        if _score(others) < _score(fits):
            evidence, fits = aligned, others
        said, explained = _explain(aligned)
        if said:
            after = max(fit_eye(explained, views).misfit_rad for views in explained.eyes)
            raise VergenceError(
                f"{_symptoms(evidence, fits, CLEARLY_BETTER * after)}: {'; '.join(said)}. They "
                f"then fit to {np.degrees(after):.2f} degrees."
            )
        wrong = [k for k, fit in enumerate(fits) if _is_wrong(fit)]
        if wrong:
            k = max(wrong, key=lambda k: fits[k].misfit_rad)
            raise VergenceError(
                f"{_symptoms(evidence, fits, NOISY * fits[k].misfit_rad)}. No usual mistake "
                "explains it: they may be of other moments or another eye, a sensor may stand "
                "still, the board may have moved, or the eye may have a joint that is not "
                "described; check the axes of its joints. The largest differences: "
                f"{_worst(observations, evidence.eyes[k], fits[k])}."
            )


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
        if len(rows) < LEAST_VIEWS or (e in found and len(rows) <= len(found[e].rows)):
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


def _aligned(evidence: Evidence, observations: Observations) -> Evidence:
    """Number the boards alike by the images alone, since what was read may be wrong."""
    eyes = []
    for views in evidence.eyes:
        T = views.T_cam_target.copy()
        T[:, :3, :3] = nearest_numbering(T[:, :3, :3], observations.board)
        eyes.append(replace(views, T_cam_target=T))
    return replace(evidence, eyes=tuple(eyes))


def _is_wrong(fit: TurnFit) -> bool:
    """Return whether no noise explains how little was read and seen agree."""
    share = fit.misfit_rad / fit.turn_rad
    if share < NOISY:
        return bool(fit.symptom)
    return share > UNRELATED or fit.misfit_rad > NOISY_RAD


def _symptoms(evidence: Evidence, fits: list[TurnFit], most_rad: float) -> str:
    """Say how what was read differs from the images, of eyes with a misfit beyond the largest."""
    read, said = "readings" if evidence.T_base_eye is None else "poses", []
    for views, fit in zip(evidence.eyes, fits, strict=True):
        symptom = fit.symptom or (
            f"they differ by {np.degrees(fit.misfit_rad):.2g} degrees in the median from the turns "
            f"of {views.camera} before a board at rest"
        )
        if fit.symptom or fit.misfit_rad > most_rad:
            said.append(f"the {read} of the {EYES[views.e]} eye ({symptom})")
    return f"Images contradict {listed(said) or f'the {read}'}"


def _worst(observations: Observations, views: EyeViews, fit: TurnFit) -> str:
    """Name the views that differ most, with their misfits."""
    worst = np.argsort(-np.nan_to_num(fit.by_view))[:NAMED]
    names = [observations.name_of_view(int(row)) for row in views.rows[worst]]
    off_deg = np.degrees(fit.by_view[worst])
    return ", ".join(f"{n} ({off:.2g} degrees)" for n, off in zip(names, off_deg, strict=True))


def implausible_geometry(head: HeadCalibration) -> list[Finding]:
    """Find eyes that a calibration puts where a head cannot have them."""
    if len({mounted.eye for mounted in head.cameras.values()}) < 2:
        return []
    findings = []
    across, t = float(angle(head.T_rbase_lbase[:3, :3])), eye_shift(head)
    if not head.kinematics.readings:  # which stand as they were built
        sentence = "The left camera stands to the right of the right one: exchange the two names."
        exchanged = t[1] < -ASIDE * np.linalg.norm(t)
        return [void("left-is-right", sentence, "T_rbase_lbase")] if exchanged else []
    if across > MOST_TURNED_RAD:
        sentence = (
            f"T_rbase_lbase: the bases of the eyes are turned by {np.degrees(across):.0f} degrees "
            "against each other, though the joints of both turn about the head's axes: check the "
            "signs and the columns of one eye's readings, and that they are zero at straight gaze."
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
        (np.abs(mixing[0] - mixing[1]) <= 0.2 * np.abs(mixing[0]).max(initial=0.0)).all()
    )
    left_end, right_end = (
        joints[-1].point_m if joints else np.zeros(3)
        for joints in (kinematics.eyes[eye] for eye in EYES)
    )
    if as_one or not np.array_equal(left_end, right_end):
        # A pair that turns as one, or joints elsewhere: the eyes are where their cameras are.
        T_lbase_leye, T_rbase_reye = T_lbase_leye @ left.T_eye_cam, T_rbase_reye @ right.T_eye_cam
    return (head.T_rbase_lbase @ T_lbase_leye)[:3, 3] - T_rbase_reye[:3, 3]
