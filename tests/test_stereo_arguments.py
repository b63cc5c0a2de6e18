"""What stereo with moving eyes takes as arguments, and what it says of others."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import plain_head, skewed_head
from test_triangulation import random_samples
from vergence.errors import VergenceError
from vergence.gaze.foveation import gaze_angles
from vergence.geometry.head import HeadCalibration
from vergence.geometry.neck import Neck
from vergence.geometry.projection import project_point
from vergence.stereo.extrinsics import base_extrinsics, relative_camera_pose
from vergence.stereo.rectification import rectify
from vergence.stereo.triangulation import in_body, in_head, triangulate_at
from vergence.stereo.uncertainty import joints_at_images, locate


@pytest.fixture
def head() -> HeadCalibration:
    return skewed_head(np.random.default_rng(0))


def test_a_path_in_place_of_a_head_is_refused():
    pixels = np.zeros((1, 2))
    for use in (
        lambda head: locate(head, left=pixels, right=pixels, joints=np.zeros(4)),
        lambda head: rectify(head, np.zeros(4)),
    ):
        with pytest.raises(VergenceError, match=r"such as of load_head\(path\); found 'head.json'"):
            use("head.json")


@pytest.mark.parametrize(
    "function",
    [
        *(locate, triangulate_at, base_extrinsics),
    ],
)
def test_arguments_that_could_be_exchanged_must_be_named(function):
    """Exchanged, they would give an answer all the same."""
    pixels = np.zeros((1, 2))
    with pytest.raises(TypeError, match="positional argument"):
        function(plain_head(0.09, 280.0), pixels, pixels, np.zeros((1, 4)), np.eye(4))


def test_what_are_no_numbers_is_refused_by_name(head: HeadCalibration):
    pixels, joints = np.zeros((1, 2)), np.zeros(4)
    for name, given in (
        ("left", {"left": "a", "right": pixels, "joints": joints}),
        ("right", {"left": pixels, "right": [[1, 2], [3]], "joints": joints}),
        ("joints", {"left": pixels, "right": pixels, "joints": {"left_pan": 0.1}}),
        ("pixel_std_px", {"left": pixels, "right": pixels, "joints": joints, "pixel_std_px": "x"}),
    ):
        with pytest.raises(VergenceError, match=f"^{name} takes numbers, as many in each row"):
            locate(head, **given)
    for use in (
        lambda: rectify(head, "x"),  # pyright: ignore
        lambda: project_point(head, "left_wide", "x", np.ones(3)),  # pyright: ignore
    ):
        with pytest.raises(VergenceError, match="joints takes numbers"):
            use()
    with pytest.raises(VergenceError, match="points takes numbers"):
        in_head(head, [[1.0, 2.0, 3.0], "far"])  # pyright: ignore


def test_exchanged_cameras_and_a_head_of_one_eye_are_refused():
    head, nothing = plain_head(0.09, 280.0), {"left": np.zeros((1, 2)), "right": np.zeros((1, 2))}
    for cameras in (("right_wide", "left_wide"), ("left_wide", "left_wide")):
        with pytest.raises(VergenceError, match="left eye and one of the right, in this order"):
            locate(head, **nothing, joints=np.zeros(4), cameras=cameras)
    for names in ("left_wide", ("left_wide",), ()):
        for use in (
            lambda names=names: locate(head, **nothing, joints=np.zeros(4), cameras=names),
            lambda names=names: rectify(head, np.zeros(4), cameras=names),
        ):
            with pytest.raises(VergenceError, match="left eye and one of the right, in this order"):
                use()
    alone = replace(head, cameras={"left_wide": head.cameras["left_wide"]})
    with pytest.raises(VergenceError, match="Stereo needs a camera in each eye"):
        locate(alone, **nothing, joints=np.zeros(4))


def test_angles_that_are_not_those_of_the_neck_are_refused(head: HeadCalibration):
    point, without = np.array([1.0, 0.1, 0.2]), replace(head, neck=Neck())
    assert in_body(without, point, np.empty(0)).shape == (3,)
    for own, angles, found in (
        (head, np.zeros(2), r"has 3 joints; found an array of angles of shape \(2,\)"),
        (head, np.zeros(7), r"has 3 joints; found an array of angles of shape \(7,\)"),
        (head, 0.1, r"has 3 joints; found an array of angles of shape \(\)"),
        (head, np.array([0.0, 10.0, 0.0]), "are in radians; found a joint at 10, more than a turn"),
        (without, np.zeros(3), r"has 0 joints; found an array of angles of shape \(3,\)"),
    ):
        with pytest.raises(VergenceError, match=found):
            in_body(own, point, angles)


def test_readings_in_degrees_are_refused(head: HeadCalibration):
    degrees, point = np.array([-3.0, -1.0, 15.0, -1.0]), np.array([1.0, 0.0, 0.0])
    seen = {"left": np.full((1, 2), 300.0), "right": np.full((1, 2), 290.0)}
    for use in (
        lambda: locate(head, **seen, joints=degrees),
        lambda: rectify(head, degrees),
        lambda: project_point(head, "left_wide", degrees, point),
        lambda: relative_camera_pose(head, degrees),
    ):
        with pytest.raises(VergenceError, match=r"in radians; found a joint at 1[45]\.?\d*, more"):
            use()


def test_readings_of_a_motor_before_a_gear_may_be_of_many_turns():
    rng = np.random.default_rng(5)
    head = skewed_head(rng)
    points, angles, left, right = random_samples(head, rng, 20)
    geared = {
        eye: tuple(
            replace(joint, readings={name: 0.02 * f for name, f in joint.readings.items()})
            for joint in joints
        )
        for eye, joints in head.kinematics.eyes.items()
    }
    head, motor = replace(head, kinematics=replace(head.kinematics, eyes=geared)), angles / 0.02
    assert np.abs(motor).max() > 2 * np.pi
    np.testing.assert_allclose(project_point(head, "left_wide", motor, points), left)
    located = locate(head, left=left, right=right, joints=motor)
    np.testing.assert_allclose(located.xyz, points, atol=1e-9)
    assert rectify(head, motor[0]) is not None
    with pytest.raises(VergenceError, match="in radians; found a joint at"):
        project_point(head, "left_wide", np.degrees(motor), points)


@pytest.mark.parametrize(
    "pose",
    [
        np.diag([2.0, 2, 2, 1]),
        np.diag([1.0, 1, -1, 1]),
        np.ones((4, 4)),
        np.eye(4) + np.eye(4)[[3]].T @ [[0.1, 0, 0, 0]],
    ],
)
def test_measured_poses_that_are_not_rigid_are_refused(head: HeadCalibration, pose):
    poses = np.stack([pose, np.eye(4)])
    seen = {"left": np.full((1, 2), 300.0), "right": np.full((1, 2), 290.0)}
    for use in (
        lambda: locate(head, **seen, joints=poses),
        lambda: joints_at_images(head, poses[None], [0.0]),
        lambda: rectify(head, poses),
        lambda: relative_camera_pose(head, poses),
    ):
        with pytest.raises(VergenceError, match="joints: expected a"):
            use()


def test_points_and_postures_may_be_lists_and_other_shapes_are_named(head: HeadCalibration):
    points, postures, neck = np.array([[0.6, 0.0, 0.1]] * 3), np.zeros((3, 4)), np.zeros((3, 3))
    uses = {
        "in_head": lambda p, j: in_head(head, p),
        "in_body": lambda p, j: in_body(head, p, neck.tolist()),
        "project_point": lambda p, j: project_point(head, "left_wide", j, p),
        "gaze_angles": lambda p, j: gaze_angles(head, p, cameras=["left_wide", "right_wide"]),
    }
    for use in uses.values():
        np.testing.assert_array_equal(
            use(points.tolist(), postures.tolist()), use(points, postures)
        )
        with pytest.raises(
            VergenceError, match=r"the shape \(..., 3\); found an array of \(3, 4\)"
        ):
            use(np.zeros((3, 4)), postures)
    for name in ("in_body", "project_point"):
        with pytest.raises(
            VergenceError, match=r"Points of shape \(2, 3\) do not go with postures"
        ):
            uses[name](points[:2], postures)


def test_no_samples_give_no_points(head: HeadCalibration):
    nothing = {"left": np.empty((0, 2)), "right": np.empty((0, 2)), "joints": np.empty((0, 4))}
    located = locate(head, **nothing, pixel_std_px=0.1)
    assert located.xyz.shape == (0, 3)
    assert located.status.shape == (0,)
    assert located.covariance.shape == (0, 3, 3)


@pytest.mark.parametrize(
    ("left", "right", "eyes", "says"),
    [
        ((4, 3), (4, 2), (4, 4), r"left of shape \(4, 2\), found \(4, 3\)"),
        ((4, 2), (5, 2), (4, 4), r"right of shape \(4, 2\), found \(5, 2\)"),
        ((4, 2), (4, 2), (3,), r"joints of shape \(4, 4\) or \(4,\) or .* found \(3,\)"),
        ((4, 2), (4, 2), (4, 7), r"joints of shape \(4, 4\) or \(4,\) or .* found \(4, 7\)"),
        ((1, 2, 2), (2,), (4,), r"left of shape \(N, 2\), found \(1, 2, 2\)"),
    ],
)
def test_wrong_shapes_are_named(head, left, right, eyes, says):
    with pytest.raises(VergenceError, match=says):
        locate(head, left=np.zeros(left), right=np.zeros(right), joints=np.zeros(eyes))


def test_a_single_pixel_needs_no_batch(head: HeadCalibration):
    both = {"left": [300.0, 200.0], "right": [290.0, 201.0], "joints": np.zeros(4)}
    one = locate(head, **both)
    batched = locate(head, **both | {name: [both[name]] for name in ("left", "right")})
    assert one.xyz.shape == (1, 3)
    np.testing.assert_array_equal(one.xyz, batched.xyz)
