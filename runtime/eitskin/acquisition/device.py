"""A device on a line: its identity, starting and stopping its stream, and finding it again after a reset.

The handshake refuses a device of another protocol, table or grid before a frame is read. Requests carry a tag and are
repeated until their own answer comes, since the line may lose either. ::

    HELLO_REQUEST -> HELLO: protocol, ids, serial number, configuration, rows, volts per count
    TIME_REQUEST  -> TIME                                            a few times; the quickest counts
    START         -> ACK, FRAME, FRAME, ...                          frames before the ACK belong to an older stream
    (silence)     -> HELLO_REQUEST: the same serial number and configuration -> START, else refuse

The device's clock in terms of the host's: when was this frame scanned?

A frame is read some delay after it was scanned; the delay varies, but is never negative. The smallest difference
between host and device clock over a second therefore comes from a frame that hardly waited, and the line through the
last such minima gives offset and drift::

    host - device |  x   x
                  | x  x   x  x      minima of each second, and a line through them
                  |___o______o____
                  |..a............   from TIME: the line minus the shortest delay
                  +---------------- device time

The shortest delay itself (encoding, the time on the wire) cannot be seen in frames alone. A question for the device's
time shows it: the answer was made between asking and hearing, so the offset is known to half the round trip. The
distance of the line above it is the shortest delay of a frame, and is subtracted.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eitskin.acquisition.greeting import check_same, check_usable
from eitskin.acquisition.transport import Transport
from eitskin.errors import NotReady, PortLost, PortReturned
from eitskin_proto.skin.skin import Skin
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, HelloFlag, MessageType, Mode
from eitskin_proto.wire.framing import MAX_PAYLOAD, Deframer, encode
from eitskin_proto.wire.messages import Ack, Hello, Time
from eitskin_proto.wire.volts import unpack_hello

WINDOW_US: Final = 1_000_000
"""One minimum is kept a second."""

WINDOWS: Final = 16
"""Minima that the line goes through; a crystal's drift is steady over 16 s."""

MAX_DRIFT: Final = 1e-3
"""No crystal is off by more than 1000 ppm; a steeper line means too few or disturbed minima."""

MODULUS_US: Final = 1 << 32
"""The device's clock on the wire wraps."""


@dataclass(frozen=True, slots=True)
class TimeSample:
    """One answer to a question for the device's time."""

    device_us: int
    """u32 of the answer."""
    asked_ns: int
    """``perf_counter_ns`` before the question was written."""
    heard_ns: int
    """When the answer was in hand."""

    @property
    def round_trip_ns(self) -> int:
        """Between question and answer."""
        return self.heard_ns - self.asked_ns


