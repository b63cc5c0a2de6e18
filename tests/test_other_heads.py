"""Heads that are not built like this project's: one eye, other names, poses, no straight gaze.

By the paper's method alone: test_sequential.py.
"""

from dataclasses import replace

import numpy as np
import pytest

import head_kinds
from head_kinds import recording
from measured_poses import simulate
from other_heads import KINDS, other_head
from simulated_head import as_designed, random_head
from simulated_recording import BOARD, POINTS, Noise, Recording, as_poses, facing, observe, record
from test_sequential import only
from texts import texts
from vergence.calibration import cross_validation
from vergence.calibration.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.calibrate import CalibrationResult, calibrate
from vergence.calibration.intrinsics import calibrate_intrinsics
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import (
    HeadCalibration,
    load_head,
    main_pair,
    parameter_names,
    save_head,
)
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics, Side
from vergence.geometry.parameters import boxminus, change_named, without_offsets
from vergence.geometry.projection import project_at
from vergence.geometry.se3 import POSE, boxplus, pose, rotation, transform
from vergence.geometry.se3 import boxminus as boxminus_pose

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("two_folds")]  # whole calibrations

LENS = "radial-tangential"
"""Of most heads here: its choice takes as long as all else, and does not depend on the joints."""
QUIET = Recording(reach_rad=(0.3, 0.3), noise=Noise(pixel_px=0.1, joint_rad=np.radians(0.05)))


@pytest.fixture
def no_held_out_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not cross-validate, where a test looks at the estimate from all views only."""

    def refuse(*_: object) -> None:
        raise VergenceError("no held-out error here.")

    monkeypatch.setattr(cross_validation, "calibrate_folds", refuse)


@pytest.fixture
def few_boards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten recordings of head_kinds, where a test does not depend on their accuracy."""
    monkeypatch.setattr(head_kinds, "STRAIGHT", 12)
    monkeypatch.setattr(head_kinds, "ORIENTATIONS", 16)


def recorded(
    seed: int, *lenses: str, how: Recording = QUIET
) -> tuple[HeadCalibration, Observations]:
    """Return a head with perfect axes and these lenses, else wide ones, and what it observes."""
    rng = np.random.default_rng(seed)
    truth = random_head(rng, lenses=lenses or ("wide",), perfect_axes=True)
    return truth, record(truth, rng, how)


def assert_within_stated(found: CalibrationResult, truth: HeadCalibration) -> None:
    """Every parameter is right to four of its stated standard deviations."""
    error, std = boxminus(found.head, truth), np.sqrt(np.diag(found.accuracy.covariance))
    assert max(abs(error[n]) / s for n, s in zip(found.accuracy.parameters, std, strict=True)) < 4


def assert_near(found: CalibrationResult, truth: HeadCalibration) -> None:
    for name, value in boxminus(found.head, truth).items():
        if "T_" in name:
            turn = name.rpartition(".")[2].startswith("r")
            assert abs(value) < (np.radians(0.4) if turn else 0.004), name


def test_eyes_that_give_poses_are_calibrated():
    truth, seen = recorded(1)
    found = calibrate(as_poses(seen), lens=LENS)
    assert_near(found, truth)
    assert found.accuracy.eye_motion == "poses"
    assert texts(found.findings) == []


def on_an_arm(
    seed: int, *, size: float = 1.0, pose_std: tuple[float, float] = (2e-4, 2e-4)
) -> tuple[HeadCalibration, Observations]:
    """Return a head of one eye that an arm carries, and 24 views of a board of another size.

    Measured poses have noise [rad], [m]; corners have 0.2 px.
    """
    rng = np.random.default_rng(seed)
    truth, _ = recorded(seed)
    mounted = truth.cameras["left_wide"]
    truth = replace(truth, cameras={"left_wide": mounted}, T_rbase_lbase=np.eye(4))
    V, K = 24, len(POINTS)
    turns, places = rng.uniform(-0.35, 0.35, (V, 3)), rng.uniform(-0.1, 0.1, (V, 3))
    T = pose(rotation(turns), places)
    T_base_target = mounted.T_eye_cam @ pose(rotation([0.3, 0.2, 0.0]), [-0.12, -0.08, 0.5])
    pixels = project_at(mounted, np.eye(4), T, transform(T_base_target, size * POINTS)[None])
    inside = (np.abs(pixels - [320, 240]) < [320, 240]).all(axis=2, keepdims=True)
    read = boxplus(T, rng.normal(0, 1, (V, 6)) * np.repeat(pose_std, 3))
    return truth, Observations(
        board=BOARD,
        placement=np.zeros(V, int),
        eye_angles=np.full((V, 4), np.nan),
        corners={"left_wide": np.where(inside, pixels + rng.normal(0, 0.2, (V, K, 2)), np.nan)},
        sizes={"left_wide": (640, 480)},
        T_base_eye=np.stack([read, np.tile(np.eye(4), (V, 1, 1))], axis=1),
    )


