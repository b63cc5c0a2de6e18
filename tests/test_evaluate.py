"""Errors against the truth: named, standardised, and none that is a choice of convention."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulated_head import skewed_head
from vergence import cli
from vergence.cli.evaluation_reports import evaluation_report
from vergence.errors import VergenceError
from vergence.files import write_json
from vergence.geometry.board import Chessboard
from vergence.geometry.head import HeadCalibration, save_head
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.parameters import change_named, without_offsets
from vergence.twin.evaluation import Evaluation, Truth, evaluate
from vergence.twin.profile import ErrorProfile

NAMES = ("left_wide.fx", "left_wide.fy", "left_wide.T_eye_cam.tx", "T_rbase_lbase.rz")
STD = np.array([0.2, 0.2, 1e-3, 1e-3])


def truth_of(head: HeadCalibration) -> Truth:
    return Truth(
        head=head,
        time_offset_s=0.01,
        eye_angles=np.zeros((1, 4)),
        T_lbase_target={0: np.eye(4)},
        board=Chessboard(columns=9, rows=6, square_m=0.03),
        seed=0,
        lens="2.8mm",
        profile=ErrorProfile(),
    )


def text_of(found: Evaluation) -> str:
    return evaluation_report(found).summary()


@pytest.fixture
def head() -> HeadCalibration:
    return skewed_head(np.random.default_rng(7))


def stating(head: HeadCalibration, change: np.ndarray) -> HeadCalibration:
    accuracy = Accuracy(method="bundle", parameters=NAMES, covariance=np.diag(STD**2))
    return replace(change_named(head, NAMES, change), accuracy=accuracy, time_offset_s=0.01)


def test_offsets_that_no_image_tells_are_no_error(head):
    found = evaluate(replace(without_offsets(head), time_offset_s=0.01), truth_of(head))
    assert max(abs(each.error) for each in found.parameters.values()) < 1e-12
    assert found.base_rotation_deg < 1e-5
    assert not found.regions
    assert "states no accuracy" in text_of(found)


def test_errors_are_counted_in_their_standard_deviations(head):
    plain = without_offsets(head)
    found = evaluate(stating(plain, STD * [1, -3, 0.5, 0]), truth_of(head))
    scores = [found.parameters[name].standardised for name in NAMES]
    np.testing.assert_allclose(np.array(scores, float), [1, -3, 0.5, 0], atol=1e-6)
    assert [found.parameters[name].within_95 for name in NAMES] == [True, False, True, True]
    assert found.parameters["left_wide.cx"].std is None
    assert found.regions["left_wide"].distance == pytest.approx(np.hypot(1, 3))
    assert not found.regions["left_wide"].holds_truth
    assert found.regions["T_rbase_lbase"].holds_truth
    assert found.cameras["left_wide"].translation_mm == pytest.approx(0.5)
    assert "outside: left_wide\n" in text_of(found)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("head.json", "--truth", "ds"), "Cannot read ds: it is a folder"),
        (("truth.json", "--truth", "head.json"), "truth.json is not a head calibration"),
        (("ds", "--truth", "truth.json"), "Cannot read ds: it is a folder"),
    ],
)
def test_files_that_are_exchanged_or_folders_are_refused(
    head, words, said, tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("ds").mkdir()
    save_head(head, "head.json")
    write_json(truth_of(head), Path("truth.json"))
    monkeypatch.setattr(sys, "argv", ["vergence", "evaluate", *words])
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    assert said in capsys.readouterr().err


def test_a_truth_of_another_head_is_refused(head):
    fewer = {name: m for name, m in head.cameras.items() if name != "right_narrow"}
    with pytest.raises(VergenceError, match="no camera right_narrow"):
        evaluate(head, truth_of(replace(head, cameras=fewer)))
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: head.kinematics.eyes[eye][::-1]  # tilt, then pan
        for eye in EYES
    }
    with pytest.raises(VergenceError, match="its joints have other axes"):
        evaluate(replace(head, kinematics=Kinematics(eyes)), truth_of(head))
