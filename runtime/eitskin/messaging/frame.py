"""A tactile frame as a subscriber gets it, and its checks.

On the wire a frame is one MessagePack map (firmware_proto/SPEC.md lists the fields); the publisher's half is
:mod:`eitskin.messaging.frame_message`.

A subscriber that needs no unchanged maps gets a short message without shape and map while the map is that of an earlier
frame, which ``map_seq`` names.

A subscriber checks sizes, types, shape and finiteness of every message, whatever its publisher.
"""

import math
import operator
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import FrameError
from eitskin.frame_record import STAGES
from eitskin.messaging.regions import MAX_REGIONS, MOST_PIXELS, Region, Regions, whole
from eitskin.messaging.unpacking import unpacked
from eitskin.touches.touch import NAMES, Touch, TouchList, unpack_touches
from eitskin_proto.files.plain import plain

VERSION: Final = 1
"""Of the message; a subscriber refuses another one."""

COUNTS: Final = ("lost", "corrupt", "withheld", "overrun")
"""Totals since the runtime started."""

NUMBERS: Final = (
    "n", "seq", "device_us", "age_us", "touched", "gate_logit", "cloud", "weak_rows", "map_seq", "drift",
    "drift_sd", "drift_uneven", "fused", *STAGES, *COUNTS,
)  # fmt: skip
"""Fields that change with each frame, in the order of the message."""

TOUCHED: Final = (0xC2, 0xC3)
"""False and true in MessagePack."""

TOUCH_FIRST_BYTE: Final = b"\xdf"
"""A touch message, which has no map, begins with it: the same, with a wider count."""

TOUCH_VERSION: Final = 2
"""Version of a touch message; readers of version 1 ignore it."""

LARGEST_MAP: Final = 4 * MOST_PIXELS[0] * MOST_PIXELS[1]
"""Bytes; the paper's has 5400."""

FIRST_BYTE: Final = b"\xde"
"""A frame's message begins with it: a MessagePack map of more than 15 keys."""

EVERY_FRAME: Final = FIRST_BYTE + b"\x00"
"""Topic of every frame with its whole map, and of nothing else: a frame has fewer than 256 keys."""

KEYS: Final = range(24, 36)
"""How many keys a frame may have; the byte behind ``EVERY_FRAME`` counts them."""


def patient_topics(first_byte: bytes) -> tuple[bytes, ...]:
    """Return the longest prefixes of frames: libzmq serves shorter ones first, so these subscribers come last.

    Args:
        first_byte: Of frames with maps, or of touch messages.
    """
    between = {FIRST_BYTE: b"\x00", TOUCH_FIRST_BYTE: bytes(3)}[first_byte]
    return tuple(first_byte + between + bytes([keys]) for keys in KEYS)


LARGEST_MESSAGE: Final = 68608
"""Bytes; a frame of the paper's skin has about 6000, of the largest map about 58,200."""

NO_MAP: Final = np.zeros((0, 0), dtype=np.float32)
"""Of a frame from a touch message."""

LARGEST_REST: Final = LARGEST_MESSAGE - LARGEST_MAP
"""Bytes of a message without its map."""

MAX_TEXTS: Final = 16
MAX_TEXT: Final = 128
"""How many skips or events a frame may name, and how long each may be."""


