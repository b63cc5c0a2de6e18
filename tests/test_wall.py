"""The wall between the software and the twin: what imports what, read from the sources."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SRC = Path(__file__).parents[1] / "src"
OTHER_SIDE = ("twin", "experiments", "recording", "plots", "appearance", "reproduce", "cli")
"""Modules and packages of vergence that know of simulation or of viewers. All the rest, also what
is yet to be written, is the vision side, which must run on a real head's recordings."""
FORBIDDEN = ("mujoco", "rerun", "matplotlib", "vergence.twin", "vergence.experiments")


def modules(src: Path) -> dict[str, Path]:
    """Return by dotted name every module below a source folder."""
    found = {}
    for path in sorted(src.rglob("*.py")):
        parts = path.relative_to(src).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path) -> Iterator[str]:
    """Yield every dotted name that a module imports, wherever in it, lazily or not."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            up = package.split(".")[: len(package.split(".")) + 1 - node.level]
            base = ".".join([*up, *([node.module] if node.module else [])])
            base = base if node.level else str(node.module)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
            ("import_module", "__import__")
        ):
            yield from (
                a.value for a in node.args if isinstance(a, ast.Constant) and a.value is not None
            )


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def vision_side(src: Path) -> list[str]:
    """Return the modules that must not know of the other side."""
    return [
        name
        for name in modules(src)
        if not any(within(name, f"vergence.{part}") for part in (*OTHER_SIDE, "__main__"))
    ]


def breaches(src: Path) -> list[str]:
    """Return for each breach of the wall the chain of imports that leads to it."""
    known = modules(src)
    found = []
    for start in vision_side(src):
        chains, seen = [(start,)], {start}
        while chains:
            chain = chains.pop()
            for target in sorted(set(imports(chain[-1], known[chain[-1]]))):
                if any(within(target, wall) for wall in FORBIDDEN):
                    found.append(" -> ".join([*chain, target]))
                # Importing a module runs its packages too.
                parts = target.split(".")
                for n in range(1, len(parts) + 1):
                    reached = ".".join(parts[:n])
                    if reached in known and reached not in seen:
                        seen.add(reached)
                        chains.append((*chain, reached))
    return found


def importers(src: Path, library: str) -> set[str]:
    """Return the modules that import a library."""
    return {
        name
        for name, path in modules(src).items()
        if any(within(target, library) for target in imports(name, path))
    }


def test_the_vision_side_never_reaches_the_twin_or_a_viewer():
    assert breaches(SRC) == []


def test_the_walker_sees_the_whole_vision_side():
    vision = (
        "arrays errors geometry camera kinematics head dataset sphere active_stereo uncertainty "
        "calibration.target calibration.intrinsics calibration.eye_camera calibration.pipeline"
    )
    assert {f"vergence.{name}" for name in vision.split()} <= set(vision_side(SRC))
    pipeline = "vergence.calibration.pipeline"
    assert "vergence.active_stereo" in set(imports(pipeline, modules(SRC)[pipeline]))


def test_mujoco_is_imported_only_by_the_twin():
    assert all(within(name, "vergence.twin") for name in importers(SRC, "mujoco"))


def test_rerun_is_imported_only_by_recording():
    assert all(within(name, "vergence.recording") for name in importers(SRC, "rerun"))


def test_matplotlib_is_imported_only_by_plots():
    assert all(within(name, "vergence.plots") for name in importers(SRC, "matplotlib"))


@pytest.mark.parametrize(
    "breach",
    [
        "import mujoco",
        "from mujoco import MjModel",
        "from vergence.twin.head import Twin",
        "from vergence import twin",
        "from .twin import head",
        "from . import cli",
        "def late():\n    import vergence.experiments.replay",
        "import importlib\nimportlib.import_module('rerun')",
        "import vergence.cli",
    ],
)
def test_a_breach_in_a_synthetic_tree_is_found(tmp_path: Path, breach: str):
    for name, text in {
        "__init__": "",
        "camera": "import numpy as np",
        "head": "from vergence.camera import Camera",
        "gaze": "from vergence.head import HeadCalibration",
        "cli": "import matplotlib.pyplot as plt",  # allowed, but not to be reached
    }.items():
        path = tmp_path / "vergence" / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    assert breaches(tmp_path) == []
    (tmp_path / "vergence" / "camera.py").write_text(breach)
    chains = breaches(tmp_path)
    assert any(chain.startswith("vergence.gaze -> vergence.head -> ") for chain in chains)
