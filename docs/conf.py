"""Sphinx: MyST pages and docstrings to HTML, offline; warnings are errors (``make docs``)."""

from importlib import metadata

project = "eitskin"
author = "The eitskin developers"
copyright = author
release = metadata.version("eitskin")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["examples"]
suppress_warnings = ["myst.xref_missing"]  # DESIGN.md links out of docs/; tests/docs/test_text.py checks every link
myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"npt.ArrayLike": "ArrayLike"}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_attr_annotations = True

html_theme = "furo"
html_title = f"eitskin {release}"
html_show_sourcelink = False
html_copy_source = False

COLON = "\ue000"
"""Stands for a colon while Napoleon looks, which takes what is before one in a field's docstring for its type."""


def _hide_colons(app, what, name, obj, options, lines):
    if what in {"attribute", "data", "property"}:
        lines[:] = [line.replace(":", COLON) for line in lines]


def _show_colons(app, what, name, obj, options, lines):
    lines[:] = [line.replace(COLON, ":") for line in lines]


def setup(app):
    """Hide colons before Napoleon, whose priority is 500, and show them after it."""
    app.connect("autodoc-process-docstring", _hide_colons, priority=400)
    app.connect("autodoc-process-docstring", _show_colons, priority=600)
