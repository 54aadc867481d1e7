"""``--touches``: which touches a bundle must know."""

import argparse
from typing import Final

from eitskin_proto.skin.touch_kind import TouchKind

WAYS: Final[dict[str, TouchKind]] = {"lower": "lowering", "raise": "raising"}
"""What is said -> which way touches change conductance."""


def add_touches(parser: argparse.ArgumentParser, default: str, what: str = "touches that the bundle must know") -> None:
    """Declare ``--touches``.

    Args:
        parser: Of the command.
        default: What holds where nothing is said.
        what: What is said.
    """
    parser.add_argument(
        "--touches",
        choices=tuple(WAYS),
        help=f"{what}: lower conductance, as a finger's press on a hydrogel, or raise it, as the paper's touches "
        f"(default: {default})",
    )


def chosen(arguments: argparse.Namespace) -> TouchKind | None:
    """Return which way the touches that were asked for change conductance; None where nothing was said."""
    return None if arguments.touches is None else WAYS[arguments.touches]
