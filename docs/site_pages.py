"""Collect the pages of the site in one folder, from which Sphinx builds it: `make docs`.

    python docs/site_pages.py site/pages

The documents of the repository become pages, with their links rewritten. The reference is made
from `__all__` of vergence, vergence.twin and vergence.viewer, which is the only list of their
public names; it is read from the sources, so that lazy imports do not matter.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src"
DOCUMENTS = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "benchmarks/README.md": "benchmarks.md",
    "models/cbi_head/README.md": "model.md",
    "models/shared_tilt_head/README.md": "model_shared_tilt.md",
    "models/room/README.md": "model_room.md",
}
"""Documents outside docs/, and the pages of the site that they become."""
REFERENCE = {
    "reference.md": "vergence",
    "reference-twin.md": "vergence.twin",
    "reference-viewer.md": "vergence.viewer",
}
"""Pages of the site, and the packages whose public names they list."""
CONTENTS = {
    "Guides": (
        *(
            "ten_line_programs",
            "capture",
            "calibrate",
            "recordings",
            "locate",
            "other_joints",
            "gaze",
            "own_head",
            "own_driver",
            "own_detector",
            "live",
        ),
        *("reproduction", "error_study", "design_and_plan"),
    ),
    "Reference": (
        *(name.removesuffix(".md") for name in REFERENCE),
        *("dataset", "calibration_file", "conventions", "equations", "method", "evidence"),
    ),
    "Project": (
        *("architecture", "security", "model", "model_shared_tilt", "model_room", "benchmarks"),
        *("contributing", "changelog"),
    ),
}
"""The site's table of contents; Sphinx warns of a page that is missing from it."""
PICTURES = (".png", ".svg")

LINK = re.compile(r"(?P<head>!?\[(?P<text>[^\]]*)\]\()(?P<to>[^)#\s]+)(?P<anchor>#[^)\s]*)?\)")
HTML_PICTURE = re.compile(r'(?<=src=")[^":]+(?=")')
_FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def public_names(package: str) -> dict[str, str]:
    """Return by each name of a package's `__all__` where it is defined, in that order.

    Args:
        package: dotted name, such as vergence.twin.

    Returns:
        Dotted paths, such as {"load_head": "vergence.geometry.head.load"}; empty without `__all__`.
    """
    listed: list[str] = []
    lazy = False
    defined: dict[str, str] = {}
    for node in ast.walk(_tree(package)):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                defined[alias.asname or alias.name] = f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Assign | ast.AnnAssign) and "__all__" in _targets(node):
            assert isinstance(node.value, ast.List)
            listed = [str(item.value) for item in node.value.elts if isinstance(item, ast.Constant)]
            lazy = any(isinstance(item, ast.Starred) for item in node.value.elts)
    if lazy:  # the names imported from other modules of the package
        listed += [name for name, path in defined.items() if path.startswith(f"{package}.")]
    return {name: defined.get(name, f"{package}.{name}") for name in listed}


def _tree(module: str) -> ast.Module:
    """Return the parsed source of a module or package."""
    path = SOURCES.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def _targets(node: ast.stmt) -> list[str]:
    """Return the names to which a statement assigns."""
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _kind(path: str) -> str:
    """Return the directive that documents what stands at a dotted path."""
    module, _, name = path.rpartition(".")
    if SOURCES.joinpath(*path.split(".")).with_suffix(".py").exists():
        return "automodule"
    for node in _tree(module).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            is_error = any(
                ast.unparse(base).endswith(("Error", "Exception")) for base in node.bases
            )
            return "autoexception" if is_error else "autoclass"
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return "autofunction"
    return "autodata"


def reference_page(package: str) -> str:
    """Return the page of a package: its `__all__`, by rooms, or else all of its modules.

    Args:
        package: dotted name, such as vergence.twin.
    """
    names = public_names(package)
    lines = [f"# {package}", "", *_directive("automodule", package, "no-members")]
    if not names:
        folder = SOURCES.joinpath(*package.split("."))
        for path in sorted(folder.glob("[!_]*.py")):
            module = f"{package}.{path.stem}"
            lines += ["", f"## {module}", "", *_directive("automodule", module, "members")]
    for room in dict.fromkeys(_room(path) for path in names.values()):
        lines += ["", f"## {room}"]
        for name, path in names.items():
            if _room(path) == room:
                lines += ["", f"### {name}", "", *_entry(f"{package}.{name}", _kind(path))]
    return "\n".join(lines) + "\n"


def _room(path: str) -> str:
    """Return in which part of vergence a dotted path lies."""
    parts = path.split(".")
    return ".".join(parts[1:-1]) if parts[1:2] == ["twin"] else parts[1] if parts[2:] else parts[0]


def _entry(path: str, kind: str) -> list[str]:
    """Return the directive for one name, with the members of a class."""
    options = {"autoclass": ("members", "undoc-members"), "autodata": ("no-value",)}.get(kind, ())
    return _directive(kind, path, *options)


def _directive(kind: str, argument: str, *options: str) -> list[str]:
    """Return a directive of Sphinx's autodoc, as it stands in Markdown."""
    return ["```{eval-rst}", f".. {kind}:: {argument}", *(f"   :{o}:" for o in options), "```"]


def page_of(path: str) -> str | None:
    """Return what a file of the repository is called on the site; None: it is not there."""
    if f"{path}/README.md" in DOCUMENTS:
        path += "/README.md"
    if path in DOCUMENTS:
        return DOCUMENTS[path]
    if path.startswith("docs/") and path.endswith((".md", *PICTURES)):
        return path.removeprefix("docs/")
    return path if path.endswith(PICTURES) else None


def relink(markdown: str, source: str) -> str:
    """Return a document as the site needs it: links to pages as pages, others as plain text.

    Args:
        markdown: of the document.
        source: the document's path in the repository.
    """

    def target(to: str) -> str | None:
        return page_of(os.path.normpath(os.path.join(os.path.dirname(source), to)))

    def link(found: re.Match[str]) -> str:
        page = found["to"] if ":" in found["to"] else target(found["to"])
        return found["text"] if page is None else f"{found['head']}{page}{found['anchor'] or ''})"

    parts = _FENCED.split(markdown)
    for k in range(0, len(parts), 2):  # the odd ones are blocks of code
        parts[k] = LINK.sub(link, parts[k])
        parts[k] = HTML_PICTURE.sub(lambda found: target(found[0]) or found[0], parts[k])
    return "".join(parts)


def contents() -> str:
    """Return the site's table of contents, which stands at the end of its first page."""
    blocks = []
    for caption, pages in CONTENTS.items():
        options = [f":caption: {caption}", ":hidden:", ":maxdepth: 1"]
        blocks += ["", "```{toctree}", *options, "", *pages, "```"]
    return "\n".join(blocks) + "\n"


def write(folder: Path) -> None:
    """Write all pages and pictures of the site into a folder, which is made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "docs", folder, ignore=shutil.ignore_patterns("*.py", "*.md", "__*"))
    own = {f"docs/{path.name}": path.name for path in (ROOT / "docs").glob("*.md")}
    for source, page in {**DOCUMENTS, **own}.items():
        text = relink((ROOT / source).read_text(encoding="utf-8"), source)
        text += contents() if page == "index.md" else ""
        (folder / page).write_text(text, encoding="utf-8")
        shown = [found["to"] for found in LINK.finditer(text)] + HTML_PICTURE.findall(text)
        for picture in shown:
            if picture.endswith(PICTURES) and not (folder / picture).exists():
                (folder / picture).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / picture, folder / picture)
    for page, package in REFERENCE.items():
        (folder / page).write_text(reference_page(package), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