def test_poses_that_know_lengths_show_the_size_of_the_board():
    truth, seen = on_an_arm(8, size=1.006)
    found = calibrate(seen, lens=LENS)
    assert found.estimate is not None
    assert found.estimate.board_scale == pytest.approx(1.006, abs=2e-3)
    assert "a square of the board measures" in " ".join(texts(found.findings, "note"))
    measured = replace(seen, board=replace(BOARD, square_std_m=1e-6))
    kept = bundle_adjust(found.start.head, measured, intrinsics=found.start.intrinsics)
    assert kept.board_scale == pytest.approx(1.0, abs=1e-4)
    assert_near(found, truth)
    checked = found.accuracy.held_out
    assert checked is not None
    assert checked.prediction_px is not None
    # A reading is wrong by 0.2 mrad and 0.2 mm: at 0.5 m and 300 px that is a fifth of a pixel.
    assert checked.prediction_px < 0.6


def test_an_arm_that_errs_by_its_links_keeps_the_lens_of_its_images(tmp_path):
    """Its smooth errors are corrected, in views that the calibration has not seen as well."""
    T_eye_cam, _, observations = simulate(10)
    alone = calibrate_intrinsics(observations)["left_cam"].camera
    found = calibrate(observations, lens="radial-tangential")
    mounted = found.head.cameras["left_cam"]
    np.testing.assert_allclose(mounted.intrinsics.matrix, alone.matrix, rtol=0.003)
    assert {each.severity for each in found.findings} <= {"note"}
    error = boxminus_pose(mounted.T_eye_cam, T_eye_cam)
    stds = np.sqrt(np.diag(found.accuracy.covariance))
    std = dict(zip(found.accuracy.parameters, stds, strict=True))
    for name, off in zip(POSE, error, strict=True):
        assert abs(off) < 4 * std[f"left_cam.T_eye_cam.{name}"]
    save_head(found.head, tmp_path / "head.json")
    head, T = load_head(tmp_path / "head.json"), observations.T_base_eye
    assert found.estimate is not None
    assert T is not None
    board = found.estimate.T_lbase_target[0]
    points = found.estimate.board_scale * corner_points(observations.board)
    errors = {}
    for what, eyes in (("read", T), ("corrected", eye_poses(head, T))):
        seen = project_at(mounted, np.eye(4), eyes[:, 0], transform(board, points)[None])
        errors[what] = np.sqrt(np.nanmean((seen - observations.corners["left_cam"]) ** 2))
    assert errors["corrected"] < errors["read"] / 2
    checked = found.accuracy.held_out
    assert checked is not None
    assert checked.prediction_px is not None
    assert checked.prediction_px < 1.5 * errors["read"]


def test_bases_of_measured_poses_may_stand_anywhere():
    """Two cameras on one flange, of whose poses the right ones are given in a base of its own."""
    truth, left = on_an_arm(8)
    left = left.take(np.arange(14))
    assert left.T_base_eye is not None
    mounted = truth.cameras["left_wide"]
    T_rbase_lbase = pose(rotation([0.0, 0.0, np.pi / 2]))
    aside = replace(mounted, eye="right", T_eye_cam=pose(t=[0, -0.08, 0]) @ mounted.T_eye_cam)
    truth = replace(truth, cameras={"left_wide": mounted, "right_wide": aside})
    truth = replace(truth, T_rbase_lbase=T_rbase_lbase)
    T = left.T_base_eye[:, 0]
    T_base_target = mounted.T_eye_cam @ pose(rotation([0.3, 0.2, 0.0]), [-0.12, -0.08, 0.5])
    right = project_at(aside, np.eye(4), T, transform(T_base_target, POINTS)[None])
    right += np.random.default_rng(1).normal(0, 0.2, right.shape)
    seen = replace(
        left,
        corners={**left.corners, "right_wide": right},
        sizes=dict.fromkeys(truth.cameras, (640, 480)),
        T_base_eye=np.stack([T, T_rbase_lbase @ T], axis=1),
    )
    found = calibrate(seen, lens=LENS)
    assert_within_stated(found, truth)
    assert found.accuracy.void == ()


def test_eye_poses_about_one_axis_are_refused():
    _, seen = recorded(2, how=replace(QUIET, reach_rad=(0.25, 0)))
    words = "T_eye_cam is not observable: .* turns by 0.* turn it by at least .* about two axes"
    with pytest.raises(VergenceError, match=words):
        calibrate(as_poses(seen), lens=LENS)


def test_a_head_of_one_eye_is_calibrated():
    truth, seen = recorded(3, "wide", "middle")
    names = "right_wide", "right_middle"
    found = calibrate(only(seen, *names))
    cameras = {name: truth.cameras[name] for name in names}
    assert_near(found, replace(truth, cameras=cameras, T_rbase_lbase=np.eye(4)))
    assert main_pair(found.head) is None
    assert texts(found.findings) == []
    assert not any("T_rbase" in name for name in found.accuracy.parameters)


