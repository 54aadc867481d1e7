"""Inputs that no working sheet gives: the loop must go on, publish no absurd map, and name the reason.

Each attack opens a real :class:`eitskin.Skin` on a scripted line. It may end in three ways: frames are published, all
finite and from 0 to 1; frames are withheld, each counted by its reason; or the input is refused with one line (a
``SkinError`` or a ``ValueError``). Any other end has escaped, and is a defect. Every frame sent must be accounted for.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from cobs import cobs

from eitskin import Skin
from eitskin.errors import PortLost, SkinError
from eitskin.model.bundle import Bundle
from eitskin.reference.captured import Reference
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, MessageType
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.framing import CRC_BYTES, Deframer, crc32c, encode
from eitskin_proto.wire.messages import Ack, Hello
from eitskin_tools.bench.harness import Row
from eitskin_tools.bench.stability_probe import HELLO, SEED, Sample, Tally

Array = npt.NDArray[np.float64]


LARGEST: Final = 2**31 - 1
VOLTS_PER_COUNT: Final = 1e-6
DENORMAL: Final = 5e-324

VOLTS: Final = (DENORMAL, 1e-310, 1e-300, 1e-30, 1e3, 1e4, 1e308, np.inf, -np.inf, np.nan, 0.0, -1e-9)
"""HELLO.volts_per_count."""


@dataclass(frozen=True, slots=True)
class Attack:
    """One absurd input."""

    group: str
    name: str
    payloads: Sequence[bytes]
    hello: dict[str, Any] = field(default_factory=dict)
    """Fields that differ."""
    reference: Array | None = None
    """(104,) V; None for the sound one."""
    geometry: Callable[[Skin], object] | None = None
    """What is done to the open skin before its frames are read."""
    raw: bytes = b""
    touchless: bool = False
    """No sheet can give these voltages by being touched: a map that shows touches is a lie."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of it."""

    attack: Attack
    published: int
    withheld: dict[str, int]
    corrupt: int
    refused: str
    """The refusal's line; empty if there was none."""
    escaped: str
    """The exception or the lie that should not have been; empty if there was none."""


def attacks(sample: Sample) -> Iterator[Attack]:
    """Yield every attack, built round a sound sample's counts."""
    volts = sample.voltages
    sound = np.rint(volts / VOLTS_PER_COUNT).astype(np.int32)
    rng = np.random.default_rng(SEED)
    yield from _counts(sound, rng)
    frames = [_frame(n, sound) for n in range(1, 6)]
    for value in VOLTS:
        nothing = 0.0 < value < 1e-20  # the frames then read next to no voltage at all
        yield Attack("volts per count", f"{value:g}", frames, hello={"volts_per_count": value}, touchless=nothing)
    yield from _references(sample.flat, frames)
    yield from _geometries(sample, frames)
    yield from _payloads(sound, rng)


def _frame(sequence: int, counts: npt.NDArray[np.int32], **fields: Any) -> bytes:
    return Frame(sequence=sequence, device_us=sequence * 5000 % (1 << 32), counts=counts, **fields).pack()


def _counts(sound: npt.NDArray[np.int32], rng: np.random.Generator) -> Iterator[Attack]:
    rows = len(sound)
    alternating = np.where(np.arange(rows) % 2, LARGEST, -LARGEST - 1).astype(np.int32)
    one = sound.copy()
    one[17] = LARGEST
    shapes = {
        "all the largest": np.full(rows, LARGEST, np.int32),
        "all the smallest": np.full(rows, -LARGEST - 1, np.int32),
        "alternating": alternating,
        "one row at the limit": one,
        "all one count": np.ones(rows, np.int32),
        "all signs turned": -sound,
    }
    # An open cable reads nothing at all; a touch, however hard, leaves the drive's current and so some voltage.
    yield Attack("counts", "all zero", [_frame(n, np.zeros(rows, np.int32)) for n in range(1, 6)], touchless=True)
    for name, counts in shapes.items():
        yield Attack("counts", name, [_frame(n, counts) for n in range(1, 6)])
    wild = [_frame(n, rng.integers(-LARGEST - 1, LARGEST, rows).astype(np.int32)) for n in range(1, 41)]
    yield Attack("counts", "random", wild)
    sizes = (10.0 ** rng.uniform(-8, 4, (40, rows)) * np.sign(rng.standard_normal((40, rows))) * sound).clip(
        -LARGEST, LARGEST
    )
    yield Attack("counts", "random sizes", [_frame(n + 1, one.astype(np.int32)) for n, one in enumerate(sizes)])


