"""Kalibr's camchains: what they hold, and what they bring to a head."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from other_heads import KINDS, other_head
from simulated_head import random_pose, unskewed_head
from vergence.errors import VergenceError
from vergence.geometry.camera import project
from vergence.geometry.head import camera_pose_in_base
from vergence.geometry.se3 import inverse
from vergence.interchange import kalibr
from vergence.interchange.formats import export_head, import_head


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
