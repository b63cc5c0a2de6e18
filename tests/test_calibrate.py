"""Observations, or a dataset, to a calibrated head: what is done, how often, what comes back."""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest

import vergence.calibration.bundle_start as bundle_start
import vergence.calibration.calibrate as calibrate_module
import vergence.calibration.cross_validation as cross_validation
import vergence.calibration.prepared_views as prepared_views
from recordings import JOINTS, description, picture, write_dataset
from simulated_head import plain_head, random_head
from simulated_recording import BOARD, EXACT, POINTS, Noise, Recording, record
from texts import texts
from vergence.arrays import Array
from vergence.calibration.board_numbering import turn_boards
from vergence.calibration.calibrate import CalibrationResult, Method, calibrate
from vergence.calibration.detection import SYSTEMATIC_PX
from vergence.calibration.moved_boards import SHIFTS
from vergence.calibration.observations import Observations
from vergence.calibration.summary import inaccurate, summary_lines, verdict
from vergence.data.dataset import Dataset
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.camera import project
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import HeldOut
from vergence.geometry.parameters import boxminus
from vergence.geometry.se3 import transform
from vergence.vision.board_detection import detect_board
from vergence.vision.board_pose import board_poses

GOOD = Recording(reach_rad=(0.3, 0.3), noise=Noise(pixel_px=0.1, joint_rad=np.radians(0.1)))
FOLDS = 5


@pytest.fixture(scope="module")
def recorded() -> tuple[HeadCalibration, Observations]:
    rng = np.random.default_rng(0)
    truth = random_head(rng, lenses=("wide",))
    return truth, record(truth, rng, GOOD)


@pytest.fixture(scope="module")
def found(recorded: tuple[HeadCalibration, Observations]) -> CalibrationResult:
    return calibrate(recorded[1])


def test_the_result_is_the_truth_within_what_it_states(recorded, found: CalibrationResult):
    assert_within_stated(found, recorded[0])
    assert texts(found.findings) == []


def test_a_result_holds_all_that_led_to_it(recorded, found: CalibrationResult):
    assert found.head.accuracy is found.accuracy
    assert found.accuracy.method == "bundle"
    assert found.estimate is not None
    assert set(found.estimate.residuals_px) == set(recorded[1].corners)
    assert set(found.start.intrinsics) == set(recorded[1].corners)
    held_out = found.accuracy.held_out
    assert held_out is not None
    assert held_out.folds == FOLDS
    assert held_out.transfer_views == len(recorded[1].placement)
    lines = found.summary().splitlines()
    assert lines[0].startswith(("GOOD: 2 cameras, 36 views", "DOUBTFUL: 2 cameras, 36 views"))
    assert len(lines) <= 10


def test_stray_corners_are_left_out_and_counted(recorded):
    _, seen = recorded
    corners = {name: each.copy() for name, each in seen.corners.items()}
    corners["left_wide"][::3, 20] += 40.0
    found = calibrate(replace(seen, corners=corners), method="paper")
    assert any(
        "left out: 12 in 12 images of left_wide." in s for s in texts(found.findings, "note")
    )
    assert found.start.intrinsics["left_wide"].rms_px < 0.2


def test_the_paper_s_method_does_without_bundle_adjustment(recorded, monkeypatch):
    def refuse(*_args: object, **_named: object) -> None:
        raise AssertionError("bundle adjustment was asked for")

    monkeypatch.setattr(calibrate_module, "bundle_adjust", refuse)
    said = []
    found = calibrate(recorded[1], method="paper", progress=lambda *step: said.append(step))
    assert said == [("calibrating", k, 3) for k in range(4)]
    assert found.estimate is None
    assert found.accuracy.method == "paper"
    assert not found.accuracy.parameters
    assert found.accuracy.held_out is not None
    assert found.summary().startswith("DOUBTFUL")


@pytest.mark.parametrize("method", ["bundle", "paper"])
def test_the_board_s_pose_is_found_once_in_each_image(recorded, method: Method, monkeypatch):
    """Before the folds, whose lenses are others, and whose poses are those of other lenses.

    The paper's steps solve for those of a pair of cameras again, by the corners that both see.
    """
    solved, ended = Counter[bytes](), []

    def counted(camera: object, corners: Array, points: Array) -> Array:
        if not ended:
            solved.update(image.tobytes() for image in corners if np.isfinite(image).any())
        return board_poses(camera, corners, points)  # type: ignore[arg-type]

    for module in (prepared_views, cross_validation, bundle_start):
        monkeypatch.setattr(module, "board_poses", counted)
    monkeypatch.setattr(
        cross_validation, "calibrate_folds", lambda *_: ended.append(True) or _nothing()
    )
    calibrate(recorded[1], method=method)
    images = sum(np.isfinite(c).any(axis=(1, 2)).sum() for c in recorded[1].corners.values())
    assert ended
    assert set(solved.values()) == {1}
    assert len(solved) == images