def _references(flat: Array, frames: Sequence[bytes]) -> Iterator[Attack]:
    for value in (DENORMAL, 1e-310, 1e-200, 1e-20, 1e200, 1e308, np.inf, -np.inf, np.nan, 0.0):
        one = flat.copy()
        one[40] = value
        yield Attack("reference", f"one row {value:g} V", frames, reference=one)
        yield Attack("reference", f"all rows {value:g} V", frames, reference=np.full_like(flat, value))
        yield Attack("reference", f"scaled to {value:g} V", frames, reference=flat / np.abs(flat).max() * value)


def _geometries(sample: Sample, frames: Sequence[bytes]) -> Iterator[Attack]:
    sound = np.asarray(sample.sheet.cloud_mm)
    clouds: dict[str, Any] = {}
    for value in (np.nan, np.inf, 1e308, 1e30, 999.0, DENORMAL, -np.inf):
        one = sound.copy()
        one[1, 7, 7] = value
        clouds[f"one point at {value:g} mm"] = one
        clouds[f"all points at {value:g} mm"] = np.full_like(sound, value)
    clouds |= {
        "one line": PAPER.grid.flat_cloud_mm() * np.array([1.0, 0.0, 0.0])[:, None, None],
        "shrunk to denormals": sound * 1e-310,
        "scrambled": np.random.default_rng(SEED).uniform(-999.0, 999.0, sound.shape),
        "wrong shape": sound[:, :5],
        "text": "cloud",
        "complex": sound * 1j,
    }
    for name, cloud in clouds.items():
        yield Attack("cloud", name, frames, geometry=partial(Skin.set_cloud, cloud=cloud))
    for value in (np.nan, np.inf, 0.0, DENORMAL, 1e-300, 1e30, 1e308, -1.0):
        volts = np.full(len(sample.flat), value)
        for name, pair in (("all", (volts, None)), ("flat", (sample.flat, volts))):
            use = partial(Skin.set_cloud, cloud=sound, predicted=pair[0], predicted_flat=pair[1])
            yield Attack("prediction", f"{name} {value:g} V", frames, geometry=use)


