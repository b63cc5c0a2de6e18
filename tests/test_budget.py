"""The error budget: its parts against moved heads, what cancels, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from other_heads import KINDS, other_head
from recordings import small_dataset
from simulated_head import plain_head
from test_location_accuracy import stated
from vergence.accuracy.budget import (
    CALIBRATION,
    MotionBudgets,
    Source,
    budget,
    group_of,
    motion_budgets,
    stated_sources,
)
from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import Array
from vergence.cli.accuracy_reports import advice, budget_report, budget_rows
from vergence.errors import VergenceError
from vergence.geometry.camera import pinhole
from vergence.geometry.head import HeadCalibration, parameter_names, save_head
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics, Side
from vergence.geometry.parameters import boxplus, change_named, is_gain
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.calibration_errors import profile_sources
from vergence.twin.profile import ByHand, CalibrationProcedure, ErrorProfile, Joints, load_profile
from without_mujoco import without_mujoco

HEAD = plain_head(0.092, 280.0, camera_m=((0.02, 0.001, 0.01), (0.02, -0.001, 0.01)))
POINT = np.array([0.6, -0.03, 0.02])
T = 100


def motion(name: str) -> dict[str, Array]:
    time_s = np.arange(T) * PERIOD_S[name] / T
    joints = eye_angles("parallel" if name == "parallel" else "divergent", time_s)
    return {"joints": joints, "rates": np.gradient(joints, time_s, axis=0)}


def run(
    head: HeadCalibration,
    points: Array = POINT,
    *,
    motion: str = "parallel",
    profile: ErrorProfile | None = None,
    noise_px: float | None = None,
) -> MotionBudgets:
    """Return the budgets of points (..., 3) by a calibration or a profile."""
    points = points.reshape(-1, 3)
    sources = stated_sources(head, noise_px)
    if profile is not None:
        sources = profile_sources(head, profile, noise_px)
    return motion_budgets(head, points, motion=motion, sources=sources)


def located(believed: HeadCalibration, joints: Array, readings: Array) -> Array:
    """Return where a wrong head puts the point, and wrong readings."""
    left, right = (project_point(HEAD, f"{eye}_wide", joints, POINT) for eye in ("left", "right"))
    return triangulate_at(believed, left=left, right=right, joints=readings)[0]


@pytest.mark.parametrize("name", ["right_wide.fx", "left_wide.T_eye_cam.rz", "left.pan_gain"])
@pytest.mark.parametrize("kind", ["parallel", "divergent"])
def test_a_known_error_spreads_and_shifts_points_as_a_wrong_head_does(name: str, kind: str):
    size = 0.02 if name.endswith("fx") else 2e-5
    moves = motion(kind)
    wrong = change_named(HEAD, [name], np.array([size]))
    points = located(wrong, moves["joints"], moves["joints"])
    source = Source("wrong", errors={name: size})
    (found,) = budget(HEAD, POINT[None], **moves, sources=[source])
    np.testing.assert_allclose(found.total.spread_m, points.std(axis=0), rtol=2e-3, atol=1e-8)
    shift = np.abs(points.mean(axis=0) - POINT)
    np.testing.assert_allclose(found.total.shared_m, shift, rtol=2e-3, atol=1e-8)
    assert found.samples == T


def test_a_wrong_time_offset_counts_by_how_fast_the_eyes_turn():
    moves, late = motion("divergent"), 1e-4
    points = located(HEAD, moves["joints"], moves["joints"] + late * moves["rates"])
    source = Source("offset", errors={"time_offset_s": late})
    (found,) = budget(HEAD, POINT[None], **moves, sources=[source])
    np.testing.assert_allclose(found.total.spread_m, points.std(axis=0), rtol=2e-3)


def test_squares_of_the_parts_add_up_to_those_of_the_total():
    errors = {"left.pan_gain": 0.01}, {"left_wide.fx": 2.0, "right_wide.fx": 2.0}
    sources = [
        Source("pixels", pixel_std_px=0.2),
        Source("joints", reading_std=np.array([1e-3, 1e-3, 2e-3, 1e-3])),
        *(Source(str(k), errors=each) for k, each in enumerate(errors)),
    ]
    (found,) = budget(stated(HEAD), POINT[None], **motion("divergent"), sources=sources)
    for name in ("spread_m", "shared_m"):
        parts = np.array([getattr(part, name) for part in found.parts])
        total = getattr(found.total, name)
        np.testing.assert_allclose((np.sign(parts) * parts**2).sum(axis=0), total**2, rtol=1e-9)


def test_halving_a_source_gives_what_the_budget_says():
    def total(pixel: float, gain: float) -> float:
        sources = [
            Source("pixels", pixel_std_px=pixel),
            Source("gain", errors={"left.pan_gain": gain}),
            Source("lens", errors={"left_wide.fx": 2.0}),
        ]
        (found,) = budget(stated(HEAD), POINT[None], **motion("divergent"), sources=sources)
        halved.update(found.halved_m)
        return float(np.linalg.norm(found.total.std_m))

    halved: dict[str, float] = {}
    less_noise, less_gain = total(0.1, 0.01), total(0.2, 0.005)
    whole = total(0.2, 0.01)
    assert halved["pixels"] == pytest.approx(less_noise)
    assert halved["gain"] == pytest.approx(less_gain)
    assert halved[CALIBRATION] < whole


def test_the_covariance_of_a_calibration_is_split_into_its_groups():
    head = stated(HEAD)
    accuracy = head.accuracy
    assert accuracy is not None
    moves = motion("divergent")
    (found,) = budget(head, POINT[None], **moves, sources=[])
    names = [part.name for part in found.parts]
    groups = list(dict.fromkeys(map(group_of, accuracy.parameters)))
    assert names == [*groups, "correlation of the calibration's errors"]
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(
        np.zeros(len(accuracy.parameters)), 1e-4 * accuracy.covariance, 400, method="cholesky"
    )
    everything, spreads = parameter_names(head), []
    rows = [everything.index(name) for name in accuracy.parameters]
    for each in drawn:
        change = np.zeros(len(everything))
        change[rows] = each
        points = located(boxplus(head, change), moves["joints"], moves["joints"])
        spreads.append([points.var(axis=0), (points.mean(axis=0) - POINT) ** 2])
    sampled = 100 * np.sqrt(np.mean(spreads, axis=0))
    np.testing.assert_allclose(found.total.spread_m, sampled[0], rtol=0.12)
    np.testing.assert_allclose(found.total.shared_m, sampled[1], rtol=0.12)


TILTS = other_head("shared tilt, pan", np.random.default_rng(0))
"""A head that has other readings than pan and tilt of each eye."""


@pytest.mark.parametrize(
    ("head", "options", "said"),
    [
        (HEAD, {}, "needs sources of errors"),
        (stated(HEAD), {"points": -POINT}, "both cameras see"),
        (HEAD, {"noise_px": np.nan}, "pixel noise has a standard deviation of 0 or more"),
        (stated(HEAD), {"motion": "round"}, "There is no motion 'round'"),
        (
            replace(HEAD, accuracy=replace(stated(HEAD).accuracy, eye_motion="poses")),
            {},
            r"errors of joint readings .* measured eye poses",
        ),
        (
            stated(TILTS),
            {"motion": "set"},
            r"is for the joint readings tilt, left_pan, right_pan; .*set has left_pan, left_tilt",
        ),
    ],
)
def test_what_cannot_be_budgeted_is_refused(head, options, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small_dataset(tmp_path / "set")
    with pytest.raises(VergenceError, match=said):
        run(head, **options)


def test_points_and_parameters_that_no_camera_has_are_refused():
    noise = Source("pixels", pixel_std_px=0.1)
    lens = pinhole(640, 480, 280.0, (-0.3, 0.0, 0.0, 0.0, 0.0))  # folds over at 46 degrees
    cameras = {n: replace(c, intrinsics=lens) for n, c in HEAD.cameras.items()}
    folded = replace(HEAD, cameras=cameras)
    with pytest.raises(VergenceError, match="in both images in 0 of"):
        budget(folded, np.array([[0.4, 0.72, 0.0]]), **motion("parallel"), sources=[noise])
    source = Source("wrong", errors={"nose.fx": 1.0})
    with pytest.raises(VergenceError, match=r"no parameter 'nose\.fx'"):
        budget(HEAD, POINT[None], **motion("parallel"), sources=[source])


def test_a_budget_beyond_first_order_says_so():
    near, far = (run(HEAD, scale * POINT, noise_px=0.5).budgets[0] for scale in (1, 20))
    assert "may be larger or smaller" not in advice(near)
    assert "may be larger or smaller" in advice(far)


@pytest.mark.parametrize("kind", KINDS)
def test_a_profiles_errors_are_sources_for_heads_with_any_joints(kind: str):
    head = other_head(kind, np.random.default_rng(0))
    sources = {source.name: source for source in profile_sources(head, load_profile("paper"))}
    assert list(sources)[-1] == "shift of the mountings, by hand"
    gains = {name for name in parameter_names(head) if is_gain(name)}
    assert set(sources["gains of the joints"].errors) == gains


def test_a_profile_gives_errors_that_the_calibration_did_not_estimate():
    by_hand = ErrorProfile(by_hand=ByHand(focal_percent_28=1.0, focal_percent_40=2.0))
    (lens,) = (source for source in profile_sources(HEAD, by_hand) if "focal" in source.name)
    assert lens.errors["left_wide.fx"] == pytest.approx(2.8)
    bundle = replace(HEAD, accuracy=replace(stated(HEAD).accuracy, method="bundle"))
    sensors = ErrorProfile(
        joints=Joints(noise_deg=0.1, gain_percent=(1, 1, 1, 1), delay_ms=5),
        calibration=CalibrationProcedure(square_percent=1.0),
    )
    before, after = ({s.name for s in profile_sources(h, sensors)} for h in (HEAD, bundle))
    assert before - after == {"gains of the joints"}
    assert {"delay", "size of the board"} <= after  # no eyes moved in its recording


def test_motions_and_noise_of_a_profile_are_those_of_the_joints_behind_a_gear():
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(replace(joint, readings={f"{eye}_{joint.name}": 0.01}) for joint in own)
        for eye, own in HEAD.kinematics.eyes.items()
    }
    geared, profile = replace(HEAD, kinematics=Kinematics(eyes)), load_profile("noise-only")
    for name in ("parallel", "divergent"):
        direct, before = (
            run(head, motion=name, profile=profile, noise_px=0.1).budgets[0]
            for head in (HEAD, geared)
        )
        np.testing.assert_allclose(before.total.std_m, direct.total.std_m, rtol=1e-6)


def test_the_table_has_parallel_motion_beside_and_no_negative_zeros():
    at = np.array([0.5, -0.04, 0.0])
    found = run(HEAD, at, motion="divergent", profile=load_profile("paper"))
    rows = budget_rows(found, 0)
    assert [row[0] for row in rows[:3]] == ["pixel noise", "joint noise", "gains of the joints"]
    assert rows[-1][0] == "total"
    assert any((part.shared_m < 0).any() for part in found.budgets[0].parts)
    assert "-0.00" not in " ".join(" ".join(row) for row in rows)
    same = run(HEAD, noise_px=0.2)
    assert [row[4] for row in budget_rows(same, 0)] == [row[1] for row in budget_rows(same, 0)]
    assert budget_report(same).data["in_parallel_motion"] == budget_report(same).data["points"]


def test_a_real_heads_budget_writes_a_table_json_and_a_figure_without_the_twin(tmp_path):
    save_head(stated(HEAD), tmp_path / "head.json")
    words = "budget --calibration head.json --at 0.6 -0.03 0.02 --json budget.json --figure b.png"
    done = without_mujoco(*words.split(), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1 std [mm]" in done.stdout
    assert "mountings" in done.stdout
    assert "half of" in done.stdout
    written = json.loads((tmp_path / "budget.json").read_text())
    assert written == json.loads(budget_report(run(stated(HEAD), motion="divergent")).json())
    assert (tmp_path / "b.png").stat().st_size > 1000
    refused = without_mujoco(*words.split()[:3], "--profile", "paper", folder=tmp_path)
    assert refused.returncode == 2
    assert "Rendering needs OpenGL" in refused.stderr