@lru_cache(maxsize=1)
def host_id() -> str:
    """Return the id of this boot of this machine; stamps compare only within it."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()[:36]
    except OSError:
        return "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One tactile frame, as a subscriber receives it.

    Attributes:
        map: (rows, columns), (30, 45) for the paper's skin, read-only, row 0 at y = 0. A value is the touched share of
            a pixel, or its touch probability, from 0 to 1. The shape is (0, 0) if the subscriber requested no maps.
        touched: Whether the gate found a touch; the map of an untouched frame is 0.
        sequence: The device's frame number, unwrapped; a gap means that frames were lost before the runtime.
        number: The runtime's count of published frames; a gap means that this subscriber missed frames.
        device_us: Device clock at the end of the scan, unwrapped past 2^32.
        host_ns: ``perf_counter_ns`` of the runtime's machine at the end of each of ``STAGES``.
        received_ns: ``perf_counter_ns`` of this machine when it took the frame from the socket.
        age_us: Time from the scan to publishing, relative to the fastest frame so far.
        solver: ``vd2t``, ``vd2t-int8``, ``vd2t-small`` or ``tikhonov``; ``none`` if no map was computed.
        skipped: Skipped work with its reason, such as ``inference:untouched``.
        events: Events at this frame: ``overrun``, ``device_reset``, ``saturated``, ``cloud``, ``lost``.
        electrodes: Failed electrodes, each with its fault and the replacement of its rows: ``5:detached:imputed``.
        drift_percent: Common change of the untouched voltages since the reference; None if the bundle cannot tell.
        drift_sd_percent: Standard deviation of ``drift_percent``, 10 before any evidence; None if the bundle cannot
            tell.
        drift_uneven_percent: Rms over the rows of the change beyond ``drift_percent``; None while unknown.
        gate_logit: The gate's logit for this frame alone; ``touched`` also depends on earlier frames.
        cloud: Revision of the cloud in use; 0 is the flat sheet.
        weak_rows: Number of reference rows that carry no information and are filled in from the others.
        map_sequence: ``sequence`` of the frame that the map was computed for; an earlier one if only noise changed.
        fused: How many frames the map is computed of: 1, or the mean of 2, 4, 8 ... while only noise changes.
        regions: The computed parts of the map, as rectangles; the rest is 0.
        counts: The runtime's totals of ``COUNTS``: lost, corrupt and withheld frames, and overruns.
        configuration: Name and digest of the device's active configuration.
        bundle: Id of the bundle.
        serial_number: Serial number of the device.
        run: Id of this run of the runtime; it differs after each start.
        touch_list: Touches and their events; None unless a subscriber requested touches.
        same_host: Whether the runtime runs on this machine, so that ``host_ns`` compares with ``received_ns``.
    """

    map: npt.NDArray[np.float32]
    touched: bool
    sequence: int
    number: int
    device_us: int
    host_ns: Mapping[str, int]
    received_ns: int
    age_us: int
    solver: str
    skipped: tuple[str, ...]
    events: tuple[str, ...]
    electrodes: tuple[str, ...]
    drift_percent: float | None
    drift_sd_percent: float | None
    drift_uneven_percent: float | None
    gate_logit: float
    cloud: int
    weak_rows: int
    map_sequence: int
    regions: Regions
    counts: Mapping[str, int]
    configuration: str
    bundle: str
    serial_number: str
    run: str
    same_host: bool
    touch_list: TouchList | None = None
    fused: int = 1

    def __repr__(self) -> str:
        """Return one line: number, touched or not, solver, age at arrival."""
        state = "touched" if self.touched else "untouched"
        events = f", {' '.join(self.events)}" if self.events else ""
        return f"<Frame {self.sequence} of {self.serial_number}: {state}, {self.solver}, {self.age_us} us old{events}>"

    @property
    def touches(self) -> tuple[Touch, ...]:
        """The touches, by id; raises :class:`FrameError` if the subscription did not request touches."""
        if self.touch_list is None:
            raise FrameError(f"frame {self.sequence} has no touches: ask for them by subscribe(..., touches=True)")
        return self.touch_list.touches

    @property
    def age_s(self) -> float:
        """Seconds from the scan until now; on another machine without the time on the network."""
        since_ns = time.perf_counter_ns() - (self.host_ns["publish"] if self.same_host else self.received_ns)
        return self.age_us * 1e-6 + max(since_ns, 0) * 1e-9

    @property
    def latency_s(self) -> float:
        """Seconds from the last byte on the wire to this process; on another machine only up to publishing."""
        end_ns = self.received_ns if self.same_host else self.host_ns["publish"]
        return (end_ns - self.host_ns["read"]) * 1e-9

    def stages_us(self) -> dict[str, float]:
        """Return the duration of each stage in us; ``deliver`` is the way from the publisher to this process."""
        stamps = [self.host_ns[stage] for stage in STAGES]
        spans = {stage: (end - start) / 1000 for stage, start, end in zip(STAGES[1:], stamps, stamps[1:], strict=False)}
        if self.same_host:
            spans["deliver"] = (self.received_ns - stamps[-1]) / 1000
        return spans


class MapMissing(FrameError):  # noqa: N818 -- named as the other states of a stream are
    """A frame without a map, whose map was not received either."""


