"""The API page names every public name of eitskin, and nothing that is not there."""

import importlib
import re

import pytest

import eitskin
import eitskin.errors

from .markdown import ROOT

PAGE = (ROOT / "docs/api.md").read_text(encoding="utf-8")
TARGETS = re.findall(r"^\.\. auto(\w+):: ([\w.]+)$", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("kind", "target"), TARGETS)
def test_what_the_page_names_is_there_and_has_a_docstring(kind, target):
    if kind == "module":
        found = importlib.import_module(target)
    else:
        module, _, name = target.rpartition(".")
        found = getattr(importlib.import_module(module), name)
    assert found.__doc__


def test_every_public_name_is_on_the_page():
    named = {target.removeprefix("eitskin.") for _, target in TARGETS}
    missing = [name for name in eitskin.__all__ if name not in named and not hasattr(eitskin.errors, name)]
    assert all(f"`eitskin.{name}`" in PAGE for name in missing), missing
