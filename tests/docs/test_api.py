"""The API pages name every public name of eitskin once, and nothing that is not there."""

import importlib
import re

import pytest

import eitskin
import eitskin.errors

from .markdown import ROOT

PAGES = {path.name: path.read_text(encoding="utf-8") for path in [ROOT / "docs/api.md", *(ROOT / "docs/api").glob("*")]}
TARGETS = {name: re.findall(r"^\.\. auto(\w+):: ([\w.]+)$", page, re.MULTILINE) for name, page in PAGES.items()}


@pytest.mark.parametrize(("kind", "target"), [one for targets in TARGETS.values() for one in targets])
def test_what_a_page_names_is_there_and_has_a_docstring(kind, target):
    if kind == "module":
        found = importlib.import_module(target)
    else:
        module, _, name = target.rpartition(".")
        found = getattr(importlib.import_module(module), name)
    assert found.__doc__


def pages_of(public):
    """Return the pages that document a public name: by itself, in the text, or with the module of the errors."""
    targets = {f"eitskin.{public}"} | ({"eitskin.errors"} if public in eitskin.errors.__all__ else set())
    return [
        name
        for name, page in PAGES.items()
        if f"`eitskin.{public}`" in page or targets & {target for _, target in TARGETS[name]}
    ]


def test_every_public_name_is_on_exactly_one_page():
    assert {name: found for name in eitskin.__all__ if len(found := pages_of(name)) != 1} == {}
