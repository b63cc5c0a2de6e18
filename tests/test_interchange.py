"""Other programs' formats: round trips are exact, and what a format cannot say is refused."""

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

SEEDS = st.integers(0, 2**32 - 1)
NAMED_NECK = Neck(np.eye(3)[[2, 1]], np.ones((2, 3)), np.ones(3), joints=("neck_yaw", "neck_pitch"))


def with_k3(head: HeadCalibration, k3: float) -> HeadCalibration:
    lens = head.cameras["left_wide"].intrinsics
    lens = replace(lens, distortion=np.append(lens.distortion[:4], k3))
    return with_intrinsics(head, {"left_wide": lens})


def numbers(item: HeadCalibration | Camera) -> dict:
    """Return all fields as plain numbers and lists, to be compared to the last digit."""
    return TypeAdapter(type(item)).dump_python(item, mode="json")


@pytest.mark.parametrize("suffix", opencv.SUFFIXES)
@pytest.mark.parametrize("neck", [NAMED_NECK, Neck()], ids=["neck", "no neck"])
def test_a_head_survives_opencv_to_the_last_digit(tmp_path, suffix, neck):
    head = replace(with_k3(unskewed_head(1), 0.0123456789), time_offset_s=0.0321, neck=neck)
    opencv.save(head, tmp_path / f"head{suffix}")
    assert numbers(opencv.load(tmp_path / f"head{suffix}")) == numbers(head)


def assert_opencv_projects(matrix: np.ndarray, distortion: np.ndarray, camera: Camera) -> None:
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 0.5], [0.5, 0.4, 2.0], (50, 3))
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
    np.testing.assert_allclose(pixels.reshape(-1, 2), project(camera, points), atol=1e-9)


def test_opencv_alone_reads_what_it_needs_to_project(tmp_path):
    head = unskewed_head(3)
    opencv.save(head, tmp_path / "head.yml")
    storage = cv2.FileStorage(str(tmp_path / "head.yml"), cv2.FILE_STORAGE_READ)
    node = storage.getNode("cameras").getNode("right_wide")
    K, D = (node.getNode(k).mat() for k in ("camera_matrix", "distortion_coefficients"))
    assert_opencv_projects(K, D, head.cameras["right_wide"].intrinsics)
    assert storage.getNode("T_rbase_lbase").mat().shape == (4, 4)


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


@pytest.mark.parametrize("format_name", ["kalibr", "ros", "opencv"])
def test_skew_is_refused_by_formats_that_have_no_field_for_it(tmp_path, format_name):
    head = skewed_head(np.random.default_rng(12))
    said = r"left_wide has a skew .*set cameras\.left_wide\.intrinsics\.matrix\[0\]\[1\] to 0"
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


def test_kalibr_and_ros_need_a_head_to_start_from(tmp_path):
    ros.save(unskewed_head(14), tmp_path)
    with pytest.raises(VergenceError, match="name a head calibration"):
        import_head(tmp_path, "ros")


def test_a_format_that_does_not_exist_is_answered_with_those_that_do(tmp_path):
    with pytest.raises(VergenceError, match="one of kalibr, ros, opencv, urdf; found 'foo'"):
        export_head(unskewed_head(14), tmp_path / "a", "foo")  # pyright: ignore[reportArgumentType]
    with pytest.raises(VergenceError, match="one of kalibr, ros, opencv; found 'urdf'"):
        import_head(tmp_path / "a", "urdf")  # pyright: ignore[reportArgumentType]


def test_opencv_says_which_endings_it_knows(tmp_path):
    with pytest.raises(VergenceError, match=r"\.yml, \.yaml, \.xml, \.json"):
        opencv.save(unskewed_head(19), tmp_path / "head.txt")


FISHEYE = (-0.02, 0.01, -0.004, 0.001)
RATIONAL = (0.3, 0.02, 5e-4, -5e-4, 0.001, 0.45, 0.06, 0.002)


def with_lens(head: HeadCalibration, model: CameraModel) -> HeadCalibration:
    """Return the head with a fisheye or a rational lens on its left wide camera."""
    k = np.array(FISHEYE if model == "fisheye" else RATIONAL)
    lens = replace(head.cameras["left_wide"].intrinsics, distortion=k, model=model)
    return with_intrinsics(head, {"left_wide": lens})


@pytest.mark.parametrize("model", ["fisheye", "rational"])
def test_every_lens_survives_opencv_and_ros(tmp_path, model):
    head = with_lens(unskewed_head(21), model)
    opencv.save(head, tmp_path / "head.yml")
    assert numbers(opencv.load(tmp_path / "head.yml")) == numbers(head)
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
