"""The documents as text: lengths, links, and code that at least compiles."""

import subprocess
from urllib.parse import unquote

import pytest

from .markdown import ROOT, anchors, code_blocks, links, pages

LONGEST = 120

OTHERS = {".mcap", ".png", ".gif", ".svg", ".npz", ".npy", ".ply", ".eitskin", ".py"}
"""No text, or made by a program, or Python, which ruff holds to the same length."""

LONGER = {
    "tests/golden/wire.json": "one object a line, made by tests/golden/regenerate.py",
    "tools/eitskin_tools/phantoms/paper_units.json": "one phantom a line",
    "tools/eitskin_tools/phantoms/paper_mm.json": "one phantom a line",
    "tools/contract.sh": "programs and lists of keys in quotation marks",
    "LICENSE": "as Apache has it",
}
"""Files with longer lines, and why."""


def relative(path):
    return str(path.relative_to(ROOT))


def test_no_line_of_any_text_file_is_longer_than_120_characters():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip(f"the files of the project are not known: {listed.stderr.strip()}")
    too_long = []
    for path in (ROOT / name for name in listed.stdout.split("\0") if name and name not in LONGER):
        if path.suffix in OTHERS or not path.is_file():
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if len(line) > LONGEST and "://" not in line:
                too_long.append(f"{relative(path)}:{number} has {len(line)}")
    assert not too_long


def test_the_numbers_of_decisions_have_no_gap_and_the_index_names_each_of_them():
    names = sorted(path.name for path in (ROOT / "docs/decisions").glob("[0-9]*.md"))
    assert [int(name[:2]) for name in names] == list(range(1, len(names) + 1))
    assert [link for link in links(ROOT / "docs/decisions/index.md") if link[0].isdigit()] == names


def test_every_relative_link_and_anchor_leads_somewhere():
    wrong = []
    for path in pages():
        for target in links(path):
            if "://" in target or target.startswith("mailto:"):
                continue
            name, _, anchor = unquote(target).partition("#")
            there = (path.parent / name).resolve() if name else path
            if not there.exists() or (anchor and anchor not in anchors(there)):
                wrong.append(f"{relative(path)} links to {target}")
    assert not wrong


def test_python_in_the_documents_compiles():
    for path in pages():
        for block in code_blocks(path, "python"):
            compile(block, str(path), "exec")