def _nothing() -> None:
    raise VergenceError("no held-out error here.")


@pytest.mark.usefixtures("two_folds")
def test_a_calibration_that_predicts_held_out_points_far_too_badly_is_void(recorded, monkeypatch):
    wrong = HeldOut(5, 30, 0.1, 30, point_mm=12.0, expected_mm=2.0, distance_m=0.5)
    monkeypatch.setattr(cross_validation, "held_out", lambda *_: wrong)
    found = calibrate(recorded[1], lens="radial-tangential")
    assert found.summary().startswith("VOID")
    assert "6.0 times as wrong as the noise explains" in texts(found.findings, "void")[0]


@pytest.mark.parametrize(("expected_mm", "checks"), [(40.0, True), (60.0, False), (5000.0, False)])
def test_held_out_points_check_nothing_where_noise_explains_a_tenth_of_the_distance(
    found, expected_mm, checks
):
    held = HeldOut(12, 12, 0.1, 12, point_mm=4.0, expected_mm=expected_mm, distance_m=0.5)
    findings = inaccurate(replace(found.head, accuracy=replace(found.accuracy, held_out=held)))
    accuracy = replace(found.accuracy, findings=tuple(findings))
    word, following = verdict(accuracy, found.head)
    assert (f"noise explains errors of {expected_mm:.0f} mm at 0.50 m" in following) != checks
    assert word == ("GOOD" if checks else "DOUBTFUL")


def test_what_to_do_next_is_about_the_largest_part_of_a_point_s_error(found):
    """Noisy readings ask for what the eyes see, a rough calibration for more views."""
    accuracy = replace(found.accuracy, findings=())
    for better, wanted in (
        ({"joint_std": (np.radians(1.0),)}, "Next: let images correct"),
        ({"covariance": 400 * accuracy.covariance}, "Next: record more views"),
        (
            {"joint_std": (1e-6,), "covariance": 1e-6 * accuracy.covariance},
            "Next: nothing; a smaller error",
        ),
    ):
        stated = replace(accuracy, **better)
        word, following = verdict(stated, replace(found.head, accuracy=stated))
        assert word == "GOOD"
        assert following.startswith(wanted)


def test_the_noise_of_readings_is_said_of_each_kind(found):
    head, observed = found.head, found.observations
    for levels, said in (
        ((0.003,), "0.172 degrees in all readings"),
        (
            (0.003, 0.004),
            "0.172 degrees in left_pan and right_pan, 0.229 degrees in left_tilt and right_tilt",
        ),
    ):
        stated = replace(head, accuracy=replace(found.accuracy, joint_std=levels))
        assert summary_lines(stated, observed)[1].endswith(f" px in corners, {said}.")


@pytest.mark.usefixtures("two_folds")
@pytest.mark.parametrize("ratio", [3.0, 11.0])
def test_parts_of_the_views_that_differ_are_doubted_or_void(recorded, monkeypatch, ratio):
    differing = HeldOut(12, 12, 0.1, 0, None, None, None, jackknife_ratio=ratio)
    monkeypatch.setattr(cross_validation, "held_out", lambda *_: differing)
    found = calibrate(recorded[1], lens="radial-tangential")
    (said,) = (each for each in texts(found.findings) if f"differ {ratio} times as much" in each)
    assert (said in texts(found.findings, "void")) == (ratio > 10)


@pytest.mark.usefixtures("two_folds")
def test_boards_numbered_from_the_wrong_end_are_renumbered_and_named(recorded, found, monkeypatch):
    observed = recorded[1]
    monkeypatch.setattr(cross_validation, "held_out", lambda *_: _nothing())
    turns = {"left_wide": np.isin(np.arange(36), [3, 20]).astype(int)}
    again = calibrate(turn_boards(observed, turns))
    remark = (
        "The board is numbered from the wrong end, and was turned, in view 3, view 20 of left_wide."
    )
    assert texts(again.findings, "note")[0] == remark
    for name, corners in observed.corners.items():
        np.testing.assert_array_equal(again.observations.corners[name], corners)
    off = boxminus(again.head, found.head)
    assert max(map(abs, off.values())) < 1e-6


