"""Dense depth of drawn planes with and without texture, and of the rendered room."""

import json
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drawn_head import four_cameras
from vergence import cli
from vergence.arrays import Array
from vergence.cli import depth as of_dataset
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard
from vergence.geometry.camera import normalise
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import save_head
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYE_JOINTS, EYES
from vergence.geometry.parameters import change_named
from vergence.geometry.se3 import inverse, pose, transform
from vergence.stereo.dense_depth import LEAST_STD_PX, dense_depth, point_cloud
from vergence.stereo.rectification import RectifiedPair, rectify
from vergence.twin import simulated_robot
from vergence.twin.head_model import nominal_head
from vergence.twin.model import as_built_head
from vergence.twin.profile import load_profile
from without_mujoco import without_mujoco

HEAD = four_cameras()
JOINTS = np.array([0.06, 0.03, -0.05, 0.02])
NORMAL, DISTANCE_M = np.array([0.9, 0.3, 0.3]) / np.linalg.norm([0.9, 0.3, 0.3]), 0.8
"""A plane in the left eye's base frame: NORMAL . p = DISTANCE_M."""
STEEP, STEEP_DISTANCE_M = np.array([0.35, 0.93, 0.1]) / np.linalg.norm([0.35, 0.93, 0.1]), 0.4
"""Another one, seen under a small angle."""


@pytest.fixture(scope="module")
def drawn() -> tuple[np.ndarray, np.ndarray]:
    return drawn_plane(NORMAL, DISTANCE_M)


def drawn_plane(normal: Array, distance_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the wide images of a plane, textured on one half (left of y = 0), with noise."""
    rng = np.random.default_rng(0)
    frequencies = rng.normal(size=(24, 3))
    frequencies *= (rng.uniform(60, 220, 24) / np.linalg.norm(frequencies, axis=1))[:, None]
    phases = rng.uniform(0, 2 * np.pi, 24)
    images = []
    poses = eye_poses(HEAD, JOINTS)
    poses[1] = inverse(HEAD.T_rbase_lbase) @ poses[1]
    for name, T in zip(("left_wide", "right_wide"), poses, strict=True):
        mounted = HEAD.camera(name)
        u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
        xy = normalise(mounted.intrinsics, np.stack([u, v], axis=-1))
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        T_lbase_cam = T @ mounted.T_eye_cam
        along = rays @ (normal @ T_lbase_cam[:3, :3])
        points = transform(
            T_lbase_cam, rays * ((distance_m - normal @ T_lbase_cam[:3, 3]) / along)[..., None]
        )
        grey = 120 + 30 * np.cos(points @ frequencies.T + phases).sum(axis=-1) / np.sqrt(12)
        grey = np.where(points[..., 1] > 0, grey, 120)
        grey = np.clip(grey + rng.normal(0, 2, grey.shape), 0, 255)
        images.append(cv2.cvtColor(np.round(grey).astype(np.uint8), cv2.COLOR_GRAY2RGB))
    return images[0], images[1]


def true_depth(
    pair: RectifiedPair, normal: Array = NORMAL, distance_m: float = DISTANCE_M
) -> np.ndarray:
    """Return a plane's depth (H, W) in the left rectified camera."""
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(pair.matrix).T
    n = normal @ pair.T_lbase_rect[:3, :3]
    return (distance_m - normal @ pair.T_lbase_rect[:3, 3]) / (rays @ n)


@pytest.fixture(scope="module")
def pair() -> RectifiedPair:
    return rectify(HEAD, JOINTS)


def test_depth_of_a_slanted_plane_is_right_and_its_deviation_true(pair: RectifiedPair, drawn):
    found = dense_depth(pair, *drawn)
    error = (found.depth_m - true_depth(pair))[found.textured]
    truth = true_depth(pair)[found.textured]
    assert len(error) > 20_000
    assert np.median(np.abs(error) / truth) < 0.01
    disparity = pair.matrix[0, 0] * pair.baseline_m / truth
    assert np.abs(np.median(error / truth * disparity)) < LEAST_STD_PX
    within = np.abs(error) < 2 * found.std_m[found.textured]
    assert within.mean() > 0.9
    points, colours = point_cloud(pair, found)
    assert len(points) == len(colours) == np.isfinite(found.depth_m).sum()
    assert np.median(np.abs(points @ NORMAL - DISTANCE_M)) < 0.01


def test_the_deviation_is_true_of_a_surface_that_is_seen_under_a_small_angle(pair: RectifiedPair):
    found = dense_depth(pair, *drawn_plane(STEEP, STEEP_DISTANCE_M))
    truth = true_depth(pair, STEEP, STEEP_DISTANCE_M)
    seen = found.textured & (truth > 0.3) & (truth < 2)
    error = (found.depth_m - truth)[seen]
    assert len(error) > 20_000
    assert (np.abs(error) < 2 * found.std_m[seen]).mean() > 0.9


def test_a_blank_half_is_not_called_textured_and_its_deviation_is_large(pair: RectifiedPair, drawn):
    found = dense_depth(pair, *drawn)
    points, _ = point_cloud(pair, found)
    v, u = np.nonzero(np.isfinite(found.depth_m))
    blank = points[:, 1] < -0.05
    assert blank.sum() > 1000
    assert found.textured[v[blank], u[blank]].mean() < 0.02
    relative = (found.std_m / found.depth_m)[v[blank], u[blank]]
    assert np.median(relative) > 5 * np.nanmedian((found.std_m / found.depth_m)[found.textured])


def test_noise_of_the_joints_widens_the_deviation(pair: RectifiedPair, drawn):
    exact, noisy = (dense_depth(pair, *drawn, reading_std=std) for std in (None, 5e-3))
    np.testing.assert_array_equal(exact.depth_m, noisy.depth_m)
    assert np.nanmedian(noisy.std_m[noisy.textured] / exact.std_m[noisy.textured]) > 2


def test_a_depth_too_near_for_the_cameras_is_refused(pair: RectifiedPair):
    image = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(VergenceError, match=r"nearest depth is from 0\.07 m"):
        dense_depth(pair, image, image, nearest_m=0.01)


def test_cameras_that_do_not_show_the_usual_nearest_depth_have_one_of_their_own():
    apart = replace(HEAD, T_rbase_lbase=pose(t=[0.0, 0.6, 0.0]))
    wide = rectify(apart, np.zeros(4))
    image = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(VergenceError, match=r"nearest depth is from 0\.45 m"):
        dense_depth(wide, image, image, nearest_m=0.3)
    assert np.isnan(dense_depth(wide, image, image).depth_m).all()


def test_grey_images_have_the_depth_of_the_same_ones_in_colour(pair: RectifiedPair, drawn):
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in drawn]
    by_grey, by_colour = (dense_depth(pair, *images) for images in (grey, drawn))
    np.testing.assert_array_equal(by_grey.disparity_px, by_colour.disparity_px)
    np.testing.assert_array_equal(by_grey.image, by_colour.image)