# Other joints than pan and tilt of each eye


@pytest.mark.usefixtures("few_boards")
@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"pan, tilt"}))
def test_any_joints_are_calibrated_exactly_from_exact_corners(kind: str):
    rng = np.random.default_rng(7)
    truth = without_offsets(other_head(kind, rng, rolled=True))
    seen = recording(truth, rng, Noise())
    found = bundle_adjust(nearby(truth, rng), seen)
    for name, value in boxminus(found.head, truth).items():
        assert abs(value) < 1e-6, name


def nearby(truth: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a head that is a little wrong everywhere, with joints as designed."""
    start = replace(truth, kinematics=as_designed(truth.kinematics))
    names = [n for n in parameter_names(start) if ".T_eye_cam." in n or n.startswith("T_rbase")]
    return change_named(start, names, rng.normal(0, 1e-3, len(names)))


@pytest.mark.parametrize("kind", ["shared tilt, pan", "version and vergence"])
def test_readings_that_eyes_share_have_one_noise_and_true_regions(kind: str):
    rng = np.random.default_rng(3)
    truth = without_offsets(other_head(kind, rng, rolled=True))
    found = bundle_adjust(nearby(truth, rng), recording(truth, rng))
    assert found.joint_std == pytest.approx([np.radians(0.05)] * len(found.joint_std), rel=0.35)
    assert len(found.joint_std) == {"shared tilt, pan": 2, "version and vergence": 3}[kind]
    off = boxminus(found.head, truth)
    std = dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)), strict=True))
    scores = [off[name] / std[name] for name in std if std[name] > 0]
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_eyes_that_share_readings_may_see_boards_one_after_the_other():
    """A board shows one eye's sum of version and vergence only, and no noise of each."""
    rng = np.random.default_rng(3)
    truth = without_offsets(other_head("version and vergence", rng))
    seen = recording(truth, rng)
    seen.corners["left_wide"][::2] = np.nan
    seen.corners["right_wide"][1::2] = np.nan
    found = bundle_adjust(nearby(truth, rng), seen)
    assert found.joint_std == pytest.approx([np.radians(0.05)], rel=0.35)
    few = replace(
        seen,
        eye_angles=seen.eye_angles[:24],
        placement=seen.placement[:24],
        corners={name: each[:24] for name, each in seen.corners.items()},
    )
    assert np.isfinite(bundle_adjust(nearby(truth, rng), few).covariance).all()


@pytest.mark.usefixtures("no_held_out_error")
@pytest.mark.parametrize(("kind", "still"), [("pan, tilt, roll", 2), ("version and vergence", 1)])
def test_a_joint_that_never_moved_is_not_called_wrong(kind: str, still: int):
    rng = np.random.default_rng(1)
    truth = without_offsets(other_head(kind, rng))
    straight, turned = 8, 16
    angles = np.zeros((straight + turned, len(truth.kinematics.readings)))
    angles[straight:] = rng.uniform(-0.2, 0.2, (turned, angles.shape[1]))
    angles[:, still] = 0.0
    centres = np.column_stack([np.ones(9), rng.uniform(-0.1, 0.1, (9, 2)) - [0.04, 0.0]])
    boards = facing(rng.uniform(0.45, 0.7, (9, 1)) * centres, rng.uniform(-0.5, 0.5, (9, 3)))
    placement = np.minimum(np.arange(straight + turned), straight)
    seen = observe(
        truth,
        rng,
        Noise(0.1, np.radians(0.05)),
        placement=placement,
        T_lbase_target=boards[placement],
        joints=angles,
    )
    found = calibrate(seen, lens=LENS)
    said = " ".join(texts(found.findings))
    assert "not observable" in said


def test_a_reading_before_a_gear_has_a_noise_of_its_own_in_few_views_too():
    """With the level of another reading it would pass for exact, and the other for noise."""
    truth, seen = recorded(3, how=Recording(straight=8, orientations=4, alike=False))
    gears = {"pan": 1.0, "tilt": 0.01}
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(
            replace(joint, readings={f"{eye}_{joint.name}": gears[joint.name]}) for joint in own
        )
        for eye, own in seen.kinematics.eyes.items()
    }
    read = seen.eye_angles / np.array([*gears.values()] * 2)
    geared = replace(seen, kinematics=Kinematics(eyes), eye_angles=read)
    direct, found = (
        bundle_adjust(replace(truth, kinematics=each.kinematics), each) for each in (seen, geared)
    )
    assert_told_alike(direct, found)


def assert_told_alike(direct: BundleEstimate, geared: BundleEstimate) -> None:
    """The estimate with gears is as certain as that without."""
    for name in ("left_wide.T_eye_cam.rx", "T_rbase_lbase.ry", "left.pan_gain"):
        std, expected = (
            np.sqrt(each.covariance[k, k])
            for each in (geared, direct)
            for k in [each.parameters.index(name)]
        )
        assert std == pytest.approx(expected, rel=0.3), name
