"""The virtual skin's state machine: what the firmware does between its front end and its line, without any line.

Bytes go in, packets come out; time is an argument, so that tests need no clock. ::

    receive(bytes, now_ns) -> packets that answer            sweep(now_ns) -> the packet of one scan
    poll(now_ns) -> events                               next_ns: when poll has something to do

``tests/firmware/test_conformance.py`` asks this device, the C core and the emulated board the same questions. The
device's clock starts at boot and wraps at 2^32 microseconds. The *script's* time starts at the first START after
the process began, and a reset of the device does not turn it back: the world outside the skin does not reboot.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire import hardware, messages
from eitskin_proto.wire.codes import Code, EventCode, FrameFlag, HelloFlag, MessageType, Mode
from eitskin_proto.wire.config import Configuration
from eitskin_proto.wire.frames import Frame, full_scale, quantise
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Ack, Hello
from eitskin_proto.wire.scan_rows import full_rows, row_count, table_rows
from eitskin_tools.virtual_skin.store import Answer, ConfigurationStore

Array = npt.NDArray[np.float64]


class Source(Protocol):
    """Where voltages come from."""

    def voltages(self, time_s: float) -> Array:
        """Return the V at a time since the first START, noise included.

        They are (104,); or (208,) of the full table, where a pair of pairs reads otherwise the other way round.
        """
        ...


@dataclass(frozen=True, slots=True)
class Identity:
    """What makes this skin different from others."""

    serial_number: str = "VIRTUAL-0001"
    protocol_id: str = PROTOCOL_ID
    """Another than this installation's plays a foreign device."""
    first_us: int = 0
    """What the device clock shows at boot; near 2^32 it wraps soon."""


FIRMWARE_VERSION: Final = (1, 0, 0)
"""What HELLO says."""

TRIAL_NS: Final = 30_000_000_000
"""A device that waits this long for CONFIG_CONFIRM restarts by itself."""

RESTART_NS: Final = 20_000_000
"""Between the answer to RESTART and the restart, so that the answer leaves."""

CONVERTER_V: Final = 2.5
"""Voltage at the converter that gives full scale; the amplifier's gain stands before it."""

STUCK_COUNT: Final = 12_345
"""What a converter reads that is stuck."""