def unpack_frame(message: bytes, received_ns: int, known: Frame | None = None) -> Frame:
    """Return the frame of a published message.

    Args:
        message: Of any origin.
        received_ns: When it was taken from the socket.
        known: An earlier frame of the same stream, whose map a message without one may mean.

    Raises:
        MapMissing: It has no map, and means another one than ``known`` has.
        FrameError: It is no frame, or one of another version.
    """
    fields = unpacked(
        message, "a frame", largest=LARGEST_MESSAGE, longest_text=256, longest_list=MAX_TEXTS, longest_map=64
    )
    alone = message[:1] == TOUCH_FIRST_BYTE
    if fields.get("v") != (expected := TOUCH_VERSION if alone else VERSION):
        found = plain(str(fields.get("v"))[:20])
        raise FrameError(f"found frames of version {found}, expected {expected}: use the runtime's release")
    sequence = _count(fields, "seq")
    map_sequence = _count(fields, "map_seq") if "map_seq" in fields else sequence
    regions: Regions | None = None
    if alone:
        values = NO_MAP
    elif "map" in fields:
        values = _map(fields)
    elif known is not None and (known.run, known.map_sequence) == (fields.get("run"), map_sequence):
        values, regions = known.map, known.regions
    else:
        raise MapMissing(f"frame {sequence} has the map of frame {map_sequence}, which was not received")
    claimed = _regions(fields, MOST_PIXELS if alone else (values.shape[0], values.shape[1]))
    if not isinstance(fields.get("touched"), bool):
        raise FrameError("frame touched: expected true or false")
    gate_logit = fields.get("gate_logit")
    if not isinstance(gate_logit, float):
        raise FrameError("frame gate_logit: expected a float")
    return Frame(
        map=values,
        touched=fields["touched"],
        sequence=sequence,
        number=_count(fields, "n"),
        device_us=_count(fields, "device_us"),
        host_ns=_counts(fields, "host_ns", STAGES),
        received_ns=received_ns,
        age_us=_count(fields, "age_us"),
        solver=_text(fields, "solver"),
        skipped=_texts(fields, "skipped"),
        events=_texts(fields, "events"),
        electrodes=_texts(fields, "electrodes") if "electrodes" in fields else (),
        drift_percent=_drift(fields, "drift"),
        drift_sd_percent=_drift(fields, "drift_sd"),
        drift_uneven_percent=_drift(fields, "drift_uneven"),
        gate_logit=gate_logit,
        cloud=_count(fields, "cloud"),
        weak_rows=_count(fields, "weak_rows"),
        map_sequence=map_sequence,
        regions=claimed if regions is None else regions,
        counts=_counts(fields, "counts", COUNTS),
        configuration=_text(fields, "configuration"),
        bundle=_text(fields, "bundle"),
        serial_number=_text(fields, "serial"),
        run=_text(fields, "run"),
        same_host=_text(fields, "host") == host_id(),
        fused=max(_count(fields, "fused"), 1) if "fused" in fields else 1,
        touch_list=unpack_touches(*map(fields.get, NAMES)) if NAMES[0] in fields else None,
    )


def _map(fields: Mapping[str, Any]) -> npt.NDArray[np.float32]:
    """Return the map, (rows, columns) and read-only."""
    shape, raw = fields.get("shape"), fields.get("map")
    if (
        not isinstance(shape, list)
        or len(shape) != 2
        or not all(type(size) is int and 1 <= size <= most for size, most in zip(shape, MOST_PIXELS, strict=True))
    ):
        raise FrameError(f"frame shape: found {str(shape)[:40]}, expected [rows, columns] up to {list(MOST_PIXELS)}")
    if not isinstance(raw, bytes) or len(raw) != 4 * shape[0] * shape[1]:
        raise FrameError(f"frame map: expected {4 * shape[0] * shape[1]} bytes")
    values = np.frombuffer(raw, dtype="<f4").reshape(shape)  # of immutable bytes: read-only
    if not np.isfinite(values).all():
        raise FrameError("frame map: holds values that are not finite")
    return values


def _regions(fields: Mapping[str, Any], shape: tuple[int, int]) -> Regions:
    """Return the computed regions of a map of this shape, from a message."""
    found = fields.get("regions")
    if found is None:
        return whole(shape)
    try:
        regions = tuple(Region(*map(operator.index, bounds)).check(shape) for bounds in found)
    except (TypeError, ValueError) as error:
        raise FrameError(f"frame regions: found {str(found)[:60]}, expected rectangles on the sheet") from error
    if not 1 <= len(regions) <= MAX_REGIONS:
        raise FrameError(f"frame regions: found {len(regions)}, expected 1 to {MAX_REGIONS}")
    return regions


def _count(fields: Mapping[str, Any], name: str) -> int:
    value = fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise FrameError(f"frame {name}: found {str(value)[:40]}, expected a count")
    return value


def _drift(fields: Mapping[str, Any], name: str) -> float | None:
    """Return a number on drift; a message without it, or with a number that is none, says that it is unknown."""
    value = fields.get(name, math.nan)
    if not isinstance(value, float):
        raise FrameError(f"frame {name}: found {str(value)[:40]}, expected a float")
    return value if math.isfinite(value) else None


def _counts(fields: Mapping[str, Any], name: str, keys: tuple[str, ...]) -> dict[str, int]:
    value = fields.get(name)
    if not isinstance(value, dict):
        raise FrameError(f"frame {name}: expected a map of {', '.join(keys)}")
    return {key: _count(value, key) for key in keys}


def _text(fields: Mapping[str, Any], name: str) -> str:
    value = fields.get(name)
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise FrameError(f"frame {name}: expected a text of at most {MAX_TEXT} characters")
    return value


def _texts(fields: Mapping[str, Any], name: str) -> tuple[str, ...]:
    value = fields.get(name)
    if not isinstance(value, list) or not all(isinstance(text, str) and len(text) <= MAX_TEXT for text in value):
        raise FrameError(f"frame {name}: expected a list of short texts")
    return tuple(value)
