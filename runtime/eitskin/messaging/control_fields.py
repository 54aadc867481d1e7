"""What a control message may hold: one MessagePack map of bounded size, data and nothing else."""

from collections.abc import Mapping
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin.errors import ControlError
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER

LARGEST_REQUEST: Final = 32768
"""Bytes to a runtime of the paper's skin; a cloud with both predictions has 18,000. libzmq drops a client that sends
more, before it takes memory."""


def largest_request(grid: Grid) -> int:
    """Return the same for any skin: as much more as its clouds are larger."""
    return LARGEST_REQUEST + 12 * max(0, grid.n_pixels - PAPER.grid.n_pixels)


def unpack_fields(parts: list[bytes], largest: int = LARGEST_REQUEST) -> dict[str, Any]:
    """Return the map of a message.

    Args:
        parts: Of the message.
        largest: Bytes of one field.

    Raises:
        ControlError: It is no map, or too large.
    """
    if len(parts) != 1:
        raise ControlError(f"a message of {len(parts)} parts; expected one")
    try:
        fields = msgpack.unpackb(
            parts[0], raw=False, strict_map_key=True, max_str_len=2048, max_bin_len=largest, max_array_len=64,
            max_map_len=64, max_ext_len=0,
        )  # fmt: skip
    except Exception as error:  # msgpack's exceptions have no common base
        raise ControlError(
            f"a message of {len(parts[0])} bytes is no MessagePack map ({type(error).__name__})"
        ) from error
    if not isinstance(fields, dict):
        raise ControlError(f"a message holds {type(fields).__name__}, expected a map")
    return fields


def array_field(
    request: Mapping[str, Any], name: str, kind: np.dtype[Any], shape: tuple[int, ...]
) -> npt.NDArray[Any] | None:
    """Return an array of a request, or None where the field is missing.

    Args:
        request: The request's fields.
        name: Of the field.
        kind: Of its numbers.
        shape: Expected.

    Raises:
        ControlError: The field has another type or length.
    """
    raw = request.get(name)
    if raw is None:
        return None
    expected = int(np.prod(shape)) * kind.itemsize
    if not isinstance(raw, bytes) or len(raw) != expected:
        found = f"{len(raw)} bytes" if isinstance(raw, bytes) else type(raw).__name__
        raise ControlError(f"{name}: found {found}, expected {expected} bytes of {kind.str} {shape}")
    return np.frombuffer(raw, dtype=kind).reshape(shape)
