"""Modules stay small enough to be read in one go, and folders small enough to be surveyed."""

from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("firmware_proto", "runtime", "training", "export", "tools", "tests", "docs")

MOST_LINES = 300
MOST_MODULES = 15
"""Of a folder, ``__init__`` and ``conftest`` among them."""

SKIN_LINES = 250
"""What a user calls is surveyed more often than the rest."""

LONGER: set[str] = set()
"""Modules that are still longer than they may be; the list only ever gets shorter."""


def modules() -> list[Path]:
    return [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_no_module_has_more_than_300_lines() -> None:
    found = {str(path.relative_to(ROOT)): lines(path) for path in modules()}
    assert len(found) > 300
    longer = {name: count for name, count in found.items() if count > MOST_LINES and name not in LONGER}
    assert longer == {}, f"more than {MOST_LINES} lines; split them by idea"


def test_whoever_is_excepted_is_still_longer() -> None:
    assert {name for name in LONGER if lines(ROOT / name) <= MOST_LINES} == set(), "no longer an exception"


def test_no_folder_has_more_than_15_modules() -> None:
    counted = Counter(str(path.parent.relative_to(ROOT)) for path in modules())
    assert {name: count for name, count in counted.items() if count > MOST_MODULES} == {}, "make folders of its ideas"


def test_the_skin_has_fewer_than_250_lines() -> None:
    assert lines(ROOT / "runtime" / "eitskin" / "skin.py") < SKIN_LINES
