"""Joint angles to poses: signs, order, imperfect axes, the neck."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drawn_head import four_cameras
from simulated_head import random_pan_tilt
from vergence.errors import VergenceError
from vergence.geometry.eye_motion import eye_linearised, eye_poses
from vergence.geometry.joints import Joint, change_joints, joint_parameters
from vergence.geometry.kinematics import (
    EYE_JOINTS,
    EYES,
    Chain,
    Kinematics,
    chain_pose,
    eye_pose,
    eye_turn,
    pan_tilt,
    reading_kinds,
    readings_to_turn,
)
from vergence.geometry.neck import Neck, head_pose
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import boxminus, hat, pose, rotation, transform
from vergence.stereo.extrinsics import rebase, relative_camera_pose

FORWARD, LEFT, UP = np.eye(3)
PAN, TILT = pan_tilt("left")
angle_pairs = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)).map(np.array)


def left_eye(angles: np.ndarray, *, pan: Joint = PAN, tilt: Joint = TILT) -> np.ndarray:
    """Return the pose of a left eye at pan and tilt."""
    kinematics = Kinematics({"left": (pan, tilt), "right": pan_tilt("right")})
    return eye_pose(kinematics, "left", np.concatenate([angles, 9 * np.ones_like(angles)], -1))


def test_positive_pan_looks_left_and_positive_tilt_looks_down():
    assert (left_eye(np.array([0.1, 0.0]))[:3, :3] @ FORWARD) @ LEFT > 0.09
    assert (left_eye(np.array([0.0, 0.1]))[:3, :3] @ FORWARD) @ UP < -0.09


@given(angle_pairs)
def test_pan_comes_first_about_axes_that_intersect(angles: np.ndarray):
    expected = rotation(angles[0] * UP) @ rotation(angles[1] * LEFT)
    np.testing.assert_allclose(left_eye(angles), pose(expected), atol=1e-14)


@given(angle_pairs)
def test_true_angles_are_gain_times_reading_plus_offset(reading: np.ndarray):
    pan, tilt = replace(PAN, gain=1.02, offset_rad=0.01), replace(TILT, gain=0.97, offset_rad=-0.02)
    true = np.array([1.02 * reading[0] + 0.01, 0.97 * reading[1] - 0.02])
    np.testing.assert_allclose(left_eye(reading, pan=pan, tilt=tilt), left_eye(true), atol=1e-14)


@given(angle_pairs)
def test_a_tilt_axis_out_of_square_turns_about_x(angles: np.ndarray):
    tilt_axis = rotation(angles[0] * UP) @ rotation(0.03 * FORWARD) @ LEFT
    R = left_eye(angles, tilt=replace(TILT, nonorthogonality_rad=0.03))[:3, :3]
    np.testing.assert_allclose(
        R, rotation(angles[1] * tilt_axis) @ rotation(angles[0] * UP), atol=1e-14
    )


@given(angle_pairs)
def test_a_tilt_axis_ahead_of_the_pan_axis_moves_with_pan_only(angles: np.ndarray):
    expected = 0.002 * (rotation(angles[0] * UP) @ FORWARD)
    T = left_eye(angles, tilt=replace(TILT, axis_distance_m=0.002))
    np.testing.assert_allclose(T[:3, 3], expected, atol=1e-17)


def random_chain(rng: np.random.Generator, joints: int, readings: int) -> Chain:
    """Return a chain whose angles are any linear combinations of readings."""
    axes = rng.normal(size=(joints, 3))
    return Chain(
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        points_m=rng.normal(size=(joints, 3)),
        end_m=rng.normal(size=3),
        mixing=rng.normal(size=(joints, readings)),
        offset_rad=rng.normal(0, 0.1, joints),
    )


def turned_one_after_the_other(chain: Chain, angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return where a point of the end's frame is in the base: the last joint turns it first."""
    at = point + chain.end_m
    for axis, centre, turn in reversed(list(zip(chain.axes, chain.points_m, angles, strict=True))):
        at = rotation(turn * axis) @ (at - centre) + centre
    return at


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 3))
def test_joints_may_share_readings(seed: int, joints: int, readings: int):
    rng = np.random.default_rng(seed)
    chain, read = random_chain(rng, joints, readings), rng.normal(size=readings)
    point = rng.normal(size=3)
    expected = turned_one_after_the_other(chain, chain.mixing @ read + chain.offset_rad, point)
    np.testing.assert_allclose(transform(chain_pose(chain, read), point), expected, atol=1e-13)


