"""Loads a study: a script of its own, in no package."""

import importlib.util
import sys
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[3] / "tools" / "studies"


@cache
def study(name):
    """Return the module of a study, under a name that nothing else has."""
    spec = importlib.util.spec_from_file_location(f"study_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look for it
    sys.path.insert(0, str(FOLDER))  # studies import those beside them
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(FOLDER))
    return module
