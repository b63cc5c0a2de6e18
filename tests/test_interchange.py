"""Other programs' formats: round trips are exact, and what a format cannot say is refused."""

import ast
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from other_heads import KINDS, other_head
from simulated_head import random_pose, skewed_head, unskewed_head
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, project
from vergence.geometry.head import HeadCalibration, camera_pose_in_base
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.lens import CameraModel
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import inverse
from vergence.interchange import kalibr, opencv, ros
from vergence.interchange.formats import export_head, import_head
from vergence.interchange.serialization import with_intrinsics
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.stereo.uncertainty import locate

SEEDS = st.integers(0, 2**32 - 1)
NAMED_NECK = Neck(np.eye(3)[[2, 1]], np.ones((2, 3)), np.ones(3), joints=("neck_yaw", "neck_pitch"))


def with_k3(head: HeadCalibration, k3: float) -> HeadCalibration:
    lens = head.cameras["left_wide"].intrinsics
    lens = replace(lens, distortion=np.append(lens.distortion[:4], k3))
    return with_intrinsics(head, {"left_wide": lens})


def numbers(item: HeadCalibration | Camera) -> dict:
    """Return all fields as plain numbers and lists, to be compared to the last digit."""
    return TypeAdapter(type(item)).dump_python(item, mode="json")


def assert_opencv_projects(matrix: np.ndarray, distortion: np.ndarray, camera: Camera) -> None:
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 0.5], [0.5, 0.4, 2.0], (50, 3))
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
    np.testing.assert_allclose(pixels.reshape(-1, 2), project(camera, points), atol=1e-9)


@pytest.mark.parametrize("suffix", opencv.SUFFIXES)
@pytest.mark.parametrize("neck", [NAMED_NECK, Neck()], ids=["neck", "no neck"])
def test_opencv_reads_what_it_needs_to_project_and_all_joints(tmp_path, suffix, neck):
    head = replace(with_k3(unskewed_head(3), 0.0123456789), time_offset_s=0.0321, neck=neck)
    opencv.save(head, tmp_path / f"head{suffix}")
    storage = cv2.FileStorage(str(tmp_path / f"head{suffix}"), cv2.FILE_STORAGE_READ)
    node = storage.getNode("cameras").getNode("left_wide").getNode("intrinsics")
    K, D = (node.getNode(k).mat() for k in ("matrix", "distortion"))
    assert_opencv_projects(K, D, head.cameras["left_wide"].intrinsics)
    np.testing.assert_array_equal(storage.getNode("T_rbase_lbase").mat(), head.T_rbase_lbase)
    assert storage.getNode("time_offset_s").real() == head.time_offset_s
    joints = storage.getNode("neck").getNode("joints")
    assert [joints.at(k).string() for k in range(joints.size())] == list(neck.joints)
    eye = storage.getNode("kinematics").getNode("eyes").getNode("left")
    for k, joint in enumerate(head.kinematics.eyes["left"]):
        read = eye.at(k)
        np.testing.assert_array_equal(read.getNode("axis").mat().ravel(), joint.axis)
        assert [read.getNode(n).real() for n in ("gain", "slide_m")] == [joint.gain, joint.slide_m]


