"""The fields of a stream's body, each checked before it is believed."""

import math
from collections.abc import Mapping
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin.errors import FrameError

LARGEST_BODY: Final = 32 * 65_535
"""Bytes."""

MAX_TEXT: Final = 256
"""Characters."""

MAX_LIST: Final = 256
"""Items of a list, and keys of a map."""

DEEPEST: Final = 4
"""Lists and maps within each other, of what a runtime says of itself."""

_MISSING: Final = object()


class Fields:
    """The fields of one body.

    Args:
        name: Of the stream.
        body: Of any origin.

    Raises:
        FrameError: It is too large, or no MessagePack map.
    """

    __slots__ = ("_name", "_values")

    def __init__(self, name: str, body: bytes) -> None:
        self._name = name
        if len(body) > LARGEST_BODY:
            raise FrameError(f"stream {name}: a body of {len(body)} bytes; expected at most {LARGEST_BODY}")
        try:
            values = msgpack.unpackb(
                body, raw=False, strict_map_key=True, max_str_len=4 * MAX_TEXT, max_bin_len=LARGEST_BODY,
                max_array_len=MAX_LIST, max_map_len=MAX_LIST, max_ext_len=0,
            )  # fmt: skip
        except Exception as error:  # msgpack's exceptions have no common base
            raise FrameError(
                f"stream {name}: a body of {len(body)} bytes is no map ({type(error).__name__})"
            ) from error
        if not isinstance(values, dict):
            raise FrameError(f"stream {name}: a body holds {type(values).__name__}, expected a map")
        self._values: Mapping[str, Any] = values

    def wrong(self, key: str, expected: str) -> FrameError:
        """Return what is raised for a field."""
        value = self._values.get(key, _MISSING)
        found = "nothing" if value is _MISSING else f"{type(value).__name__} {str(value)[:40]!r}"
        return FrameError(f"stream {self._name}, {key}: found {found}, expected {expected}")

    def is_nil(self, key: str) -> bool:
        """Return whether a field is there, and nil."""
        return self._values.get(key, _MISSING) is None

    def count(self, key: str) -> int:
        """Return a whole number, 0 or more."""
        value = self._values.get(key)
        if type(value) is not int or not 0 <= value < 1 << 63:
            raise self.wrong(key, "a count")
        return value

    def count_or_none(self, key: str) -> int | None:
        """Return the same, or None for nil."""
        return None if self.is_nil(key) else self.count(key)

    def number(self, key: str) -> float:
        """Return a finite float."""
        value = self._values.get(key)
        if not isinstance(value, float) or not math.isfinite(value):
            raise self.wrong(key, "a finite float")
        return value

    def any_number(self, key: str) -> float:
        """Return a float, finite or not."""
        value = self._values.get(key)
        if not isinstance(value, float):
            raise self.wrong(key, "a float")
        return value

    def truth(self, key: str) -> bool:
        """Return true or false."""
        value = self._values.get(key)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def text(self, key: str) -> str:
        """Return a text."""
        value = self._values.get(key)
        if not isinstance(value, str) or len(value) > MAX_TEXT:
            raise self.wrong(key, f"a text of at most {MAX_TEXT} characters")
        return value

    def raw(self, key: str, most: int = LARGEST_BODY, least: int = 0) -> bytes:
        """Return bytes."""
        value = self._values.get(key)
        if not isinstance(value, bytes) or not least <= len(value) <= most:
            raise self.wrong(key, f"{least} to {most} bytes" if least else f"at most {most} bytes")
        return value

    def array(self, key: str, kind: str, shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """Return numbers of a shape, finite and read-only."""
        raw, dtype = self._values.get(key), np.dtype(kind)
        size = math.prod(shape) * dtype.itemsize
        if not isinstance(raw, bytes) or len(raw) != size:
            raise self.wrong(key, f"{size} bytes of {kind} {shape}")
        values = np.frombuffer(raw, dtype=dtype).reshape(shape)
        if not np.isfinite(values).all():
            raise FrameError(f"stream {self._name}, {key}: holds values that are not finite")
        return values

    def array_or_none(self, key: str, kind: str, shape: tuple[int, ...]) -> npt.NDArray[Any] | None:
        """Return the same, or None for nil."""
        return None if self.is_nil(key) else self.array(key, kind, shape)

    def items(self, key: str, most: int) -> list[Any]:
        """Return a list of any items."""
        value = self._values.get(key)
        if not isinstance(value, list) or len(value) > most:
            raise self.wrong(key, f"a list of at most {most}")
        return value

    def counts(self, key: str, most: int, below: int) -> tuple[int, ...]:
        """Return a list of whole numbers below a bound."""
        found = self.items(key, most)
        if not all(type(value) is int and 0 <= value < below for value in found):
            raise self.wrong(key, f"numbers from 0 to {below - 1}")
        return tuple(found)

    def texts(self, key: str, most: int) -> tuple[str, ...]:
        """Return a list of texts."""
        found = self.items(key, most)
        if not all(isinstance(value, str) and len(value) <= MAX_TEXT for value in found):
            raise self.wrong(key, f"texts of at most {MAX_TEXT} characters")
        return tuple(found)

    def plain(self, key: str) -> dict[str, Any]:
        """Return a map of plain values: texts, numbers, lists and maps of them, nothing binary."""
        value = self._values.get(key)
        if not isinstance(value, dict) or not _is_plain(value, DEEPEST):
            raise self.wrong(key, "a map of plain values")
        return value


def _is_plain(value: object, depth: int) -> bool:
    if value is None or isinstance(value, bool | int):
        return True
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, str):
        return len(value) <= MAX_TEXT
    if depth and isinstance(value, list):
        return all(_is_plain(item, depth - 1) for item in value)
    if depth and isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(item, depth - 1) for key, item in value.items())
    return False
