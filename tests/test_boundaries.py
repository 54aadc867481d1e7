"""Which package may import which, and which room of a package which: held by reading every module's syntax tree.

A room is a folder of a package, or a module beside its folders. Arrows between rooms are listed; a new one is a
decision, to be written down here. No arrows may form a circle, neither between rooms nor between modules.
"""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

IMPORTERS = {"import_module", "__import__"}
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

Arrows = dict[str, set[str]]

ROOMS: dict[str, Arrows] = {
    "eitskin_proto": {
        "__init__": set(), "errors": set(), "files": {"errors"},
        "sensor": {"errors", "files"},
        "skin": {"errors", "files", "sensor"},
        "wire": {"errors", "files", "sensor", "skin"},
    },
    "eitskin": {
        "errors": set(),
        "touches": {"errors"},
        "model": {"errors", "touches"},
        "reference": {"errors", "model"},
        "acquisition": {"errors", "reference"}, "health": {"errors", "model", "reference"},
        "messaging": {"errors", "reference", "touches"},
        "pipeline": {"acquisition", "errors", "health", "messaging", "model", "reference"},
        "diagnostics": {"acquisition", "errors", "health", "messaging", "model", "reference"},
        "frame_source": {"acquisition", "errors", "pipeline"},
        "frame_loop": {"acquisition", "errors", "frame_source", "messaging", "pipeline", "reference", "touches"},
        "status": {"acquisition", "frame_loop", "pipeline"},
        "stream_source": {"acquisition", "frame_loop", "messaging", "pipeline", "reference", "status"},
        "skin": {
            "acquisition", "errors", "frame_loop", "health", "messaging", "model", "pipeline", "reference", "status",
            "stream_source",
        },
        "serving": {"messaging", "skin"}, "robot": {"errors", "messaging", "touches"},
        "__init__": {"acquisition", "errors", "messaging", "model", "reference", "robot", "serving", "skin", "touches"},
    },
    "eitskin_sim": {
        "__init__": set(), "scene": set(), "fem": {"scene"},
        "measurement": {"fem"},
        "devices": {"fem", "measurement", "scene"},
        "unit_grid": {"devices", "fem", "scene"},
        "freeform": {"devices", "fem", "scene", "unit_grid"},
        "surface": {"fem", "scene"},
        "solvers": {"fem", "scene", "surface"}, "shapes": {"fem", "freeform", "scene", "unit_grid"},
        "dataset": {"devices", "fem", "freeform", "scene", "surface", "unit_grid"},
        "outline": {"fem", "scene"}, "tank": {"fem", "outline", "scene", "solvers"},
        "calibration": {"devices", "fem", "measurement", "scene", "surface"},
        "evaluation": {"fem", "measurement", "scene", "solvers", "surface"},
        "reduced": {"devices", "fem", "scene", "surface", "unit_grid"},
        "verification": {"fem", "freeform", "reduced", "scene", "shapes", "surface", "unit_grid"},
    },
    "eitskin_training": {
        "__init__": set(),
        "network": set(),
        "recipes": {"network"},
        "samples": {"network", "recipes"},
        "score": {"network", "samples"},
        "card": {"network", "samples", "score"}, "gate": {"network", "samples"},
        "start": {"network", "recipes", "run_files"}, "narrowed": {"network", "recipes", "samples", "start"},
        "run": {"network", "recipes"}, "schedule": {"recipes"}, "curves": {"run"},
        "resident": {"network", "recipes", "run", "samples", "schedule", "score"},
        "train": {"narrowed", "network", "recipes", "resident", "run", "run_files", "samples", "schedule", "score",
                  "start"},
        "adapt": {"missing_electrodes_score", "network", "recipes", "run_files", "samples", "score"},
        "run_files": {"network", "recipes", "samples"}, "row_statistics": {"gate", "recipes", "samples"},
        "missing_electrodes_score": {"network", "samples", "score"},
        "ablations": {"network", "recipes", "run_files", "samples", "score", "train"},
    },
    "eitskin_export": {
        "__init__": set(),
        "bundle": set(), "pair": {"bundle"},
        "consistency": set(),
        "fold": set(),
        "unfold": {"bundle"},
        "parity": set(),
        "projection": set(),
        "gate_audit": {"parity"},
        "graphs": {"fold"},
        "quantise": {"graphs"},
        "package": {"bundle", "consistency", "fold", "gate_audit", "graphs", "parity", "projection", "quantise"},
    },
    "eitskin_tools": {
        "__init__": set(), "choices": set(),
        "command_line": {"errors"},
        "console": {"processes"},
        "errors": set(), "stages": set(), "flash": {"processes"}, "guided": {"console"},
        "mismatches": set(), "phantoms": set(), "pictures": set(),
        "processes": set(),
        "recording": {"command_line", "pictures", "processes"},
        "scans": {"command_line"},
        "scenes": set(),
        "service": {"processes"}, "robot": {"command_line", "console", "errors", "processes", "service"},
        "verifier": {"command_line", "errors", "evaluation", "processes"},
        "view": {"command_line", "console", "pictures", "processes", "recording"},
        "scripted_scene": {"processes"},
        "virtual_skin": {"processes", "scripted_scene"},
        "emulator": {"flash", "scripted_scene", "virtual_skin"},
        "evaluation": {"command_line", "pictures", "recording"},
        "demo": {"pictures", "processes", "scripted_scene"},
        "fault_injection": {"emulator", "flash", "recording", "virtual_skin"},
        "recipes": set(), "build": {"command_line", "evaluation"},
        "bench": {
            "build", "choices", "command_line", "demo", "errors", "evaluation", "pictures", "processes", "recording",
            "scripted_scene", "stages", "view", "virtual_skin",
        },
        "commands": {
            "build", "command_line", "console", "demo", "errors", "evaluation", "flash", "guided", "processes",
            "recording", "robot", "service", "stages", "verifier", "view", "virtual_skin",
        },
        "cli": {"processes", "command_line", "console", "errors"}, "entry": {"cli"},
    },
}  # fmt: skip
"""Of each package: room, and what it may import of its neighbours."""