@pytest.mark.slow
@given(seed=SEEDS)
def test_intrinsics_survive_kalibr_and_ros_to_the_last_digit(seed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out")
    head = unskewed_head(seed)
    kalibr.save(head, folder / "camchain.yaml")
    chain = kalibr.load(folder / "camchain.yaml")
    ros.save(head, folder / "info")
    infos = ros.load(folder / "info")
    assert list(chain) == list(head.cameras)
    assert set(infos) == set(head.cameras)
    for name, mounted in head.cameras.items():
        assert numbers(chain[name][0]) == numbers(infos[name]) == numbers(mounted.intrinsics)


def test_a_camera_info_has_every_field_that_ros_requires(tmp_path):
    head = unskewed_head(9)
    ros.save(head, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.yaml" for name in head.cameras}
    info = yaml.safe_load((tmp_path / "left_wide.yaml").read_text())
    shapes = {"camera_matrix": (3, 3), "distortion_coefficients": (1, 5)}
    shapes |= {"rectification_matrix": (3, 3), "projection_matrix": (3, 4)}
    assert set(info) == {
        "image_width", "image_height", "camera_name", "distortion_model", *shapes
    }  # fmt: skip
    assert info["distortion_model"] == "plumb_bob"
    for name, (rows, cols) in shapes.items():
        assert (info[name]["rows"], info[name]["cols"]) == (rows, cols)
        assert len(info[name]["data"]) == rows * cols
    K = np.reshape(info["camera_matrix"]["data"], (3, 3))
    D = np.array(info["distortion_coefficients"]["data"])
    assert_opencv_projects(K, D, head.cameras["left_wide"].intrinsics)


@pytest.mark.parametrize("format_name", ["kalibr", "mrcal", "ros", "opencv"])
def test_skew_is_refused_by_formats_that_have_no_field_for_it(tmp_path, format_name):
    head = skewed_head(np.random.default_rng(12))
    said = r"left_wide has a skew of -0\.0492 px, for which .* no field; .*set it to 0"
    with pytest.raises(VergenceError, match=said) as refused:
        export_head(head, tmp_path / "out.yml", format_name)
    assert "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_k3_is_refused_by_kalibr_and_kept_by_ros(tmp_path):
    head = with_k3(unskewed_head(13), 0.004)
    with pytest.raises(
        VergenceError, match=r"left_wide has k3 = 0\.004.*opencv or ros.*radial-tan"
    ):
        kalibr.save(head, tmp_path / "camchain.yaml")
    ros.save(head, tmp_path)
    assert ros.load(tmp_path / "left_wide.yaml")["left_wide"].distortion[4] == 0.004


@pytest.mark.parametrize("format_name", ["kalibr", "ros", "opencv", "urdf"])
def test_a_dash_in_a_name_is_refused_with_a_name_that_will_do(tmp_path, format_name):
    head = unskewed_head(12)
    head = replace(head, cameras={n.replace("_", "-"): each for n, each in head.cameras.items()})
    with pytest.raises(VergenceError, match=r"called 'left-wide'; .*: write 'left_wide' wherever"):
        export_head(head, tmp_path / "out.yml", format_name)


@pytest.mark.parametrize("format_name", ["kalibr", "ros"])
def test_the_accuracy_of_the_head_to_start_from_is_not_that_of_other_lenses(tmp_path, format_name):
    head, path = (
        unskewed_head(3),
        tmp_path / ("chain.yaml" if format_name == "kalibr" else "cameras"),
    )
    export_head(head, path, format_name)
    stated = replace(head, accuracy=Accuracy("bundle", ("time_offset_s",), np.array([[1e-6]])))
    assert import_head(path, format_name, template=stated).accuracy is None


def test_a_format_that_does_not_exist_is_answered_with_those_that_do(tmp_path):
    with pytest.raises(VergenceError, match="one of kalibr, mrcal, ros, opencv, urdf; found 'foo'"):
        export_head(unskewed_head(14), tmp_path / "a", "foo")  # pyright: ignore[reportArgumentType]
    with pytest.raises(VergenceError, match="one of kalibr, ros; found 'urdf'"):
        import_head(tmp_path / "a", "urdf", template=unskewed_head(14))  # pyright: ignore[reportArgumentType]


def test_opencv_says_which_endings_it_knows(tmp_path):
    with pytest.raises(VergenceError, match=r"\.yml, \.yaml, \.json; found 'head\.xml'"):
        opencv.save(unskewed_head(19), tmp_path / "head.xml")


FISHEYE = (-0.02, 0.01, -0.004, 0.001)
RATIONAL = (0.3, 0.02, 5e-4, -5e-4, 0.001, 0.45, 0.06, 0.002)


def with_lens(head: HeadCalibration, model: CameraModel) -> HeadCalibration:
    """Return the head with a fisheye or a rational lens on its left wide camera."""
    k = np.array(FISHEYE if model == "fisheye" else RATIONAL)
    lens = replace(head.cameras["left_wide"].intrinsics, distortion=k, model=model)
    return with_intrinsics(head, {"left_wide": lens})


@pytest.mark.parametrize("model", ["fisheye", "rational"])
def test_every_lens_survives_ros(tmp_path, model):
    head = with_lens(unskewed_head(21), model)
    ros.save(head, tmp_path / "ros")
    text = yaml.safe_load((tmp_path / "ros" / "left_wide.yaml").read_text())
    name = {"fisheye": "equidistant", "rational": "rational_polynomial"}[model]
    assert text["distortion_model"] == name
    lens = ros.load(tmp_path / "ros")["left_wide"]
    assert numbers(lens) == numbers(head.cameras["left_wide"].intrinsics)


def test_kalibr_keeps_a_fisheye_lens_and_refuses_a_rational_one(tmp_path):
    head = with_lens(unskewed_head(22), "fisheye")
    kalibr.save(head, tmp_path / "chain.yaml")
    cam = yaml.safe_load((tmp_path / "chain.yaml").read_text())["cam0"]
    assert (cam["distortion_model"], cam["distortion_coeffs"]) == ("equidistant", list(FISHEYE))
    lens, _ = kalibr.load(tmp_path / "chain.yaml")["left_wide"]
    assert numbers(lens) == numbers(head.cameras["left_wide"].intrinsics)
    with pytest.raises(VergenceError, match=r"rational lens.*--lens radial-tangential or fisheye"):
        kalibr.save(with_lens(unskewed_head(22), "rational"), tmp_path / "other.yaml")


# Kalibr's camchains


def radtan(cam: dict, points: np.ndarray) -> np.ndarray:
    """Return pixels by Kalibr's own formulas (aslam_cv RadialTangentialDistortion)."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2 = cam["distortion_coeffs"]
    rho = x * x + y * y
    radial = k1 * rho + k2 * rho**2
    u = x + x * radial + 2 * p1 * x * y + p2 * (rho + 2 * x * x)
    v = y + y * radial + 2 * p2 * x * y + p1 * (rho + 2 * y * y)
    fu, fv, pu, pv = cam["intrinsics"]
    return np.stack([fu * u + pu, fv * v + pv], axis=-1)


def test_a_camchain_has_every_field_that_kalibr_requires_and_projects_as_the_head_does(tmp_path):
    head = unskewed_head(5)
    points = np.random.default_rng(1).uniform([-0.5, -0.4, 0.5], [0.5, 0.4, 2.0], (50, 3))
    kalibr.save(head, tmp_path / "camchain.yaml")
    content = yaml.safe_load((tmp_path / "camchain.yaml").read_text())
    assert list(content) == ["cam0", "cam1", "cam2", "cam3"]
    required = {"camera_model", "intrinsics", "distortion_model", "distortion_coeffs"}
    required |= {"resolution", "rostopic", "cam_overlaps"}
    for k, (cam, mounted) in enumerate(zip(content.values(), head.cameras.values(), strict=True)):
        assert set(cam) == required | ({"T_cn_cnm1"} if k else set())
        assert (cam["camera_model"], cam["distortion_model"]) == ("pinhole", "radtan")
        exact = project(mounted.intrinsics, points)
        np.testing.assert_allclose(radtan(cam, points), exact, atol=1e-9)


def test_a_camchain_leads_from_camera_to_camera(tmp_path):
    head = unskewed_head(6)
    kalibr.save(head, tmp_path / "camchain.yaml")
    chain = kalibr.load(tmp_path / "camchain.yaml")
    # From cam0, left_wide, to the last one, right_narrow.
    T = np.linalg.multi_dot([step for _, step in reversed(chain.values()) if step is not None])
    T_lbase_first = camera_pose_in_base(head, "left_wide", np.zeros(4))
    T_rbase_last = camera_pose_in_base(head, "right_narrow", np.zeros(4))
    np.testing.assert_allclose(
        T, inverse(T_rbase_last) @ head.T_rbase_lbase @ T_lbase_first, atol=1e-12
    )


def test_a_camchain_brings_poses_to_cameras_of_any_name(tmp_path):
    head = unskewed_head(7)
    renamed = {
        n.replace("wide", "cam").replace("narrow", "tele"): m for n, m in head.cameras.items()
    }
    head = replace(head, cameras=renamed)
    rng = np.random.default_rng(7)
    cameras = {
        name: m if name.endswith("cam") else replace(m, T_eye_cam=random_pose(rng))
        for name, m in head.cameras.items()
    }
    start = replace(head, cameras=cameras, T_rbase_lbase=random_pose(rng))
    kalibr.save(head, tmp_path / "camchain.yaml")
    back = import_head(str(tmp_path / "camchain.yaml"), "kalibr", template=start)
    np.testing.assert_allclose(back.T_rbase_lbase, head.T_rbase_lbase, atol=1e-12)
    for name, mounted in head.cameras.items():
        np.testing.assert_allclose(back.cameras[name].T_eye_cam, mounted.T_eye_cam, atol=1e-12)
    teles = {name: m for name, m in head.cameras.items() if name.endswith("tele")}
    export_head(replace(head, cameras=teles), str(tmp_path / "teles.yaml"), "kalibr")
    with pytest.raises(VergenceError, match=r"it has .* and not left_cam; without T_cn_cnm1"):
        import_head(tmp_path / "teles.yaml", "kalibr", template=start)


@pytest.mark.parametrize("kind", KINDS)
def test_a_camchain_holds_at_straight_gaze_of_any_joints(kind, tmp_path):
    rng = np.random.default_rng(9)
    head = other_head(kind, rng)
    kalibr.save(head, tmp_path / "camchain.yaml")
    start = replace(head, T_rbase_lbase=random_pose(rng))
    back = import_head(tmp_path / "camchain.yaml", "kalibr", template=start)
    np.testing.assert_allclose(back.T_rbase_lbase, head.T_rbase_lbase, atol=1e-12)


def test_a_camchain_of_other_programs_is_read(tmp_path):
    (tmp_path / "camchain.yaml").write_text(
        "cam0: {camera_model: pinhole, distortion_model: radtan, rostopic: /left_wide/image_raw,\n"
        "  distortion_coeffs: [-0.1, 2e-2, 1e-5, 0], intrinsics: [280, 281, 319.5, 239.5],\n"
        "  resolution: [640, 480], T_cam_imu: [[1, 0]], timeshift_cam_imu: 0.0}\n"
    )
    camera, _ = kalibr.load(tmp_path / "camchain.yaml")["left_wide"]
    assert camera.distortion.tolist() == [-0.1, 0.02, 1e-5, 0, 0]


def camera_info(model: str, coefficients: list[float], name: str = "left_wide") -> dict:
    """Return the content of a file as ROS's calibrator writes it, for a camera of unskewed_head."""
    K = unskewed_head(3).cameras["left_wide"].intrinsics.matrix
    matrices = {"camera_matrix": K, "rectification_matrix": np.eye(3)}
    fields = {n: {"rows": 3, "cols": 3, "data": M.ravel().tolist()} for n, M in matrices.items()}
    D = {"rows": 1, "cols": len(coefficients), "data": coefficients}
    size = {"image_width": 640, "image_height": 480, "camera_name": name}
    return fields | size | {"distortion_model": model, "distortion_coefficients": D}


@pytest.mark.parametrize(
    ("model", "coefficients", "found"),
    [
        ("plumb_bob", [-0.2, 0.03, 1e-3, 2e-3], ("radial-tangential", 4)),
        ("plumb_bob", [-0.2, 0.03, 1e-3, 2e-3, 0.01, 0, 0, 0], ("radial-tangential", 5)),
        ("plumb_bob", [0.3, 0.03, 0, 0, 0.01, 0.4, 0.1, 0.01], ("rational", 8)),
        ("plumb_bob", [-0.2, 0.03, 1e-3, 2e-3, *[0.0] * 10], ("radial-tangential", 4)),
        ("rational_polynomial", [-0.2, 0.03, 1e-3, 2e-3, 0.01], ("rational", 5)),
        ("rational_polynomial", [0.3, 0.03, 0, 0, 0.01, 0.4, 0.1, 0.01, *[0] * 4], ("rational", 8)),
        ("rational_polynomial", [0.3, 0.03, 0, 0, 0.01, 0.4, 0.1, 0.01, *[0] * 6], ("rational", 8)),
        ("equidistant", [0.01, 0.02, 0.03, 0.04, 0.0], ("fisheye", 4)),
    ],
)
def test_coefficients_of_other_programs_may_end_in_zeros(tmp_path, model, coefficients, found):
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(camera_info(model, coefficients)))
    lens = ros.load(tmp_path / "a.yaml")["left_wide"]
    assert (lens.model, np.flatnonzero(lens.distortion).max() + 1) == found
    np.testing.assert_array_equal(np.trim_zeros(coefficients, "b"), lens.distortion[: found[1]])


@pytest.mark.parametrize(
    ("coefficients", "said"),
    [
        ([0.1] * 12, "8 distortion coefficients"),
        ([0.1] * 3, "4 at least"),
        ([float("nan")] * 4, "valid number"),
    ],
)
def test_coefficients_of_no_lens_of_ours_are_named(tmp_path, coefficients, said):
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(camera_info("plumb_bob", coefficients)))
    with pytest.raises(VergenceError, match=said):
        ros.load(tmp_path / "a.yaml")


