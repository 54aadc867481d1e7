"""The messages of a recording that are not bodies of streams: maps and published frames.

===========  =========================================================================================================
frame        JSON; the published frame without its map, whose BLAKE2b of 8 bytes is ``digest``
map          MessagePack: seq, shape (rows, columns), map float32, little-endian
===========  =========================================================================================================

Wire, clouds and conditions are the bodies of their streams, as they came (:mod:`eitskin.messaging.streams`).
"""

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin.messaging.regions import MOST_PIXELS
from eitskin_tools.recording.layout import RecordingError

DIGEST_BYTES: Final = 8
"""Of a map: two maps of a recording of a year are alike by chance once in 10^9."""

LARGEST_JSON: Final = 1 << 16
"""Bytes of a message that is read; a frame's has one thousand."""


def digest_of(values: npt.NDArray[np.float32]) -> str:
    """Return the digest of a map, in hex."""
    plain = np.ascontiguousarray(values, dtype="<f4")
    return hashlib.blake2b(plain.data, digest_size=DIGEST_BYTES).hexdigest()


def pack_map(sequence: int, values: npt.NDArray[np.float32]) -> bytes:
    """Return a map as a message.

    Args:
        sequence: Of the frame that it was computed for.
        values: (rows, columns).
    """
    return bytes(msgpack.packb({"seq": sequence, "shape": list(values.shape), "map": values.astype("<f4").tobytes()}))


def unpack_map(data: bytes) -> tuple[int, npt.NDArray[np.float32]]:
    """Return (sequence, map) of a message.

    Raises:
        RecordingError: It is none.
    """
    try:
        fields = msgpack.unpackb(data, strict_map_key=True)
        rows, columns = (int(side) for side in fields["shape"])
        if not all(0 < side <= most for side, most in zip((rows, columns), MOST_PIXELS, strict=True)):
            raise ValueError(f"its shape is {rows}, {columns}")
        return int(fields["seq"]), np.frombuffer(fields["map"], dtype="<f4").reshape(rows, columns)
    except Exception as error:  # msgpack's exceptions have no common base
        raise RecordingError(f"a map of the recording is damaged: {error}") from error


def pack_json(fields: Mapping[str, Any]) -> bytes:
    """Return an object as JSON; numbers that are none become null."""
    try:
        return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode("utf-8")
    except (ValueError, TypeError):  # rare, and going through every value costs more than packing them
        return json.dumps(_finite(fields), separators=(",", ":")).encode("utf-8")


def unpack_json(data: bytes) -> dict[str, Any]:
    """Return the object of a JSON message.

    Raises:
        RecordingError: It is none.
    """
    if len(data) > LARGEST_JSON:
        raise RecordingError(f"a message of the recording has {len(data)} bytes, expected {LARGEST_JSON} at most")
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"a message of the recording is not JSON: {error}") from error
    if not isinstance(found, dict):
        raise RecordingError("a message of the recording is not a JSON object")
    return found


def note_of(frame: Any) -> dict[str, Any]:
    """Return what is kept of a published frame but for its map.

    Args:
        frame: :class:`eitskin.Frame`.
    """
    return {
        "seq": frame.sequence,
        "number": frame.number,
        "map_seq": frame.map_sequence,
        "fused": frame.fused,
        "touched": frame.touched,
        "gate_logit": frame.gate_logit,
        "solver": frame.solver,
        "cloud": frame.cloud,
        "digest": digest_of(frame.map),
        "peak": float(frame.map.max()) if frame.map.size else 0.0,
        "device_us": frame.device_us,
        "age_us": frame.age_us,
        "latency_us": (frame.received_ns - frame.host_ns["read"]) / 1000 if frame.same_host else None,
        "skipped": list(frame.skipped),
        "events": list(frame.events),
        "electrodes": list(frame.electrodes),
        "drift": frame.drift_percent,
        "drift_sd": frame.drift_sd_percent,
        "drift_uneven": frame.drift_uneven_percent,
        "weak_rows": frame.weak_rows,
        "regions": [list(region.bounds) for region in frame.regions],
        "host_ns": dict(frame.host_ns),
        "counts": dict(frame.counts),
    }


def _finite(value: Any) -> Any:
    """Return what JSON can hold: bytes in hex, arrays as lists, null for what is no number."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, np.generic | np.ndarray):
        return _finite(value.tolist())
    return value
