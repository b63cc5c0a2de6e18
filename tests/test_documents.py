"""What the documents say can be done and found, can be done and found."""

import ast
import contextlib
import functools
import importlib
import json
import re
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import tyro
from pydantic import TypeAdapter

import make_map
import moving_frames
import site_pages
import vergence
from documents import (
    DOCUMENTS,
    ROOT,
    anchors,
    blocks,
    commands,
    inline_commands,
    links,
    prose,
    read,
)  # fmt: skip
from drawn_card import smooth_picture
from drawn_head import DrawnHead, four_cameras, point_at
from vergence import cli
from vergence.data.dataset import Frame
from vergence.data.description import Description
from vergence.data.reader import load_dataset
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera, save_head
from vergence.geometry.head_accuracy import Accuracy, HeldOut
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics
from vergence.geometry.neck import Neck

EQUATIONS = read("docs/equations.md")
MAKEFILE = read("Makefile")
PYTHON = [
    pytest.param(document, block.text, id=f"{document}-{k}")
    for document in DOCUMENTS
    for k, block in enumerate(blocks(document))
    if block.language == "python"
]


def first(document: str, language: str) -> str:
    """Return the first block of a language in a document."""
    return next(block.text for block in blocks(document) if block.language == language)


@pytest.mark.parametrize("cited", sorted(set(re.findall(r"`(test_\w+\.py::test_\w+)`", EQUATIONS))))
def test_a_test_that_is_cited_exists(cited: str):
    file, name = cited.split("::")
    source = (ROOT / "tests" / file).read_text(encoding="utf-8")
    assert f"def {name}(" in source


@pytest.mark.parametrize(
    "cited", sorted(set(re.findall(r"`([a-z_]+(?:\.[a-z_]+)*\.[A-Za-z_]+)`", EQUATIONS)))
)
def test_code_that_is_cited_exists(cited: str):
    module, name = cited.rsplit(".", 1)
    assert hasattr(importlib.import_module(f"vergence.{module}"), name)


@pytest.mark.parametrize("number", range(1, 24))
def test_every_equation_has_code_and_a_test(number: int):
    (row,) = re.findall(rf"^\| {number} \|.*::test_.*$", EQUATIONS, re.MULTILINE)
    assert "not yet" not in row


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_lead_to_files_and_headings_that_exist(document: str):
    for path, anchor in links(document):
        target = (ROOT / document).parent / path if path else ROOT / document
        assert target.exists(), path
        if anchor:
            assert anchor in anchors(target.resolve().relative_to(ROOT).as_posix()), anchor


@pytest.mark.parametrize("document", DOCUMENTS)
def test_files_that_are_named_exist(document: str):
    folders = "src|docs|tests|benchmarks|scenarios|models"
    for path in re.findall(rf"`((?:{folders})/[\w./]+)`", prose(document)):
        assert (ROOT / path).exists(), path


def parse(words: list[str]) -> None:
    """Parse a command line of vergence as the command line does, without running it."""

    def idle(command: Any) -> Any:
        @functools.wraps(command)
        def nothing(*_: object, **__: object) -> None: ...

        return nothing

    tyro.extras.subcommand_cli_from_dict(
        {name: idle(command) for name, command in cli.COMMANDS.items()}, args=words
    )


def name_of(program: str, words: list[str]) -> str:
    """Return the name of a program, and check that the target or script given to it exists."""
    name = program.removeprefix(".venv/bin/")
    if name == "make":
        assert re.search(rf"^([\w ]+ )?{words[0]}( [\w ]+)?:", MAKEFILE, re.MULTILINE), words
    elif name == "python" and words[0] != "-m":
        assert (ROOT / words[0]).exists(), words
    return name


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_in_blocks_can_be_typed(document: str):
    for program, *words in commands(document):
        if name_of(program, words) == "vergence" and words != ["--help"]:
            parse(words)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_in_sentences_have_names_and_options_that_exist(document: str, capsys):
    for program, *words in inline_commands(document):
        if name_of(program, words) == "vergence" and not words[0].startswith("-"):
            assert words[0] in cli.COMMANDS, words
            with contextlib.suppress(SystemExit):
                parse([words[0], "--help"])
            shown = capsys.readouterr().out
            for option in (word for word in words if word.startswith("--")):
                assert option in shown, (words, option)


