"""A sheet's size, map and electrodes come from its skin: no module has numbers of one sheet."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGES = ("firmware_proto", "runtime", "training", "export", "tools")

PAPER_NUMBERS: set[Any] = {1350, (150.0, 100.0), (30, 45), (3, 30, 45), (9, 14)}
"""Pixels of the paper's map, its sheet's size, the shapes of its map, cloud and units."""

STATED = {
    "firmware_proto/eitskin_proto/skin/parts.py": "the paper's skin, which is the default",
    "training/eitskin_training/network/architecture.py": "how files from before skins name their outputs",
}
"""Where a sheet's numbers may stand, and as what."""


def literals(tree: ast.AST) -> Iterator[Any]:
    """Yield numbers and tuples of numbers."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield node.value
        elif isinstance(node, ast.Tuple) and all(isinstance(one, ast.Constant) for one in node.elts):
            yield ast.literal_eval(node)


def test_no_module_has_numbers_of_one_sheet() -> None:
    found: dict[str, list[Any]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            numbers = [one for one in literals(ast.parse(path.read_text(encoding="utf-8"))) if one in PAPER_NUMBERS]
            if numbers:
                found[str(path.relative_to(ROOT))] = numbers
    assert set(found) == set(STATED), f"take it from a skin, as skin.grid or skin.outline: {found}"


def test_the_scan_sees_what_it_looks_for() -> None:
    source = "SHAPE = (30, 45)\nPIXELS: int = 30 * 45\nMAP = np.zeros((1350,))\nSIZE_MM = 150.0, 100.0\n"
    seen = [one for one in literals(ast.parse(source)) if one in PAPER_NUMBERS]
    assert sorted(map(str, seen)) == ["(150.0, 100.0)", "(30, 45)", "1350"]