def _payloads(sound: npt.NDArray[np.int32], rng: np.random.Generator) -> Iterator[Attack]:
    good = _frame(1, sound)
    empty = b"\0" + bytes(cobs.encode(crc32c(b"").to_bytes(CRC_BYTES, "little"))) + b"\0"
    yield Attack("wire", "empty payload", [good, _frame(2, sound)], raw=empty)
    yield Attack("wire", "every type, no body", [good, *(bytes([kind]) for kind in range(256)), _frame(2, sound)])
    yield Attack("wire", "every length", [good[:n] for n in range(1, len(good))] + [_frame(2, sound)])
    yield Attack("wire", "too long", [good + bytes(n) for n in (1, 4, 100)] + [_frame(2, sound)])
    heads: list[bytes] = []
    for offset in range(20):
        for value in (0, 1, 127, 128, 255):
            damaged = bytearray(_frame(2 + len(heads), sound))
            damaged[offset] = value
            heads.append(bytes(damaged))
    yield Attack("wire", "header bytes changed", [good, *heads])
    yield Attack("wire", "sequence back and forth", [_frame(n, sound) for n in (5, 5, 4, 2**31, 0, 2**32 - 1, 1, 9)])
    yield Attack("wire", "random payloads", [rng.bytes(int(n)) for n in rng.integers(1, 600, 300)] + [good])
    yield Attack("wire", "random bytes", [good], raw=rng.bytes(20_000) + b"\0")
    flipped = bytearray()
    for bit in range(0, 8 * len(encode(good)), 7):
        packet = bytearray(encode(good))
        packet[bit // 8] ^= 1 << bit % 8
        flipped += packet
    yield Attack("wire", "one bit of a packet turned", [_frame(2, sound)], raw=bytes(flipped) + b"\0")
    events = [bytes([MessageType.EVENT]) + rng.bytes(n) for n in range(1, 40) for _ in range(20)]
    yield Attack("wire", "events of random bytes", [good, *events, _frame(2, sound)])
    yield Attack("wire", "all rows saturated", [_frame(n, sound, saturation=2**104 - 1) for n in range(1, 6)])


def strike(attack: Attack, bundle: Bundle, sample: Sample, tally: Tally) -> Outcome:
    """Return what one attack comes to, and count it."""
    hello = replace(HELLO, **{"volts_per_count": VOLTS_PER_COUNT, **attack.hello})
    published, refused, escaped = 0, "", ""
    withheld: dict[str, int] = {}
    corrupt = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning of numpy in the loop is a value that no check caught
        try:
            reference = _reference(sample.flat if attack.reference is None else attack.reference, hello)
            skin = Skin(ScriptedLine(hello, attack.payloads, attack.raw), bundle=bundle, reference=reference)
            try:
                if attack.geometry is not None:
                    attack.geometry(skin)
                for frame in skin.frames():
                    published += 1
                    tally.count(frame.map)
                    if attack.touchless and frame.touched:
                        escaped = "a touch was published of voltages that no touch can make"
            except PortLost:
                pass  # the script's end
            finally:
                withheld = {reason: n for reason, n in skin.pipeline.intake.withheld.items() if n}
                corrupt = skin.device.deframer.corrupt
        except (SkinError, ValueError) as error:
            refused = f"{type(error).__name__}: {error}"
            tally.refused[type(error).__name__] += 1
            if "\n" in str(error):
                escaped = f"a refusal of several lines: {refused}"
        except Exception as error:
            escaped = f"{type(error).__name__}: {error}"
    tally.withheld.update(withheld)
    if escaped:
        tally.escaped.append(f"{attack.group}, {attack.name}: {escaped}")
    return Outcome(attack, published, withheld, corrupt, refused, escaped)


def _reference(volts: Array, hello: Hello) -> Reference:
    return Reference(volts, np.zeros_like(volts), 2, hello.serial_number, hello.configuration_digest, "stress", "")


def input_rows(bundle: Bundle, sample: Sample, tally: Tally) -> list[Row]:
    """Return a row for each group of attacks."""
    groups: dict[str, list[Outcome]] = {}
    for attack in attacks(sample):
        groups.setdefault(attack.group, []).append(strike(attack, bundle, sample, tally))
    return [_row(group, outcomes) for group, outcomes in groups.items()]


def _row(group: str, outcomes: Sequence[Outcome]) -> Row:
    reasons: dict[str, int] = {}
    for outcome in outcomes:
        for reason, count in outcome.withheld.items():
            reasons[reason] = reasons.get(reason, 0) + count
    refusals = sorted({outcome.refused.partition(":")[0] for outcome in outcomes if outcome.refused})
    first = next((outcome.refused for outcome in outcomes if outcome.refused), "")
    said = [f"{reason} {count}" for reason, count in reasons.items()]
    text = f"withheld: {', '.join(said) or 'none'}; refused by {', '.join(refusals) or 'none'}"
    return {
        "sweep": f"inputs: {group}",
        "solver": "runtime",
        "unit": "cases",
        "from": 1,
        "to": len(outcomes),
        "frames": sum(outcome.published for outcome in outcomes),
        "withheld": sum(reasons.values()),
        "corrupt": sum(outcome.corrupt for outcome in outcomes),
        "refused": sum(bool(outcome.refused) for outcome in outcomes),
        "escaped": sum(bool(outcome.escaped) for outcome in outcomes),
        "degrades_10pct_at": None,
        "breaks_at": None,
        "why": text + (f", e.g. {first}" if first else ""),
    }


class ScriptedLine:
    """A transport whose device does what a script says: shakes hands, starts, sends payloads, and vanishes.

    Args:
        hello: What the device answers.
        payloads: What it sends after START, a packet each; bytes that are framed already go in ``raw``.
        raw: Bytes sent as they are before the payloads.
    """

    name = "scripted"
    line_bytes_per_s = 0

    def __init__(self, hello: Hello, payloads: Iterable[bytes], raw: bytes = b"") -> None:
        self._hello = hello
        self._script = [raw] if raw else []
        self._script += [encode(payload) for payload in payloads]
        self._script.reverse()
        self._answers: list[bytes] = []
        self._deframer = Deframer()
        self._started = False

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return the next answer, or the next packet of the script; nothing to those who do not wait.

        Raises:
            PortLost: There is none left.
        """
        if self._answers:
            return self._answers.pop(0)
        if timeout_s is not None and timeout_s <= 0.0:
            return b""  # frames come one at a time: none waits behind another
        if self._started and self._script:
            return self._script.pop()
        raise PortLost(f"{self.name}: the script has ended")

    def write(self, data: bytes) -> None:
        """Answer requests."""
        for payload in self._deframer.feed(data):
            kind, tag = payload[0], payload[1]
            if kind == MessageType.HELLO_REQUEST:
                self._answers.append(encode(replace(self._hello, tag=tag).pack()))
            elif kind == MessageType.TIME_REQUEST:
                self._answers.append(encode(messages.Time(0, tag).pack()))
            else:
                self._started = self._started or isinstance(messages.unpack(payload), messages.Start)
                self._answers.append(encode(Ack(kind, Code.OK, 0, tag).pack()))

    def cancel(self) -> None:
        """Do nothing: no call waits here."""

    def report(self) -> list[str]:
        """Return nothing to report."""
        return []

    def close(self) -> None:
        """Do nothing: there is nothing to give back."""
