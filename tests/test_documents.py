"""What the documents point to exists."""

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EQUATIONS = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")


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
    assert hasattr(import_module(f"vergence.{module}"), name)


@pytest.mark.parametrize("number", range(1, 24))
def test_every_equation_has_code_and_a_test(number: int):
    (row,) = re.findall(rf"^\| {number} \|.*::test_.*$", EQUATIONS, re.MULTILINE)
    assert "not yet" not in row


@pytest.mark.parametrize("document", ["conventions", "equations"])
def test_links_lead_somewhere(document: str):
    text = (ROOT / "docs" / f"{document}.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (ROOT / "docs" / target).exists()
