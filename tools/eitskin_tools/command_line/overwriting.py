"""A file that a command reads is not the one that it writes: a recording would be lost for its own maps."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from eitskin_tools.errors import UsageError

WRITTEN: Final = ("out", "plot", "picture", "record", "log", "wire_times")
"""Arguments that name what is written."""

GROWS: Final[dict[str, tuple[str, ...]]] = {
    "card": ("bundle",), "pair": ("bundle",), "reference": ("against",),
}  # fmt: skip
"""Command -> what it reads and may write anew: nothing of it is lost, or that is what was asked for."""


def check(arguments: argparse.Namespace) -> None:
    """Refuse a command that would write over what it reads, or twice to one file, before it does anything.

    Raises:
        UsageError: It would.
    """
    given = vars(arguments)
    written = [name for name in WRITTEN if isinstance(given.get(name), str | Path)]
    if given.get("guided"):
        written.append("recording")
    for index, name in enumerate(written):
        target = Path(given[name])
        for other in written[:index]:
            if _same(target, Path(given[other])):
                raise UsageError(f"{_option(name)} and {_option(other)} name one file, {target}; name two")
        left_out = (*written, *GROWS.get(arguments.command, ()))
        for path in (path for other, value in given.items() if other not in left_out for path in _paths(value)):
            if path.is_file() and _same(target, path):
                raise UsageError(f"{_option(name)} {target} is read too, and would be lost; name another file")


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, str | Path):
        yield Path(value)
    elif isinstance(value, list | tuple):
        yield from (Path(one) for one in value if isinstance(one, str | Path))


def _same(first: Path, second: Path) -> bool:
    """Return whether two names are of one file, there or to be made."""
    try:
        return first.samefile(second)
    except (OSError, ValueError):
        return first.absolute() == second.absolute()


def _option(name: str) -> str:
    return "FILE" if name == "recording" else f"--{name.replace('_', '-')}"