class DeviceClock:
    """Estimates when a frame was scanned, on the host's ``perf_counter_ns``."""

    __slots__ = (
        "_anchor", "_anchor_elapsed_us", "_anchor_ns", "_drift", "_minima", "_offset_ns", "_origin_us", "_shift_ns",
        "_window_best", "_window_end_us",
    )  # fmt: skip

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque(maxlen=WINDOWS)
        self._anchor: TimeSample | None = None
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after a reset of the device; a sample that is still unused belongs to its new clock."""
        self._minima.clear()
        self._origin_us = -1
        self._window_end_us = 0
        self._window_best = (0.0, 0.0)
        self._offset_ns = 0.0
        self._drift = 0.0
        self._anchor_elapsed_us = 0
        self._anchor_ns: float | None = None
        self._shift_ns = 0.0

    def anchor(self, sample: TimeSample | None) -> None:
        """Take an answer of the device, asked just before its stream; None if it gave none."""
        self._anchor = sample

    @property
    def drift_ppm(self) -> float:
        """By how much the host's clock runs faster than the device's."""
        return self._drift * 1e6

    @property
    def shortest_delay_us(self) -> float | None:
        """Shortest time from the end of a scan to its last byte; None without a time request."""
        return None if self._anchor_ns is None else self._shift_ns / 1000

    def scanned_ns(self, device_us: int, read_ns: int) -> int:
        """Return when a frame was scanned, never later than it was read.

        Args:
            device_us: Unwrapped device time of the frame.
            read_ns: When its last byte was read.
        """
        if self._origin_us < 0:
            self._origin_us = device_us
            self._window_end_us = device_us + WINDOW_US
            self._window_best = (0.0, float(read_ns - device_us * 1000))
            self._offset_ns = self._window_best[1]
        if self._anchor is not None:
            self._hook(self._anchor, device_us)
        elapsed_us = device_us - self._origin_us
        difference = float(read_ns - device_us * 1000)
        if difference < self._window_best[1]:
            self._window_best = (float(elapsed_us), difference)
        if device_us >= self._window_end_us:
            self._close_window(device_us, elapsed_us, difference)
        line = self._offset_ns + self._drift * elapsed_us * 1000.0
        if difference < line:  # faster than every frame before: the line was too high
            self._offset_ns -= line - difference
            line = difference
            self._measure_shift()
        return device_us * 1000 + int(line - self._shift_ns)

    def _hook(self, sample: TimeSample, device_us: int) -> None:
        """Relate a sample to the first frame after it; between the two the u32 may have wrapped once."""
        self._anchor = None
        sampled_us = device_us - (device_us - sample.device_us) % MODULUS_US
        self._anchor_elapsed_us = sampled_us - self._origin_us
        self._anchor_ns = (sample.asked_ns + sample.heard_ns) / 2 - sampled_us * 1000.0
        self._measure_shift()

    def _measure_shift(self) -> None:
        """Compare the line with the sample, while the line still passes where the sample was taken."""
        if self._anchor_ns is not None and len(self._minima) < WINDOWS:
            there = self._offset_ns + self._drift * self._anchor_elapsed_us * 1000.0
            self._shift_ns = max(0.0, there - self._anchor_ns)

    def _close_window(self, device_us: int, elapsed_us: int, difference: float) -> None:
        self._minima.append(self._window_best)
        self._window_end_us = device_us + WINDOW_US
        self._window_best = (float(elapsed_us), difference)
        count = len(self._minima)
        mean_t = sum(t for t, _ in self._minima) / count
        mean_d = sum(d for _, d in self._minima) / count
        spread = sum((t - mean_t) ** 2 for t, _ in self._minima)
        slope = sum((t - mean_t) * (d - mean_d) for t, d in self._minima) / (spread * 1000.0) if spread else 0.0
        steady = count >= WINDOWS // 2 and abs(slope) <= MAX_DRIFT
        self._drift = slope if steady else 0.0
        # The line touches the lowest minimum from below, so that no frame is scanned after it was read.
        self._offset_ns = min(d - self._drift * t * 1000.0 for t, d in self._minima)
        self._measure_shift()


HANDSHAKE_S: Final = 4.0
"""How long a device may take to answer; one that boots when its port is opened needs two seconds."""

RETRY_S: Final = 0.4
"""After which a request is sent again."""

SILENCE_S: Final = 1.0
"""After this time, and 20 frame periods, without a frame the device is greeted again."""

IDLE_SILENCE_S: Final = 5.0
"""The same in the idle mode."""

LEAVE_S: Final = 0.2
"""Longest wait for the device to confirm STOP on closing; it stops without, too."""

TIME_QUESTIONS: Final = 5
"""Number of time requests before each stream; the shortest round trip bounds the clock best."""

TIME_ANSWER_S: Final = 0.1
"""Longest wait for TIME; a device that misses it is not asked again, since the answer only refines ages."""


class Device:
    """A device that answered; the transport stays the caller's to close.

    Args:
        transport: An open line.
        skin: The skin for which the device must be configured, if it states one; None for any.

    Raises:
        HandshakeError: The device did not answer, or measures in a way this runtime cannot use.
        ProtocolError: It speaks another major version.
        MismatchError: It was built for another protocol_id, or is configured for another skin.
        PortLost: The line is gone.
    """

    def __init__(self, transport: Transport, skin: Skin | None = None) -> None:
        self.transport, self._skin = transport, skin
        self.deframer = Deframer(getattr(transport, "largest_payload", MAX_PAYLOAD))
        self.read_ns = 0
        """``perf_counter_ns`` when the bytes behind the last ``payloads`` were in hand."""
        self.held: deque[bytes] = deque()
        """Payloads that arrived after the expected one or were not consumed; ``payloads`` returns them first."""
        self.idle = False
        """It scans a few drives only, at a rate that HELLO does not state."""
        self.stopping = False
        """Stop waiting for answers; another thread may set it, and then wakes the transport."""
        self._tag = 0
        self._returned: PortReturned | None = None
        self.hello = self._greeted()
        """The device's last HELLO."""
        self.time_sample: TimeSample | None = None
        """Its clock, asked just before the stream was started; None if it gave no answer."""

    @property
    def configuration(self) -> str:
        """Name and digest of the active configuration, as frames carry it."""
        return f"{self.hello.configuration_name}/{self.hello.configuration_digest:08x}"

    @property
    def silence_s(self) -> float:
        """Time without a frame after which the stream counts as silent."""
        if self.idle:
            return IDLE_SILENCE_S
        return max(SILENCE_S, 20e3 / max(self.hello.rate_mHz, 1))

    @property
    def patience_s(self) -> float:
        """How long to wait for a device that does not answer; 0 by default."""
        return float(getattr(self.transport, "patience_s", 0.0))

    @property
    def pause_s(self) -> float:
        """How long after the last frame the next one is due by plan, as in a recording with a gap; 0 for a device."""
        return float(getattr(self.transport, "pause_s", 0.0))

    def bear(self, error: NotReady, since_ns: int) -> None:
        """Let the transport open the line again for a device that does not answer, while there is patience.

        Args:
            error: What the device did.
            since_ns: Since when, on ``perf_counter_ns``.

        Raises:
            NotReady: The patience is over.
            PortReturned: The line is open again.
            PortLost: It did not come back in time.
        """
        if (time.perf_counter_ns() - since_ns) * 1e-9 < self.patience_s:
            self.transport.reopen()  # type: ignore[attr-defined]  # a patient transport can
        elif self.patience_s > 0:
            raise NotReady(f"no frame within {self.patience_s:g} s of --reconnect: {error}") from error
        else:
            raise error

    def payloads(self, timeout_s: float | None = None) -> list[bytes]:
        """Return the intact payloads that have arrived, waiting for bytes.

        Args:
            timeout_s: How long to wait; None waits until something comes or the transport is cancelled.

        Raises:
            PortLost: The line is gone.
            PortReturned: It vanished and is open again.
        """
        if self._returned is not None:
            returned, self._returned = self._returned, None
            raise returned
        if self.held:
            held = list(self.held)
            self.held.clear()
            self.read_ns = time.perf_counter_ns()
            return held
        data = self.transport.read(timeout_s)
        self.read_ns = time.perf_counter_ns()
        return self.deframer.feed(data)

    def start(self) -> None:
        """Start streaming whole scans; earlier bytes are discarded.

        Raises:
            NotReady: The device refused or did not answer.
        """
        if self.hello.flags & HelloFlag.IDLE or self.idle:
            self._request(messages.SetMode(self._next_tag(), Mode.ACTIVE))
            self.idle = False
        self.time_sample = self.ask_time()
        self._request(messages.Start(self._next_tag()))

    def ask_time(self) -> TimeSample | None:
        """Return the device's clock from the quickest of a few questions; None if one was not answered in time.

        Raises:
            PortLost: The line is gone.
        """
        best: TimeSample | None = None
        for _ in range(TIME_QUESTIONS):
            tag = self._next_tag()

            def answers(payload: bytes, tag: int = tag) -> bool:
                return payload[0] == MessageType.TIME and len(payload) == Time.LAYOUT.size and payload[1] == tag

            asked_ns = time.perf_counter_ns()
            payload = self._exchange(encode(messages.TimeRequest(tag).pack()), answers, TIME_ANSWER_S)
            if payload is None:
                return best
            sample = TimeSample(Time.unpack(payload).device_us, asked_ns, time.perf_counter_ns())
            if best is None or sample.round_trip_ns < best.round_trip_ns:
                best = sample
        return best

    def stop(self) -> None:
        """Stop streaming.

        Raises:
            HandshakeError: The device refused or did not answer.
        """
        self._request(messages.Stop(self._next_tag()))

    def leave(self) -> None:
        """Stop streaming, and restore the mode for the next user.

        Raises:
            SkinError: The device refused or did not answer within ``LEAVE_S``, or the line is gone.
        """
        self.stopping = False
        if getattr(self.transport, "gone", False):
            return  # there is nothing to stop, so do not wait for its return
        self._request(messages.Stop(self._next_tag()), LEAVE_S)
        if self.idle:
            self.ask_mode(Mode.ACTIVE)

    def ask_mode(self, mode: Mode) -> None:
        """Request another mode and return at once; the frames show when the device has switched.

        If the line vanished and is back, the next ``payloads`` raises it.

        Raises:
            PortLost: The line is gone, and the device is not being stopped.
        """
        self.idle = mode == Mode.IDLE
        try:
            self.transport.write(encode(messages.SetMode(self._next_tag(), mode).pack()))
        except PortReturned as returned:
            self._returned = returned
        except PortLost:
            if not self.stopping:
                raise

    def recover(self) -> None:
        """Greet the device again after silence or a reset, and stream on if nothing changed.

        Raises:
            NotReady: It does not answer, or refuses to stream.
            HandshakeError: It is another device, runs another configuration, or measures in another way.
        """
        self.deframer.reset()
        found = self._handshake()
        check_same(self.hello, found, self.transport.name)
        self.hello = found
        self.start()

    def _next_tag(self) -> int:
        self._tag = (self._tag + 1) & 0xFF
        return self._tag

    def _greeted(self) -> Hello:
        """Shake hands, again whenever the line was opened, and while there is patience for a device that boots."""
        since_ns = time.perf_counter_ns()
        while True:
            try:
                try:
                    return self._handshake()
                except NotReady as error:
                    self.bear(error, since_ns)
            except PortReturned:
                since_ns = time.perf_counter_ns()
                self.deframer.reset()

    def _handshake(self) -> Hello:
        before = self.deframer.discarded_bytes
        request = messages.HelloRequest(self._next_tag())
        packet = b"\0" + encode(request.pack())  # the delimiter ends whatever the line holds of an earlier host
        payload = self._exchange(packet, lambda payload: payload[0] == MessageType.HELLO, HANDSHAKE_S)
        if payload is None:
            noise = self.deframer.discarded_bytes - before + self.deframer.pending_bytes
            if noise:
                raise NotReady(
                    f"{self.transport.name} sends {noise} bytes that do not belong to this protocol: it is another "
                    "kind of device, or --baud is wrong; 'eitskin doctor' lists the ports"
                )
            raise NotReady(
                f"{self.transport.name} did not answer within {HANDSHAKE_S:g} s: check the power and that this is the "
                "skin; 'eitskin doctor' lists the ports"
            )
        hello = unpack_hello(payload)
        hello.check()
        if self._skin is not None:
            hello.check_skin(self._skin)
        check_usable(hello, self.transport.line_bytes_per_s)
        return hello

    def _request(
        self, message: messages.Start | messages.Stop | messages.SetMode, timeout_s: float | None = None
    ) -> None:
        kind = message.LAYOUT.type

        def answers(payload: bytes) -> bool:
            if payload[0] != MessageType.ACK or len(payload) != Ack.LAYOUT.size:
                return False
            ack = Ack.unpack(payload)
            return ack.request == kind and ack.tag == message.tag

        seconds = HANDSHAKE_S if timeout_s is None else timeout_s
        payload = self._exchange(encode(message.pack()), answers, seconds)
        if payload is None:
            raise NotReady(f"{self.transport.name} did not acknowledge {kind.name} within {seconds:g} s")
        ack = Ack.unpack(payload)
        if ack.code != Code.OK:
            raise NotReady(f"{self.transport.name} refused {kind.name}: {ack.text}")

    def _exchange(self, packet: bytes, wanted: Callable[[bytes], bool], timeout_s: float) -> bytes | None:
        end = time.perf_counter() + timeout_s
        repeat = 0.0
        while (now := time.perf_counter()) < end and not self.stopping:
            if now >= repeat:
                self.transport.write(packet)
                repeat = now + RETRY_S
            payloads = self.deframer.feed(self.transport.read(min(end, repeat) - now))
            for index, payload in enumerate(payloads):
                if wanted(payload):
                    self.held.clear()
                    self.held.extend(payloads[index + 1 :])
                    return payload
        return None
