"""The parts of a received frame that take more than a look at a type: the map of fields, the map, the regions."""

import operator
from collections.abc import Mapping
from typing import Any

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin.errors import FrameError
from eitskin.messaging.regions import MOST, MOST_PIXELS, Region, Regions, whole


def strict_map(message: bytes, largest: int, largest_bin: int, longest_list: int) -> dict[str, Any]:
    """Return the fields of a message of any origin.

    Args:
        message: As it came.
        largest: Bytes of a message that is looked at.
        largest_bin: Bytes of the largest bin in it.
        longest_list: Items of the longest list.

    Raises:
        FrameError: It is too large, or no MessagePack map.
    """
    if len(message) > largest:
        raise FrameError(f"a message of {len(message)} bytes is no frame; expected at most {largest}")
    try:
        fields = msgpack.unpackb(
            message, raw=False, strict_map_key=True, max_str_len=256, max_bin_len=largest_bin,
            max_array_len=longest_list, max_map_len=64, max_ext_len=0,
        )  # fmt: skip
    except (
        Exception
    ) as error:  # msgpack's exceptions have no common base: ValueError, StackError, UnicodeDecodeError, ...
        raise FrameError(f"a message of {len(message)} bytes is no frame ({type(error).__name__})") from error
    if not isinstance(fields, dict):
        raise FrameError(f"a message is no frame: found {type(fields).__name__}, expected a map")
    return fields


def map_of(fields: Mapping[str, Any]) -> npt.NDArray[np.float32]:
    """Return the map, (rows, columns) and read-only, of a message's fields.

    Raises:
        FrameError: It is malformed, or not finite.
    """
    shape, raw = fields.get("shape"), fields.get("map")
    if not isinstance(shape, list) or len(shape) != 2 or not all(map(_is_size, shape, MOST_PIXELS)):
        raise FrameError(f"frame shape: found {str(shape)[:40]}, expected [rows, columns] up to {list(MOST_PIXELS)}")
    if not isinstance(raw, bytes) or len(raw) != 4 * shape[0] * shape[1]:
        raise FrameError(f"frame map: expected {4 * shape[0] * shape[1]} bytes")
    values = np.frombuffer(raw, dtype="<f4").reshape(shape)  # of immutable bytes: read-only
    if not np.isfinite(values).all():
        raise FrameError("frame map: holds values that are not finite")
    return values


def _is_size(value: object, most: int) -> bool:
    return type(value) is int and 1 <= value <= most


def regions_of(fields: Mapping[str, Any], shape: tuple[int, int]) -> Regions:
    """Return what a message says was computed.

    Args:
        fields: Of the message.
        shape: Rows and columns of the map.

    Raises:
        FrameError: It is malformed, or not on the map.
    """
    found = fields.get("regions")
    if found is None:
        return whole(shape)
    try:
        regions = tuple(Region(*map(operator.index, bounds)).check(shape) for bounds in found)
    except (TypeError, ValueError) as error:
        raise FrameError(f"frame regions: found {str(found)[:60]}, expected rectangles on the sheet") from error
    if not 1 <= len(regions) <= MOST:
        raise FrameError(f"frame regions: found {len(regions)}, expected 1 to {MOST}")
    return regions
