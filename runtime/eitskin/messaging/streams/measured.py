"""The items of streams: frames of the wire, clouds, conditions.

With the bundle and the reference they suffice to recompute a map. :class:`WireFrame` has the voltages and names the
solver and the conditions, :class:`CloudInUse` has the surface, :class:`Conditions` the runtime's own findings.
:class:`eitskin.messaging.streams.state.SkinState` describes the device and the runtime.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Self, TypeVar

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin.messaging.regions import MAX_REGIONS, MOST_PIXELS, Region, Regions
from eitskin.messaging.streams.envelope import CLOUD, CONDITIONS, WIRE
from eitskin.messaging.unpacking import fields_of, require
from eitskin_proto.fields import Fields
from eitskin_proto.sensor.row_table import MAX_ROWS
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS
from eitskin_proto.wire.volts import LARGEST_VOLTS

LARGEST_PAYLOAD: Final = LARGEST_VOLTS
"""Bytes of a packet's payload (SPEC.md, section 1), or of a driver's scan."""

_WIRE_FIELDS: Final = (
    "seq", "device_us", "read_ns", "payload", "withheld", "frame", "touched", "gate_logit", "solver", "map_seq",
    "fused", "conditions",
)  # fmt: skip

MAX_TEXT: Final = 256
"""Characters."""

Value = TypeVar("Value")

Finding = tuple[int, str, int | None]
"""An electrode that is not well: its number, its state, and the other one of a short or an exchange."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Received:
    """How an item of a stream came."""

    n: int = 0
    """Number of this message in its stream; a gap means that this side missed messages."""
    run: str = ""
    """Id of this run of the runtime; it differs after each start."""
    received_ns: int = 0
    """``perf_counter_ns`` of this machine when it took the message from the socket."""


@dataclass(frozen=True, slots=True)
class WireFrame(Received):
    """One intact FRAME from the wire, and its processing.

    Attributes:
        payload: The packet's payload (SPEC.md, section 4), with a correct checksum; of a driver, VOLTS (section 10).
        seq: Unwrapped ``sequence``; None if the payload is malformed.
        read_ns: ``perf_counter_ns`` of the runtime's machine after it read the last byte.
        device_us: Device clock at the end of the scan, unwrapped; None if the payload is malformed.
        withheld: Why the frame was withheld; empty if it was fit to publish.
        frame: ``number`` of the published frame; None if none was published.
        touched: Whether the gate found a touch; False if the frame was withheld.
        gate_logit: The gate's logit.
        solver: Solver of the published map; ``none`` if the map is 0.
        map_seq: ``seq`` of the frame that the map was computed for; None if no frame was published.
        fused: How many frames that map rests on.
        conditions: ``revision`` of the :class:`Conditions` of this frame.
    """

    payload: bytes
    seq: int | None
    read_ns: int
    device_us: int | None = None
    withheld: str = ""
    frame: int | None = None
    touched: bool = False
    gate_logit: float = 0.0
    solver: str = "none"
    map_seq: int | None = None
    fused: int = 1
    conditions: int = 0

    def body(self) -> bytes:
        """Return it as a stream carries it."""
        found: bytes = msgpack.packb({name: getattr(self, name) for name in _WIRE_FIELDS})
        return found

    @classmethod
    def of(cls, body: bytes) -> Self:
        """Return the frame of a body.

        Raises:
            FrameError: It is malformed.
        """
        fields = fields_of(body, f"stream {WIRE}")
        return cls(
            payload=fields.raw("payload", least=1, most=LARGEST_PAYLOAD),
            seq=_or_none(fields, "seq", fields.whole),
            read_ns=fields.whole("read_ns"),
            device_us=_or_none(fields, "device_us", fields.whole),
            withheld=_text(fields, "withheld"),
            frame=_or_none(fields, "frame", fields.whole),
            touched=fields.truth("touched"),
            gate_logit=_float(fields, "gate_logit"),
            solver=_text(fields, "solver"),
            map_seq=_or_none(fields, "map_seq", fields.whole),
            fused=fields.whole("fused", 1, low=1),
            conditions=fields.whole("conditions"),
        )


