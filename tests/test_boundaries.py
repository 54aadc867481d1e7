"""Which package may import which, and that no imports form a circle: checked on every module's syntax tree.

A room is a folder of a package, or a module beside its folders. Imports inside functions count as well.
"""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

RUNTIME = {"numpy", "onnxruntime", "serial", "usb", "msgpack", "zmq", "cobs", "google_crc32c", "adi"}
SIMULATION = {"numpy", "scipy", "distributed"}
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

FOLDERS = {**{package: folder for package, (folder, _) in ALLOWED.items()}, "eitskin_tools": "tools/eitskin_tools"}

Arrows = dict[str, set[str]]


@cache
def modules_of(package: str) -> dict[str, str]:
    """Return {dotted name: source} of a package's modules; ``package.__init__`` is the package itself."""
    folder = ROOT / FOLDERS[package]
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = (package, *path.relative_to(folder).with_suffix("").parts)
        found[".".join(parts if len(parts) == 2 or parts[-1] != "__init__" else parts[:-1])] = path.read_text()
    return found


@cache
def imports(source: str) -> set[str]:
    """Return the dotted names that a module imports; ``from a import b`` counts as both ``a`` and ``a.b``."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Call) and node.args:
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in ("import_module", "__import__") and isinstance(node.args[0], ast.Constant):
                found.add(str(node.args[0].value))
    return found


def forbidden(source: str, package: str) -> set[str]:
    """Return what a module imports although its package may not."""
    return {name.split(".")[0] for name in imports(source)} - ALLOWED[package][1] - {package} - sys.stdlib_module_names


def module_arrows(modules: dict[str, str]) -> Arrows:
    """Return which modules each module imports; a package that holds an imported module does not count itself."""
    known = set(modules)
    arrows: Arrows = {}
    for name, source in modules.items():
        named = {f"{one}.__init__" if f"{one}.__init__" in known else one for one in imports(source)} & known
        arrows[name] = {one for one in named if not any(other.startswith(f"{one}.") for other in named)} - {name}
    return arrows


def room_arrows(modules: dict[str, str]) -> Arrows:
    """Return which rooms each room imports."""
    found: Arrows = {name.split(".")[1]: set() for name in modules}
    for name, targets in module_arrows(modules).items():
        found[name.split(".")[1]] |= {target.split(".")[1] for target in targets}
    return {room: targets - {room} for room, targets in found.items()}


def circle(arrows: Arrows) -> list[str]:
    """Return the names on one circle of arrows, or none."""
    done: set[str] = set()

    def walk(name: str, way: list[str]) -> list[str]:
        if name in way:
            return way[way.index(name) :]
        if name in done:
            return []
        for target in sorted(arrows.get(name, ())):
            if found := walk(target, [*way, name]):
                return found
        done.add(name)
        return []

    return next((found for name in sorted(arrows) if (found := walk(name, []))), [])


@pytest.mark.parametrize("package", ALLOWED)
def test_a_package_imports_only_what_the_arrows_allow(package: str) -> None:
    found = {name: forbidden(source, package) for name, source in modules_of(package).items()}
    assert len(found) > 5
    assert {name: names for name, names in found.items() if names} == {}


@pytest.mark.parametrize("package", FOLDERS)
def test_no_imports_form_a_circle(package: str) -> None:
    modules = modules_of(package)
    assert circle(room_arrows(modules)) == circle(module_arrows(modules)) == []


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("eitskin", "import torch"),
        ("eitskin", "def late():\n    from scipy import sparse"),
        ("eitskin", "import importlib\nimportlib.import_module('eitskin_sim.fem.forward')"),
        ("eitskin_training", "import eitskin"),
    ],
)
def test_a_forbidden_import_is_found(package: str, source: str) -> None:
    assert forbidden(source, package)


def test_a_circle_is_found_between_rooms_and_between_modules() -> None:
    house = {"house.a.one": "", "house.a.two": "from house.a.one import x", "house.b.one": "from house.a import two"}
    assert circle(room_arrows(house)) == circle(module_arrows(house)) == []
    assert circle(room_arrows(house | {"house.a.one": "import house.b.one"})) == ["a", "b"]
    within = house | {"house.a.one": "def late():\n    from house.a.two import y"}
    assert circle(module_arrows(within)) == ["house.a.one", "house.a.two"]


def test_every_package_ships_its_types() -> None:
    assert all((ROOT / folder / "py.typed").is_file() for folder in FOLDERS.values())
