"""Unpacks messages of any origin within bounds, as data only."""

from typing import Any, Final

import msgpack  # type: ignore[import-untyped]

from eitskin.errors import FrameError
from eitskin_proto.fields import Fields

LARGEST_BODY: Final = 32 * 65_535
"""Bytes."""


def unpacked(
    message: bytes,
    what: str,
    *,
    largest: int = LARGEST_BODY,
    longest_text: int = 1024,
    longest_list: int = 256,
    longest_map: int = 256,
    error: type[Exception] = FrameError,
) -> dict[str, Any]:
    """Return the MessagePack map of a message.

    Args:
        message: As it came.
        what: The expected kind, for people: ``a frame``.
        largest: Bytes.
        longest_text: Bytes of a text.
        longest_list: Items of a list.
        longest_map: Keys of a map.
        error: Class of the errors raised.

    Raises:
        FrameError: It is too large, or no map with texts as keys; or else of class ``error``.
    """
    if len(message) > largest:
        raise error(f"a message of {len(message)} bytes is not {what}, expected at most {largest}")
    try:
        found = msgpack.unpackb(
            message, raw=False, strict_map_key=True, max_str_len=longest_text, max_bin_len=largest,
            max_array_len=longest_list, max_map_len=longest_map, max_ext_len=0,
        )  # fmt: skip
    except Exception as cause:  # msgpack's exceptions have no common base
        raise error(f"a message of {len(message)} bytes is not {what} ({type(cause).__name__})") from cause
    if not isinstance(found, dict):
        raise error(f"a message is not {what}: found {type(found).__name__}, expected a map")
    return found


def fields_of(body: bytes, what: str) -> Fields:
    """Return the fields of a body of any origin; faults in them raise :class:`FrameError`.

    Args:
        body: As it came.
        what: The expected kind, for people: ``stream wire``.
    """
    return Fields(unpacked(body, what), what, error=FrameError, joint=", ")


def require(fields: Fields, *keys: str) -> None:
    """Refuse fields that lack one of these keys; a list that is missing would read as an empty one."""
    for key in keys:
        fields.value(key)