class VirtualDevice:
    """A skin's firmware as a state machine.

    Args:
        source: Where voltages come from.
        configuration: What is built into the firmware.
        now_ns: Host clock at the first boot.
        identity: Serial number and peculiarities.
    """

    def __init__(
        self, source: Source, configuration: Configuration, now_ns: int, identity: Identity | None = None
    ) -> None:
        self.source = source
        self.identity = identity or Identity()
        self.store = ConfigurationStore(configuration)
        self.script_start_ns: int | None = None
        """Host clock at the first START."""
        self.boots = 0
        self._samples: tuple[npt.NDArray[np.int32], int] = (np.zeros(0, dtype=np.int32), 0)
        """Of the last scan."""
        self.dropped = 0
        """Scans that could not be sent, since the process began."""
        self.boot(now_ns)

    def boot(self, now_ns: int) -> None:
        """Restart the firmware: clock, sequence and stream; the stored configurations stay."""
        self.boots += 1
        self.epoch_ns = now_ns - self.identity.first_us * 1000
        """Host clock at which the device clock showed 0."""
        self._boot_ns = now_ns
        self.store.boot()
        self.streaming = False
        self.sequence = 0
        self._restart_ns = 0
        self._announced = False
        self._left = 0
        self._first = False
        self._idle = False
        self._dropped = 0
        self._deframer = Deframer(max_payload=64)
        self._arrange()

    def _arrange(self) -> None:
        configuration = self.store.configuration
        self._drives = configuration.idle_drives if self._idle else configuration.drives
        self.scan_ns = configuration.scan_us(self._drives) * 1000
        self.rate_mHz = configuration.idle_rate_mHz if self._idle else configuration.rate_mHz
        self._rows = table_rows(configuration.full, self._drives)
        self._rows_in_full = full_rows(configuration.full, self._drives)
        self.volts_per_count = CONVERTER_V / configuration.gain / full_scale(configuration.sample_bytes)

    @property
    def period_ns(self) -> float:
        """Between two scans."""
        return 1e12 / self.rate_mHz

    @property
    def next_ns(self) -> int:
        """Host clock at which :meth:`poll` has something to do; 0 while there is nothing."""
        trial_ns = self._boot_ns + TRIAL_NS if self.store.on_trial else 0
        moments = [self._boot_ns if not self._announced else 0, self._restart_ns, trial_ns]
        return min((moment for moment in moments if moment), default=0)

    def poll(self, now_ns: int) -> list[bytes]:
        """Return events that are due; boot if a restart is due, after RESTART or an unconfirmed trial."""
        packets = []
        if not self._announced:
            self._announced = True
            code = EventCode.ROLLED_BACK if self.store.rolled_back else EventCode.CONFIGURATION_CHANGED
            packets.append(self.event(code, now_ns, self.store.generation))
        expired = self.store.on_trial and now_ns >= self._boot_ns + TRIAL_NS
        if expired or (self._restart_ns and now_ns >= self._restart_ns):
            packets.append(self.event(EventCode.RESTARTING, now_ns, self.store.generation))
            self.boot(now_ns)
        return packets

    def device_us(self, now_ns: int) -> int:
        """Return the device clock, modulo 2^32."""
        return (now_ns - self.epoch_ns) // 1000 & 0xFFFFFFFF

    def receive(self, data: bytes, now_ns: int) -> list[bytes]:
        """Return the packets that answer some bytes from the host; a device about to restart answers nothing more."""
        packets = []
        for payload in self._deframer.feed(data):
            if not self._restart_ns:
                packets += [encode(answer.pack()) for answer in self._answer(payload, now_ns)]
        return packets

    def event(self, code: EventCode, now_ns: int, detail: int = 0) -> bytes:
        """Return the packet of an event."""
        return encode(messages.Event(code, self.device_us(now_ns), detail).pack())

    def drop(self, scans: int = 1) -> None:
        """Count scans that were made and could not be sent."""
        self.dropped += scans
        self._dropped = (self._dropped + scans) & 0xFFFF

    def skip(self, scans: int) -> None:
        """Skip scans that were not sent; they count as dropped."""
        self.sequence = (self.sequence + scans) & 0xFFFFFFFF
        self.drop(scans)

    def sweep(self, now_ns: int, overdriven_rows: int = 0, front_end: str = "") -> bytes:
        """Return the packet of the scan that ends now, and count it.

        Args:
            now_ns: Host clock at the end of the scan.
            overdriven_rows: Number of rows, from the first on, beyond full scale.
            front_end: A fault of :data:`eitskin_tools.virtual_skin.faults.FRONT_END` that goes on, or "".
        """
        if front_end == "failing":
            packet = self.event(EventCode.FRONT_END_FAILED, now_ns, self.sequence)
            self.skip(1)
            return packet
        store = self.store
        configuration = store.configuration
        start_ns = self.script_start_ns if self.script_start_ns is not None else now_ns
        volts = self.source.voltages((now_ns - start_ns) * 1e-9)
        voltages = volts[self._rows if len(volts) == N_ROWS else self._rows_in_full]
        voltages[:overdriven_rows] = 2.0 * CONVERTER_V
        counts, saturation = quantise(voltages, self.volts_per_count, configuration.sample_bytes)
        if front_end == "stuck":
            counts[:] = STUCK_COUNT
        elif front_end == "frozen" and self._samples[0].shape == counts.shape:
            counts, saturation = self._samples
        self._samples = counts, saturation
        frame = Frame(
            sequence=self.sequence,
            device_us=self.device_us(now_ns),
            counts=counts,
            generation=store.generation,
            sample_bytes=configuration.sample_bytes,
            flags=(FrameFlag.FULL if configuration.full else 0)
            | (FrameFlag.IDLE if self._idle else 0)
            | (FrameFlag.FIRST if self._first else 0)
            | (FrameFlag.TRIAL if store.on_trial else 0),
            drives=self._drives,
            device_dropped=self._dropped,
            saturation=saturation,
        )
        self._first = False
        self.sequence = (self.sequence + 1) & 0xFFFFFFFF
        if self._left:
            self._left -= 1
            self.streaming = self._left > 0
        return encode(frame.pack())

    def hello(self, now_ns: int, tag: int = 0) -> Hello:
        """Return what the device says about itself."""
        store, configuration = self.store, self.store.configuration
        return Hello(
            firmware_version=FIRMWARE_VERSION,
            hardware_id=hardware.EITSKIN_16.id,
            serial_number=self.identity.serial_number,
            configuration_digest=configuration.digest,
            generation=store.generation,
            configuration_name=configuration.name,
            rate_mHz=configuration.rate_mHz,
            rows=row_count(configuration.full, configuration.drives),
            sample_bytes=configuration.sample_bytes,
            volts_per_count=self.volts_per_count,
            drives=configuration.drives,
            idle_drives=configuration.idle_drives,
            flags=(HelloFlag.FULL if configuration.full else 0)
            | (HelloFlag.TRIAL if store.on_trial else 0)
            | (HelloFlag.FACTORY if store.generation == 0 else 0)
            | (HelloFlag.ROLLED_BACK if store.rolled_back else 0)
            | (HelloFlag.STREAMING if self.streaming else 0)
            | (HelloFlag.IDLE if self._idle else 0),
            uptime_ms=(now_ns - self._boot_ns) // 1_000_000 & 0xFFFFFFFF,
            tag=tag,
            protocol_id=self.identity.protocol_id,
            grid_id=configuration.skin or PAPER.grid_id,
        )

    def _answer(self, payload: bytes, now_ns: int) -> list[messages.Message]:
        kind, tag = payload[0], payload[1] if len(payload) > 1 else 0
        if kind not in _REQUESTS:
            return [Ack(kind, Code.UNKNOWN_TYPE, len(payload), tag)]
        layout = _REQUESTS[kind].LAYOUT
        if not layout.size <= len(payload) <= layout.size + layout.max_tail:
            return [Ack(kind, Code.BAD_LENGTH, len(payload), tag)]
        try:
            request = messages.unpack(payload)
        except ProtocolError:
            return [Ack(kind, Code.BAD_VALUE, len(payload), tag)]
        match request:
            case messages.HelloRequest():
                return [self.hello(now_ns, tag)]  # whatever the host's version: HELLO names the device's
            case messages.TimeRequest():
                return [messages.Time(self.device_us(now_ns), tag)]
            case messages.ConfigRead():
                found = self.store.read(request, now_ns)
                return [found if isinstance(found, messages.ConfigData) else Ack(kind, found[0], found[1], tag)]
        code, detail = self._do(request, now_ns)
        return [Ack(kind, code, detail, tag)]

    def _do(self, request: messages.Message, now_ns: int) -> Answer:
        store = self.store
        if isinstance(request, messages.ConfigBegin | messages.ConfigRollback) and self.streaming:
            return Code.STREAMING, 0
        steps: dict[type, Callable[..., Answer]] = {
            messages.Start: self._start,
            messages.Stop: self._stop,
            messages.SetMode: self._set_mode,
            messages.Restart: self._restart,
            messages.ConfigBegin: store.begin,
            messages.ConfigWrite: store.write,
            messages.ConfigVerify: store.verify,
            messages.ConfigCommit: store.commit,
            messages.ConfigConfirm: store.confirm,
            messages.ConfigRollback: store.rollback,
            messages.ConfigAbort: store.abort,
        }
        return steps[type(request)](request, now_ns)

    def _start(self, request: messages.Start, now_ns: int) -> Answer:
        if self.script_start_ns is None:
            self.script_start_ns = now_ns
        self.streaming, self._first = True, True
        self._left, self._dropped = request.frames, 0
        return Code.OK, self.sequence

    def _stop(self, request: messages.Stop, now_ns: int) -> Answer:
        self.streaming = False
        return Code.OK, self.sequence

    def _set_mode(self, request: messages.SetMode, now_ns: int) -> Answer:
        idle = request.mode == Mode.IDLE
        if request.mode not in (Mode.ACTIVE, Mode.IDLE) or (idle and not self.store.configuration.idle_drives):
            return Code.BAD_VALUE, request.mode
        self._idle = idle
        self._arrange()
        return Code.OK, request.mode

    def _restart(self, request: messages.Restart, now_ns: int) -> Answer:
        code, detail = self.store.may_restart(request.token, now_ns)
        if code == Code.OK:
            self.streaming = False
            self._restart_ns = now_ns + RESTART_NS
        return code, detail


_REQUESTS: Final = {int(kind.LAYOUT.type): kind for kind in messages.PLAIN if kind.LAYOUT.type < MessageType.HELLO}
