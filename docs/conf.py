"""Sphinx's configuration: `make docs` collects the pages (site_pages.py) and builds the site."""

from __future__ import annotations

import dataclasses
import enum
import sys
from pathlib import Path

from sphinx.ext.napoleon import GoogleDocstring

SOURCES = Path(__file__).parents[1] / "src"
sys.path.insert(0, str(SOURCES))

from vergence import __version__, arrays  # noqa: E402

project = "vergence"
author = "The vergence authors"
release = version = __version__
html_title = f"vergence {release}"
html_theme = "furo"
html_copy_source = False

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4  # links to headings are those of GitHub
default_role = "literal"  # `name` in a docstring
add_module_names = False
autodoc_mock_imports = ["mujoco"]  # a machine that builds the site needs no OpenGL
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {
    name: name
    for name in (*vars(arrays), "PositiveInt", "PositiveFloat", "FiniteFloat")
    if name[0].isupper()
}
napoleon_google_docstring = napoleon_numpy_docstring = False  # see sections
napoleon_use_rtype = False
suppress_warnings = ["myst.header"]  # the reference begins at any level


def sections(app, what, name, obj, options, lines):
    """Read the sections of a docstring (Args, Returns, Raises) as Google's style has them.

    Napoleon would do the same, but takes what stands before a colon in a field's docstring for
    the field's type.
    """
    if what not in ("attribute", "data"):
        lines[:] = GoogleDocstring(lines, app.config, app, what, name, obj, options).lines()


def without_arguments(app, what, name, obj, options, signature, returns):
    """Leave out the arguments of a dataclass, whose fields follow with their types."""
    bare = what == "class" and (dataclasses.is_dataclass(obj) or issubclass(obj, enum.Enum))
    return ("", returns) if bare else None


def setup(app):
    app.connect("autodoc-process-docstring", sections)
    app.connect("autodoc-process-signature", without_arguments)
