"""``eitskin`` within this process, as ``main`` of a command: what it says must be lines for people."""

from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from eitskin_proto.errors import SkinError


class Refused(SkinError):
    """A command ended with status 1 and a line that says why."""


def commanded(folder: Path, *words: str) -> None:
    """Run a command.

    Args:
        folder: For what it says.
        words: Of the command.

    Raises:
        Refused: It ended with status 1, and a line.
        AssertionError: It said something else than lines for people, or ran out of memory.
    """
    from eitskin_tools.cli import main

    with (folder / "said").open("w+") as said, (folder / "shown").open("w+") as shown:
        with redirect_stderr(said), redirect_stdout(shown):
            status = main(words)
        for file in (said, shown):
            file.seek(0)
        lines, results = said.read().splitlines(), shown.read().splitlines()
    for line in (*lines, *results):
        if not line.isprintable():
            raise AssertionError(f"a line that a terminal could obey: {line[:200]!r}")
    if status == 0 or (status == 1 and results):
        return
    last = lines[-1] if lines else ""
    if status != 1 or not last.startswith(f"eitskin {words[0]}: ") or "enough memory" in last:
        raise AssertionError(f"{words[0]} ended with {status} and said {last[:200]!r}")
    raise Refused(last)