def test_a_camera_of_a_namespace_has_a_name(tmp_path):
    content = camera_info("plumb_bob", [0.0] * 5, "narrow_stereo/left")
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(content))
    assert list(ros.load(tmp_path / "a.yaml")) == ["narrow_stereo_left"]


def test_topics_that_begin_alike_name_cameras_by_where_they_differ(tmp_path):
    kalibr.save(unskewed_head(3), tmp_path / "a.yaml")
    content = yaml.safe_load((tmp_path / "a.yaml").read_text())
    for k, cam in enumerate(content.values()):
        cam["rostopic"] = f"/stereo/eye_{k}/image_raw"
    (tmp_path / "b.yaml").write_text(yaml.safe_dump(content))
    assert list(kalibr.load(tmp_path / "b.yaml")) == [f"eye_{k}" for k in range(len(content))]


@pytest.mark.parametrize("model", ["omni", "eucm", "ds"])
def test_lenses_of_kalibr_that_are_none_of_ours_are_refused_with_what_to_do(tmp_path, model):
    kalibr.save(unskewed_head(3), tmp_path / "a.yaml")
    content = yaml.safe_load((tmp_path / "a.yaml").read_text())
    content["cam0"] |= {"camera_model": model, "intrinsics": [0.5, *content["cam0"]["intrinsics"]]}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(VergenceError, match=f"found {model} with 5; calibrate with Kalibr's pin"):
        kalibr.load(tmp_path / "a.yaml")


