"""Every file of tests is one that a run collects."""

from fnmatch import fnmatch
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def test_no_folder_of_tests_is_passed_over_for_its_name(pytestconfig: pytest.Config) -> None:
    passed_over = pytestconfig.getini("norecursedirs")
    folders = {path.parent for path in HERE.rglob("test_*.py")}
    names = {part for folder in folders for part in folder.relative_to(HERE).parts}
    assert {"tools", "build"} <= names
    assert not [name for name in names if any(fnmatch(name, pattern) for pattern in passed_over)]
