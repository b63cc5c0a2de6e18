"""The rooms of the package and the order in which they import one another, read from the sources.

The rules are functions of a source folder, so that each can be shown to fail: a synthetic package
that keeps all of them is broken in one place at a time.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SRC = Path(__file__).parents[1] / "src"

ROOMS = (
    "errors", "findings", "arrays", "files", "progress", "parallel", "geometry", "estimation",
    "data", "vision", "stereo", "calibration", "self_calibration", "gaze", "accuracy",
    "interchange", "vergence", "twin", "viewer", "paper", "demos", "cli", "__main__",
)  # fmt: skip
"""Folders and single modules, from the ground up: each may import itself and those before it.

`vergence` is the public face, `vergence/__init__.py`: it offers names of the core, all that stands
before it, and the core does not import it.
"""
CORE = ROOMS[: ROOMS.index("vergence") + 1]
CALIBRATION = (
    "observations", "lens_prior", "unknowns", "lenses", "intrinsics", "initial", "detection",
    "residuals", "bundle_start", "bundle_adjustment", "checks", "summary", "checked_views",
    "validation", "calibrate",
)  # fmt: skip
"""The same order inside the largest room; modules and subfolders that it lacks do not matter."""

CORE_LIBRARIES = ("numpy", "scipy", "cv2", "PIL", "pydantic", "yaml")
OUTER_LIBRARIES = {
    "threadpoolctl": ("arrays",),
    "mujoco": ("twin",),
    "rerun": ("viewer", "paper.recording"),
    "matplotlib": ("viewer", "paper.plots"),
    "joblib": ("accuracy.design_chunks", "parallel"),
    "distributed": ("accuracy.design_chunks",),
    "tyro": ("cli",),
    "rich": ("cli",),
}
"""Libraries that few may import, and the rooms or modules that may."""


@dataclass(frozen=True)
class Import:
    target: str
    """A dotted name, of a module or of something inside a module."""
    for_types: bool
    """Stands under `if TYPE_CHECKING:`, and is not executed."""


def modules(src: Path) -> dict[str, Path]:
    """Return every module below a source folder by its dotted name."""
    found = {}
    for path in sorted(src.rglob("*.py")):
        parts = path.relative_to(src).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path) -> Iterator[Import]:
    """Yield what a module imports, at its top, inside functions, for types only, or by name."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in ast.walk(tree):
        for target in imported_names(node, package):
            yield Import(target, node in for_types)


def imported_names(node: ast.AST, package: str) -> list[str]:
    """Return the dotted names that one node of the syntax imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        base = absolute("." * node.level + (node.module or ""), package)
        return [f"{base}.{alias.name}" for alias in node.names]
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
        ("import_module", "__import__")
    ):
        argument = node.args[0]
        # Of a name that is put together, its beginning.
        known = argument.values[0] if isinstance(argument, ast.JoinedStr) else argument
        name = str(ast.literal_eval(known)) if isinstance(known, ast.Constant) else "unknown"
        return [absolute(name, package).rstrip(".")]
    return []


def absolute(name: str, package: str) -> str:
    """Return the dotted name that a name with leading dots has from inside a package."""
    plain = name.lstrip(".")
    level = len(name) - len(plain)
    if not level:
        return plain
    parents = package.split(".")
    return ".".join([*parents[: len(parents) + 1 - level], *([plain] if plain else [])])


def module_of(target: str, known: dict[str, Path]) -> str | None:
    """Return the module of the package in which a dotted name stands, None if in a library."""
    while target and target not in known:
        target = target.rpartition(".")[0]
    return target or None


def within(name: str, place: str) -> bool:
    """Return whether a module is a room or module (without `vergence.`), or stands in it."""
    return f"{name}.".startswith(f"vergence.{place}.")


def room(name: str) -> str:
    """Return the room of a module, which is a folder or a module of its own."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else "vergence"


def breaches(src: Path) -> list[str]:
    """Return a sentence for each import that breaks a rule."""
    known = modules(src)
    homeless = {name for name in known if room(name) not in ROOMS}
    found = [f"{name} stands in no room" for name in homeless]
    for name in known.keys() - homeless:
        for imported in imports(name, known[name]):
            target = module_of(imported.target, known)
            if target is None:
                found += library_breach(name, imported.target.partition(".")[0])
            elif target not in homeless:
                found += room_breach(name, target, for_types=imported.for_types)
    return sorted(set(found))


def room_breach(name: str, target: str, *, for_types: bool) -> list[str]:
    """Return what is wrong with a module that imports another one, if anything."""
    here, there = room(name), room(target)
    if here == "viewer" and there == "twin" and not for_types:
        return [f"{name} imports {target}, of which it may name types only"]
    if ROOMS.index(there) > ROOMS.index(here):
        return [f"{name} imports {target}, which stands above it"]
    if here == there == "calibration":
        own, other = ((*n.split("."), "")[2] for n in (name, target))
        ranks = [CALIBRATION.index(part) for part in (own, other) if part in CALIBRATION]
        if len(ranks) == 2 and ranks[1] > ranks[0]:
            return [f"{name} imports {target}, which stands above it in its room"]
    return []


def library_breach(name: str, library: str) -> list[str]:
    """Return what is wrong with a module that imports a library, if anything."""
    if library in OUTER_LIBRARIES:
        allowed = any(within(name, place) for place in OUTER_LIBRARIES[library])
    else:
        own = library in (*sys.stdlib_module_names, *CORE_LIBRARIES)
        allowed = own or room(name) not in CORE
    return [] if allowed else [f"{name} imports {library}"]


