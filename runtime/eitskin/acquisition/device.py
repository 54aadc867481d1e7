"""A skin at the end of a line: who it is, starting and stopping its stream, and finding it again after a reset.

The handshake is the gate: a device of another protocol, table or grid is refused before one frame is read. Requests
carry a tag and are repeated until their own answer comes, since the line may lose either. ::

    HELLO_REQUEST -> HELLO: protocol, ids, serial number, configuration, rows, volts per count
    TIME_REQUEST  -> TIME                                            a few times; the quickest counts
    START         -> ACK, FRAME, FRAME, ...                          frames before the ACK belong to an older stream
    (silence)     -> HELLO_REQUEST: the same serial number and configuration -> START, else refuse
"""

import time
from collections import deque
from typing import Final, Protocol

from eitskin.acquisition.clock import TimeSample
from eitskin.acquisition.greeting import check_same, check_usable
from eitskin.acquisition.transport import Transport
from eitskin.errors import NotReady, PortLost, PortReturned
from eitskin_proto.skin.skin import Skin
from eitskin_proto.wire import requests
from eitskin_proto.wire.answers import Ack, Hello, Time
from eitskin_proto.wire.codes import Code, HelloFlag, MessageType, Mode
from eitskin_proto.wire.framing import Deframer, encode

HANDSHAKE_S: Final = 4.0
"""How long a device may take to answer; one that boots when its port is opened needs two seconds."""

RETRY_S: Final = 0.4
"""After which a request is sent again."""

SILENCE_S: Final = 1.0
"""A stream that is silent for so long, and for 20 frames, is looked after."""

IDLE_SILENCE_S: Final = 5.0
"""The same in the idle mode."""

LEAVE_S: Final = 0.2
"""How long who leaves waits for the device's word that it stopped: it stops without, too."""

TIME_QUESTIONS: Final = 5
"""Asked before each stream; the shortest round trip bounds the clock best."""

TIME_ANSWER_S: Final = 0.1
"""A device that does not answer this question within this time is not asked again: it only makes ages better."""


class Wanted(Protocol):
    """Whether a payload is the one that is waited for."""

    def __call__(self, payload: bytes, /) -> bool:
        """Return whether it is."""


class Device:
    """A device that answered; the transport stays the caller's to close.

    Args:
        transport: An open line.
        skin: What the device must be configured for, if it says; None for any.

    Raises:
        HandshakeError: Nobody answered, or the device measures in a way this runtime cannot use.
        ProtocolError: It speaks another major version.
        MismatchError: It was built for another protocol_id, or is configured for another skin.
        PortLost: The line is gone.
    """

    def __init__(self, transport: Transport, skin: Skin | None = None) -> None:
        self.transport, self._skin = transport, skin
        self.deframer = Deframer()
        self.read_ns = 0
        """``perf_counter_ns`` when the bytes behind the last ``payloads`` were in hand."""
        self.held: deque[bytes] = deque()
        """Payloads that came behind the one that was waited for, or that their taker left: ``payloads`` has them."""
        self.idle = False
        """It scans a few drives only, at a rate that HELLO does not tell."""
        self.stopping = False
        """Nobody waits for answers any more; may be set from another thread, which then wakes the transport."""
        self._tag = 0
        self._returned: PortReturned | None = None
        self.hello = self._greeted()
        """What the device said about itself."""
        self.time_sample: TimeSample | None = None
        """Its clock, asked just before the stream was started; None if it gave no answer."""

    @property
    def configuration(self) -> str:
        """Name and digest of the active configuration, as frames carry it."""
        return f"{self.hello.configuration_name}/{self.hello.configuration_digest:08x}"

    @property
    def silence_s(self) -> float:
        """How long without a frame is too long."""
        if self.idle:
            return IDLE_SILENCE_S
        return max(SILENCE_S, 20e3 / max(self.hello.rate_mHz, 1))

    @property
    def patience_s(self) -> float:
        """How long a device that does not answer is waited for; 0 where nobody asked for that."""
        return float(getattr(self.transport, "patience_s", 0.0))

    @property
    def pause_s(self) -> float:
        """How long after the last frame the next one is due by plan, as in a recording with a gap; 0 for a device."""
        return float(getattr(self.transport, "pause_s", 0.0))

    def reopen(self) -> None:
        """Close the line and open it anew, where the transport can; whoever hangs behind it may come to.

        Raises:
            PortReturned: The line is open again.
            PortLost: It did not come back in time.
        """
        again = getattr(self.transport, "reopen", None)
        if again is not None:
            again()

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
        """Start streaming whole scans; what was sent before is thrown away.

        Raises:
            NotReady: The device refused or did not answer.
        """
        if self.hello.flags & HelloFlag.IDLE or self.idle:
            self._request(requests.SetMode(self._next_tag(), Mode.ACTIVE))
            self.idle = False
        self.time_sample = self.ask_time()
        self._request(requests.Start(self._next_tag()))

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
            payload = self._exchange(encode(requests.TimeRequest(tag).pack()), answers, TIME_ANSWER_S)
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
        self._request(requests.Stop(self._next_tag()))

    def leave(self) -> None:
        """Stop streaming, and let whoever comes next find the mode as it was.

        Raises:
            SkinError: The device refused or did not answer within ``LEAVE_S``, or the line is gone.
        """
        self.stopping = False
        if getattr(self.transport, "gone", False):
            return  # there is nothing to stop, and nobody waits for it to come back
        self._request(requests.Stop(self._next_tag()), LEAVE_S)
        if self.idle:
            self.ask_mode(Mode.ACTIVE)

    def ask_mode(self, mode: Mode) -> None:
        """Ask for another mode and return at once; the frames say when it has come about.

        If the line vanished and is back, the next ``payloads`` says so.

        Raises:
            PortLost: The line is gone, and nobody stops.
        """
        self.idle = mode == Mode.IDLE
        try:
            self.transport.write(encode(requests.SetMode(self._next_tag(), mode).pack()))
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
        """Shake hands, and once more whenever the line vanished and is back."""
        while True:
            try:
                return self._handshake()
            except PortReturned:
                self.deframer.reset()

    def _handshake(self) -> Hello:
        before = self.deframer.discarded_bytes
        request = requests.HelloRequest(self._next_tag())
        packet = b"\0" + encode(request.pack())  # the delimiter ends whatever the line holds of an earlier host
        payload = self._exchange(packet, lambda payload: payload[0] == MessageType.HELLO, HANDSHAKE_S)
        if payload is None:
            noise = self.deframer.discarded_bytes - before + self.deframer.pending_bytes
            if noise:
                raise NotReady(
                    f"{self.transport.name} sends {noise} bytes that are no packets of this protocol: another kind of "
                    "device, or another baud rate; 'eitskin doctor' lists the ports"
                )
            raise NotReady(
                f"{self.transport.name} did not answer within {HANDSHAKE_S:g} s: check the power and that this is the "
                "skin; 'eitskin doctor' lists the ports"
            )
        hello = Hello.unpack(payload)
        hello.check()
        if self._skin is not None:
            hello.check_skin(self._skin)
        check_usable(hello, self.transport.line_bytes_per_s)
        return hello

    def _request(
        self, message: requests.Start | requests.Stop | requests.SetMode, timeout_s: float | None = None
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

    def _exchange(self, packet: bytes, wanted: Wanted, timeout_s: float) -> bytes | None:
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
