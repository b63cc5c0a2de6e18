"""Readings, poses, images and descriptions that are mistaken are refused with their cause."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from head_kinds import head_of, recording
from simulated_head import plain_head
from simulated_recording import BOARD, POINTS, Noise, Recording, as_poses, record
from test_other_heads import LENS, on_an_arm
from test_other_heads import recorded as recorded_of
from texts import texts
from turned_boards import turned_at_random
from vergence.arrays import Array
from vergence.calibration.calibrate import calibrate
from vergence.calibration.observations import Observations
from vergence.calibration.plausibility import check_readings_and_images, implausible_geometry
from vergence.calibration.prepared_views import prepare
from vergence.data.timing import Timing
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side, pan_tilt
from vergence.geometry.parameters import boxminus
from vergence.geometry.se3 import inverse, pose, rotation
from vergence.vision.board_pose import board_poses

Change = Callable[[Observations], Observations]
GOOD = Recording(reach_rad=(0.3, 0.3), noise=Noise(pixel_px=0.1, joint_rad=np.radians(0.2)))


def recorded(
    seed: int = 0, *, alike: bool = False, apart_rad: float = 0.0
) -> tuple[HeadCalibration, Observations]:
    """Return a head and what it observes, with eyes that move each by itself, or alike."""
    return recorded_of(seed, how=replace(GOOD, alike=alike, apart_rad=apart_rad))


def of_kind(kind: str) -> Observations:
    """Return what a head with some kind of joints observes."""
    if kind == "arm":
        return on_an_arm(8)[1]
    if kind == "poses":
        return as_poses(recorded_of(1)[1])
    if kind in ("alike", "apart"):
        return recorded(alike=kind == "alike")[1]
    rng = np.random.default_rng(5)
    return recording(head_of(kind, rng), rng)


def columns(matrix: Array) -> Change:
    """Multiply the readings (V, r) by a matrix (r, r)."""
    return lambda seen: replace(seen, eye_angles=seen.eye_angles @ matrix)


def scale(column: int, factor: float) -> Change:
    def change(seen: Observations) -> Observations:
        factors = np.where(np.arange(seen.eye_angles.shape[1]) == column, factor, 1.0)
        return replace(seen, eye_angles=seen.eye_angles * factors)

    return change


def exchange(a: int, b: int) -> Change:
    def change(seen: Observations) -> Observations:
        order = np.arange(seen.eye_angles.shape[1])
        order[[a, b]] = b, a
        return replace(seen, eye_angles=seen.eye_angles[:, order])

    return change


def rows(order: Callable[[Array], Array]) -> Change:
    """Move readings or poses to other rows."""

    def change(seen: Observations) -> Observations:
        T = seen.T_base_eye
        return replace(
            seen, eye_angles=order(seen.eye_angles), T_base_eye=None if T is None else order(T)
        )

    return change


def poses(change: Callable[[Array], Array]) -> Change:
    def changed(seen: Observations) -> Observations:
        assert seen.T_base_eye is not None
        return replace(seen, T_base_eye=change(seen.T_base_eye.copy()))

    return changed


def lengths(factor: float, shift_m: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Change:
    return poses(lambda T: pose(T[..., :3, :3], factor * (T[..., :3, 3] + shift_m)))


def quaternions(by: int) -> Change:
    """Read the numbers of quaternions in another order."""

    def change(T: Array) -> Array:
        numbers = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat()
        R = Rotation.from_quat(np.roll(numbers, by, axis=1)).as_matrix()
        return pose(R.reshape(T[..., :3, :3].shape), T[..., :3, 3])

    return poses(change)


def joints(change: Callable[[tuple[Joint, ...]], tuple[Joint, ...]]) -> Change:
    """Change the description of both eyes."""

    def changed(seen: Observations) -> Observations:
        eyes: dict[Side, tuple[Joint, ...]] = {
            eye: change(seen.kinematics.eyes[eye]) for eye in EYES
        }
        return replace(seen, kinematics=Kinematics(eyes, seen.kinematics.readings))

    return changed


def other_eyes_images(seen: Observations) -> Observations:
    left, right = seen.corners["left_wide"], seen.corners["right_wide"]
    return replace(seen, corners={"left_wide": right, "right_wide": left})


def left_images_twice(seen: Observations) -> Observations:
    left = seen.corners["left_wide"]
    return replace(seen, corners={"left_wide": left, "right_wide": left.copy()})


def separate_tilts(seen: Observations) -> Observations:
    """Describe a tilt that both eyes share as a tilt of each, behind its pan."""
    tilt, left, right = seen.eye_angles.T
    readings = np.stack([left, tilt, right, tilt], axis=1)
    return replace(seen, eye_angles=readings, kinematics=Kinematics())


def without_roll(seen: Observations) -> Observations:
    """Describe eyes that pan, tilt and roll as eyes that pan and tilt."""
    return replace(seen, eye_angles=seen.eye_angles[:, [0, 1, 3, 4]], kinematics=Kinematics())


def whole_vergence(eye: tuple[Joint, ...]) -> tuple[Joint, ...]:
    pan, tilt = eye
    return replace(pan, readings={"version": 1.0, "vergence": 2 * pan.readings["vergence"]}), tilt


def copied(source: int, to: int) -> Change:
    return lambda seen: replace(
        seen,
        eye_angles=np.where(
            np.arange(seen.eye_angles.shape[1]) == to,
            seen.eye_angles[:, [source]],
            seen.eye_angles,
        ),
    )


def shuffled(values: Array) -> Array:
    return np.random.default_rng(0).permutation(values)


def as_text(first: int) -> Callable[[Array], Array]:
    """Read values in the order of their numbers, with images in that of 1, 10, 2."""

    def change(values: Array) -> Array:
        by_number = np.empty_like(values)
        by_number[sorted(range(len(values)), key=lambda row: str(row + first))] = values
        return by_number

    return change


PLAIN, TILT, VERGENCE = "pan, tilt", "shared tilt, pan", "version and vergence"
ROLL, NECK, TWO_TILTS = "pan, tilt, roll", "pair on a neck", "neck tilt, tilt, pan"
DEG = np.degrees(1.0)
WRONG: list[tuple[str, Change, str]] = [
    # Signs.
    (PLAIN, scale(0, -1), "left_pan counts the other way; set joints.left_pan.sign"),
    (PLAIN, scale(3, -1), "right_tilt counts the other way"),
    (PLAIN, columns(np.diag([-1, -1, 1, 1])), "left_pan and left_tilt count the other way"),
    (TILT, scale(0, -1), "tilt counts the other way; set readings.tilt.sign"),
    (VERGENCE, scale(1, -1), "vergence counts the other way"),
    (NECK, scale(1, -1), "neck_tilt counts the other way"),
    (ROLL, scale(1, -1), "left_tilt counts the other way"),
    (TWO_TILTS, scale(1, -1), "tilt counts the other way"),
    # Columns.
    (PLAIN, exchange(0, 1), "left_pan and left_tilt are exchanged"),
    (PLAIN, exchange(1, 2), "left_tilt and right_pan are exchanged"),
    (VERGENCE, exchange(0, 1), "version and vergence are exchanged"),
    (ROLL, exchange(1, 5), "left_tilt and right_roll are exchanged"),
    ("apart", columns(np.eye(4)[[2, 3, 0, 1]]), "in the columns of the joint readings"),
    (PLAIN, scale(1, 0.0), "readings of the left eye .* a sensor may stand still"),
    (ROLL, copied(0, 3), "readings of the right eye .* a sensor may stand still"),
    # Images.
    (PLAIN, other_eyes_images, "exchanged in the images"),
    (VERGENCE, other_eyes_images, "exchanged in the images"),
    ("alike", other_eyes_images, "exchanged in the images"),
    (PLAIN, left_images_twice, "stand in the same place"),
    # Units and gears.
    (PLAIN, scale(0, DEG), "left_pan: they are degrees; set joints.left_pan.unit to deg"),
    (PLAIN, scale(3, 1 / DEG), "right_tilt: they are radians"),
    (PLAIN, scale(2, 1 / 3), "times the readings of right_pan.*check its unit, its gear"),
    (VERGENCE, scale(1, DEG), "vergence: they are degrees"),
    (VERGENCE, joints(whole_vergence), "vergence: check its unit, its gear or factor"),
    # Joints.
    (PLAIN, joints(lambda eye: eye[::-1]), "fit pan before tilt"),
    (TILT, joints(lambda eye: eye[::-1]), "fit tilt before pan"),
    (TILT, separate_tilts, "fit tilt before pan"),
    (ROLL, joints(lambda eye: (eye[0], eye[2], eye[1])), "fit pan before tilt before roll"),
    (PLAIN, joints(lambda eye: (eye[0], replace(eye[1], axis=np.eye(3)[0]))), "check the axes"),
    (ROLL, without_roll, "a joint that is not described"),
    # Rows.
    (PLAIN, rows(lambda each: np.roll(each, 1, axis=0)), "one row too late"),
    (TILT, rows(lambda each: np.roll(each, -1, axis=0)), "one row too early"),
    (PLAIN, rows(as_text(0)), r"the images are sorted as text \(1, 10, 2\)\. They then fit"),
    (PLAIN, rows(shuffled), r"other moments or another eye.*view \d+ \(\d+ degrees\)"),
    # Measured poses.
    ("arm", poses(inverse), "they are inverted"),
    ("arm", rows(lambda each: np.roll(each, 1, axis=0)), "one row too late"),
    ("arm", rows(lambda each: np.roll(each, -1, axis=0)), "one row too early"),
    ("arm", rows(as_text(1)), "the images are sorted as text"),
    ("arm", rows(shuffled), r"other moments or another eye.*view \d+ \(\d+ degrees\)"),
    ("arm", quaternions(1), "quaternions are in another order"),
    ("arm", quaternions(-1), "quaternions are in another order"),
    ("arm", lengths(1e3), "they are in millimetres; give metres"),
    ("arm", lengths(100), "they are in centimetres"),
    ("arm", lengths(-1), "left-handed, or their translations point the other way"),
    ("arm", lengths(1.5), "measures 0.66.* m.: check their unit, and board.square_m"),
    ("poses", rows(lambda each: np.roll(each, 1, axis=0)), "one row too late"),
    ("poses", lengths(1e3, (0.03, 0.0, 0.12)), "they are in millimetres"),
]


@pytest.mark.parametrize(("kind", "change", "cause"), WRONG)
def test_a_mistake_is_refused_with_its_cause(kind: str, change: Change, cause: str):
    with pytest.raises(VergenceError, match=re.compile(cause, re.DOTALL)):
        prepare(change(of_kind(kind)), "bundle", LENS)


@pytest.mark.parametrize("kind", ["apart", TILT, VERGENCE, ROLL, NECK, TWO_TILTS, "arm", "poses"])
def test_what_is_as_described_passes(kind: str):
    assert prepare(of_kind(kind), "bundle", LENS).observations.findings == ()


@pytest.mark.parametrize("roll_deg", [90, -135, 180])
def test_a_wrong_sign_is_named_however_the_cameras_are_rolled(roll_deg: float):
    truth, _ = recorded()
    roll = pose(rotation([0, 0, np.radians(roll_deg)]))
    cameras = {n: replace(m, T_eye_cam=m.T_eye_cam @ roll) for n, m in truth.cameras.items()}
    seen = record(replace(truth, cameras=cameras), np.random.default_rng(3), GOOD)
    with pytest.raises(VergenceError, match="left_tilt counts the other way"):
        prepare(scale(1, -1)(seen), "bundle", LENS)


def poses_by(head: HeadCalibration, seen: Observations) -> dict[str, Array]:
    return {
        name: board_poses(head.cameras[name].intrinsics, corners, POINTS)
        for name, corners in seen.corners.items()
    }


def test_readings_that_are_missing_lost_or_not_needed_do_not_matter():
    truth, seen = recorded(2)
    angles = seen.eye_angles.copy()
    angles[[-10, -3]], angles[20, 0] = 2.5, np.nan
    check_readings_and_images(replace(seen, eye_angles=angles), poses_by(truth, seen))
    left = replace(seen, corners={"left_wide": seen.corners["left_wide"]})
    for sign in (1, -1):
        wrong = replace(left, eye_angles=seen.eye_angles * [1, sign, np.nan, np.nan])
        if sign == 1:
            check_readings_and_images(wrong, poses_by(truth, left))
            continue
        with pytest.raises(VergenceError, match="left_tilt counts the other way"):
            check_readings_and_images(wrong, poses_by(truth, left))


@given(st.integers(0, 10**6))
@settings(max_examples=10)
def test_good_readings_are_never_refused(seed: int):
    truth, seen = recorded(seed, alike=bool(seed % 2))
    seen = turned_at_random(seen, np.random.default_rng(seed))
    check_readings_and_images(seen, poses_by(truth, seen))


def test_an_eye_without_readings_is_named():
    _, seen = recorded()
    angles = seen.eye_angles.copy()
    angles[:, 0] = np.nan
    with pytest.raises(VergenceError, match=r"left eye sees a board in view \d+, but its joint"):
        calibrate(replace(seen, eye_angles=angles), lens=LENS)


def test_eyes_that_moved_nearly_alike_are_told_apart():
    """By 0.6 degrees apart, with 0.2 of noise in each reading."""
    swap = columns(np.eye(4)[[2, 3, 0, 1]])
    _, seen = recorded(alike=True, apart_rad=0.01)
    assert prepare(seen, "bundle", LENS).observations.findings == ()
    with pytest.raises(VergenceError, match="exchanged in the columns of the joint readings"):
        prepare(swap(seen), "bundle", LENS)


@pytest.mark.usefixtures("two_folds")
@pytest.mark.parametrize("change", ["exchanged", "copied"])
def test_single_poses_of_other_rows_are_named_and_left_out(change: str):
    seen = replace(on_an_arm(8)[1], lines=np.arange(24) + 2)
    order = np.arange(24)
    if change == "exchanged":
        order[[4, 9]] = [9, 4]
    else:
        order[6] = 7
    wrong = np.flatnonzero(order != np.arange(24))
    found = calibrate(rows(lambda each: each[order])(seen), lens=LENS)
    named = [each for each in found.findings if each.code == "wrong-view"]
    assert ", ".join(each.where for each in named) == ", ".join(f"line {k + 2}" for k in wrong)
    assert {each.severity for each in named} == {"note"}
    assert not found.accuracy.void


def test_a_time_offset_of_moving_eyes_is_not_taken_for_another_row():
    """It is estimated."""
    seen = on_an_arm(8)[1]
    assert seen.T_base_eye is not None
    phase = np.linspace(0, 6 * np.pi, 60)[:, None]
    turns = 0.3 * np.sin(phase + np.arange(3))
    late = pose(rotation(turns), 0.1 * turns)
    true = np.concatenate([np.roll(late, -1, axis=0), seen.T_base_eye[:, 0]])
    read = np.concatenate([late, seen.T_base_eye[:, 0]])
    V, K = len(read), len(POINTS)
    moving = Observations(
        board=BOARD,
        placement=np.zeros(V, int),
        eye_angles=np.full((V, 4), np.nan),
        corners={"left_wide": np.zeros((V, K, 2))},
        sizes={"left_wide": (640, 480)},
        timing=Timing(np.arange(V) / 30, (np.arange(V) < 60).astype(int)),
        T_base_eye=np.stack([read, read], axis=1),
    )
    T_base_target = pose(rotation([0.3, 0.2, 0.0]), [-0.12, -0.08, 0.5])
    poses = {"left_wide": inverse(true) @ T_base_target}
    check_readings_and_images(moving, poses)


@pytest.mark.parametrize("change", ["mirrored", "longer"])
def test_poses_that_are_no_rotations_are_refused_when_observations_are_made(change: str):
    factors = np.array([1, -1, 1]) if change == "mirrored" else 1.02
    seen = on_an_arm(8)[1]
    with pytest.raises(VergenceError, match="T_base_eye: expected a rigid transform"):
        poses(lambda T: pose(T[..., :3, :3] * factors, T[..., :3, 3]))(seen)


def test_eyes_above_each_other_are_those_of_a_head_on_its_side():
    """Else the result is void: they look like eyes whose images or readings are exchanged."""
    truth, _ = recorded()
    above = replace(truth, T_rbase_lbase=pose(t=[0.0, -0.002, 0.08]))
    (found,) = implausible_geometry(above)
    assert (found.severity, found.code) == ("void", "eyes-not-beside")
    assert "describe by `kinematics` a head that lies on its side" in found.sentence
    on_side = {"pan": np.array([0.0, 1.0, 0.0]), "tilt": np.array([0.0, 0.0, -1.0])}
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(replace(joint, axis=on_side[joint.name]) for joint in pan_tilt(eye))
        for eye in EYES
    }
    seen = record(above, np.random.default_rng(0), GOOD)
    found = calibrate(replace(seen, kinematics=Kinematics(eyes)), method="paper", lens=LENS)
    assert found.accuracy.void == ()
    np.testing.assert_allclose(found.head.T_rbase_lbase[:3, 3], [0, 0.08, 0.002], atol=0.003)


def test_odd_heads_are_named_in_plain_numbers():
    assert implausible_geometry(plain_head(0.08, 300.0)) == []
    (said,) = texts(implausible_geometry(plain_head(1.0, 300.0)))
    assert said.startswith("The eyes came out 1000.0 mm apart")
    turned = replace(
        plain_head(0.08, 300.0), T_rbase_lbase=pose(rotation([0, 0, 3.0]), [0, 0.08, 0])
    )
    assert "bases-turned" in {each.code for each in implausible_geometry(turned)}


SPOILT = {
    "signs": lambda angles, rng: angles * rng.choice([-1.0, 1.0], 4),
    "columns": lambda angles, rng: angles[:, rng.permutation(4)],
    "units": lambda angles, rng: angles * rng.choice([1.0, DEG, 1 / DEG], 4),
    "a dead joint": lambda angles, rng: np.where(np.arange(4) == rng.integers(4), 0.0, angles),
    "noise": lambda angles, rng: angles + rng.normal(0, 0.3, angles.shape),
    "another order": lambda angles, rng: rng.permutation(angles),
}


@pytest.mark.slow
@pytest.mark.usefixtures("two_folds")
@given(seed=st.integers(0, 10**6), how=st.sampled_from(sorted(SPOILT)), images=st.booleans())
@settings(max_examples=8)
def test_spoilt_readings_end_in_words_or_in_the_truth(seed: int, how: str, images: bool):
    rng = np.random.default_rng(seed)
    truth, seen = recorded(seed % 5, alike=bool(rng.integers(2)))
    seen = replace(seen, eye_angles=SPOILT[how](seen.eye_angles, rng))
    if images:
        seen = other_eyes_images(seen)
    try:
        found = calibrate(seen, lens=LENS)
    except VergenceError:
        return
    if not texts(found.findings):
        off = boxminus(found.head, truth)
        for part, most in (("T_eye_cam.r", np.radians(1)), ("T_rbase_lbase.t", 0.005)):
            assert max(abs(value) for name, value in off.items() if part in name) < most
