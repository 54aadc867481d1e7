"""JSON objects read strictly: no unknown key, no repeated key, no number that is not finite, each error with its path.

The scene's parser asks a :class:`Fields` for one key at a time, then closes it; whatever was not asked for is unknown.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import FileError, parse_json

MOST_NAMED: Final = 8
"""Unknown keys that a message names."""


class SceneError(SkinError, ValueError):
    """A scene that is no scene: what was found, what was expected, and where."""


class Fields:
    """The keys of one JSON object, taken one by one.

    Args:
        value: The object as ``json`` gives it.
        where: Its path from the root, for messages.
    """

    def __init__(self, value: object, where: str) -> None:
        if not isinstance(value, dict):
            raise SceneError(f"{where}: found {_kind(value)}, expected an object")
        self._rest = dict(value)
        self._known: list[str] = []
        self.where = where

    def take(self, key: str, default: Any) -> Any:
        """Return the value of a key, or the default where it is missing."""
        self._known.append(key)
        return self._rest.pop(key, default)

    def number(
        self,
        key: str,
        default: float,
        *,
        above: float | None = None,
        low: float | None = None,
        high: float | None = None,
    ) -> float:
        """Return a finite number within its bounds: ``above`` exclusive, ``low`` and ``high`` inclusive."""
        return number(self.take(key, default), f"{self.where}.{key}", above=above, low=low, high=high)

    def __contains__(self, key: str) -> bool:
        return key in self._rest

    def close(self) -> None:
        """Raise SceneError if a key is left that nobody asked for."""
        if self._rest:
            unknown = ", ".join(quoted(key) for key in sorted(map(str, self._rest))[:MOST_NAMED])
            raise SceneError(f"{self.where}: unknown key {unknown}; known keys are {', '.join(self._known)}")


def number(
    value: object, where: str, *, above: float | None = None, low: float | None = None, high: float | None = None
) -> float:
    """Return a finite number within its bounds: ``above`` exclusive, ``low`` and ``high`` inclusive."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SceneError(f"{where}: found {_kind(value)}, expected a number")
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not math.isfinite(found):
        raise SceneError(f"{where} is {found}; it must be finite")
    if above is not None and not found > above:
        raise SceneError(f"{where} is {found:g}; it must be above {above:g}")
    if low is not None and found < low:
        raise SceneError(f"{where} is {found:g}; it must be at least {low:g}")
    if high is not None and found > high:
        raise SceneError(f"{where} is {found:g}; it must be at most {high:g}")
    return found


def numbers(value: object, where: str, count: int | None = None) -> tuple[float, ...]:
    """Return a list of finite numbers, of a given length where one is given."""
    items = sequence(value, where)
    if count is not None and len(items) != count:
        raise SceneError(f"{where} has {len(items)} numbers; it must have {count}")
    return tuple(number(item, f"{where}[{i}]") for i, item in enumerate(items))


def sequence(value: object, where: str, most: int | None = None) -> Sequence[object]:
    """Return a list, of at most so many items where a bound is given."""
    if not isinstance(value, list | tuple):
        raise SceneError(f"{where}: found {_kind(value)}, expected a list")
    if most is not None and len(value) > most:
        raise SceneError(f"{where} has {len(value)} items; it must have at most {most}")
    return value


def loads(text: str, where: str) -> object:
    """Return what a JSON text says; a repeated key, NaN or Infinity is an error."""

    def pairs(items: list[tuple[str, object]]) -> dict[str, object]:
        found: dict[str, object] = {}
        for key, value in items:
            if key in found:
                raise SceneError(f"{where}: key {quoted(key)} stands twice in one object")
            found[key] = value
        return found

    def constant(name: str) -> object:
        raise SceneError(f"{where}: {name} is not a number that a scene can hold")

    try:
        return parse_json(text, object_pairs_hook=pairs, parse_constant=constant)
    except FileError as error:
        raise SceneError(f"{where} {error}") from error


def _kind(value: object) -> str:
    if value is None:
        return "null"
    names = {bool: "a truth value", str: "a string", dict: "an object", list: "a list"}
    return f"{names.get(type(value), 'a number')} ({quoted(value)})"
