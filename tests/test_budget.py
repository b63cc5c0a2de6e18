"""The error budget: its parts against moved heads, what cancels, and the command."""

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from other_heads import KINDS, other_head
from recordings import small_dataset
from simulated_head import plain_head
from test_location_accuracy import stated
from vergence import cli
from vergence.accuracy.budget import CALIBRATION, Source, budget, group_of
from vergence.accuracy.motion_budget import (
    MotionBudgets,
    motion_budgets,
    motion_of,
    stated_sources,
)
from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import Array
from vergence.cli.accuracy_reports import advice, budget_report, budget_rows
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, save_head
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics, Side
from vergence.geometry.parameters import boxplus, change_named, is_gain, parameter_names
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.budget_sources import profile_sources
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
    *,
    points: Array,
    motion: str,
    profile: ErrorProfile | None = None,
    pixel_std_px: float | None = None,
) -> MotionBudgets:
    sources = stated_sources(head, pixel_std_px)
    if profile is not None:
        sources = profile_sources(head, profile, pixel_std_px)
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
        Source("joints", joint_std_rad=np.array([1e-3, 1e-3, 2e-3, 1e-3])),
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


def test_what_cannot_be_budgeted_is_refused():
    nothing = {"motion": "parallel", "profile": None, "pixel_std_px": None}
    with pytest.raises(VergenceError, match="needs sources of errors"):
        run(HEAD, points=POINT[None], **nothing)
    with pytest.raises(VergenceError, match="both cameras see"):
        run(stated(HEAD), points=-POINT[None], **nothing)
    with pytest.raises(VergenceError, match="pixel noise has a standard deviation of 0 or more"):
        run(HEAD, points=POINT[None], motion="parallel", profile=None, pixel_std_px=np.nan)
    with pytest.raises(VergenceError, match="There is no motion 'round'"):
        motion_of("round", HEAD)
    source = Source("wrong", errors={"nose.fx": 1.0})
    with pytest.raises(VergenceError, match=r"no parameter 'nose\.fx'"):
        budget(HEAD, POINT[None], **motion("parallel"), sources=[source])


def test_a_head_calibrated_with_measured_eye_poses_has_no_budget():
    accuracy = replace(stated(HEAD).accuracy, joint_std=(1e-3, 2e-3), eye_motion="poses")
    with pytest.raises(VergenceError, match=r"errors of joint readings .* measured eye poses"):
        run(
            replace(HEAD, accuracy=accuracy),
            points=POINT[None],
            motion="parallel",
            profile=None,
            pixel_std_px=None,
        )


@pytest.mark.parametrize("kind", KINDS)
def test_a_profiles_errors_are_sources_for_heads_with_any_joints(kind: str):
    head = other_head(kind, np.random.default_rng(0))
    sources = {source.name: source for source in profile_sources(head, load_profile("paper"))}
    assert list(sources)[-1] == "shift of the mountings, by hand"
    gains = {name for name in parameter_names(head) if is_gain(name)}
    assert set(sources["gains of the joints"].errors) == gains


def test_motions_of_pan_and_tilt_are_refused_for_heads_with_other_readings():
    head = stated(other_head("shared tilt, pan", np.random.default_rng(0)))
    said = r"'divergent' is of the readings .* has tilt, left_pan, right_pan\. .* dataset"
    with pytest.raises(VergenceError, match=said):
        run(head, points=POINT[None], motion="divergent", profile=None, pixel_std_px=0.1)


def test_motions_and_noise_of_a_profile_are_those_of_the_joints_behind_a_gear():
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(replace(joint, readings={f"{eye}_{joint.name}": 0.01}) for joint in own)
        for eye, own in HEAD.kinematics.eyes.items()
    }
    geared, profile = replace(HEAD, kinematics=Kinematics(eyes)), load_profile("noise-only")
    for name in ("parallel", "divergent"):
        direct, before = (
            run(head, points=POINT[None], motion=name, profile=profile, pixel_std_px=0.1)
            for head in (HEAD, geared)
        )
        total, expected = before.budgets[0].total, direct.budgets[0].total
        np.testing.assert_allclose(total.std_m, expected.std_m, rtol=1e-6)


def test_a_head_with_other_joints_has_no_parallel_motion():
    head = other_head("shared tilt, pan", np.random.default_rng(0))
    joints = np.random.default_rng(1).uniform(-0.1, 0.1, (5, len(head.kinematics.readings)))
    source = [Source("pixels", pixel_std_px=0.2)]
    budgets = budget(head, POINT[None], joints=joints, rates=0 * joints, sources=source)
    found = MotionBudgets("data", budgets, None)
    assert [row[4] for row in budget_rows(found, 0)] == ["", ""]
    assert budget_report(found).data["in_parallel_motion"] is None
    same = run(HEAD, points=POINT[None], motion="parallel", profile=None, pixel_std_px=0.2)
    assert [row[4] for row in budget_rows(same, 0)] == [row[1] for row in budget_rows(same, 0)]
    assert budget_report(same).data["in_parallel_motion"] == budget_report(same).data["points"]


