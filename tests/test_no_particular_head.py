"""No code but the paper's names a joint or a camera of a particular head."""

import ast
from pathlib import Path
from xml.etree import ElementTree

from vergence.geometry.kinematics import EYE_JOINTS

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src" / "vergence"
MAY = {"paper", "recordings"}
"""The paper's head, and the columns that recordings of known robots have."""


def names_of_models() -> set[str]:
    """List the names of joints and cameras, but those of the format of datasets."""
    files = (ROOT / "models").glob("*/*_head.xml")
    parts = [e for file in files for tag in ("joint", "camera") for e in _named(file, tag)]
    return set(parts) - set(EYE_JOINTS)


def _named(file: Path, tag: str) -> list[str]:
    return [e.get("name", "") for e in ElementTree.parse(file).iter(tag) if e.get("name")]


def literals(file: Path) -> set[str]:
    """List the strings of a module without its docstrings."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    documents = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in documents
    }


def test_no_code_names_a_joint_or_a_camera_of_a_particular_head():
    names = names_of_models()
    assert {"neck_pitch", "left_wide", "eyes_tilt", "left_camera"} <= names
    for file in SOURCES.rglob("*.py"):
        if not MAY & set(file.relative_to(SOURCES).parts):
            named = {text for text in literals(file) for name in names if name in text}
            assert not named, file
