"""From a dataset folder to a calibrated head, through the command line."""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from recordings import description, small_dataset, write_dataset
from rrd import read_series
from simulated_head import plain_head
from simulated_recording import BOARD, as_poses
from test_other_heads import recorded as recorded_of_another
from test_sequential import some_cameras
from vergence import cli
from vergence.calibration import calibrate as calibrate_module
from vergence.calibration.observations import Observations
from vergence.cli.calibration_report import RESULTS
from vergence.data.dataset import Dataset
from vergence.data.description import pose_columns
from vergence.data.reader import load_dataset
from vergence.findings import void
from vergence.geometry.head import HeadCalibration, load_head, main_pair, save_head
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Side
from vergence.interchange.formats import export_head

NOT_CONVERGED = void("not-converged", "The estimate did not converge.")


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, arguments)])
    cli.main()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, opengl: None, coarsely) -> Path:
    folder = tmp_path_factory.mktemp("calibration") / "dataset"
    with pytest.MonkeyPatch.context() as monkeypatch:
        coarsely(monkeypatch)
        run(monkeypatch, "record", "--out", folder, "--frames", 20, "--profile", "noise-only")
    return folder


@pytest.mark.usefixtures("two_folds")
def test_a_recorded_head_is_calibrated_and_evaluated(recorded, tmp_path, monkeypatch, capsys):
    out = tmp_path / "calibration.json"
    report, accuracy, errors = tmp_path / "report", tmp_path / "a.json", tmp_path / "e.json"
    hidden = recorded / "truth.json"
    aside = hidden.rename(recorded / "hidden.json")  # calibration must do without it
    try:
        words = ("calibrate", recorded, "--out", out, "--report", report, "--json", accuracy)
        run(monkeypatch, *words)
    finally:
        aside.rename(hidden)
    run(monkeypatch, "evaluate", out, "--truth", hidden, "--json", errors)
    printed = capsys.readouterr().out
    head = load_head(out)
    assert head.accuracy is not None
    assert head.accuracy.method == "bundle"
    assert np.linalg.eigvalsh(head.accuracy.covariance).min() > -1e-12
    assert head.accuracy.held_out is not None
    assert set(head.cameras) == {"left_wide", "left_narrow", "right_wide", "right_narrow"}
    found = json.loads(errors.read_text())
    assert set(found["cameras"]) == set(head.cameras)
    for camera in found["cameras"].values():
        assert camera["rotation_deg"] < 0.5
        assert camera["translation_mm"] < 4
        assert camera["focal_percent"] < 0.5
    stated = json.loads(accuracy.read_text())
    assert stated["verdict"] in printed
    assert {path.name for path in report.iterdir()} == set(RESULTS)
    _check_recording(report / "dataset.rrd", recorded, stated)
    text = (report / "report.md").read_text()
    assert text.splitlines()[2].startswith(stated["verdict"])
    assert re.search(
        r"\| left_narrow +\| none +\| not compared +\|  +\|", text
    )  # fewer than ten views


@pytest.mark.parametrize(
    "words",
    [
        "budget --calibration void.json",
        "depth dataset --calibration void.json --out depth",
        "depth --twin --calibration void.json --out depth",
        "export void.json --format opencv --out head.yaml",
        "import camchain.yaml --format kalibr --start void.json --out b.json",
        "plan void.json --board 9 6 0.03",
        "self-calibrate dataset --calibration void.json --out b.json",
    ],
)
def test_a_void_calibration_is_not_used(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    void = Accuracy("bundle", findings=(NOT_CONVERGED,))
    save_head(replace(plain_head(0.07, 300.0), accuracy=void), "void.json")
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, *words.split())
    said = capsys.readouterr().err
    assert said == "vergence: The calibration void.json is VOID: The estimate did not converge.\n"
    assert [path.name for path in tmp_path.iterdir()] == ["void.json"]


