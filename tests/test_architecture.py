"""The rooms of the package and the order in which they import one another."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

SRC = Path(__file__).parents[1] / "src"

ROOMS = (
    "errors", "findings", "arrays", "files", "progress", "parallel", "geometry", "estimation",
    "data", "vision", "stereo", "calibration", "self_calibration", "gaze", "accuracy",
    "interchange", "recordings", "vergence", "twin", "live", "viewer", "paper", "demos", "cli",
    "__main__",
)  # fmt: skip
"""Folders and single modules, from the ground up: each may import itself and those before it.

`vergence` is the public face, `vergence/__init__.py`: it offers names of the core, all that stands
before it, and the core does not import it.
"""
CORE = ROOMS[: ROOMS.index("vergence") + 1]

CORE_LIBRARIES = ("numpy", "scipy", "cv2", "PIL", "pydantic", "yaml")
OUTER_LIBRARIES = {
    "threadpoolctl": ("arrays",),
    "mujoco": ("twin",),
    "rerun": ("viewer", "paper.recording"),
    "matplotlib": ("viewer", "paper.plots"),
    "joblib": ("parallel",),
    "pyarrow": ("recordings",),
    "av": ("recordings.video",),
    "rosbags": ("recordings.ros", "recordings.bag"),
    "lz4": ("recordings.ros",),
    "dynamixel_sdk": ("live.uvc_servos",),
    "scservo_sdk": ("live.uvc_servos",),
    "reachy_mini": ("live.reachy_mini",),
    "tyro": ("cli",),
    "rich": ("cli",),
}
"""Libraries that few may import, and the rooms or modules that may."""


def modules(src: Path) -> dict[str, Path]:
    """Map the dotted name of every module below a source folder to its file."""
    paths = {".".join(p.relative_to(src).with_suffix("").parts): p for p in src.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for name, path in sorted(paths.items())}


def imports(name: str, path: Path) -> Iterator[tuple[str, bool]]:
    """Yield the dotted names that a module imports anywhere, and whether for types only."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    guarded = [
        n
        for n in ast.walk(tree)
        if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)
    ]
    for_types = {inner for node in guarded for part in node.body for inner in ast.walk(part)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            names = [f"{base}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Call) and "import_" in ast.unparse(node.func):
            first = node.args[0]  # of an f-string, its beginning
            first = first.values[0] if isinstance(first, ast.JoinedStr) else first
            names = [str(first.value).rstrip(".")] if isinstance(first, ast.Constant) else []
        else:
            continue
        yield from ((each, node in for_types) for each in names)


def module_of(target: str, known: Iterable[str]) -> str | None:
    """Return the module of the package that holds a dotted name; None: it is a library's."""
    while target and target not in known:
        target = target.rpartition(".")[0]
    return target or None


def room(name: str) -> str:
    """Return the room of a module, which is a folder or a module of its own."""
    return [*name.split("."), "vergence"][1]


def breaches(src: Path) -> list[str]:
    """Describe each import that breaks a rule."""
    known = modules(src)
    homeless = {name for name in known if room(name) not in ROOMS}
    found = {f"{name} stands in no room" for name in homeless}
    for name in known.keys() - homeless:
        for imported, for_types in imports(name, known[name]):
            target, here = module_of(imported, known), room(name)
            library = imported.partition(".")[0]
            if target is None and not is_allowed(name, library):
                found.add(f"{name} imports {library}")
            elif target is not None and target not in homeless:
                if here == "viewer" and room(target) == "twin" and not for_types:
                    found.add(f"{name} imports {target}, of which it may name types only")
                elif ROOMS.index(room(target)) > ROOMS.index(here):
                    found.add(f"{name} imports {target}, which stands above it")
    return sorted(found)


def is_allowed(name: str, library: str) -> bool:
    """Return whether a module may import a library."""
    if library in OUTER_LIBRARIES:
        places = (f"vergence.{place}." for place in OUTER_LIBRARIES[library])
        return f"{name}.".startswith(tuple(places))
    return library in (*sys.stdlib_module_names, *CORE_LIBRARIES) or room(name) not in CORE


def circle(src: Path) -> list[str]:
    """Return the modules of a circle of imports, those inside functions included; empty: none."""
    known = modules(src)
    graph = {
        name: {module_of(imported, known) for imported, _ in imports(name, path)} - {None, name}
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


def test_the_page_on_architecture_has_a_row_for_every_room_in_their_order():
    page = (SRC.parent / "docs/architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, flags=re.MULTILINE)
    named = [name for row in rows for name in re.findall("`(.*?)`", row)]
    assert named == [name for name in ROOMS if name not in ("vergence", "__main__")]


def test_importing_the_package_loads_no_simulator_viewer_or_command_line():
    code = f"import sys, vergence; print(*sys.modules.keys() & {set(OUTER_LIBRARIES)})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


SOUND = {
    "__init__": "from vergence.gaze.controller import look",
    "geometry.camera": "import numpy as np",
    "geometry.head": "from . import camera",
    "gaze.controller": "from vergence.geometry.head import load",
    "twin.head": "import mujoco\nimport vergence",
    "viewer.shapes": "import rerun as rr\nfrom typing import TYPE_CHECKING\n"
    "if TYPE_CHECKING:\n    from vergence.twin.head import Twin",
    "paper.plots": "import matplotlib.pyplot as plt\nimport vergence.viewer.shapes",
    "cli": "import rich, tyro\nfrom vergence.paper import plots",
}
"""A package that keeps all rules; each test breaks one."""


def write_package(src: Path, contents: dict[str, str]) -> None:
    for name, text in contents.items():
        path = src / "vergence" / f"{name.replace('.', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.mark.parametrize(
    ("where", "text", "found"),
    [
        ("geometry.camera", "import vergence.gaze.controller", "gaze.controller, which stands ab"),
        ("geometry.camera", "from ..gaze.controller import look", "vergence.gaze.controller, "),
        ("geometry.camera", "from .. import cli", "vergence.cli, which stands above it"),
        ("geometry.camera", "import vergence", "vergence, which stands above it"),
        ("geometry.camera", "def f():\n    import vergence.twin.head", "vergence.twin.head, "),
        ("geometry.camera", "__import__('vergence.cli')", "vergence.cli, which stands above it"),
        (
            "geometry.camera",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import vergence.cli",
            "vergence.cli, which stands above it",
        ),
        ("__init__", "from vergence.twin.head import Twin", "vergence imports vergence.twin.head"),
        ("viewer.shapes", "from vergence.twin.head import Twin", "it may name types only"),
        ("helpers", "", "vergence.helpers stands in no room"),
        *(("gaze.controller", f"import {name}.x", f"imports {name}") for name in OUTER_LIBRARIES),
        ("gaze.controller", "import torch", "vergence.gaze.controller imports torch"),
        ("paper.plots", "from rich import progress", "vergence.paper.plots imports rich"),
    ],
)
def test_a_single_breach_is_found(tmp_path: Path, where: str, text: str, found: str):
    write_package(tmp_path / "sound", SOUND)
    write_package(tmp_path / "broken", SOUND | {where: text})
    assert breaches(tmp_path / "sound") == circle(tmp_path / "sound") == []
    (sentence,) = breaches(tmp_path / "broken")
    assert sentence.startswith(f"vergence.{where}".removesuffix(".__init__"))
    assert found in sentence


def test_a_circle_is_found(tmp_path: Path):
    write_package(tmp_path, SOUND | {"geometry.camera": "def late():\n    from . import head"})
    assert "vergence.geometry.camera" in circle(tmp_path)


def test_a_real_head_needs_no_mujoco():
    """Import all rooms but the twin and its experiments where mujoco cannot be imported."""
    code = (
        "import sys; sys.modules['mujoco'] = None; from importlib import import_module; "
        "[import_module(name) for name in sys.argv[1:]]"
    )
    without = {"twin", "paper", "demos", "__main__"}
    names = [name for name in modules(SRC) if not without & set(name.split(".")[1:2])]
    assert len(names) > 100
    done = subprocess.run(
        [sys.executable, "-c", code, *names], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
