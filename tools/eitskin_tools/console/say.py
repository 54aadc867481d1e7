"""Prints lines whose parts came from a device, a file or a network: what a terminal would obey is shown instead."""

import sys

from eitskin_proto.files.plain import plain


def say(line: str, *, error: bool = False) -> None:
    """Print one line.

    Args:
        line: What to print.
        error: On stderr instead of stdout.
    """
    stream = sys.stderr if error else sys.stdout
    print(plain(line), file=stream, flush=stream.isatty())


def note(line: str) -> None:
    """Print one line on stderr, of what goes on."""
    say(line, error=True)