def slopes(function, at: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Return how poses (..., 4, 4) change with (..., n) by central differences (..., 6, n)."""
    columns = [
        (boxminus(function(at + d), function(at)) - boxminus(function(at - d), function(at)))
        / (2 * step)
        for d in step * np.eye(at.shape[-1])
    ]
    return np.stack(columns, axis=-1)


def random_eyes(
    rng: np.random.Generator, joints: int, readings: int = 3, *, parallel: bool = False
) -> Kinematics:
    """Return eyes whose joints turn about any axes, moved by any combination of readings."""
    names = tuple(f"r{k}" for k in range(readings))

    def joint(k: int) -> Joint:
        axis = np.eye(3)[k % 3] + rng.normal(0, 0.2, 3)
        if parallel:
            axis = np.array([0.0, 1.0, 0.02 * k])
        return Joint(
            name=f"j{k}",
            axis=axis / np.linalg.norm(axis),
            readings=dict(zip(names, rng.normal(size=readings).tolist(), strict=True)),
            point_m=rng.normal(0, 0.01, 3) + 0.1 * k,
        )

    own = {eye: tuple(joint(k) for k in range(joints)) for eye in EYES}
    off = {eye: rng.normal(0, 0.05, len(joint_parameters(own[eye]))) for eye in EYES}
    return Kinematics({eye: change_joints(own[eye], off[eye]) for eye in EYES}, names)


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.booleans())
def test_the_jacobians_of_an_eye_agree_with_differences(seed: int, joints: int, parallel: bool):
    rng = np.random.default_rng(seed)
    kinematics = random_eyes(rng, joints, parallel=parallel)
    readings = rng.uniform(-0.5, 0.5, (5, 3))
    T, by_errors, by_readings = eye_linearised(kinematics, "left", readings)
    np.testing.assert_array_equal(T, eye_pose(kinematics, "left", readings))

    def with_errors(change: np.ndarray) -> np.ndarray:
        eyes = kinematics.eyes | {"left": change_joints(kinematics.eyes["left"], change)}
        return eye_pose(Kinematics(eyes, kinematics.readings), "left", readings)

    expected = slopes(lambda each: eye_pose(kinematics, "left", each), readings)
    np.testing.assert_allclose(by_readings, expected, atol=1e-7)
    if joints:
        expected = slopes(with_errors, np.zeros(by_errors.shape[-1]))
        np.testing.assert_allclose(by_errors, expected, atol=1e-7)
    else:
        assert by_errors.shape == (5, 6, 0)
    one = eye_linearised(kinematics, "left", readings[1])
    np.testing.assert_allclose(one[1], by_errors[1], atol=1e-15)


def test_a_chain_serves_many_postures():
    rng = np.random.default_rng(1)
    kinematics, angles = random_pan_tilt(rng), rng.normal(size=(3, 5, 4))
    T = eye_pose(kinematics, "right", angles)
    assert T.shape == (3, 5, 4, 4)
    np.testing.assert_allclose(T[2, 4], eye_pose(kinematics, "right", angles[2, 4]), atol=1e-15)
    fixed = Chain(np.empty((0, 3)), np.empty((0, 3)), np.ones(3), np.empty((0, 0)), np.empty(0))
    np.testing.assert_array_equal(chain_pose(fixed, np.empty((7, 0)))[6], pose(t=np.ones(3)))


HEAD = four_cameras()
POSTURE = np.array([0.0, 0.0, 0.0, 0.1, 0.02, -0.1, 0.02])
"""The neck's three joints, then the eyes' four."""
POINT = np.array([0.6, 0.0, 0.0])


@pytest.mark.parametrize("wrong", [POSTURE, np.zeros((5, 3)), np.zeros((4, 5)), 0.1, []])
@pytest.mark.parametrize(
    "find",
    [
        lambda joints: eye_pose(HEAD.kinematics, "left", joints),
        lambda joints: eye_linearised(HEAD.kinematics, "right", joints),
        lambda joints: project_point(HEAD, "left_wide", joints, POINT),
        lambda joints: relative_camera_pose(HEAD, joints),
        lambda joints: rebase(HEAD, np.eye(4), joints=joints),
        lambda joints: eye_poses(HEAD, joints),
    ],
)
def test_readings_that_are_not_as_many_as_the_heads_are_refused(find, wrong):
    shape = str(np.shape(wrong)).replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(VergenceError, match=f"readings left_pan, left_tilt.* found .*{shape}"):
        find(wrong)


def shared_tilt() -> Kinematics:
    """Return eyes that tilt together and pan each by itself, in this order."""
    eyes = {}
    for eye in EYES:
        tilt = Joint(name="tilt", axis=LEFT, readings={"tilt": 1.0})
        eyes[eye] = tilt, Joint(name="pan", axis=UP, readings={f"{eye}_pan": 1.0})
    return Kinematics(eyes, ("tilt", "left_pan", "right_pan"))


def version_and_vergence() -> Kinematics:
    """Return eyes that are read by their mean angle and their difference."""
    eyes = {}
    for eye, sign in zip(EYES, (0.5, -0.5), strict=True):
        pan = Joint(name="pan", axis=UP, readings={"version": 1.0, "vergence": sign})
        eyes[eye] = pan, Joint(name="tilt", axis=LEFT, readings={"tilt": 1.0})
    return Kinematics(eyes, ("version", "vergence", "tilt"))


def test_readings_that_eyes_share_have_kinds_of_their_own():
    assert reading_kinds(Kinematics()) == [0, 1, 0, 1]
    assert reading_kinds(shared_tilt()) == [1, 0, 0]
    assert reading_kinds(version_and_vergence()) == [0, 1, 2]


def test_readings_of_one_kind_turn_joints_that_are_built_alike():
    pan, tilt = pan_tilt("right")
    turned_round = Kinematics({"left": pan_tilt("left"), "right": (tilt, pan)})
    assert reading_kinds(turned_round) == [0, 1, 0, 1]
    geared = tuple(
        replace(joint, readings={name: 0.01 for name in joint.readings})
        for joint in pan_tilt("left")
    )
    assert reading_kinds(Kinematics({"left": geared, "right": (pan, tilt)})) == [0, 1, 2, 3]
    roll = Joint(name="roll", axis=FORWARD, readings={"right_roll": 1.0})
    three = Kinematics(
        {"left": pan_tilt("left"), "right": (tilt, roll, pan)}, (*EYE_JOINTS, "right_roll")
    )
    assert reading_kinds(three) == [0, 1, 0, 1, 2]


def test_both_eyes_turn_by_the_readings_that_are_asked_for():
    turn = np.array([0.0, 0.02, -0.03])
    for kinematics in (Kinematics(), shared_tilt(), version_and_vergence()):
        readings = readings_to_turn(kinematics, turn)
        for eye in EYES:
            np.testing.assert_allclose(eye_turn(kinematics, eye, readings), turn, atol=1e-15)
    np.testing.assert_allclose(readings_to_turn(Kinematics(), turn), [-0.03, 0.02] * 2, atol=1e-15)
    np.testing.assert_allclose(
        readings_to_turn(version_and_vergence(), turn), [-0.03, 0, 0.02], atol=1e-15
    )


def test_joints_about_nearly_one_axis_are_not_turned_against_each_other():
    """A neck's yaw and a geared pan, off by 5 mrad: together they would tilt, by 200 times it."""
    yaw = Joint(name="yaw", axis=UP, readings={"yaw": 1.0}, point_m=-FORWARD)
    eyes = {
        eye: (
            yaw,
            Joint(name="pan", axis=rotation([0.005, 0, 0]) @ UP, readings={f"{eye}_pan": 0.02}),
        )
        for eye in EYES
    }
    kinematics = Kinematics(eyes, ("yaw", "left_pan", "right_pan"))
    turn = np.array([0.0, 0.2, 0.2])
    readings = readings_to_turn(kinematics, turn)
    assert np.abs(readings * [1, 0.02, 0.02]).max() < 0.2
    for eye in EYES:
        found = eye_turn(kinematics, eye, readings)
        np.testing.assert_allclose(found, [0, 0, 0.2], atol=0.002)


def test_all_that_parallel_axes_may_differ_by_is_estimated_once():
    """None of the errors of the joints is a combination of others, or of base and mounting."""
    rng = np.random.default_rng(3)
    for kinds in ("zy", "yyz", "zyyx", "zyyyx"):
        joints = tuple(
            Joint(
                name=f"j{k}",
                axis=np.eye(3)["xyz".index(kind)],
                readings={f"r{k}": 1.0},
                point_m=np.array([0.1 * k, 0.0, 0.05 * k * k]),
            )
            for k, kind in enumerate(kinds)
        )
        names = tuple(f"r{k}" for k in range(len(kinds)))
        eyes = Kinematics({"left": joints, "right": ()}, names)
        T, by_errors, _ = eye_linearised(eyes, "left", rng.uniform(-1, 1, (40, len(kinds))))
        errors = joint_parameters(joints)
        turns = [(0, "offset_rad"), (len(kinds) - 1, "offset_rad")]
        kept = [n for n, error in enumerate(errors) if error not in turns]
        # The base may be anywhere before the joints, and the cameras anywhere behind them.
        base, mount = np.zeros((2, len(T), 6, 6))
        base[:] = np.eye(6)
        base[:, 3:, :3] = -hat(T[:, :3, 3])
        mount[:, :3, :3] = mount[:, 3:, 3:] = T[:, :3, :3]
        J = np.concatenate([base, mount, by_errors[..., kept]], axis=-1)
        _, s, _ = np.linalg.svd(J.reshape(-1, J.shape[-1]), full_matrices=False)
        assert (s > 1e-6 * s[0]).sum() == J.shape[-1], kinds


def test_a_joint_needs_a_unit_axis_and_a_reading():
    with pytest.raises(ValidationError, match="unit vector, found 2"):
        Joint(name="pan", axis=2 * UP, readings={"pan": 1.0})
    for gain, factor in ((0.0, 1.0), (1.0, 1e-320)):
        with pytest.raises(ValidationError, match="no reading moves joint pan"):
            Joint(name="pan", axis=UP, readings={"pan": factor}, gain=gain)
    with pytest.raises(ValidationError, match="no reading moves joint pan"):
        Joint(name="pan", axis=UP, readings={"pan": 0.0})


def test_a_gain_of_several_readings_is_multiplied_into_their_factors():
    joint = Joint(name="pan", axis=UP, readings={"version": 1.0, "vergence": 0.5}, gain=1.02)
    assert joint.gain == 1
    assert joint.readings == {"version": 1.02, "vergence": 0.51}


def test_each_neck_joint_carries_those_after_it():
    neck = Neck(
        axes=np.array([LEFT, FORWARD, UP]),
        points_m=np.array([[0.0, 0, 0.1], [0, 0, 0.2], [0, 0, 0.3]]),
        head_m=np.array([0.05, 0, 0.35]),
    )
    angles, point = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, 0.3])
    chain = Chain(neck.axes, neck.points_m, neck.head_m, np.eye(3), np.zeros(3))
    expected = turned_one_after_the_other(chain, angles, point)
    np.testing.assert_allclose(transform(head_pose(neck, angles), point), expected, atol=1e-15)


def test_the_neck_at_zero_only_shifts_and_without_a_neck_the_head_is_the_body():
    neck = Neck(axes=np.eye(3), points_m=np.ones((3, 3)), head_m=np.array([1.0, 2, 3]))
    np.testing.assert_array_equal(head_pose(neck, np.zeros((4, 3)))[2], pose(t=[1, 2, 3]))
    np.testing.assert_array_equal(head_pose(Neck(), np.zeros((2, 0)))[1], np.eye(4))
