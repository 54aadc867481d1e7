"""What a page may ask for besides its files and the stream."""

from typing import Final, Protocol

PART: Final = "/part/"
"""How the paths of parts of a recording begin; a number follows."""

ACTIONS: Final = ("/record/start", "/record/stop")
"""What a page may ask for, by POST without a body."""


class Actions(Protocol):
    """What starts and stops recordings."""

    def start(self) -> str:
        """Begin; return "" or why not."""
        ...

    def stop(self) -> str:
        """End; return "" or why not."""
        ...


class Parts(Protocol):
    """A recording in parts."""

    @property
    def parts(self) -> int:
        """How many there are."""
        ...

    def part(self, number: int) -> bytes:
        """Return the messages of one."""
        ...
