"""A run of tests leaves nothing in the temporary directory.

Each worker's temporary directory is a folder of its own, for its children, too. Whoever leaves something there is named
at the end: the test after which it was first seen.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

NOT_OURS: Final = (".ses", "torchinductor_", "pytest-of-")
"""How names begin of what is not ours: a file of onnxruntime, a cache of torch, the folder of a pytest in a test."""


class Leftovers:
    """What lies in a folder, and since when.

    Args:
        folder: Where nothing should stay.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._first_seen: dict[str, str] = {}

    def look(self, test: str) -> None:
        """Note what is there now; what is new is the test's."""
        for name in self._names():
            self._first_seen.setdefault(name, test)

    def left(self) -> list[str]:
        """Return one line for each thing that is still there."""
        return [f"{name}, first seen after {self._first_seen.get(name, 'the last test')}" for name in self._names()]

    def _names(self) -> list[str]:
        return sorted(name for name in os.listdir(self.folder) if not name.startswith(NOT_OURS))


@contextmanager
def temporary_directory(folder: str) -> Iterator[None]:
    """Make a folder the temporary directory of this process and of those that it starts."""
    before = os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = folder
    tempfile.tempdir = None
    try:
        yield
    finally:
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before
        tempfile.tempdir = None