@pytest.fixture
def voided(tmp_path, monkeypatch) -> HeadCalibration:
    """Calibrations of the dataset `set` in the current folder come out void, for two reasons."""
    monkeypatch.chdir(tmp_path)
    small_dataset(tmp_path / "set")
    findings = (NOT_CONVERGED, void("another", "And another reason."))
    accuracy = Accuracy("bundle", findings=findings)
    head = replace(plain_head(0.08, 310.0), accuracy=accuracy)
    result = SimpleNamespace(
        head=head,
        accuracy=accuracy,
        findings=findings,
        summary=lambda: "VOID: of a test",
        lenses={},
    )
    monkeypatch.setattr(calibrate_module, "calibrate", lambda *_, **__: result)
    return head


def test_a_void_calibration_does_not_replace_one_that_is_there(voided, monkeypatch, capsys):
    save_head(plain_head(0.07, 300.0), "keep.json")
    before = Path("keep.json").read_bytes()
    run(monkeypatch, "calibrate", "set", "--out", "keep.json")
    said = capsys.readouterr().out
    assert "Wrote keep.void.json; keep.json is as it was." in said
    assert "To read all 2 warnings, add --report FOLDER.\n" in said
    assert Path("keep.json").read_bytes() == before
    beside = load_head("keep.void.json", allow_void=True)
    np.testing.assert_array_equal(beside.T_rbase_lbase, voided.T_rbase_lbase)
    run(monkeypatch, "calibrate", "set", "--out", "new.json")
    assert "Wrote new.json.\n" in capsys.readouterr().out


def test_a_file_that_is_no_calibration_is_not_replaced(voided, monkeypatch, capsys):
    Path("notes.json").write_text("{}")
    with pytest.raises(SystemExit) as ended:
        run(monkeypatch, "calibrate", "set", "--out", "notes.json")
    assert ended.value.code == 2
    assert "notes.json is no calibration, and is not replaced" in capsys.readouterr().err
    assert Path("notes.json").read_text() == "{}"


def _check_recording(path: Path, folder: Path, stated: dict) -> None:
    """Every image of the dataset with a board has its corners and residuals in the recording."""
    dataset, residuals = load_dataset(folder), []
    for camera, files in dataset.files.items():
        entity = f"/world/{camera.partition('_')[0]}_eye/{camera}"
        images, _ = read_series(
            path, f"{entity}/image", component="EncodedImage:media_type", timeline="frame"
        )
        assert images.tolist() == [row for row, name in enumerate(files) if name is not None]
        rows, rms = read_series(path, f"/residual/{camera}", timeline="frame")
        assert set(rows) <= set(images)
        residuals += rms.ravel().tolist()
    # Cameras differ: the corners of narrow images are noisier than those of wide ones.
    assert 0.5 < np.median(residuals) / (np.sqrt(2) * stated["pixel_std_px"]) < 2
    _, pan = read_series(path, "/joints/left_pan", timeline="frame")
    np.testing.assert_array_equal(pan.ravel(), dataset.eye_angles[:, 0])


def test_the_paper_s_method_states_no_covariance(recorded, tmp_path, monkeypatch, capsys):
    out = tmp_path / "paper.json"
    run(monkeypatch, "calibrate", recorded, "--out", out, "--method", "paper")
    assert capsys.readouterr().out.startswith("DOUBTFUL")  # never "GOOD"
    accuracy = load_head(out).accuracy
    assert accuracy is not None
    assert accuracy.method == "paper"
    assert not accuracy.parameters
    assert set(accuracy.lenses) == set(load_head(out).cameras)
    assert all(0 < each.focal < 1e-2 for each in accuracy.lenses.values())