def test_what_no_head_can_be_is_not_imported(tmp_path):
    head, path = unskewed_head(3), tmp_path / "a.yaml"
    T = head.T_rbase_lbase.copy()
    for factor, said in ((1200.0, "apart"), (-1.0, "to the left of the right one")):
        T[:3, 3] = factor * head.T_rbase_lbase[:3, 3]
        kalibr.save(replace(head, T_rbase_lbase=T), path)
        with pytest.raises(VergenceError, match=said):
            import_head(path, "kalibr", template=head)
    content = camera_info("plumb_bob", [0.0] * 5) | {"image_width": 641}
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(VergenceError, match="640 x 480 px, but those of the file have 641 x 480"):
        import_head(path, "ros", template=head)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("fisheye", [False, True])
def test_a_camera_info_rectifies_as_opencv_and_as_the_head_does(tmp_path, seed, fisheye):
    rng = np.random.default_rng(seed)
    head = unskewed_head(3)
    if fisheye:
        lens = replace(with_lens(head, "fisheye").cameras["left_wide"].intrinsics, model="fisheye")
        head = with_intrinsics(head, dict.fromkeys(("left_wide", "right_wide"), lens))
    at = rng.uniform(-0.1, 0.1, 4)
    export_head(head, tmp_path, "ros", at=at)
    info = [
        yaml.safe_load((tmp_path / f"{n}.yaml").read_text()) for n in ("left_wide", "right_wide")
    ]
    R = [np.reshape(each["rectification_matrix"]["data"], (3, 3)) for each in info]
    P = [np.reshape(each["projection_matrix"]["data"], (3, 4)) for each in info]
    T = relative_camera_pose(head, at)
    np.testing.assert_allclose(R[1] @ T[:3, :3] @ R[0].T, np.eye(3), atol=1e-9)
    # The baseline is along x, and Tx = -fx' B.
    baseline = np.linalg.norm(T[:3, 3])
    np.testing.assert_allclose(R[1] @ T[:3, 3], np.array([-baseline, 0, 0]), atol=1e-9)
    assert P[1][0, 3] == pytest.approx(-P[1][0, 0] * baseline, rel=1e-9)
    assert P[0][0, 3] == 0
    with pytest.raises(VergenceError, match="4 joint readings"):
        export_head(head, tmp_path, "ros", at=[0.0])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_camchain_holds_at_a_stated_posture(tmp_path, seed):
    head, at = unskewed_head(3), np.random.default_rng(seed).uniform(-0.2, 0.2, 4)
    export_head(head, tmp_path / "a.yaml", "kalibr", at=at)
    T, poses = np.eye(4), {}
    for name, (_, step) in kalibr.load(tmp_path / "a.yaml").items():
        T = T if step is None else step @ T
        poses[name] = T
    found = poses["right_wide"] @ inverse(poses["left_wide"])
    np.testing.assert_allclose(found, relative_camera_pose(head, at), atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("model", ["radial-tangential", "rational"])
def test_cameramodels_project_located_points_where_they_were_seen(tmp_path, seed, model):
    """By the documented text alone: a dict, OpenCV's coefficients, and rt from the reference."""
    head = unskewed_head(3) if model == "radial-tangential" else with_lens(unskewed_head(3), model)
    at = np.random.default_rng(seed).uniform(-0.1, 0.1, 4)
    export_head(head, tmp_path / "out", "mrcal", at=at)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        f"{n}.cameramodel" for n in head.cameras
    }
    pair = "left_wide", "right_wide"
    poses = [inverse(camera_pose_in_base(head, name, at)) for name in pair]
    poses[1] = poses[1] @ head.T_rbase_lbase
    points = np.array([[1.0, 0.02, 0.03], [2.0, -0.1, 0.1]])
    seen = []
    for name, T in zip(pair, poses, strict=True):
        content = ast.literal_eval((tmp_path / "out" / f"{name}.cameramodel").read_text())
        assert list(content) == ["lensmodel", "intrinsics", "extrinsics", "imagersize"]
        count = int(content["lensmodel"].removeprefix("LENSMODEL_OPENCV"))
        fx, fy, cx, cy, *distortion = content["intrinsics"]
        assert len(distortion) == count
        assert content["imagersize"] == list(head.cameras[name].intrinsics.size)
        r, t = np.split(np.array(content["extrinsics"]), 2)
        np.testing.assert_allclose(cv2.Rodrigues(r)[0], T[:3, :3], atol=1e-9)
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        seen.append(cv2.projectPoints(points, r, t, K, np.array(distortion))[0][:, 0])
    found = locate(head, left=seen[0], right=seen[1], joints=at)
    np.testing.assert_allclose(found.xyz, points, atol=1e-8)


def test_mrcal_has_no_field_for_a_fisheye_lens(tmp_path):
    with pytest.raises(VergenceError, match="a fisheye lens, for which mrcal's cameramodel has no"):
        export_head(with_lens(unskewed_head(3), "fisheye"), tmp_path / "out", "mrcal")
