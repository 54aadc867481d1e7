"""Rules for every source file, held by reading its syntax tree: one door to a library, one writer of a state."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RUNTIME = ROOT / "runtime" / "eitskin"
DOOR = RUNTIME / "model" / "session.py"


def loads_the_library_alone(source):
    """Return the lines of a module that import onnxruntime before the door was gone through."""
    if "onnxruntime" not in source:
        return []  # most modules: reading all their trees takes seconds
    tree = ast.parse(source)
    door, found = 1 << 30, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
        else:
            continue
        if "eitskin.model.session" in names:
            door = min(door, node.lineno)
        if any(name.split(".")[0] == "onnxruntime" for name in names):
            found.append(node.lineno)
    return [line for line in found if line < door]


def test_every_module_goes_through_the_one_door():
    folders = ("runtime", "training", "export", "tools", "firmware_proto", "tests")
    modules = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py")) if path != DOOR]
    assert len(modules) > 100
    assert {str(path): lines for path in modules if (lines := loads_the_library_alone(path.read_text()))} == {}


@pytest.mark.parametrize(
    "source",
    [
        "import onnxruntime",
        "def late():\n    from onnxruntime.quantization import QuantType\nimport eitskin.model.session",
    ],
)
def test_a_module_that_does_not_is_found(source):
    assert loads_the_library_alone(source)


def written_from_outside(source):
    """Return the attributes of something called ``pipeline`` that a module sets."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Assign):
            targets = node.targets
        else:
            targets = [node.target] if isinstance(node, ast.AugAssign | ast.AnnAssign) else []
        for target in targets:
            owner = getattr(target, "value", None)
            if isinstance(target, ast.Attribute) and getattr(owner, "attr", getattr(owner, "id", "")).endswith(
                "pipeline"
            ):
                found.append(target.attr)
    return found


def test_nobody_outside_writes_the_pipelines_state():
    modules = [path for path in RUNTIME.rglob("*.py") if path.parent.name != "pipeline"]
    assert len(modules) > 30
    assert {path.name: names for path in modules if (names := written_from_outside(path.read_text()))} == {}


def test_a_hand_on_the_pipelines_state_is_found():
    assert written_from_outside(
        "self.pipeline.health = 1\nskin._pipeline.events += ('x',)\npipeline.idle: bool = True"
    ) == [
        "health",
        "events",
        "idle",
    ]
