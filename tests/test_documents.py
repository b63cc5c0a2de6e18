"""What the documents say can be done and found, can be done and found."""

import ast
import contextlib
import functools
import importlib
import json
import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import tyro

import make_map
import site_pages
import vergence
from documents import (
    DOCUMENTS,
    ROOT,
    anchors,
    blocks,
    commands,
    first,
    inline_commands,
    links,
    prose,
    read,
)
from vergence import cli
from vergence.data.reader import load_dataset
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera
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
def test_links_files_and_public_names_exist_and_data_is_valid(document: str):
    for path, anchor in links(document):
        target = (ROOT / document).parent / path if path else ROOT / document
        assert target.exists(), path
        if anchor:
            assert anchor in anchors(target.resolve().relative_to(ROOT).as_posix()), anchor
    folders = "src|docs|tests|benchmarks|scenarios|models"
    for path in re.findall(rf"`((?:{folders})/[\w./]+)`", prose(document)):
        assert (ROOT / path).exists(), path
    named = re.findall(r"`(?:vg|vergence)\.([A-Za-z]\w*)[`(]", prose(document))
    rooms = {path.stem for path in (ROOT / "src" / "vergence").iterdir()}
    assert set(named) <= {*vergence.__all__, *rooms}
    for block in blocks(document):
        if block.language in ("json", "toml"):
            {"json": json.loads, "toml": tomllib.loads}[block.language](block.text)


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
    assert dataset.findings == ()
    monkeypatch.chdir(tmp_path)
    code = next(text.values[1] for text in PYTHON if "csv.DictReader" in str(text.values[1]))
    exec(compile(str(code), "dataset.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(dataset) == len(there["text"].splitlines()) - 1 == 4
    assert "left_pan -0.1415" in lines[2]  # 8.11 degrees, counted the other way
    assert f"{dataset.eye_angles[2, 0]:.4f}" in lines[2]


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


def test_every_field_of_the_calibration_file_and_of_the_truth_is_documented():
    from vergence.twin.evaluation import Truth

    text = read("docs/calibration_file.md")
    named = set(re.findall(r"`(?:[\w*]+\.)*(\w+)`", text))
    described = (
        HeadCalibration, MountedCamera, Camera, Joint, Kinematics, Neck, Accuracy, HeldOut, Truth,
    )  # fmt: skip
    assert {field.name for each in described for field in fields(each)} <= named


def test_the_map_shows_the_imports_as_they_are():
    shown = make_map.PICTURE.read_text(encoding="utf-8")
    assert shown == make_map.drawing(), "run: python docs/make_map.py"


def test_the_reference_lists_the_public_names():
    page = site_pages.reference_page("vergence")
    shown = re.findall(r"^\.\. auto\w+:: vergence\.(\w+)$", page, re.MULTILINE)
    assert sorted(shown) == sorted(vergence.__all__)


def test_the_site_contains_every_document():
    pages = {name for names in site_pages.CONTENTS.values() for name in names}
    own = {Path(name).stem for name in DOCUMENTS if name.startswith("docs/")}
    assert own <= pages
    assert set(DOCUMENTS) == {
        *site_pages.DOCUMENTS,
        *(f"docs/{name}.md" for name in own),
    }


def test_links_of_a_page_of_the_site_lead_to_pages_and_no_source_files():
    text = "[a](docs/gaze.md#x) [b](src/vergence/cli/__init__.py) ![c](docs/images/gaze.png)"
    assert site_pages.relink(text, "README.md") == "[a](gaze.md#x) b ![c](images/gaze.png)"
