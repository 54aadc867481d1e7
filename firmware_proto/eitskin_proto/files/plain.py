r"""Makes texts from a device, a file or a network safe to print in a terminal.

A terminal executes escape sequences: they move its cursor, set its title, or type for its user. A line break forges a
line of a log, and marks of writing direction reverse a sentence. Such characters are made visible instead::

    ESC [ 2 J   is shown as   \x1b[2J
"""

import unicodedata
from typing import Final

UNFIT: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode categories of characters that are not shown as themselves: controls (C0, C1, DEL), formats (writing
direction, zero width), halves of pairs, private and unassigned ones, separators of lines and paragraphs."""

LONGEST_SHOWN: Final = 80
"""Characters of a value that a message quotes."""


def plain(text: str) -> str:
    r"""Return a text on one line with every character that a terminal could obey shown as ``\\xNN`` or ``\\uNNNN``."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(character if _is_fit(character) else _shown(character) for character in text)


def quoted(value: object) -> str:
    """Return a value as a message quotes it: as ``repr`` gives it, fit for a terminal, and cut off where it is long.

    Args:
        value: As a file's parser gave it; lists and objects are told by their size.
    """
    if isinstance(value, list | tuple | dict | set):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    if isinstance(value, int) and abs(value) >= 10**20:
        return f"a number of {value.bit_length()} bits"
    text = plain(repr(value[: LONGEST_SHOWN + 1] if isinstance(value, str | bytes) else value))
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def stated(value: object) -> str:
    """Return a value as :func:`quoted` does, a text without its quotation marks."""
    return quoted(value)[1:-1] if isinstance(value, str) and len(value) < LONGEST_SHOWN - 2 else quoted(value)


def _is_fit(character: str) -> bool:
    return unicodedata.category(character) not in UNFIT


def _shown(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