def imported_names(source: str) -> set[str]:
    """Return the top-level names that a module imports, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in IMPORTERS:
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


def modules_of(package: str) -> dict[str, str]:
    """Return {dotted name: source} of a package's modules; ``package.__init__`` is the package itself."""
    folder = ROOT / (ALLOWED[package][0] if package in ALLOWED else "tools/eitskin_tools")
    found = {}
    for path in sorted(folder.rglob("*.py")):
        parts = (package, *path.relative_to(folder).with_suffix("").parts)
        found[".".join(parts if len(parts) == 2 or parts[-1] != "__init__" else parts[:-1])] = path.read_text()
    return found


def imported_modules(source: str, known: set[str]) -> set[str]:
    """Return which of the known modules a module imports, inside functions too; a package counts as itself alone."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= members & known or {node.module}
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module" and node.args:
            first = node.args[0]
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                found.add(first.value)
    return {f"{name}.__init__" if f"{name}.__init__" in known else name for name in found} & known


def module_arrows(modules: dict[str, str]) -> Arrows:
    return {name: imported_modules(source, set(modules)) - {name} for name, source in modules.items()}


def room_arrows(modules: dict[str, str]) -> Arrows:
    found: Arrows = {name.split(".")[1]: set() for name in modules}
    for name, targets in module_arrows(modules).items():
        found[name.split(".")[1]] |= {target.split(".")[1] for target in targets}
    return {room: targets - {room} for room, targets in found.items()}


def forbidden_arrows(modules: dict[str, str], allowed: Arrows) -> list[str]:
    """Return what is not listed, as ``room -> room``; a room that is not listed, by its name."""
    found = room_arrows(modules)
    unlisted = [room for room in found if room not in allowed]
    return unlisted + [
        f"{room} -> {target}" for room in found if room in allowed for target in sorted(found[room] - allowed[room])
    ]


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


@pytest.mark.parametrize("package", ROOMS)
def test_rooms_import_only_what_their_arrows_allow(package: str) -> None:
    modules = modules_of(package)
    assert len(modules) > 5
    assert forbidden_arrows(modules, ROOMS[package]) == []


@pytest.mark.parametrize("package", ROOMS)
def test_there_is_no_circle_between_rooms_nor_between_modules(package: str) -> None:
    modules = modules_of(package)
    assert circle(ROOMS[package]) == []
    assert circle(room_arrows(modules)) == circle(module_arrows(modules)) == []


HOUSE = {
    "house.errors": "",
    "house.cellar.wine": "from house.errors import Corked",
    "house.kitchen.__init__": "",
    "house.kitchen.stove": "from house.cellar import wine",
    "house.kitchen.oven": "from house.kitchen.stove import heat",
}

HOUSE_ARROWS: Arrows = {"errors": set(), "cellar": {"errors"}, "kitchen": {"cellar"}}


def test_a_house_in_order_passes() -> None:
    assert forbidden_arrows(HOUSE, HOUSE_ARROWS) == []
    assert circle(module_arrows(HOUSE)) == circle(room_arrows(HOUSE)) == []


@pytest.mark.parametrize(
    ("module", "source", "found"),
    [
        ("house.cellar.wine", "from house.kitchen.stove import heat", ["cellar -> kitchen"]),
        ("house.cellar.wine", "def late():\n    import house.kitchen.oven", ["cellar -> kitchen"]),
        ("house.kitchen.stove", "from house.errors import Burnt", ["kitchen -> errors"]),
        ("house.kitchen.stove", "import importlib\nimportlib.import_module('house.errors')", ["kitchen -> errors"]),
        ("house.attic.trunk", "", ["attic"]),
    ],
)
def test_an_arrow_or_a_room_that_is_not_listed_is_found(module: str, source: str, found: list[str]) -> None:
    assert forbidden_arrows(HOUSE | {module: source}, HOUSE_ARROWS) == found


def test_a_circle_is_found_between_rooms_and_between_the_modules_of_one_room() -> None:
    between = HOUSE | {"house.cellar.wine": "from house.kitchen.oven import bake"}
    assert circle(room_arrows(between)) == ["cellar", "kitchen"]
    within = HOUSE | {"house.kitchen.stove": "def late():\n    from house.kitchen.oven import bake"}
    assert circle(room_arrows(within)) == []
    assert circle(module_arrows(within)) == ["house.kitchen.oven", "house.kitchen.stove"]