def test_depth_does_not_depend_on_how_the_eyes_expose(pair: RectifiedPair, drawn):
    left, right = drawn
    darker = np.round(0.6 * right.astype(float)).astype(np.uint8)
    alike, found = (dense_depth(pair, left, each) for each in (right, darker))
    both = np.isfinite(alike.depth_m) & alike.textured & np.isfinite(found.depth_m)
    assert both.sum() > 0.98 * (np.isfinite(alike.depth_m) & alike.textured).sum()
    assert np.median(np.abs(found.depth_m / alike.depth_m - 1)[both]) < 0.005


@pytest.mark.parametrize(
    ("shape", "dtype", "said"),
    [
        ((240, 320, 3), np.uint8, r"640 x 480 px.*found .*\(240, 320, 3\)"),
        ((480, 640, 4), np.uint8, r"RGB.*found .*\(480, 640, 4\)"),
        ((480, 640, 3), np.uint16, r"uint8.*found .* of uint16"),
    ],
)
def test_images_that_do_not_fit_the_calibration_are_refused(pair, drawn, shape, dtype, said):
    with pytest.raises(VergenceError, match=said):
        dense_depth(pair, drawn[0], np.zeros(shape, dtype))


def test_an_image_that_was_not_read_is_refused(pair, drawn):
    with pytest.raises(VergenceError, match="found None: the file was not read"):
        dense_depth(pair, drawn[0], None)  # pyright: ignore[reportArgumentType]


def depth(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", "depth", *words])
    cli.main()


def write_recording(folder: Path, images: Iterable[np.ndarray], *postures: Array) -> None:
    """Write a dataset with the same two images at postures (4,), and the calibration."""
    named: dict[str, np.ndarray] = dict(zip(("left_wide", "right_wide"), images, strict=True))
    described = Description(
        cameras={f"{eye}_wide": DatasetCamera(eye=eye, width=640, height=480) for eye in EYES},
        board=Chessboard(columns=9, rows=6, square_m=0.03),
        joints={name: DatasetJoint(column=name, unit="rad") for name in EYE_JOINTS},
    )
    frames = [Frame(k, k, each, np.zeros(3), named) for k, each in enumerate(postures)]
    write_dataset(folder / "data", described, [DatasetRow(frame) for frame in frames])
    save_head(HEAD, folder / "head.json")


def test_depth_of_a_real_heads_dataset_needs_no_twin(drawn, tmp_path):
    write_recording(tmp_path, drawn, JOINTS)
    done = without_mujoco(
        "depth", "data", "--calibration", "head.json", "--out", "depth", folder=tmp_path
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "depth" / "depth.json").read_text())
    assert (found["pairs"], found["left_out"]) == (1, 0)
    assert found["textured"] > 0.1
    assert found["joints"] is None
    assert found["row_difference_deg"] < 0.02
    assert found["findings"] == []