def assert_within_stated(found: CalibrationResult, truth: HeadCalibration) -> None:
    off, accuracy = boxminus(found.head, truth), found.accuracy
    errors = np.array([off[name] for name in accuracy.parameters])
    assert (np.abs(errors) < 4.5 * np.sqrt(np.diag(accuracy.covariance))).all()


@pytest.mark.usefixtures("two_folds")
def test_images_turned_exchanged_or_of_other_moments_are_named_and_spoil_nothing(recorded):
    """Straight ones, from which the start takes how the eyes stand to each other."""
    truth, seen = recorded
    left, right = (each.copy() for each in seen.corners.values())
    left[3] = [639, 479] - left[3]
    left[7], right[7] = seen.corners["right_wide"][7], seen.corners["left_wide"][7]
    right[9] = seen.corners["right_wide"][10]
    corners = {"left_wide": left, "right_wide": right}
    found = calibrate(replace(seen, corners=corners), lens="radial-tangential")
    named = [each for each in found.findings if each.code == "wrong-view"]
    assert [each.where for each in named] == ["view 3", "view 7", "view 9"]
    assert {each.severity for each in named} == {"note"}
    off = boxminus(found.start.head, truth)
    assert max(abs(off[f"T_rbase_lbase.{name}"]) for name in ("rx", "ry", "rz")) < 0.02
    assert not texts(found.findings)
    assert_within_stated(found, truth)


@pytest.mark.usefixtures("two_folds")
def test_a_board_that_a_hand_moves_between_the_eyes_does_not_set_the_noise_of_readings():
    rng = np.random.default_rng(2)
    truth = random_head(rng, lenses=("wide",))
    how = replace(GOOD, straight=16, alike=False, noise=Noise(0.1, np.radians(0.03)))
    seen = record(truth, rng, how)
    camera, right = truth.cameras["right_wide"].intrinsics, seen.corners["right_wide"].copy()
    T = board_poses(camera, right, POINTS)
    for view in range(how.straight):
        points = transform(T[view], POINTS)
        moved = points + rng.normal(0, 1e-3, 3)
        right[view] += project(camera, moved) - project(camera, points)
    corners = {**seen.corners, "right_wide": right}
    found = calibrate(replace(seen, corners=corners), lens="radial-tangential")
    assert np.array(found.accuracy.joint_std) == pytest.approx(np.radians(0.03), rel=0.25)
    assert found.estimate is not None
    assert found.estimate.levels[SHIFTS] == pytest.approx(1e-3, rel=0.4)
    assert [each.severity for each in found.findings if each.code == "board-moved"] == ["note"]
    assert_within_stated(found, truth)