def test_the_motion_of_a_dataset_of_other_joints_is_refused(tmp_path):
    small_dataset(tmp_path / "set")
    head = stated(other_head("shared tilt, pan", np.random.default_rng(0)))
    said = r"is for the joint readings tilt, left_pan, right_pan; .*set has left_pan, left_tilt"
    with pytest.raises(VergenceError, match=said):
        motion_of(str(tmp_path / "set"), head)


def test_a_budget_beyond_first_order_says_so():
    noise = {"motion": "parallel", "profile": None, "pixel_std_px": 0.5}
    near, far = (run(HEAD, points=scale * POINT[None], **noise) for scale in (1, 20))
    assert "may be larger or smaller" not in advice(near.budgets[0])
    assert "may be larger or smaller" in advice(far.budgets[0])


def test_a_point_that_cannot_be_told_apart_from_infinity_is_refused_with_the_limit():
    noise = {"motion": "parallel", "profile": None, "pixel_std_px": 0.5}
    for scale in (100, 1e6):
        with pytest.raises(VergenceError, match=r"points beyond about (\d+) m apart") as refused:
            run(HEAD, points=scale * POINT[None], **noise)
    # sqrt(2) * 0.5 px of disparity at 280 px and 92 mm: 36 m, less with eyes that look aside.
    limit = float(re.findall(r"about (\d+) m", str(refused.value))[0])
    assert 25 < limit < 40
    run(HEAD, points=0.9 * limit * POINT[None] / np.linalg.norm(POINT), **noise)


def test_a_profile_gives_sources_that_the_papers_method_does_not_find():
    found = run(
        HEAD,
        points=POINT[None],
        motion="divergent",
        profile=load_profile("paper"),
        pixel_std_px=None,
    )
    names = [row[0] for row in budget_rows(found, 0)]
    assert names[:3] == ["pixel noise", "joint noise", "gains of the joints"]
    assert names[-1] == "total"
    assert "half of" in advice(found.budgets[0])
    both = ErrorProfile(by_hand=ByHand(focal_percent_28=1.0, focal_percent_40=2.0))
    of_lens = [source for source in profile_sources(HEAD, both) if "focal" in source.name]
    assert [source.errors["left_wide.fx"] for source in of_lens] == [pytest.approx(2.8)]
    bundle = replace(HEAD, accuracy=replace(stated(HEAD).accuracy, method="bundle"))
    sensors = ErrorProfile(
        joints=Joints(noise_deg=0.1, gain_percent=(1, 1, 1, 1), delay_ms=5),
        calibration=CalibrationProcedure(square_percent=1.0),
    )
    common = {"points": POINT[None], "motion": "parallel", "pixel_std_px": None}
    parts = [
        [part.name for part in run(head, profile=sensors, **common).budgets[0].parts]
        for head in (HEAD, bundle)
    ]
    assert {"gains of the joints", "delay"} <= set(parts[0])
    assert "gains of the joints" not in parts[1]
    assert "delay" in parts[1]  # no eyes moved in its recording
    assert all("size of the board" in own for own in parts)  # no view of joint heads shows it


def test_the_command_writes_a_table_json_and_a_figure(tmp_path, monkeypatch, capsys):
    save_head(stated(HEAD), tmp_path / "head.json")
    monkeypatch.chdir(tmp_path)
    typed = "budget --calibration head.json --at 0.6 -0.03 0.02 --json budget.json --figure b.png"
    monkeypatch.setattr(sys, "argv", ["vergence", *typed.split()])
    cli.main()
    printed = capsys.readouterr().out
    assert "mountings" in printed
    written = json.loads((tmp_path / "budget.json").read_text())
    found = run(
        stated(HEAD), points=POINT[None], motion="divergent", profile=None, pixel_std_px=None
    )
    assert written == json.loads(json.dumps(budget_report(found).data))
    assert (tmp_path / "b.png").stat().st_size > 1000


def test_a_real_heads_budget_needs_no_twin(tmp_path):
    save_head(stated(HEAD), tmp_path / "head.json")
    words = "budget", "--calibration", "head.json"
    done = without_mujoco(*words, "--json", "budget.json", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "half of" in done.stdout
    assert (tmp_path / "budget.json").exists()
    refused = without_mujoco(
        "budget", "--calibration", "head.json", "--profile", "paper", folder=tmp_path
    )
    assert refused.returncode == 2
    assert "Rendering needs OpenGL" in refused.stderr