@pytest.mark.parametrize("pan_std_deg", [0.02, 1.0])
def test_rows_show_that_a_calibration_is_of_another_head(drawn, tmp_path, pan_std_deg: float):
    """However noisy readings are that do not turn rows apart."""
    write_recording(tmp_path, drawn, JOINTS)
    turned = change_named(HEAD, ["left_wide.T_eye_cam.ry"], np.radians([0.5]))
    accuracy = Accuracy("bundle", joint_std=tuple(np.radians([pan_std_deg, 0.02])))
    save_head(replace(turned, accuracy=accuracy), tmp_path / "other.json")
    head = tmp_path / "other.json"
    done = of_dataset(tmp_path / "data", calibration=head, out=tmp_path / "depth").data
    (doubt,) = done["findings"]
    assert str(doubt).startswith("Features are 0.51 degrees beside their rows")
    assert "Warning: Features are" in (tmp_path / "depth" / "report.md").read_text()


APART = np.array([1.2, 0.0, -1.2, 0.0])


def test_postures_that_cannot_be_rectified_are_left_out_of_the_depth_of_a_dataset(tmp_path):
    dark = np.zeros((2, 480, 640, 3), np.uint8)
    write_recording(tmp_path, dark, JOINTS, APART)
    head = tmp_path / "head.json"
    done = of_dataset(tmp_path / "data", calibration=head, out=tmp_path / "depth").data
    assert (done["pairs"], done["left_out"]) == (1, 1)
    report = (tmp_path / "depth" / "report.md").read_text()
    assert "1 more cannot be rectified" in report
    assert "median standard deviation" not in report


def test_a_dataset_in_which_no_pair_can_be_rectified_is_refused(tmp_path):
    write_recording(tmp_path, np.zeros((2, 480, 640, 3), np.uint8), APART)
    head = tmp_path / "head.json"
    with pytest.raises(VergenceError, match="do not overlap"):
        of_dataset(tmp_path / "data", calibration=head, out=tmp_path / "depth")
    assert not (tmp_path / "depth").exists()


@pytest.mark.render
def test_depth_of_the_room_by_the_true_head_is_right(tmp_path, monkeypatch):
    """And the same geometry whether it comes from a file and readings or from the twin."""
    calibration = tmp_path / "true.json"
    save_head(as_built_head(nominal_head("2.8mm"), load_profile("ideal"), 0), calibration)
    out = tmp_path / "depth"
    depth(
        monkeypatch, "--twin", "--profile", "ideal", "--calibration", str(calibration),
        "--pairs", "2", "--out", str(out),
    )  # fmt: skip
    found = json.loads((out / "depth.json").read_text())
    for geometry in ("joints", "true_geometry"):
        assert found[geometry]["median_relative"] < 0.02
        assert found[geometry]["wrong"] < 0.05
        assert found[geometry]["within_two_std"] > 0.9
        assert found[geometry]["vertical_rms_px"] < 0.01
        assert found[geometry]["pixels"] > 10_000
    assert (out / "depth.rrd").stat().st_size > 100_000
    assert "true geometry" in (out / "report.md").read_text()


@pytest.mark.render
def test_depth_by_what_both_eyes_see_is_better_than_by_wrong_joints(tmp_path, monkeypatch):
    """The head is known, but the readings have gains and noise."""
    calibration, profile = tmp_path / "true.json", load_profile("paper")
    save_head(as_built_head(nominal_head("2.8mm"), profile, 0), calibration)
    monkeypatch.setattr(simulated_robot, "LOOK_S", 2.0)
    monkeypatch.setattr(simulated_robot, "LOOK_STEP_S", 0.2)
    out = tmp_path / "depth"
    depth(
        monkeypatch, "--twin", "--calibration", str(calibration), "--geometry", "seen",
        "--pairs", "2", "--out", str(out),
    )  # fmt: skip
    found = json.loads((out / "depth.json").read_text())
    for figure in ("median_relative", "vertical_rms_px"):
        assert found["seen"][figure] < found["joints"][figure] / 3
    assert found["seen"]["within_two_std"] > 0.85
    assert "seen by both eyes" in (out / "report.md").read_text()


@pytest.mark.render
def test_depth_of_the_twin_by_a_calibration_of_other_cameras_is_refused(
    tmp_path, monkeypatch, capsys
):
    head = nominal_head("2.8mm")
    renamed = {name.replace("wide", "outer"): each for name, each in head.cameras.items()}
    save_head(replace(head, cameras=renamed), tmp_path / "head.json")
    with pytest.raises(SystemExit):
        depth(
            monkeypatch, "--twin", "--calibration", str(tmp_path / "head.json"),
            "--out", str(tmp_path / "depth"),
        )  # fmt: skip
    assert "No camera is called 'left_wide'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "x"], "found neither"),
        (["folder", "--twin", "--out", "x"], "found both"),
        (["folder", "--out", "x", "--seed", "3"], "Options of the twin are given, and a dataset"),
        (["folder", "--out", "x"], "needs --calibration FILE"),
        (["--twin", "--pairs", "0", "--out", "x"], "Asked for 0 pairs"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_sentence(words, said, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        depth(monkeypatch, *words)
    assert stop.value.code == 2
    assert said in capsys.readouterr().err
