"""URDF: it moves as the head does, read by its specification."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from postures import NECK_JOINTS
from simulated_head import unskewed_head
from vergence.errors import VergenceError
from vergence.gaze.commands import joint_limits
from vergence.geometry.head import base_pose_in_body, camera_pose_in_base
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Kinematics
from vergence.geometry.neck import Neck, head_pose
from vergence.geometry.se3 import inverse, pose, rotation, rotvec
from vergence.interchange import urdf
from vergence.interchange.formats import export_head

SEEDS = st.integers(0, 2**32 - 1)


class Tree:
    """A little forward kinematics of URDF, written from its specification."""

    def __init__(self, path: Path):
        self.joints = {}
        for joint in ElementTree.parse(path).getroot().iter("joint"):
            name, child = joint.get("name"), joint.find("child")
            assert child is not None
            self.joints[child.get("link")] = (name, joint)

    def T_root(self, link: str, angles: dict[str, float]) -> np.ndarray:
        if link not in self.joints:
            return np.eye(4)
        name, joint = self.joints[link]
        origin, axis, mimic = (joint.find(tag) for tag in ("origin", "axis", "mimic"))
        roll, pitch, yaw = map(float, origin.get("rpy").split())
        R = rotation([0, 0, yaw]) @ rotation([0, pitch, 0]) @ rotation([roll, 0, 0])
        T = pose(R, np.array(origin.get("xyz").split(), dtype=float))
        if joint.get("type") == "revolute":
            angle = angles[name if mimic is None else mimic.get("joint")]
            if mimic is not None:
                angle = float(mimic.get("multiplier")) * angle + float(mimic.get("offset"))
            T = T @ pose(rotation(angle * np.array(axis.get("xyz").split(), dtype=float)))
        return self.T_root(joint.find("parent").get("link"), angles) @ T


@given(seed=SEEDS)
def test_the_urdf_moves_as_the_head_does(seed, tmp_path_factory):
    path = tmp_path_factory.mktemp("out") / "head.urdf"
    head = unskewed_head(seed)
    urdf.save(head, path)
    tree = Tree(path)
    rng = np.random.default_rng(seed)
    neck, eyes = rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.5, 4)
    angles = dict(zip((*NECK_JOINTS, *EYE_JOINTS), (*neck, *eyes), strict=True))
    np.testing.assert_allclose(tree.T_root("head", angles), head_pose(head.neck, neck), atol=1e-12)
    for name, mounted in head.cameras.items():
        T_body_eye_base = base_pose_in_body(head, mounted.eye, neck)
        np.testing.assert_allclose(
            tree.T_root(f"{mounted.eye}_base", angles), T_body_eye_base, atol=1e-12
        )
        wanted = T_body_eye_base @ camera_pose_in_base(head, name, eyes)
        np.testing.assert_allclose(tree.T_root(f"{name}_optical_frame", angles), wanted, atol=1e-12)


def many_joints(seed: int) -> Kinematics:
    """Make eyes that share a tilt, by version and vergence, behind gears, with a roll."""
    rng = np.random.default_rng(seed)
    turn = rotation(rng.normal(0, 0.3, 3))
    eyes = {
        eye: (
            Joint("tilt", turn[:, 1], {"tilt (motor)": 0.02}, rng.normal(0, 0.02, 3), gain=1.1),
            Joint("pan", turn[:, 2], {"version": 1.0, "vergence": half}, offset_rad=0.1),
            Joint("roll", turn[:, 0], {f"{eye}_roll": -1.0}, rng.normal(0, 0.02, 3)),
        )
        for eye, half in zip(EYES, (-0.5, 0.5), strict=True)
    }
    readings = ("vergence", "left_roll", "right_roll", "tilt (motor)", "version")
    return Kinematics(eyes, readings)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of its loader
@pytest.mark.parametrize("kinematics", [Kinematics(), many_joints(1), many_joints(2)])
def test_mujoco_and_yourdfpy_place_the_cameras_of_the_urdf_as_the_head_does(tmp_path, kinematics):
    urdfpy = pytest.importorskip("yourdfpy")
    mujoco = pytest.importorskip("mujoco")
    head = replace(unskewed_head(3), kinematics=kinematics)
    path = tmp_path / "head.urdf"
    urdf.save(head, path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, robot = mujoco.MjData(model), urdfpy.URDF.load(str(path), load_meshes=False)
    rng = np.random.default_rng(0)
    for _ in range(20):
        neck, readings = rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.5, len(kinematics.readings))
        names = [re.sub(r"\W", "_", name) for name in kinematics.readings]
        angles = dict(zip((*NECK_JOINTS, *names), (*neck, *readings), strict=True))
        robot.update_cfg(angles)
        for name, angle in angles.items():
            data.joint(name).qpos[0] = angle
        for follower, leader, polynomial in zip(
            model.eq_obj1id, model.eq_obj2id, model.eq_data, strict=True
        ):
            address = model.jnt_qposadr
            leads = data.qpos[address[leader]]
            data.qpos[address[follower]] = polynomial[0] + polynomial[1] * leads
        mujoco.mj_kinematics(model, data)
        for name, mounted in head.cameras.items():
            wanted = base_pose_in_body(head, mounted.eye, neck)
            wanted = wanted @ camera_pose_in_base(head, name, readings)
            frame = f"{name}_optical_frame"
            placed = data.body(frame)
            found = pose(placed.xmat.reshape(3, 3), placed.xpos)
            np.testing.assert_allclose(found, wanted, atol=1e-9)
            np.testing.assert_allclose(robot.get_transform(frame, "body"), wanted, atol=1e-9)


def test_joints_get_the_limits_of_the_head(tmp_path):
    kinematics = many_joints(1)
    joints = (*NECK_JOINTS, *kinematics.readings)
    ranges = {name: (-0.1 * k, 0.2 * k) for k, name in enumerate(joints, 1)}
    limits = joint_limits(ranges, dict.fromkeys(joints, 3.0), joints=joints)
    head = replace(unskewed_head(10), kinematics=kinematics)
    export_head(head, tmp_path / "head.urdf", "urdf", limits=limits)
    robot = ElementTree.parse(tmp_path / "head.urdf").getroot()
    found = {joint.get("name"): joint for joint in robot.iter("joint")}
    for name in joints:
        limited = "left_roll_true" if name == "left_roll" else re.sub(r"\W", "_", name)
        low, high = ranges[name]
        expected = (-high, -low) if name == "left_roll" else (low, high)
        np.testing.assert_allclose(limits_rad(found[limited]), expected, err_msg=name)


def limits_rad(joint: ElementTree.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    assert limit is not None
    return float(limit.get("lower", "nan")), float(limit.get("upper", "nan"))


def test_joints_are_limited_and_readings_by_as_much_as_moves_a_joint_so_far(tmp_path):
    """Behind a gear a motor turns farther than the eye; of two factors the larger one limits."""
    up, left = np.eye(3)[[2, 1]]
    eyes = {
        eye: (
            Joint(name="pan", axis=up, readings={f"{eye}_motor": -0.02}),
            Joint(name="tilt", axis=left, readings={"tilt": factor}, offset_rad=0.1),
        )
        for eye, factor in zip(EYES, (1.0, 0.5), strict=True)
    }
    kinematics = Kinematics(eyes, ("left_motor", "right_motor", "tilt"))
    urdf.save(replace(unskewed_head(10), kinematics=kinematics), tmp_path / "head.urdf")
    robot = ElementTree.parse(tmp_path / "head.urdf").getroot()
    limits = {joint.get("name"): joint for joint in robot.iter("joint")}
    quarter = np.array([-1.0, 1.0]) * urdf.LIMIT_RAD
    for name, wanted in (
        ("left_motor", quarter / 0.02),
        ("left_pan_true", quarter),
        ("tilt", quarter),
        ("left_tilt_true", quarter + 0.1),
        ("right_tilt_true", quarter / 2 + 0.1),
    ):
        np.testing.assert_allclose(limits_rad(limits[name]), wanted, err_msg=name)


@pytest.mark.parametrize(
    ("joint", "reading", "said"),
    [
        ("eye", "a", "two links called left_eye;"),
        ("base", "a", "two links called left_base;"),
        ("wide", "a", "two links called left_wide;"),
        ("pan", "b c", "two joints called b_c;"),
        ("pan", "head_joint", "two joints called head_joint;"),
    ],
)
def test_names_that_would_be_there_twice_are_refused(tmp_path, joint, reading, said):
    up, left = np.eye(3)[[2, 1]]
    joints = (
        Joint(name=joint, axis=up, readings={reading: 1.1}),
        Joint(name="tilt", axis=left, readings={"b_c": 1.0}),
    )
    kinematics = Kinematics({"left": joints, "right": ()}, (reading, "b_c"))
    with pytest.raises(VergenceError, match=said):
        urdf.save(replace(unskewed_head(10), kinematics=kinematics), tmp_path / "head.urdf")


@pytest.mark.parametrize("eyes", [("left",), ("right",), ("left", "right")])
def test_an_eye_whose_pose_is_measured_floats_in_the_urdf(tmp_path, eyes):
    head = unskewed_head(10)
    cameras = {name: each for name, each in head.cameras.items() if each.eye in eyes}
    accuracy = Accuracy("bundle", eye_motion="poses")
    head = replace(head, cameras=cameras, neck=Neck(), accuracy=accuracy)
    urdf.save(head, tmp_path / "head.urdf")
    robot = ElementTree.parse(tmp_path / "head.urdf").getroot()
    kinds = {joint.get("name"): joint.get("type") for joint in robot.iter("joint")}
    assert "revolute" not in kinds.values()
    moved = {name for name, kind in kinds.items() if kind == "floating"}
    assert moved == {f"{eye}_eye_joint" for eye in eyes}


@pytest.mark.parametrize("past", [0.0, 1e-9, 1e-8, 1e-6])
@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_the_urdf_turns_a_camera_that_looks_straight_up_or_down_rightly(tmp_path, pitch, yaw, past):
    pitch = pitch + past
    R_eye_link = rotation([0, 0, yaw]) @ rotation([0, pitch, 0])
    head = unskewed_head(11)
    T_eye_cam = pose(R_eye_link) @ urdf.T_LINK_OPTICAL
    cameras = {"left_wide": replace(head.cameras["left_wide"], T_eye_cam=T_eye_cam)}
    urdf.save(replace(head, cameras=cameras), tmp_path / "head.urdf")
    angles = dict.fromkeys(NECK_JOINTS, 0.0) | dict.fromkeys(EYE_JOINTS, 0.1)
    tree = Tree(tmp_path / "head.urdf")
    T_eye = tree.T_root("left_eye", angles)
    found = inverse(T_eye) @ tree.T_root("left_wide_optical_frame", angles)
    # scipy takes angles within 1e-7 of the pole for it.
    assert np.abs(rotvec(found[:3, :3].T @ T_eye_cam[:3, :3])).max() < 3e-7
