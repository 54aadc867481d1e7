"""Every attack can be loaded, the page about attacks names each, and its folder tries its short form."""

import ast
import re
from pathlib import Path

import pytest

from .catalogue import ATTACKS, load
from .short import SLOW

HERE = Path(__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "attacks.md"

IN_PARTS = {"shutdown.moments:at_moments": "run.terminated"}
"""What tests try instead of an attack's own function, since it takes parts of it that run on several cores."""


def test_every_attack_is_a_function() -> None:
    assert all(callable(load(name)) for name in ATTACKS)


def test_the_page_names_each_attack_and_no_other() -> None:
    first_table, _ = PAGE.read_text(encoding="utf-8").split("## What must hold")
    assert re.findall(r"^\| ([a-z_-]+\.[a-z_-]+) \|", first_table, re.MULTILINE) == list(ATTACKS)


def is_slow(node: ast.AST) -> bool:
    return any(isinstance(part, ast.Attribute) and part.attr == "slow" for part in ast.walk(node))


def called_with(node: ast.AST, function: str) -> list[str]:
    """Return the texts that a function is called with, anywhere below a node."""
    return [
        part.args[0].value
        for part in ast.walk(node)
        if isinstance(part, ast.Call)
        and isinstance(part.func, ast.Name)
        and part.func.id == function
        and part.args
        and isinstance(part.args[0], ast.Constant)
    ]


def tried(folder: str, source: str) -> set[str]:
    """Return the names of the attacks that a test module of a folder tries, by no slow test but those of ``SLOW``."""
    imported, found = dict[str, str](), set[str]()
    by_place = {where: name for name, where in ATTACKS.items()} | IN_PARTS
    for node in ast.parse(source).body:
        parts = [part for target in getattr(node, "targets", ()) for part in ast.walk(target)]
        names = [part.id for part in parts if isinstance(part, ast.Name)]
        if "pytestmark" in names and is_slow(node):
            return set()
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            imported |= {one.asname or one.name: f"{folder}.{node.module}:{one.name}" for one in node.names}
        elif any(name.startswith("test_") for name in names):
            taken = called_with(node, "short_form")
            found |= {name for name, where in ATTACKS.items() if where.split(".")[0] in taken}
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and not is_slow(node):
            used = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            found |= {by_place[imported[name]] for name in used & set(imported) if imported[name] in by_place}
            found |= set(called_with(node, "load")) & set(ATTACKS)
    return found


def test_every_attack_is_tried_by_a_test_of_its_folder() -> None:
    left = dict(ATTACKS)
    for folder in {where.split(".")[0] for where in ATTACKS.values()}:
        for path in (HERE / folder).glob("test_*.py"):
            for name in tried(folder, path.read_text(encoding="utf-8")):
                left.pop(name, None)
    assert left == {}, "no test of their folder tries them"
    assert set(IN_PARTS.values()) | SLOW <= set(ATTACKS)


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("from .keys import key_folders\ndef test_a():\n    key_folders(1)", {"control.keys"}),
        ("from .keys import key_folders as k\n@parametrize('a', [k])\ndef test_a(a):\n    a(1)", {"control.keys"}),
        ("def test_a():\n    load('control.keys')(1)", {"control.keys"}),
        ("outcome, test_a = short_form('control')", {"control.keys", "control.requests"}),
        ("outcome, it_is_withstood = short_form('control')", set()),
        ("from .keys import key_folders\ndef test_a():\n    pass", set()),
        ("from .keys import key_folders\ndef helper():\n    key_folders(1)", set()),
        ("@pytest.mark.slow\ndef test_a():\n    load('control.keys')(1)", set()),
        ("pytestmark = [pytest.mark.slow]\ndef test_a():\n    load('control.keys')(1)", set()),
    ],
)
def test_an_attack_that_no_test_tries_is_found(source: str, names: set[str]) -> None:
    assert tried("control", source) == names
