"""The documents as text: lengths, links, and code that at least compiles."""

import os
from pathlib import Path
from urllib.parse import unquote

import pytest

from .markdown import ROOT, anchors, code_blocks, links, pages

LONGEST = 120

OTHERS = {".png", ".svg", ".mcap", ".npz", ".npy", ".ply", ".eitskin", ".py"}
"""No text, or made by a program, or Python, which ruff holds to the same length."""

MADE = {"__pycache__", "data", "out", "dist", "eitskin.egg-info"}
MADE_SUFFIXES = (".pyc", ".o", ".so", ".elf", ".bin", ".typed")
"""Folders and files that programs make, as in .gitignore."""

LONGER = {
    "tests/golden/wire.json": "one object a line, made by tests/golden/regenerate.py",
    "tools/eitskin_tools/phantoms/paper_units.json": "one phantom a line",
    "tools/eitskin_tools/phantoms/paper_mm.json": "one phantom a line",
    "LICENSE": "as Apache has it",
}
"""Files with longer lines, and why."""


def relative(path):
    return str(path.relative_to(ROOT))


def written_by_hand():
    """Yield every file of the project; what is hidden, made or ignored lies in folders that are left out."""
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in MADE and not name.startswith(".")]
        yield from (Path(folder) / name for name in names if not name.endswith(MADE_SUFFIXES))


@pytest.mark.process
def test_no_line_of_any_text_file_is_longer_than_120_characters():
    too_long = []
    for path in written_by_hand():
        if path.suffix in OTHERS or relative(path) in LONGER or not path.is_file():
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if len(line) > LONGEST and "://" not in line:
                too_long.append(f"{relative(path)}:{number} has {len(line)}")
    assert not too_long


def test_the_readme_has_at_most_120_lines():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("path", sorted((ROOT / "docs/decisions").glob("0*.md")), ids=lambda path: path.stem[:4])
def test_a_decision_has_at_most_40_lines_and_its_four_parts(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 40
    parts = [line for line in text.splitlines() if line.startswith("## ")]
    assert parts == ["## Context", "## Decision", "## Rejected", "## Evidence"]
    assert text.startswith(f"# {int(path.stem[:4])}. ")


def test_the_numbers_of_decisions_have_no_gap_and_the_index_names_each_of_them():
    names = sorted(path.name for path in (ROOT / "docs/decisions").glob("0*.md"))
    assert [int(name[:4]) for name in names] == list(range(1, len(names) + 1))
    assert sorted(links(ROOT / "docs/decisions/index.md")) == names


@pytest.mark.parametrize("path", pages(), ids=relative)
def test_every_relative_link_and_anchor_leads_somewhere(path):
    for target in links(path):
        if "://" in target or target.startswith("mailto:"):
            continue
        name, _, anchor = unquote(target).partition("#")
        there = (path.parent / name).resolve() if name else path
        assert there.exists(), f"{relative(path)} links to {target}, which is not there"
        if anchor:
            assert anchor in anchors(there), f"{relative(path)} links to {target}, which has no such heading"


@pytest.mark.parametrize("path", pages(), ids=relative)
def test_python_in_the_documents_compiles(path):
    for block in code_blocks(path, "python"):
        compile(block, str(path), "exec")
