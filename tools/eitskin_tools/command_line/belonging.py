"""Options that belong to some ways of using a command only: where they do nothing they are refused, not ignored."""

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from eitskin_tools.errors import UsageError


@dataclass(frozen=True, slots=True)
class Own:
    """An option whose default is None where it is declared."""

    usual: Any
    """What holds where nothing was said."""
    ways: tuple[str, ...]
    """In which ways of using the command it does something."""
    elsewhere: Mapping[str, Any] = field(default_factory=dict)
    """What holds instead in some of these ways."""


def settle(arguments: argparse.Namespace, way: str, options: Mapping[str, Own]) -> None:
    """Give every option what holds where nothing was said, and refuse those that would do nothing.

    Args:
        arguments: They are changed.
        way: In which way the command is used, by the option that says so.
        options: By their names in ``arguments``.

    Raises:
        UsageError: One was named that does nothing in this way.
    """
    for name, own in options.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, own.elsewhere.get(way, own.usual))
        elif way not in own.ways:
            raise UsageError(
                f"{flag(name)} does nothing with {flag(way)}: leave it out; it belongs to {_listed(own.ways)}"
            )


def flag(name: str) -> str:
    """Return an argument's name as it is typed."""
    return f"--{name.replace('_', '-')}"


def _listed(names: Iterable[str]) -> str:
    *first, last = (flag(name) for name in names)
    return f"{', '.join(first)} and {last}" if first else last
