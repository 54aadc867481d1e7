"""What pages name of the packages is there; results tell of their time, and are left out."""

import importlib
import re
from pathlib import Path

from .markdown import ROOT, outside_code, pages

NAMED = re.compile(r"`(eitskin(?:_\w+)?(?:\.[A-Za-z_]\w*)+)")
FILES = {"eitskin.service"}
"""What looks like a name and is a file."""

OF_THEIR_TIME = (ROOT / "docs/results", ROOT / "CHANGELOG.md")


def named() -> list[tuple[str, str]]:
    """Return each page and a name on it, once."""
    own = [page for page in pages() if not any(page.is_relative_to(one) for one in OF_THEIR_TIME)]
    return sorted({(str(page.relative_to(ROOT)), name) for page in own for name in names_on(page)})


def names_on(page: Path) -> set[str]:
    """Return the dotted names of a page."""
    return {name for line in outside_code(page) for name in NAMED.findall(line)} - FILES


def find(name: str) -> object:
    """Return what a dotted name names: a module, or what is in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


def test_what_a_page_names_is_there():
    for page, name in named():
        assert find(name) is not None, page