def test_an_import_names_the_cameras_that_the_file_leaves_as_they_were(
    tmp_path, monkeypatch, capsys
):
    save_head(plain_head(0.07, 300.0), tmp_path / "start.json")
    export_head(plain_head(0.07, 310.0), tmp_path / "info", "ros")
    words = ("--format", "ros", "--start", tmp_path / "start.json", "--out", tmp_path / "out.json")
    run(monkeypatch, "import", tmp_path / "info", *words)
    assert "leaves" not in capsys.readouterr().out
    run(monkeypatch, "import", tmp_path / "info" / "left_wide.yaml", *words)
    assert "leaves the lenses of right_wide as" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("keep", "named"), [(0, "frames.csv"), (2, "need at least 3 views of the board, found [02]")]
)
def test_too_little_data_ends_in_a_sentence(keep, named, recorded, tmp_path, monkeypatch, capsys):
    folder = shutil.copytree(recorded, tmp_path / "dataset")
    head, *rows = (recorded / "frames.csv").read_text().splitlines()
    (folder / "frames.csv").write_text("\n".join([head, *rows[:keep]]) + "\n")
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, "calibrate", folder, "--out", tmp_path / "c.json")
    assert re.search(named, capsys.readouterr().err.splitlines()[-1])
    assert not (tmp_path / "c.json").exists()


# Of heads that are not built like this project's


def write_folder(folder: Path, seen: Observations, eyes: dict[str, Side]) -> None:
    """Write a dataset of these cameras whose images show nothing."""
    about = description(BOARD, (640, 480)) | {
        "cameras": {name: {"eye": eye, "width": 640, "height": 480} for name, eye in eyes.items()}
    }
    poses = seen.T_base_eye
    if poses is not None:
        about |= {"joints": {}, "eye_motion": "poses"}
    table = []
    for v, placement in enumerate(seen.placement):
        row = {"time_s": v + 1.0, "joint_time_s": v + 1.0, "placement": placement}
        if poses is None:
            row |= dict(zip(EYE_JOINTS, seen.eye_angles[v].tolist(), strict=True))
        else:
            for k, eye in enumerate(EYES):
                columns = pose_columns(eye)
                row |= dict(zip(columns, poses[v, k].ravel().tolist(), strict=True))
        table.append(row | {name: f"images/{name}_{v}.png" for name in eyes})
    images = {row[name]: np.zeros((1, 1), np.uint8) for row in table for name in eyes}
    write_dataset(folder, table, about, images)


@pytest.mark.usefixtures("two_folds")
@pytest.mark.slow
@pytest.mark.parametrize("poses", [False, True])
def test_other_heads_go_all_the_way_from_a_folder_to_a_report(
    poses: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    truth, seen = recorded_of_another(9)
    eyes: dict[str, Side] = {"port": "left", "starboard": "right"}
    seen = some_cameras(seen, {"left_wide": "port", "right_wide": "starboard"}, eyes)
    seen = as_poses(seen) if poses else seen
    write_folder(tmp_path / "set", seen, eyes)
    # Corners as if they had been found.
    monkeypatch.setattr(calibrate_module, "detect_target", lambda *_, **__: seen)
    blank = np.zeros((480, 640, 3), np.uint8)
    seen.corners["port"][0] = np.nan  # of a damaged file, which the report does without
    monkeypatch.setattr(
        Dataset,
        "readable_image",
        lambda _, name, row: None if (name, row) == ("port", 0) else blank,
    )
    out, report = tmp_path / "head.json", tmp_path / "report"
    run(monkeypatch, "calibrate", tmp_path / "set", "--out", out, "--report", report)
    printed = capsys.readouterr().out
    assert printed.startswith(("GOOD", "DOUBTFUL"))
    assert ("mm in eye poses" in printed) == poses
    assert (report / "report.md").read_text().startswith("# Calibration")
    calibrated = load_head(out)
    assert main_pair(calibrated) == ("port", "starboard")
    assert calibrated.accuracy is not None
    assert calibrated.accuracy.eye_motion == ("poses" if poses else "pan-tilt")
    checked = calibrated.accuracy.held_out
    assert checked is not None
    assert checked.transfer_views > 10
    assert checked.point_mm is not None
    off = calibrated.T_rbase_lbase[:3, 3] - truth.T_rbase_lbase[:3, 3]
    assert np.abs(off).max() < 0.004
