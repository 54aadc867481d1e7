"""A table of a TOML file that is taken apart key by key; what is left over at the end is an error."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eitskin_proto.files.plain import plain, quoted
from eitskin_proto.files.reading import is_whole
from eitskin_proto.skin.toml import unknown

LONGEST_TEXT = 512


class Table:
    """One table.

    Args:
        content: As the parser gave it.
        where: What messages call it.
    """

    def __init__(self, content: dict[str, Any], where: str) -> None:
        self._content, self._asked = content, list[str]()
        self.where = where

    def take(self, key: str) -> Any:
        """Return a value, whatever it is; None where the key is left out."""
        self._asked.append(key)
        return self._content.get(key)

    def only(self, known: Sequence[str]) -> None:
        """Raise ValueError if there is another key than those that are known, with the nearest one."""
        unknown(self._content, list(known), self.where)

    def end(self) -> None:
        """Raise ValueError if a key was never asked for, with the nearest one that was."""
        unknown(self._content, self._asked, self.where)

    def table(self, key: str) -> "Table | None":
        """Return a table within this one."""
        value = self.take(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self._wrong(key, value, "a table")
        return Table(value, f"{self.where} {key}")

    def text(self, key: str) -> str | None:
        """Return a text on one line."""
        value = self.take(key)
        if value is not None and (
            not isinstance(value, str) or not 0 < len(value) <= LONGEST_TEXT or plain(value) != value
        ):
            raise self._wrong(key, value, f"a text of at most {LONGEST_TEXT} printable characters")
        return value

    def one_of(self, key: str, names: Sequence[str]) -> str | None:
        """Return one of some words."""
        value = self.take(key)
        if value is not None and value not in names:
            raise self._wrong(key, value, f"one of {', '.join(names)}")
        return None if value is None else str(value)

    def path(self, key: str, beside: Path) -> Path | None:
        """Return a path; a relative one lies beside the file."""
        value = self.text(key)
        return None if value is None else beside / Path(value).expanduser()

    def number(self, key: str) -> float | None:
        """Return a number above 0."""
        value = self.take(key)
        if value is not None and (
            isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e9 or math.isnan(value)
        ):
            raise self._wrong(key, value, "a number above 0")
        return None if value is None else float(value)

    def whole(self, key: str, least: int, most: int) -> int | None:
        """Return a whole number."""
        value = self.take(key)
        if value is not None and (not is_whole(value) or not least <= value <= most):
            raise self._wrong(key, value, f"a whole number from {least} to {most}")
        return None if value is None else int(value)

    def wholes(self, key: str, most: int) -> tuple[int, ...]:
        """Return a list of whole numbers from 0 on; none where the key is left out."""
        value = self.take(key)
        if value is None:
            return ()
        if not isinstance(value, list) or not all(is_whole(one) and 0 <= one <= most for one in value):
            raise self._wrong(key, value, f"a list of whole numbers from 0 to {most}")
        return tuple(value)

    def truth(self, key: str) -> bool | None:
        """Return true or false."""
        value = self.take(key)
        if value is not None and not isinstance(value, bool):
            raise self._wrong(key, value, "true or false")
        return value

    def _wrong(self, key: str, value: object, expected: str) -> ValueError:
        return ValueError(f"{self.where} {key} is {quoted(value)}, expected {expected}")
