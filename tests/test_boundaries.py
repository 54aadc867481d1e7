"""Which package may import which: the arrows of DESIGN.md, held by reading every module's syntax tree."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

RUNTIME = {"numpy", "onnxruntime", "serial", "usb", "msgpack", "zmq", "cobs", "google_crc32c"}
SIMULATION = {"numpy", "scipy", "rich", "distributed"}
TRAINING = {*SIMULATION, "torch", "matplotlib"}

ALLOWED: dict[str, tuple[str, set[str]]] = {
    "eitskin_proto": ("firmware_proto/eitskin_proto", {"numpy", "cobs", "google_crc32c"}),
    "eitskin": ("runtime/eitskin", {*RUNTIME, "eitskin_proto"}),
    "eitskin_sim": ("training/eitskin_sim", {*SIMULATION, "eitskin_proto"}),
    "eitskin_training": ("training/eitskin_training", {*TRAINING, "eitskin_proto", "eitskin_sim"}),
    "eitskin_export": (
        "export/eitskin_export",
        {*TRAINING, "onnx", "onnxscript", "onnxruntime", "eitskin_proto", "eitskin_sim", "eitskin_training", "eitskin"},
    ),
}
"""Package, its folder, and what it may import besides itself and the standard library."""


def imported_names(source: str) -> set[str]:
    """Return the top-level names that a module imports, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in {
            "import_module",
            "__import__",
        }:
            first = node.args[0] if node.args else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                names.add(first.value.split(".")[0])
    return names


def forbidden(source: str, package: str) -> set[str]:
    return imported_names(source) - ALLOWED[package][1] - {package} - set(sys.stdlib_module_names)


@pytest.mark.parametrize("package", ALLOWED)
def test_a_package_imports_only_what_the_arrows_allow(package: str) -> None:
    modules = sorted((ROOT / ALLOWED[package][0]).rglob("*.py"))
    assert modules, f"{package} has no modules"
    found = {str(path.relative_to(ROOT)): forbidden(path.read_text(), package) for path in modules}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("eitskin", "import torch"),
        ("eitskin", "def late():\n    from scipy import sparse"),
        ("eitskin", "import importlib\nimportlib.import_module('eitskin_sim.fem.forward')"),
        ("eitskin_proto", "import onnxruntime"),
        ("eitskin_sim", "from eitskin_training import model"),
        ("eitskin_training", "import eitskin"),
    ],
)
def test_the_check_fails_when_it_is_given_a_forbidden_import(package: str, source: str) -> None:
    assert forbidden(source, package)


def test_every_package_ships_its_types() -> None:
    for folder in [path for path, _ in ALLOWED.values()] + ["tools/eitskin_tools"]:
        assert (ROOT / folder / "py.typed").is_file()