@pytest.mark.parametrize(("document", "code"), PYTHON)
def test_python_in_documents_names_what_exists(document: str, code: str):
    for node in ast.walk(ast.parse(code, document)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vergence"):
            module = importlib.import_module(str(node.module))
            assert all(hasattr(module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == "vg":
            assert node.attr in vergence.__all__


@pytest.mark.parametrize("document", DOCUMENTS)
def test_public_names_in_sentences_exist(document: str):
    named = re.findall(r"`(?:vg|vergence)\.([A-Za-z]\w*)[`(]", prose(document))
    rooms = {path.stem for path in (ROOT / "src" / "vergence").iterdir()}
    assert set(named) <= {*vergence.__all__, *rooms}


def test_the_reader_of_datasets_that_the_document_prints_reads_the_dataset_that_it_prints(
    tmp_path, monkeypatch, capsys
):
    there = {block.language: block.text for block in blocks("docs/dataset.md")}
    (tmp_path / "dataset.json").write_text(there["json"])
    (tmp_path / "frames.csv").write_text(there["text"])
    for name in re.findall(r"images/\w+\.png", there["text"]):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    dataset = load_dataset(tmp_path)
    assert dataset.remarks == ()
    monkeypatch.chdir(tmp_path)
    code = next(text.values[1] for text in PYTHON if "csv.DictReader" in str(text.values[1]))
    exec(compile(str(code), "dataset.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(dataset) == len(there["text"].splitlines()) - 1 == 4
    assert "left_pan -0.1415" in lines[2]  # 8.11 degrees, counted the other way
    assert f"{dataset.eye_angles[2, 0]:.4f}" in lines[2]


def test_the_guide_to_recording_writes_a_dataset(tmp_path, monkeypatch):
    grey = np.full((480, 640), 90, np.uint8)
    reads = iter(range(1000))
    angles = [np.zeros(4)]

    def read(names: Sequence[str]) -> Frame | None:
        k = next(reads)
        return None if k == 1 else Frame(k, k, angles[-1], np.zeros(3), dict.fromkeys(names, grey))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("builtins.input", lambda _: "")
    postures = [np.array([0.1, -0.2, 0.05, -0.2]), np.array([-0.1, 0.1, -0.2, 0.1])]
    code = next(block.text for block in blocks("docs/dataset.md") if "DatasetRow" in block.text)
    head = SimpleNamespace(read=read)
    exec(code, {"head": head, "postures": postures, "move_to": angles.append})
    dataset = load_dataset("my_recording")
    assert dataset.remarks == ()
    assert len(set(dataset.placement[:15])) == 15
    assert list(dataset.placement[15:]) == [0, 0]
    np.testing.assert_allclose(dataset.eye_angles[15:], postures)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_json_and_toml_in_documents_are_valid(document: str):
    for block in blocks(document):
        if block.language == "json":
            json.loads(block.text)
        elif block.language == "toml":
            tomllib.loads(block.text)


def test_the_error_profile_that_is_printed_can_be_used(tmp_path):
    from vergence.twin.profile import load_profile

    text = first("docs/reproduction.md", "toml")
    (tmp_path / "mine.toml").write_text(text)
    assert load_profile(str(tmp_path / "mine.toml")).joints.delay_ms == 20


def test_the_calibration_file_that_is_printed_can_be_read(tmp_path):
    text = first("docs/calibration_file.md", "json")
    (tmp_path / "head.json").write_text(text)
    head = vergence.load_head(tmp_path / "head.json")
    assert set(head.cameras) == {"left_wide"}


def run_blocks(document: str, names: dict[str, Any]) -> dict[str, Any]:
    """Run the blocks of Python of a document, as one program."""
    for block in blocks(document):
        if block.language == "python":
            exec(compile(block.text, document, "exec"), names)
    return names


def test_the_guide_to_detectors_runs(tmp_path, monkeypatch, capsys):
    save_head(four_cameras(), tmp_path / "head.json")
    picture = np.repeat(smooth_picture(60)[..., None], 3, axis=-1)
    cv2.imwrite(str(tmp_path / "mug.png"), picture)
    table = np.full((480, 640, 3), 90, np.uint8)
    table[200:260, 300:360] = picture
    cv2.imwrite(str(tmp_path / "table.png"), table)
    monkeypatch.chdir(tmp_path)
    names = run_blocks("docs/own_detector.md", {})
    np.testing.assert_allclose(names["found"].pixel, [329.5, 229.5], atol=0.3)
    assert names["bright_spot"](np.zeros((480, 640, 3), np.uint8), None, None) is None
    printed = capsys.readouterr().out
    assert "looking at mug with ('left_wide', 'right_wide', 'left_narrow'" in printed
    assert "No object is called 'cup'" in printed
    assert "centred in ('left_wide', 'right_wide')" in printed


def test_the_guide_to_other_joints_describes_and_uses_them(tmp_path, monkeypatch, capsys):
    described, version = (
        json.loads(block.text)
        for block in blocks("docs/other_joints.md")
        if block.language == "json"
    )
    adapter = TypeAdapter(Description)
    shared = adapter.validate_python(described).head_kinematics
    assert shared.used("left") == [0, 1]
    assert shared.used("right") == [0, 2]
    readings = {name: {"unit": "rad"} for name in ("version", "vergence", "tilt")}
    described |= {"kinematics": version, "readings": readings}
    assert adapter.validate_python(described).head_kinematics.readings == tuple(readings)
    save_head(four_cameras(), tmp_path / "calibration.json")
    monkeypatch.chdir(tmp_path)
    names = run_blocks("docs/other_joints.md", {})
    np.testing.assert_allclose(names["points"].xyz, [[0.6, -0.04, 0.1]], atol=1e-9)
    assert "(3,) [[ 0.6" in capsys.readouterr().out


def test_the_guide_to_drivers_moves_a_head(tmp_path, monkeypatch, capsys):
    """The stand-in for motors and cameras is a drawn head, whose tilt encoders count upwards."""
    drawn = DrawnHead(lambda _: point_at(10, 5, 0.6))
    sign = {"left_pan": 1, "left_tilt": -1, "right_pan": 1, "right_tilt": -1}
    moved: list[dict[str, float]] = []

    def grab(names: Sequence[str], timeout_s: float) -> Frame | None:
        drawn.commands.append(driver["head"].sent)
        driver["head"].renew_setpoints()
        return drawn.read(names)

    def angles_rad() -> dict[str, float]:
        angles = np.zeros(4) if drawn.last is None else drawn.last.eye_angles
        return {name: sign[name] * angle for name, angle in zip(sign, angles, strict=True)}

    bus = SimpleNamespace(time_s=drawn.now_s, angles_rad=angles_rad, move_to=moved.append)
    driver: dict[str, Any] = {"bus": bus, "cameras": SimpleNamespace(grab=grab)}
    save_head(four_cameras(), tmp_path / "head.json")
    monkeypatch.chdir(tmp_path)
    run_blocks("docs/own_driver.md", driver)
    assert drawn.errors_px(drawn.time_s).max() < 0.5
    assert "fixation at [" in capsys.readouterr().out
    assert moved[-1]["left_pan"] > 0.05
    np.testing.assert_allclose(moved[-1]["left_tilt"], -drawn.posture(drawn.time_s)[4], atol=1e-3)


@pytest.mark.slow
def test_the_guide_to_self_calibration_runs(tmp_path, monkeypatch):
    save_head(moving_frames.HEAD, tmp_path / "head.json")
    monkeypatch.chdir(tmp_path)
    ((_, frame),) = moving_frames.frames(1)
    pixels = np.array([[320.0, 240.0]])
    names: dict[str, Any] = {
        **{"frame": frame, "joints": frame.eye_angles, "elapsed_s": 0.3},
        **{f"{eye}_image": frame.images[f"{eye}_wide"] for eye in ("left", "right")},
        **{"left_pixels": pixels, "right_pixels": pixels},
    }
    by_frame, by_pair = (
        block.text
        for block in blocks("docs/self_calibration.md")
        if block.language == "python" and "load_dataset" not in block.text
    )
    exec(by_frame, names)
    assert names["seen"].status == "seen"
    assert vergence.load_head("learned.json").accuracy is not None
    first = names["points"].xyz
    exec(by_pair, names)
    np.testing.assert_allclose(names["points"].xyz, first, rtol=1e-3)
    assert names["state"].frames == 1


def test_every_field_of_the_calibration_file_and_of_the_truth_is_documented():
    from vergence.commands.truth import Truth

    text = read("docs/calibration_file.md")
    named = set(re.findall(r"`(?:[\w*]+\.)*(\w+)`", text))
    described = (
        HeadCalibration, MountedCamera, Camera, Joint, Kinematics, Neck, Accuracy, HeldOut, Truth,
    )  # fmt: skip
    assert {field.name for each in described for field in fields(each)} <= named


def test_the_map_shows_the_imports_as_they_are():
    shown = make_map.PICTURE.read_text(encoding="utf-8")
    assert shown == make_map.drawing(), "run: python docs/make_map.py"


def test_the_map_refuses_rooms_that_import_each_other():
    with pytest.raises(ValueError, match="circle: a, b"):
        make_map.levels({"a": {"b"}, "b": {"a"}, "c": {"a"}})


def test_the_reference_lists_the_public_names():
    page = site_pages.reference_page("vergence")
    shown = re.findall(r"^\.\. auto\w+:: vergence\.(\w+)$", page, re.MULTILINE)
    assert sorted(shown) == sorted(vergence.__all__)


@pytest.mark.parametrize("package", ["vergence.twin", "vergence.viewer"])
def test_the_reference_has_a_page_for_twin_and_viewer(package: str):
    page = site_pages.reference_page(package)
    assert page.count(".. auto") > 3


def test_the_site_contains_every_document():
    pages = {name for names in site_pages.CONTENTS.values() for name in names}
    own = {Path(name).stem for name in DOCUMENTS if name.startswith("docs/")}
    assert own <= pages
    assert set(DOCUMENTS) - {"models/cbi_head/CHANGELOG.md"} == {
        *site_pages.DOCUMENTS,
        *(f"docs/{name}.md" for name in own),
    }


def test_links_of_a_page_of_the_site_lead_to_pages_and_no_source_files():
    text = "[a](docs/gaze.md#x) [b](src/vergence/cli/__init__.py) ![c](docs/images/gaze.png)"
    assert site_pages.relink(text, "README.md") == "[a](gaze.md#x) b ![c](images/gaze.png)"


@pytest.mark.usefixtures("coarse_images", "two_folds")
@pytest.mark.render
def test_the_program_on_the_first_screen_finds_where_points_are(tmp_path, monkeypatch, capsys):
    from vergence.commands.truth import TRUTH, load

    monkeypatch.chdir(tmp_path)
    record = ["vergence", "record", "--out", "my_head", "--frames", "20"]
    monkeypatch.setattr(sys, "argv", record)
    cli.main()
    truth = load(Path("my_head") / TRUTH).head
    there = np.array([[0.5, -0.05, 0.02], [0.7, 0.1, -0.05]])
    angles = np.array([0.05, -0.02, 0.1, -0.02])
    left, right = (
        vergence.project_point(truth, f"{eye}_wide", angles, there) for eye in ("left", "right")
    )
    names: dict[str, Any] = {"uv_left": left, "uv_right": right, "angles": angles}
    code = first("README.md", "python")
    assert '"my_head/"' in code
    exec(compile(code, "README.md", "exec"), names)
    points = names["points"]
    assert (points.status == vergence.Status.OK).all()
    error = points.xyz - there
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.inv(points.covariance), error)
    assert (distance < 25).all()  # five standard deviations
    assert np.abs(error).max() < 0.02
    assert (tmp_path / "head.json").exists()
    assert capsys.readouterr().out.strip()


def test_the_guide_to_dense_depth_runs(tmp_path, monkeypatch):
    vergence.save_head(four_cameras(), tmp_path / "head.json")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks("docs/depth.md"):
        if block.language == "python":
            exec(compile(block.text, "depth.md", "exec"), names)
    assert names["found"].depth_m.shape == names["left"].shape[:2] == (480, 640)
    assert not names["found"].textured.any()  # the images of the guide are black


def test_the_guide_to_using_a_calibration_runs(tmp_path, monkeypatch, capsys):
    text = first("docs/calibration_file.md", "json")
    head = json.loads(text)
    left = head["cameras"]["left_wide"]
    narrow = json.loads(json.dumps(left))
    narrow["intrinsics"]["matrix"] = [[1200.0, 0, 319.5], [0, 1200.0, 239.5], [0, 0, 1]]
    narrow["intrinsics"]["distortion"] = [0.0] * 5
    head["cameras"] = {
        f"{eye}_{lens}": {**camera, "eye": eye}
        for eye in ("left", "right")
        for lens, camera in (("wide", left), ("narrow", narrow))
    }
    head["accuracy"] = {
        **{"method": "bundle", "parameters": ["left_wide.fx"], "covariance": [[0.01]]},
        **{"pixel_std_px": 0.1, "joint_std": [0.001]},
    }
    (tmp_path / "head.json").write_text(json.dumps(head))
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks("docs/using_a_calibration.md"):
        if block.language == "python":
            exec(compile(block.text, "using_a_calibration.md", "exec"), names)
    assert (names["points"].status == vergence.Status.OK).all()
    assert (names["narrow"].status == vergence.Status.OK).all()
    np.testing.assert_allclose(names["xyz_head"][:, 0], [0.6, 0.72], atol=0.01)
    printed = capsys.readouterr().out
    assert printed.count("depth") == 2
    assert "nan" not in printed
