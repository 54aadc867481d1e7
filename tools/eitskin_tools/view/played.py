"""A recording as something to look at: ``eitskin replay`` in a process of its own, over and over."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from eitskin_tools.processes.children import Child, process_group

READY_S: Final = 120.0
"""How long a recording's bundle may take to load."""


class Player:
    """A recording that is being played.

    Args:
        child: Who plays it.
        endpoint: Where it is published.
        name: Of the file.
    """

    def __init__(self, child: Child, endpoint: str, name: str) -> None:
        self._child, self.endpoint, self.name = child, endpoint, name

    def wait(self) -> None:
        """Wait for ever.

        Raises:
            ChildDiedError: The player ended, with what it said last.
        """
        while self._child.wait(3600.0) is None:
            pass
        self._child.check()


@contextmanager
def played(file: Path) -> Iterator[Player]:
    """Have a recording played, over and over, for as long as the context is open.

    Raises:
        ChildDiedError: It cannot be played; the text says why.
        TimeoutError: The player was not ready in time.
    """
    with tempfile.TemporaryDirectory(prefix="eitskin-view-") as name, process_group() as children:
        endpoint = f"ipc://{name}/frames"
        words = ["replay", str(file), f"--publish={endpoint}", f"--control=ipc://{name}/control", "--loop", "--quiet"]
        child = Child("replay", "eitskin_tools.cli", words, Path(name))
        children.append(child)
        child.line(child.err, "ready", READY_S)
        yield Player(child, endpoint, file.name)
