"""Next best views: their information is bundle adjustment's own, and their accuracy is reached."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from documents import blocks
from simulated_head import plain_head, random_head, rough_start
from simulated_recording import BOARD, EXACT, Recording, joined, record
from test_kinematics import shared_tilt
from vergence import cli
from vergence.accuracy import plan as command
from vergence.accuracy import plan as plan_module
from vergence.accuracy import plan_information
from vergence.accuracy.plan import Plan, choose, plan
from vergence.accuracy.plan_information import (
    largest_std,
    scaled_information,
    total_information,
    view_information,
    workspace,
)
from vergence.accuracy.plan_views import (
    MARGIN_PX,
    admissible_views,
    as_seen,
    shows_whole_board,
)
from vergence.calibration.bundle_adjustment import NoiseModel, bundle_adjust
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import project
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, pair_names, parameter_names, save_head
from vergence.geometry.kinematics import EYES, Kinematics
from vergence.geometry.parameters import without_offsets
from vergence.geometry.projection import camera_pose, project_point
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import locate

PIXEL_PX, JOINT_RAD = 0.1, 2e-3
NOISE = {"noise": NoiseModel(PIXEL_PX, JOINT_RAD)}
LIMITS = np.radians([25.0, 20.0, 25.0, 20.0])


@pytest.fixture(scope="module")
def truth() -> HeadCalibration:
    return without_offsets(random_head(np.random.default_rng(3), lenses=("wide",)))


@pytest.fixture(scope="module")
def calibrated(truth: HeadCalibration, slow_setup: None) -> HeadCalibration:
    """The head itself, with the covariance that a short recording without noise gives."""
    first = first_recording(truth)
    estimate = bundle_adjust(rough_start(truth, np.random.default_rng(5)), first, **NOISE)
    return replace(truth, accuracy=estimate.accuracy)


def first_recording(truth: HeadCalibration) -> Observations:
    short = Recording(straight=8, orientations=10, noise=EXACT)
    return record(truth, np.random.default_rng(4), short)


@pytest.fixture(scope="module")
def planned(calibrated: HeadCalibration) -> Plan:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_module, "CANDIDATES", (30, 6))
        return plan(calibrated, BOARD, limits_rad=LIMITS)


def test_admissible_views_show_the_whole_board_before_both_main_cameras_within_the_limits(truth):
    views = admissible_views(truth, BOARD, LIMITS, np.random.default_rng(0), places=6, gazes=4)
    assert len(views.placement) == 24
    assert (np.abs(views.joints) <= LIMITS).all()
    assert shows_whole_board(truth, BOARD, views).all()
    for name, uv in as_seen(truth, BOARD, views).corners.items():
        lens = truth.cameras[name].intrinsics
        assert (uv > MARGIN_PX).all()
        assert (uv < np.array(lens.size) - 1 - MARGIN_PX).all()
    # The board is looked at from its front: z of the target points away from the head.
    T = inverse(eye_poses(truth, views.joints)[:, 0] @ truth.cameras["left_wide"].T_eye_cam)
    T_cam_target = T @ views.T_lbase_target
    assert (T_cam_target[:, 2, 2] > 0.2).all()
    places = views.T_lbase_target.reshape(6, 4, 4, 4)
    np.testing.assert_array_equal(places, places[:, :1].repeat(4, axis=1))


def test_a_board_is_held_whole_where_the_image_has_all_its_corners(truth):
    rng = np.random.default_rng(3)
    board = replace(BOARD, columns=30, rows=20, square_m=0.012)
    held = admissible_views(truth, board, LIMITS, rng, places=20, gazes=1)
    joints = held.joints + rng.uniform(-0.3, 0.3, held.joints.shape)
    views = replace(held, joints=joints)  # some of which lose a part of the board
    expected = []
    corners, T = corner_points(board), eye_poses(truth, views.joints)
    for mounted in truth.cameras.values():
        T_lbase = camera_pose(mounted, truth.T_rbase_lbase, T[:, EYES.index(mounted.eye)])
        lens = mounted.intrinsics
        uv = project(lens, transform((inverse(T_lbase) @ views.T_lbase_target)[:, None], corners))
        last = np.array(lens.size) - 1 - MARGIN_PX
        expected.append(((uv > MARGIN_PX) & (uv < last)).all(axis=(1, 2)))
    assert 0.1 < np.mean(expected) < 0.9
    shown = shows_whole_board(truth, board, views)
    np.testing.assert_array_equal(shown, np.stack(expected, axis=1))


def test_views_of_a_large_board_are_linearised_in_parts(truth, monkeypatch):
    """Together their derivatives might take more memory than there is."""
    views = admissible_views(truth, BOARD, LIMITS, np.random.default_rng(1), places=3, gazes=2)
    names = parameter_names(truth)[:8]
    noise = {"pixel_std_px": PIXEL_PX, "joint_stds": np.full((1, 4), JOINT_RAD)}
    together = view_information(truth, BOARD, views, names, scale=np.ones(8), **noise)
    monkeypatch.setattr(plan_information, "CORNERS_AT_A_TIME", 2 * BOARD.columns * BOARD.rows)
    in_parts = view_information(truth, BOARD, views, names, scale=np.ones(8), **noise)
    np.testing.assert_allclose(in_parts, together, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("kinematics", [None, shared_tilt()], ids=["pan-tilt", "shared tilt"])
def test_the_information_of_views_is_that_of_bundle_adjustment(truth, kinematics):
    """Recorded without noise at the true head, the covariance of both must be the same."""
    head = truth if kinematics is None else replace(truth, kinematics=kinematics)
    limits = np.full(len(head.kinematics.readings), 0.4)
    views = admissible_views(head, BOARD, limits, np.random.default_rng(1), places=5, gazes=5)
    estimate = bundle_adjust(head, as_seen(head, BOARD, views), **NOISE)
    names = estimate.accuracy.parameters
    scale = np.sqrt(np.diag(estimate.accuracy.covariance))
    noise = {"pixel_std_px": PIXEL_PX, "joint_stds": np.full((1, len(limits)), JOINT_RAD)}
    of_views = view_information(head, BOARD, views, names, scale=scale, **noise)[0]
    N = total_information(of_views, views.placement)
    correlation = estimate.accuracy.covariance / np.outer(scale, scale)
    # Bundle adjustment adds the least systematic errors that it can tell from none.
    np.testing.assert_allclose(np.linalg.inv(N), correlation, atol=5e-3)


def test_the_eyes_fixate_the_workspace_and_its_covariance_is_that_of_located_points(calibrated):
    pair = pair_names(calibrated)
    points = workspace(calibrated, pair, LIMITS, names=calibrated.accuracy.parameters)
    left, right = (project_point(calibrated, k, points.joints, points.points) for k in pair)
    inside = (np.abs(points.joints) < LIMITS - 1e-9).all(axis=1)
    assert inside.sum() > 20
    for uv, name in ((left, pair[0]), (right, pair[1])):
        centre = calibrated.cameras[name].intrinsics.matrix[:2, 2]
        np.testing.assert_allclose(uv[inside], np.broadcast_to(centre, uv[inside].shape), atol=1e-6)
    located = locate(calibrated, left=left, right=right, joints=points.joints)
    assert calibrated.accuracy is not None
    found = largest_std(points.by_parameters, calibrated.accuracy.covariance)
    # Only weights between the four equations differ.
    wanted = np.sqrt(np.linalg.eigvalsh(located.calibration_covariance)[:, -1])
    np.testing.assert_allclose(found[inside], wanted[inside], rtol=1e-3)


def geared(kinematics: Kinematics, factor: float) -> Kinematics:
    """Return joints of which each reading counts by a factor."""
    eyes = {
        eye: tuple(replace(j, readings=dict.fromkeys(j.readings, factor)) for j in joints)
        for eye, joints in kinematics.eyes.items()
    }
    return replace(kinematics, eyes=eyes)


def test_limits_of_each_reading_are_those_of_the_planned_readings(calibrated, quick):
    head = replace(calibrated, kinematics=geared(calibrated.kinematics, 0.5))
    limits = 1.5 * LIMITS
    found = plan(head, BOARD, views=3, limits_rad=limits)
    assert (np.abs(found.views.joints) <= limits).all()
    assert (np.abs(found.workspace.joints) <= limits + 1e-9).all()


def test_a_plan_beats_random_views_and_its_prediction_is_what_recalibration_states(
    calibrated, planned
):
    rng = np.random.default_rng(6)
    truth = replace(calibrated, accuracy=None)
    first = first_recording(truth)
    assert planned.after_m.max() < 0.6 * planned.before_m.max()
    assert (np.diff(planned.steps_m) <= 1e-12).all()  # no view does harm
    ratios = []
    for views in (
        planned.views,
        admissible_views(truth, BOARD, LIMITS, rng, places=10, gazes=1),
        admissible_views(truth, BOARD, LIMITS, rng, places=5, gazes=2),
    ):
        both = joined([first, as_seen(truth, BOARD, views)])
        accuracy = bundle_adjust(truth, both, **NOISE).accuracy
        std = largest_std(planned.workspace.by_parameters, accuracy.covariance)
        ratios.append(std.max() / planned.after_m.max())
    assert ratios[0] == pytest.approx(1, rel=0.005)
    assert np.mean(ratios[1:]) > 1.2


def test_the_view_that_tells_what_points_need_is_chosen_first_and_others_are_exchanged():
    """Two parameters move the only point; view 0 tells a little of both, 1 and 2 of one each."""
    V, p = 4, 2
    of_views = np.zeros((V, p + 6, p + 6))
    of_views[:, p:, p:] = np.eye(6)
    of_views[0, :p, :p] = 3 * np.eye(2)
    of_views[1, 0, 0] = of_views[2, 1, 1] = 40.0
    by_parameters = np.array([[[1.0, 0], [0, 1], [0, 0]]])
    before, place = np.eye(p), np.arange(V)
    assert choose(before, of_views, place, by_parameters, 1).tolist() == [0]
    assert sorted(choose(before, of_views, place, by_parameters, 2).tolist()) == [1, 2]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_module, "CANDIDATES", (6, 3))


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, arguments)])
    cli.main()


def test_the_command_prints_a_plan_and_writes_figure_and_json(
    calibrated, quick, tmp_path, monkeypatch, capsys
):
    save_head(calibrated, tmp_path / "head.json")
    words = ["plan", tmp_path / "head.json", "--board", 9, 6, 0.03, "--views", 4]
    run(monkeypatch, *words, "--figure", tmp_path / "p.png", "--json", tmp_path / "p.json")
    printed = capsys.readouterr().out
    assert printed.count("\n| ") == 5 - 1
    assert "mm after these views (predicted)" in printed
    assert (tmp_path / "p.png").stat().st_size > 10_000
    found = json.loads((tmp_path / "p.json").read_text())
    assert len(found["views"]) == 4
    assert max(found["std_after_m"]) == pytest.approx(found["views"][-1]["largest_std_m"])
    # The printed centre of the board is where its corners are.
    first = found["views"][0]
    T = np.array(first["T_lbase_target"])
    middle = transform(T, np.array([4, 2.5, 0]) * BOARD.square_m)
    left_eye = inverse(calibrated.T_rbase_lbase)[:3, 3] / 2  # the head is midway
    np.testing.assert_allclose(first["board_centre_head_m"], middle - left_eye, atol=1e-12)


def test_a_dataset_is_calibrated_first_and_states_its_board(
    calibrated, quick, tmp_path, monkeypatch, capsys
):
    kinematics = calibrated.kinematics
    cameras = {eye: SimpleNamespace(eye=eye) for eye in EYES}
    about = SimpleNamespace(board=BOARD, head_kinematics=kinematics, cameras=cameras)
    data = SimpleNamespace(description=about, board=BOARD, T_base_eye=None)
    monkeypatch.setattr(command, "load_dataset", lambda folder: data)
    result = SimpleNamespace(head=calibrated, accuracy=calibrated.accuracy)
    begun = []
    monkeypatch.setattr(command, "calibrate", lambda given, **_: begun.append(given) or result)
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, "plan", tmp_path, "--limits-deg", 20, 10)
    said = "vergence: Limits are one for each of left_pan, left_tilt, right_pan, right_tilt, or one"
    assert capsys.readouterr().err.startswith(said)
    assert not begun
    run(monkeypatch, "plan", tmp_path, "--views", 2)
    assert begun == [data]
    of_dataset = capsys.readouterr().out
    save_head(calibrated, tmp_path / "head.json")
    run(monkeypatch, "plan", tmp_path / "head.json", "--views", 2, "--board", 9, 6, 0.03)
    assert capsys.readouterr().out == of_dataset


def test_the_guide_to_plans_runs(calibrated, quick, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_head(calibrated, tmp_path / "head.json")
    (code,) = (b.text for b in blocks("docs/design_and_plan.md") if b.language == "python")
    names = {}
    exec(compile(code, "design_and_plan.md", "exec"), names)
    assert names["found"].views.joints.shape == (6, 4)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "say it with --board COLUMNS ROWS SQUARE_M"),
        (["--board", "9", "6", "30"], "the side of a square up to 1 m, found 9 6 30"),
        (["--board", "9", "6", "0.03", "--views", "0"], "A plan has one view or more"),
        (["--board", "9", "6", "0.03", "--seed", "-1"], "seed must be a whole number from 0"),
        (["--board", "9", "6", "0.03", "--limits-deg", "25", "20"], "one for each of left_pan"),
        (
            ["--board", "9", "6", "0.03", "--limits-deg", "-5"],
            "or one for all, above 0; found -5.0 degrees",
        ),
        (["--board", "9", "6", "0.03", "--distances", "0"], "Distances of points are above 0 m"),
        (["--board", "9", "6", "0.03", "--distances", "0.02"], "name larger distances"),
        (["--board", "9", "6", "0.03", "--distances", "1", "900"], "Points at 900 m are out of"),
    ],
)
def test_wrong_options_end_in_a_sentence(
    options, said, calibrated, quick, tmp_path: Path, monkeypatch, capsys
):
    save_head(calibrated, tmp_path / "head.json")
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, "plan", tmp_path / "head.json", *options)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("views", [0, 19])
def test_as_many_views_are_planned_as_there_are_candidates_at_most(calibrated, quick, views):
    with pytest.raises(VergenceError, match=f"of the 6 places .* x 3 directions .* found {views}"):
        plan(calibrated, BOARD, views=views, limits_rad=LIMITS)


def test_what_a_calibration_holds_fixed_is_known_before_the_planned_views(calibrated):
    accuracy = calibrated.accuracy
    C = accuracy.covariance.copy()
    fx, fy = (accuracy.parameters.index(f"left_wide.{name}") for name in ("fx", "fy"))
    C[fy], C[:, fy] = C[fx], C[:, fx]  # a lens with one focal length
    C[fy, fy] = C[fx, fx]
    held = replace(calibrated, accuracy=replace(accuracy, covariance=C))
    scale, information = scaled_information(held)
    back = np.linalg.inv(information) * np.outer(scale, scale)
    stds = np.sqrt(np.diag(C))
    np.testing.assert_allclose(back / np.outer(stds, stds), C / np.outer(stds, stds), atol=1e-3)


def test_a_head_that_states_no_covariance_or_has_one_eye_is_refused():
    head = plain_head(0.08, 400)
    with pytest.raises(VergenceError, match="states no covariance"):
        plan(head, BOARD)
    one = replace(head, cameras={"left_wide": head.cameras["left_wide"]})
    with pytest.raises(VergenceError, match="a camera in each eye"):
        pair_names(one)
