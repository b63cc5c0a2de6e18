"""Cameras that stand still to each other: a pair, one camera, several on one body."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vergence as vg
from fixed_pairs import VIEWS, boards, random_pair
from recordings import change_about, refusal, small_dataset
from simulated_recording import BOARD, Noise, observe
from vergence.accuracy.plan import plan
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.observations import Observations
from vergence.gaze.state import GazeSettings
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.parameters import boxminus
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import pose, rotation
from vergence.stereo.rectification import rectified_pixels

PAIR = random_pair("plain", np.random.default_rng(3))
NOISE = Noise(pixel_px=0.05)


def recorded(
    head: HeadCalibration, noise: Noise = NOISE, cameras: list[list[str]] | None = None
) -> Observations:
    """Return what the cameras of a head see of boards that a hand holds."""
    rng = np.random.default_rng(5)
    return observe(
        head,
        rng,
        noise,
        placement=np.arange(VIEWS),
        T_lbase_target=boards(PAIR, rng),
        joints=np.zeros((VIEWS, 0)),
        cameras=cameras,
    )


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    return calibrate(recorded(PAIR), lens="radial-tangential")


def test_a_fixed_pair_is_calibrated_within_what_it_states(result: CalibrationResult):
    off, accuracy = boxminus(result.head, PAIR), result.accuracy
    assert accuracy.eye_motion == "fixed"
    std = dict(zip(accuracy.parameters, np.sqrt(np.diag(accuracy.covariance)), strict=True))
    assert not any("T_eye_cam" in name for name in std)  # by definition
    assert all(abs(off[name]) < 4 * std[name] for name in std)
    assert result.summary().startswith("GOOD")


def test_held_out_views_of_a_fixed_pair_are_predicted_to_their_noise(result: CalibrationResult):
    held_out = result.accuracy.held_out
    assert held_out is not None
    assert held_out.prediction_px == pytest.approx(np.sqrt(2) * NOISE.pixel_px, rel=0.1)
    assert held_out.transfer_px is not None
    assert held_out.transfer_px < 4 * NOISE.pixel_px


def test_points_are_located_and_rectified_without_readings(result: CalibrationResult):
    points = np.array([[0.5, 0.0, 0.0], [0.7, -0.1, 0.05]])
    left, right = (project_point(PAIR, name, np.zeros(0), points) for name in PAIR.cameras)
    found = vg.locate(result.head, left=left, right=right, joints=[])  # pyright: ignore
    assert np.linalg.norm(found.xyz - points, axis=1) == pytest.approx(0, abs=1e-3)
    assert np.isfinite(found.covariance).all()
    pair = vg.rectify(result.head, [])
    rows = [
        rectified_pixels(pair, view, uv)[:, 1]
        for view, uv in ((pair.left, left), (pair.right, right))
    ]
    assert rows[0] == pytest.approx(rows[1], abs=0.1)


def test_exact_corners_of_one_camera_give_its_lens():
    name, mounted = next(iter(PAIR.cameras.items()))
    alone = HeadCalibration({name: mounted}, np.eye(4), PAIR.kinematics)
    found = calibrate(recorded(alone, Noise()), lens="radial-tangential")
    assert max(map(abs, boxminus(found.head, alone).values())) < 1e-3
    assert found.accuracy.held_out is not None
    assert found.accuracy.held_out.prediction_px == pytest.approx(0, abs=1e-3)


def test_cameras_on_one_body_are_placed():
    (_, first), (_, second) = PAIR.cameras.items()
    T = {
        "a": first.T_eye_cam,
        "b": pose(t=np.array([0.0, 0.04, 0.0])) @ first.T_eye_cam,
        "c": pose(rotation(np.array([0, 0.05, 0])), np.array([0, 0, 0.05])) @ first.T_eye_cam,
    }
    cameras = {n: MountedCamera("left", second.intrinsics, each) for n, each in T.items()}
    body = HeadCalibration(cameras, np.eye(4), PAIR.kinematics)
    shown = [["a", "b"], ["a", "c"]] * (VIEWS // 2)
    found = calibrate(recorded(body, Noise(), shown), lens="radial-tangential")
    assert max(map(abs, boxminus(found.head, body).values())) < 1e-3


def test_a_board_on_a_stand_may_be_shown_in_several_views():
    seen = recorded(PAIR)
    again = np.concatenate([np.arange(VIEWS), np.arange(6)])
    found = calibrate(seen.take(again), lens="radial-tangential")
    assert found.summary().startswith("GOOD")


def test_exchanged_images_of_a_fixed_pair_are_found():
    seen = recorded(PAIR)
    left, right = seen.corners
    exchanged = {left: seen.corners[right], right: seen.corners[left]}
    found = calibrate(replace(seen, corners=exchanged), lens="radial-tangential")
    assert [each.code for each in found.accuracy.void] == ["left-is-right"]


def test_what_needs_moving_eyes_says_so():
    for use in (
        lambda: plan(PAIR, BOARD),
        lambda: vg.SelfCalibrator(PAIR),
        lambda: GazeSettings(calibration=PAIR, objects={}),  # pyright: ignore
    ):
        with pytest.raises(vg.VergenceError, match=r"stand still|joint readings; this head has n"):
            use()


def test_the_table_of_a_fixed_pair_needs_images_only(tmp_path: Path):
    small_dataset(tmp_path)
    change_about(tmp_path, {"eye_motion": "fixed", "joints": {}})
    table = (tmp_path / "frames.csv").read_text().splitlines()
    header = table[0].split(",")
    cameras = [header.index(name) for name in header if name.startswith(("left_w", "right_w"))]
    rows = [",".join(row.split(",")[k] for k in cameras) for row in table]
    (tmp_path / "frames.csv").write_text("\n".join(rows))
    data = vg.load_dataset(tmp_path)
    assert data.eye_angles.shape == (len(rows) - 1, 0)
    assert len(set(data.placement)) == len(data)
    change_about(tmp_path, {"joints": {"left_pan": {"column": "a", "unit": "rad"}}})
    assert "eye_motion is fixed, but joints has left_pan" in refusal(tmp_path)
