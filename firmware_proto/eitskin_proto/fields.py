"""The entries of a table or an object from outside, each checked as it is read.

TOML, JSON and MessagePack give tables, lists and plain values of any kind. A :class:`Fields` reads one table key by
key; each method says which kind and which bounds it expects, and :meth:`Fields.close` refuses keys that were not read.
Every error is one line that names the key, what was found and what was expected::

    [layer] thickness_mm is 200.0, expected a number from 0.05 to 20
    skin left-arm lacks port, expected a text of at most 512 printable characters
    unknown key 'thicknes_mm' in [layer]; did you mean 'thickness_mm'?

A list reads like a table whose keys are 0, 1, 2 and so on, so that lists of tables and lists of lists need no extra
code.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final, TypeVar

from eitskin_proto.files.plain import plain, quoted

if TYPE_CHECKING:
    import numpy.typing as npt

REQUIRED: Final[Any] = object()
"""The default of a key that must be there."""

LONGEST_TEXT: Final = 512
"""Characters of a text, unless the caller gives another bound."""

SIMILARITY: Final = 0.65
"""Share of letters that a suggested name must have in common with the key found; ``file`` has 0.6 of ``single``."""

Default = TypeVar("Default")
Key = str | int


class Fields:
    """The entries of one table, object or list.

    Args:
        content: As the parser gave it.
        where: Its name in messages: ``[layer]``, ``scene.sheet``; empty for a whole file.
        error: Class of the errors raised.
        joint: Text between ``where`` and a key in messages.

    Raises:
        ValueError: ``content`` is not a table; here and below the error is of class ``error``.
    """

    __slots__ = ("_content", "_error", "_joint", "_read", "where")

    def __init__(self, content: object, where: str, *, error: type[Exception] = ValueError, joint: str = " ") -> None:
        if not isinstance(content, dict):
            raise error(f"{where or 'the file'} is {quoted(content)}, expected a table")
        self._content: dict[Any, Any] = content
        self._error, self._joint = error, joint
        self._read: dict[Key, None] = {}
        self.where = where

    def __contains__(self, key: Key) -> bool:
        return key in self._content

    def __iter__(self) -> Iterator[Any]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    def close(self) -> None:
        """Refuse a key that was never read, with the nearest one that was."""
        self.only(str(key) for key in self._read)

    def only(self, known: Iterable[str]) -> None:
        """Refuse a key that is not among the known ones, with the nearest one that is."""
        names = list(known)
        for key in self._content:
            if key not in names:
                meant = did_you_mean(str(key), names) or f"; known are {', '.join(names)}"
                raise self._error(f"unknown key {quoted(key)} in {self.where or 'the file'}{meant}")

    def check_format(self, expected: str, version: int, what: str) -> None:
        """Refuse content whose ``format`` and ``version`` are not the expected ones.

        Args:
            expected: Format.
            version: Of the format.
            what: Such content describes, as ``a skin's description``.
        """
        found = self.value("format", None), self.value("version", None)
        if found != (expected, version):
            named = f"{quoted(found[0])} version {quoted(found[1])}"
            raise self._error(f"format is {named}, expected {expected!r} version {version}: is it {what}?")

    def path(self, key: Key) -> str:
        """Return a key's name in messages."""
        if isinstance(key, int):
            return f"{self.where}[{key}]"
        return f"{self.where}{self._joint}{plain(key)}" if self.where else plain(key)

    def wrong(self, key: Key, expected: str) -> Exception:
        """Return the error for a key that holds something else, or is missing."""
        if key not in self._content:
            near = did_you_mean(str(key), map(str, self._content)).replace("did you mean", "is it meant by")
            return self._error(f"{self.where or 'the file'} lacks {key}, expected {expected}{near}")
        value = self._content[key]
        found = f"{len(value)} bytes" if isinstance(value, bytes) else quoted(value)
        return self._error(f"{self.path(key)} is {found}, expected {expected}")

    def value(self, key: Key, default: Any = REQUIRED) -> Any:
        """Return a value of any kind."""
        self._read[key] = None
        if key not in self._content and default is REQUIRED:
            raise self.wrong(key, "a value")
        return self._content.get(key, default)

    def is_nil(self, key: Key) -> bool:
        """Return whether a key is there without a value: JSON's null, MessagePack's nil."""
        self._read[key] = None
        return self._content.get(key, REQUIRED) is None

    def truth(self, key: Key, default: Default = REQUIRED) -> bool | Default:
        """Return true or false."""
        if self._defaults(key, default):
            return default
        value = self._content.get(key)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def number(
        self,
        key: Key,
        default: Default = REQUIRED,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float | None = None,
    ) -> float | Default:
        """Return a finite number from ``low`` to ``high``, or larger than ``above``."""
        if self._defaults(key, default):
            return default
        found = _finite(self._content.get(key))
        if found is None or not low <= found <= high or (above is not None and found <= above):
            raise self.wrong(key, f"a number{_bounds(low, high, above)}")
        return found

    def whole(self, key: Key, default: Default = REQUIRED, *, low: float = 0, high: float = math.inf) -> int | Default:
        """Return a whole number from ``low`` to ``high``; 3.0 is none."""
        if self._defaults(key, default):
            return default
        value = self._content.get(key)
        if type(value) is not int or not low <= value <= high:
            raise self.wrong(key, f"a whole number{_bounds(low, high)}")
        return value

    def text(
        self, key: Key, default: Default = REQUIRED, *, longest: int = LONGEST_TEXT, least: int = 1, what: str = ""
    ) -> str | Default:
        """Return a text on one line that a terminal shows as it is; ``what`` says in messages what it names."""
        if self._defaults(key, default):
            return default
        value = self._content.get(key)
        if value == "" and least:
            raise self._error(f"{self.path(key)} is empty, expected {what or 'a text'}")
        if not isinstance(value, str) or not least <= len(value) <= longest or plain(value) != value:
            raise self.wrong(key, f"{what or 'a text'} of at most {longest} printable characters")
        return value

    def choice(self, key: Key, names: Sequence[str], default: Default = REQUIRED) -> str | Default:
        """Return one of some words."""
        if self._defaults(key, default):
            return default
        value = self._content.get(key)
        if not isinstance(value, str) or value not in names:
            near = did_you_mean(value, names) if isinstance(value, str) else ""
            raise self.wrong(key, f"one of {', '.join(names)}{near}")
        return value

    def table(self, key: Key, where: str | None = None) -> "Fields":
        """Return the entries of a table within this one; of an empty one where the key is missing.

        Args:
            key: Of the table.
            where: Its name in messages; None for the path of its key.
        """
        value = self.value(key, {})
        if not isinstance(value, dict):
            raise self.wrong(key, "a table")
        return Fields(value, self.path(key) if where is None else where, error=self._error, joint=self._joint)

    def entries(self, key: Key, *, least: int = 0, most: float = math.inf, of: str = "entries") -> "Fields":
        """Return the items of a list by their place; of an empty one where the key is missing.

        Args:
            key: Of the list.
            least: Fewest items.
            most: Most items.
            of: Their name in messages.
        """
        value = self.value(key, [])
        if not isinstance(value, list | tuple) or not least <= len(value) <= most:
            raise self.wrong(key, f"a list of {_count(least, most)}{of}")
        return Fields(dict(enumerate(value)), self.path(key), error=self._error, joint=self._joint)

    def numbers(
        self, key: Key, count: int, default: Default = REQUIRED, *, low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, ...] | Default:
        """Return the given number of finite numbers."""
        if self._defaults(key, default):
            return default
        items = self.entries(key, least=count, most=count, of="numbers")
        return tuple(items.number(place, low=low, high=high) for place in items)

    def wholes(
        self,
        key: Key,
        default: Default = REQUIRED,
        *,
        low: float = 0,
        high: float = math.inf,
        least: int = 0,
        most: float = math.inf,
    ) -> tuple[int, ...] | Default:
        """Return a list of whole numbers."""
        if self._defaults(key, default):
            return default
        items = self.entries(key, least=least, most=most, of="whole numbers")
        return tuple(items.whole(place, low=low, high=high) for place in items)

    def texts(
        self, key: Key, default: Default = REQUIRED, *, most: float = math.inf, longest: int = LONGEST_TEXT
    ) -> tuple[str, ...] | Default:
        """Return a list of texts."""
        if self._defaults(key, default):
            return default
        items = self.entries(key, most=most, of="texts")
        return tuple(items.text(place, longest=longest) for place in items)

    def raw(self, key: Key, *, least: int = 0, most: int) -> bytes:
        """Return the bytes of a MessagePack field."""
        self._read[key] = None
        value = self._content.get(key)
        if not isinstance(value, bytes) or not least <= len(value) <= most:
            raise self.wrong(key, f"{least} to {most} bytes")
        return value

    def array(self, key: Key, kind: str, shape: tuple[int, ...]) -> "npt.NDArray[Any]":
        """Return the finite numbers of a MessagePack field, read-only.

        Args:
            key: Of the field.
            kind: NumPy's name of the numbers' type, with the order of bytes.
            shape: Of the array.
        """
        import numpy as np  # noqa: PLC0415 -- a command's help needs none

        size = math.prod(shape) * np.dtype(kind).itemsize
        self._read[key] = None
        value = self._content.get(key)
        if not isinstance(value, bytes) or len(value) != size:
            raise self.wrong(key, f"{size} bytes of {kind} {shape}")
        found = np.frombuffer(value, dtype=kind).reshape(shape)
        if not np.isfinite(found).all():
            raise self._error(f"{self.path(key)} holds values that are not finite, expected finite numbers")
        return found

    def _defaults(self, key: Key, default: object) -> bool:
        """Return whether a key takes its default: it is missing and need not be there."""
        self._read[key] = None
        return default is not REQUIRED and key not in self._content


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Return ``; did you mean 'bench'?`` for the nearest name, and nothing where none is near.

    Args:
        word: What was found.
        names: What there is.
    """
    by_lower = {name.lower().lstrip("-"): name for name in names}  # dashes would make short options look alike
    near = get_close_matches(word.lower().lstrip("-"), by_lower, n=1, cutoff=SIMILARITY)
    return f"; did you mean {by_lower[near[0]]!r}?" if near else ""


def _finite(value: object) -> float | None:
    """Return a finite number as a float, and None for everything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


def _bounds(low: float, high: float, above: float | None = None) -> str:
    """Return how a message states bounds."""
    if above is not None:
        return f" above {above:g}" if high == math.inf else f" above {above:g}, at most {_shown(high)}"
    if high < math.inf:
        return f" from {_shown(low)} to {_shown(high)}" if low > -math.inf else f" of at most {_shown(high)}"
    return f" of at least {_shown(low)}" if low > -math.inf else ""


def _count(least: int, most: float) -> str:
    """Return how a message states the length of a list."""
    if least == most:
        return f"{least} "
    if most < math.inf:
        return f"{least} to {_shown(most)} "
    return f"at least {least} " if least else ""


def _shown(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:g}"