def circle(src: Path) -> list[str]:
    """Return the modules of a circle of imports, empty if there is none.

    Imports inside functions count: they put off a circle, and do not open it.
    """
    known = modules(src)
    graph = {
        name: {
            target
            for imported in imports(name, path)
            if (target := module_of(imported.target, known)) not in (None, name)
        }
        for name, path in known.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_every_import_leads_down_and_libraries_stay_in_their_rooms():
    assert breaches(SRC) == []


def test_no_files_import_one_another_in_a_circle():
    assert circle(SRC) == []


def test_every_room_of_the_order_stands():
    """So that a room that was renamed does not leave its old name in the order."""
    assert {room(name) for name in modules(SRC)} == set(ROOMS)


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in modules(SRC).values()}), ids=lambda path: path.name
)
def test_every_folder_states_its_subject_in_one_sentence(folder: Path):
    docstring = ast.get_docstring(ast.parse((folder / "__init__.py").read_text("utf-8"))) or ""
    first = docstring.split("\n\n")[0]
    assert first.endswith(".")
    assert ". " not in first


def test_the_page_on_architecture_has_a_row_for_every_room_in_their_order():
    page = (SRC.parent / "docs/architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, flags=re.MULTILINE)
    named = [name for row in rows for name in re.findall("`(.*?)`", row)]
    assert named == [name for name in ROOMS if name not in ("vergence", "__main__")]


def test_importing_the_package_loads_no_simulator_viewer_or_command_line():
    code = f"import sys, vergence; print(*sys.modules.keys() & {set(OUTER_LIBRARIES)})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


# Each rule fails when it is broken once.

SOUND = {
    "__init__": "from vergence.gaze.controller import look",
    "errors": "",
    "geometry.camera": "import numpy as np\nfrom vergence.errors import Error",
    "geometry.head": "from . import camera",
    "calibration.intrinsics": "import cv2\nfrom vergence.geometry.camera import Camera",
    "calibration.bundle_adjustment": "from vergence.calibration import intrinsics",
    "calibration.calibrate": "def run():\n    from .bundle_adjustment import refine",
    "gaze.controller": "from vergence.geometry.head import load",
    "twin.head": "import mujoco\nimport vergence",
    "viewer.shapes": "import rerun as rr\nfrom typing import TYPE_CHECKING\n"
    "if TYPE_CHECKING:\n    from vergence.twin.head import Twin",
    "paper.plots": "import matplotlib.pyplot as plt\nimport vergence.viewer.shapes",
    "paper.replay": "from vergence.twin import head",
    "cli": "import rich, tyro\nfrom vergence.paper import replay, plots",
}


def write_package(src: Path, contents: dict[str, str]) -> None:
    for name, text in contents.items():
        path = src / "vergence" / f"{name.replace('.', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_a_sound_synthetic_package_breaks_no_rule(tmp_path: Path):
    write_package(tmp_path, SOUND)
    assert breaches(tmp_path) == []
    assert circle(tmp_path) == []


@pytest.mark.parametrize(
    ("where", "text", "found"),
    [
        ("geometry.camera", "import vergence.gaze.controller", "gaze.controller, which stands ab"),
        ("geometry.camera", "from vergence.gaze import controller", "vergence.gaze.controller, "),
        ("geometry.camera", "from ..gaze.controller import look", "vergence.gaze.controller, "),
        ("geometry.camera", "from .. import cli", "vergence.cli, which stands above it"),
        ("geometry.camera", "import vergence", "vergence, which stands above it"),
        ("geometry.camera", "def f():\n    import vergence.twin.head", "vergence.twin.head, "),
        ("geometry.camera", "import importlib as i\ni.import_module('..cli', 'p')", "vergence.cli"),
        ("geometry.camera", "__import__('vergence.cli')", "vergence.cli, which stands above it"),
        (
            "geometry.camera",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import vergence.cli",
            "vergence.cli, which stands above it",
        ),
        ("gaze.controller", "from vergence.twin.head import Twin", "twin.head, which stands above"),
        ("__init__", "from vergence.twin.head import Twin", "vergence imports vergence.twin.head"),
        ("viewer.shapes", "from vergence.twin.head import Twin", "it may name types only"),
        ("calibration.intrinsics", "import vergence.calibration.calibrate", "its room"),
        ("helpers", "", "vergence.helpers stands in no room"),
        *(("gaze.controller", f"import {name}.x", f"imports {name}") for name in OUTER_LIBRARIES),
        *(("__init__", f"from {name} import x", f"imports {name}") for name in OUTER_LIBRARIES),
        ("gaze.controller", "import torch", "vergence.gaze.controller imports torch"),
        ("paper.replay", "import mujoco", "vergence.paper.replay imports mujoco"),
        ("paper.replay", "import rerun", "vergence.paper.replay imports rerun"),
        ("twin.head", "from matplotlib import pyplot", "vergence.twin.head imports matplotlib"),
        ("paper.plots", "from rich import progress", "vergence.paper.plots imports rich"),
        ("paper.plots", "import tyro", "vergence.paper.plots imports tyro"),
    ],
)
def test_a_single_breach_is_found(tmp_path: Path, where: str, text: str, found: str):
    write_package(tmp_path, SOUND | {where: text})
    (sentence,) = breaches(tmp_path)
    assert sentence.startswith(f"vergence.{where}".removesuffix(".__init__"))
    assert found in sentence


@pytest.mark.parametrize(
    ("where", "text"),
    [
        ("geometry.camera", "from vergence.geometry.head import load"),
        ("geometry.camera", "def late():\n    from . import head"),
        ("errors", "from vergence.gaze import controller"),
    ],
)
def test_a_circle_is_found(tmp_path: Path, where: str, text: str):
    write_package(tmp_path, SOUND | {where: text})
    assert f"vergence.{where}" in circle(tmp_path)