# From images


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Return pictures of boards before a head of pinhole cameras, with exact readings."""
    folder = tmp_path_factory.mktemp("calibrate") / "dataset"
    head = plain_head(0.07, 300.0, camera_m=((0.02, 0, 0),) * 2)
    how = Recording(straight=5, orientations=8, noise=EXACT)
    seen = record(head, np.random.default_rng(4), how)
    table, images = [], {}
    for v, placement in enumerate(seen.placement):
        row = {"time_s": v + 1.0, "joint_time_s": v + 1.0, "placement": placement}
        row |= dict(zip(JOINTS, seen.eye_angles[v].tolist(), strict=True))
        for name, corners in seen.corners.items():
            whole = np.isfinite(corners[v]).all()
            row[name] = f"images/{name}_{v}.png" if whole else ""
            if whole:
                H, _ = cv2.findHomography(POINTS[:, :2] / BOARD.square_m, corners[v])
                images[row[name]], _ = picture(BOARD, H, seen.sizes[name])
        table.append(row)
    write_dataset(folder, table, description(BOARD, (640, 480)), images)
    return load_dataset(folder)


def own_detector(dataset: Dataset) -> Observations:
    """Return what someone would write who fills in observations without detect_target."""
    corners = {name: np.full((len(dataset), len(POINTS), 2), np.nan) for name in dataset.files}
    for name, files in dataset.files.items():
        for row, file in enumerate(files):
            if file is not None:
                grey = cv2.imread(str(dataset.folder / file), cv2.IMREAD_GRAYSCALE)
                found = detect_board(grey, BOARD)
                corners[name][row] = np.nan if found is None else found
    return Observations(
        board=BOARD,
        placement=dataset.placement,
        eye_angles=dataset.eye_angles,
        corners=corners,
        sizes=dict.fromkeys(corners, (640, 480)),
        systematic_px=SYSTEMATIC_PX,
    )


@pytest.mark.slow
def test_a_detector_of_one_s_own_gives_the_same_as_a_dataset(dataset: Dataset, monkeypatch):
    monkeypatch.setattr(cross_validation, "calibrate_folds", lambda *_: _nothing())
    lens = "radial-tangential"
    ours, theirs = calibrate(dataset, lens=lens), calibrate(own_detector(dataset), lens=lens)
    assert max(map(abs, boxminus(ours.head, theirs.head).values())) < 1e-9
    np.testing.assert_allclose(ours.accuracy.covariance, theirs.accuracy.covariance, rtol=1e-6)
    assert ours.head.T_rbase_lbase[1, 3] == pytest.approx(0.07, abs=5e-4)


@pytest.mark.slow
@pytest.mark.usefixtures("two_folds")
def test_a_board_of_ten_times_its_size_is_doubted_by_the_distance_of_the_eyes(dataset: Dataset):
    board = replace(BOARD, square_m=10 * BOARD.square_m)
    large = replace(dataset, description=replace(dataset.description, board=board))
    said = calibrate(large, lens="none").summary()
    assert "The eyes are 7" in said.splitlines()[0]
    assert "nan" not in said
    assert "the board's squares have another size than the dataset says" in said.splitlines()[-1]


def test_what_cannot_be_calibrated_and_unknown_methods_are_named(dataset: Dataset):
    with pytest.raises(VergenceError, match=r"load_dataset\(folder\).*found 'runs/dataset'"):
        calibrate("runs/dataset")  # pyright: ignore[reportArgumentType]
    with pytest.raises(VergenceError, match="method is bundle or paper, found 'bundel'"):
        calibrate(dataset, method="bundel")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("method", ["bundle", "paper"])
def test_a_view_without_a_reading_is_named(recorded, method: Method):
    angles = recorded[1].eye_angles.copy()
    angles[20, 2] = np.nan
    with pytest.raises(VergenceError, match="The right eye sees a board in view 20, but its joint"):
        calibrate(replace(recorded[1], eye_angles=angles), method=method)


def test_a_dataset_of_moving_eyes_only_is_refused(dataset: Dataset):
    moving = replace(dataset, moving=np.ones(len(dataset), bool))
    with pytest.raises(VergenceError, match="moving rows only"):
        calibrate(moving)


def test_shapes_that_do_not_fit_are_refused_when_observations_are_made(recorded):
    observed: Observations = recorded[1]
    with pytest.raises(VergenceError, match=r"need eye_angles of shape \(36, 4\), found \(36, 2\)"):
        replace(observed, eye_angles=observed.eye_angles[:, :2])
    with pytest.raises(VergenceError, match=r"corners of left_wide of shape \(36, 54, 2\)"):
        replace(observed, corners={"left_wide": observed.corners["left_wide"][:, 1:]})


def test_observations_may_be_lists_and_a_corner_is_never_infinite(recorded):
    observed: Observations = recorded[1]
    listed = replace(
        observed,
        placement=observed.placement.tolist(),
        eye_angles=observed.eye_angles.tolist(),
        corners={name: corners.tolist() for name, corners in observed.corners.items()},
    )
    np.testing.assert_array_equal(listed.eye_angles, observed.eye_angles)
    assert len(listed.take(np.arange(3)).placement) == 3
    listed.corners["left_wide"][4, 5, 0] = np.inf
    with pytest.raises(VergenceError, match="Corners of left_wide are finite pixels, or NaN where"):
        replace(listed)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"sizes": {"left_wide": (640, 480)}}, "and height of right_wide's images .* found None"),
        ({"sizes": {"left_wide": (640, 0), "right_wide": (640, 480)}}, r"found \(640, 0\)"),
        ({"sizes": {"left_wide": ("640", "480")}}, r"left_wide's images .* found \('640', '480'\)"),
        ({"corners": {}}, "corners is empty"),
        ({"eyes": {"left_wide": "Left"}}, "eyes.left_wide is 'Left'; expected left or right"),
    ],
)
def test_cameras_that_no_head_has_are_refused_when_observations_are_made(recorded, change, said):
    with pytest.raises(VergenceError, match=said):
        replace(recorded[1], **change)
    corners = {"left cam": recorded[1].corners["left_wide"]}
    with pytest.raises(VergenceError, match="a camera 'left cam'; a camera's name begins with"):
        replace(recorded[1], corners=corners)