@dataclass(frozen=True, slots=True, eq=False)
class CloudInUse(Received):
    """The surface in use.

    Attributes:
        revision: As ``Frame.cloud``; 0 is the flat sheet that a runtime starts with.
        cloud: (3, rows, columns) float32 mm, in the pose in which it was sent.
        predicted: (104,) V that a model predicts for this surface untouched; None without a prediction.
        predicted_flat: (104,) V of the same model's flat sheet; None without.
        taken_ns: ``perf_counter_ns`` of the runtime's machine when it accepted the cloud.
        why: ``start``: no cloud was sent yet; ``given``: one was sent; ``fitted``: physics found it in frames;
            ``flat``: the flat sheet was requested.
        log_predicted: (rows,) float32, the solvers' input from the prediction; zeros without.
        seq: ``seq`` of the first frame computed with it; None if that was before the stream began.
        utc_ns: Wall clock when the runtime accepted the cloud.
    """

    revision: int
    cloud: npt.NDArray[np.float32]
    predicted: npt.NDArray[np.float64] | None
    predicted_flat: npt.NDArray[np.float64] | None
    taken_ns: int
    why: str
    log_predicted: npt.NDArray[np.float32]
    seq: int | None
    utc_ns: int = 0

    def body(self) -> bytes:
        """Return it as a stream carries it."""
        found: bytes = msgpack.packb(
            {"revision": self.revision, "seq": self.seq, "taken_ns": self.taken_ns, "utc_ns": self.utc_ns,
             "why": self.why, "shape": list(self.cloud.shape[1:]), "cloud": _bytes(self.cloud, "<f4"),
             "predicted": _bytes(self.predicted, "<f8"), "predicted_flat": _bytes(self.predicted_flat, "<f8"),
             "log_predicted": _bytes(self.log_predicted, "<f4")}
        )  # fmt: skip
        return found

    @classmethod
    def of(cls, body: bytes) -> Self:
        """Return the cloud of a body.

        Raises:
            FrameError: It is malformed.
        """
        fields = fields_of(body, f"stream {CLOUD}")
        rows = len(fields.raw("log_predicted", most=4 * MAX_ROWS)) // 4
        sizes = fields.entries("shape", least=2, most=2, of="sizes")
        shape = tuple(sizes.whole(place, low=1, high=most) for place, most in enumerate(MOST_PIXELS))
        return cls(
            revision=fields.whole("revision"),
            cloud=fields.array("cloud", "<f4", (3, *shape)),
            predicted=None if fields.is_nil("predicted") else fields.array("predicted", "<f8", (N_ROWS,)),
            predicted_flat=None
            if fields.is_nil("predicted_flat")
            else fields.array("predicted_flat", "<f8", (N_ROWS,)),
            taken_ns=fields.whole("taken_ns"),
            why=_text(fields, "why"),
            log_predicted=fields.array("log_predicted", "<f4", (rows,)),
            seq=_or_none(fields, "seq", fields.whole),
            utc_ns=fields.whole("utc_ns"),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Conditions(Received):
    """What determines a map in addition to voltages, reference, cloud and bundle.

    Attributes:
        revision: Counts changes; :attr:`WireFrame.conditions` names the one of a frame.
        seq: ``seq`` of the first frame computed under them while the stream had a subscriber.
        cloud: Revision of the cloud in use.
        reference: SHA-256 of the reference in use, as ``SkinState.reference_sha256``.
        regions: The computed parts of the map.
        gate_threshold: A frame with a higher ``gate_logit`` is touched, and so are some below; None without a gate.
        drift: (104,) float32 factors on 1 + dV that correct for drift; None without a correction.
        electrodes: Failed electrodes.
        missing_rows: Rows that are filled in from the others.
        skip_unchanged: Whether the runtime keeps a map while only noise changes.
        volts_per_count: V of one count.
    """

    revision: int
    seq: int
    cloud: int
    reference: str
    regions: Regions
    gate_threshold: float | None
    drift: npt.NDArray[np.float32] | None
    electrodes: tuple[Finding, ...]
    missing_rows: tuple[int, ...]
    skip_unchanged: bool
    volts_per_count: float

    def body(self) -> bytes:
        """Return them as a stream carries them."""
        found: bytes = msgpack.packb(
            {"revision": self.revision, "seq": self.seq, "cloud": self.cloud, "reference": self.reference,
             "regions": [list(region.bounds) for region in self.regions], "gate_threshold": self.gate_threshold,
             "drift": _bytes(self.drift, "<f4"), "electrodes": [list(finding) for finding in self.electrodes],
             "missing_rows": list(self.missing_rows), "skip_unchanged": self.skip_unchanged,
             "volts_per_count": self.volts_per_count}
        )  # fmt: skip
        return found

    @classmethod
    def of(cls, body: bytes) -> Self:
        """Return the conditions of a body.

        Raises:
            FrameError: They are malformed.
        """
        fields = fields_of(body, f"stream {CONDITIONS}")
        require(fields, "regions", "electrodes", "missing_rows")
        rectangles = fields.entries("regions", least=1, most=MAX_REGIONS, of="rectangles")
        findings = fields.entries("electrodes", most=N_ELECTRODES, of="findings")
        try:
            regions = tuple(Region(*rectangles.wholes(place, least=4, most=4)) for place in rectangles)
        except ValueError as error:
            raise fields.wrong("regions", "rectangles on the sheet") from error
        return cls(
            revision=fields.whole("revision"),
            seq=fields.whole("seq"),
            cloud=fields.whole("cloud"),
            reference=_text(fields, "reference"),
            regions=regions,
            gate_threshold=_or_none(fields, "gate_threshold", fields.number),
            drift=None if fields.is_nil("drift") else fields.array("drift", "<f4", (N_ROWS,)),
            electrodes=tuple(_finding(findings, place) for place in findings),
            missing_rows=fields.wholes("missing_rows", high=MAX_ROWS - 1, most=MAX_ROWS),
            skip_unchanged=fields.truth("skip_unchanged"),
            volts_per_count=fields.number("volts_per_count"),
        )


def _bytes(values: npt.NDArray[Any] | None, kind: str) -> bytes | None:
    return None if values is None else values.astype(kind).tobytes()


def _text(fields: Fields, key: str) -> str:
    return fields.text(key, least=0, longest=MAX_TEXT)


def _float(fields: Fields, key: str) -> float:
    """Return a float, finite or not."""
    if not isinstance(value := fields.value(key), float):
        raise fields.wrong(key, "a float")
    return value


def _or_none(fields: Fields, key: str, read: Callable[[str], Value]) -> Value | None:
    return None if fields.is_nil(key) else read(key)


def _finding(findings: Fields, place: int) -> Finding:
    match findings.value(place):
        case [int(electrode), str(state), None | int() as partner] if (
            0 <= electrode < N_ELECTRODES and len(state) <= 32 and (partner is None or 0 <= partner < N_ELECTRODES)
        ):
            return electrode, state, partner
    raise findings.wrong(place, "[electrode, state, partner]")
