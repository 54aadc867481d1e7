"""The loop of the virtual skin's process: scans at absolute deadlines, answers in between, faults at their moments.

The first scan begins with START, and with a change of mode, and takes as long as the front end needs; each one after it
ends a period later, however late the one before it was, so the rate does not drift. A
scan that the process could not make in time is made late, with the device time at which it was due; what is more than
``MAX_DELAY_NS`` behind is skipped and counted as dropped by the device. The loop waits in ``select`` and nowhere else.

``wire_ns[sequence % len(wire_ns)]`` takes the host clock just before the one system call that puts a frame's bytes on
the wire: the moment from which latency is counted. The call itself (about 10 us for a pseudo-terminal) is therefore
counted too. The time is negative where the line had no room for the whole frame.
"""

import math
import os
import select
from collections.abc import Callable
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.faults import Fault, FaultPlayer
from eitskin_tools.virtual_skin.pty import PtyPort

MAX_DELAY_NS: Final = 200_000_000
"""Scans that are due for longer than this are skipped."""

ANSWER_TIMEOUT_S: Final = 0.5
"""How long an answer waits for a host that does not read."""

MAX_WAIT_S: Final = 0.5
"""How long it waits at most: a signal that comes just before a wait does not end that one."""

Log = Callable[[dict[str, Any]], None]


def wire_times(path: Path, capacity: int) -> npt.NDArray[np.int64]:
    """Return a new file of host times in ns, one a sequence number, mapped into memory; 0 where no frame was sent."""
    return np.lib.format.open_memmap(path, mode="w+", dtype=np.int64, shape=(capacity,))


class SkinServer:
    """Runs one virtual device behind one port.

    Args:
        device: The state machine.
        port: Where its bytes go; the caller closes it. A test gives another line of the same methods.
        player: The faults.
        wire_ns: (capacity,) takes the time of every frame, see above.
        log: Takes an event as a flat object: boot, start, fault.
        clock: Host clock in ns.
    """

    def __init__(
        self,
        device: VirtualDevice,
        port: PtyPort,
        player: FaultPlayer | None = None,
        wire_ns: npt.NDArray[np.int64] | None = None,
        log: Log | None = None,
        clock: Callable[[], int] = perf_counter_ns,
    ) -> None:
        self.device = device
        self.port = port
        self.player = player or FaultPlayer()
        self.sent = 0
        """Frames that went onto the wire, whole."""
        self._wire_ns = wire_ns
        self._log = log or (lambda _: None)
        self._clock = clock
        self._deadline_ns = 0.0
        self._late: list[tuple[int, bytes]] = []
        self._resume_ns = 0
        self._replug_ns = 0
        self._logged = 0
        self._boots = device.boots
        self._stopped = False
        self._wake = -1

    def run(self, until_ns: int | None = None) -> None:
        """Serve until the clock shows ``until_ns``, or for ever."""
        self._log_event("boot", self._clock())
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        try:
            while not self._stopped:
                now = self._clock()
                if until_ns is not None and now >= until_ns:
                    return
                self.turn(now)
                self._wait(until_ns)
        finally:
            wake, self._wake = self._wake, -1
            os.close(wake)

    def stop(self) -> None:
        """End :meth:`run`, whatever it waits for; safe from another thread."""
        self._stopped = True
        if self._wake >= 0:
            os.eventfd_write(self._wake, 1)

    def next_ns(self) -> int:
        """Return when :meth:`turn` has something to do, on the host's clock; 0 if only the host's bytes can tell."""
        moments = [self._replug_ns, self.device.next_ns]
        moments += [due for due, _ in self._late[:1]]
        if self.device.streaming:
            moments.append(max(math.ceil(self._deadline_ns), self._resume_ns))  # rounded down, it would be too early
        return min((moment for moment in moments if moment), default=0)

    def _wait(self, until_ns: int | None) -> None:
        moments = [moment for moment in (until_ns, self.next_ns()) if moment]
        timeout_s = min(max(min(moments) - self._clock(), 0) * 1e-9, MAX_WAIT_S) if moments else MAX_WAIT_S
        ports = [self.port.fileno()] if self.port.plugged else []
        select.select([*ports, self._wake], ports if self.port.unsent else [], [], timeout_s)

    def turn(self, now: int) -> None:
        """Do everything that is due: plug, answers, scans, restarts."""
        device = self.device
        if self._replug_ns and now >= self._replug_ns:
            self._replug_ns = 0
            self.port.plug()
            self._log_event("plug", now)
        if self.port.unsent:
            self.port.flush()
        while self._late and now >= self._late[0][0]:
            self.port.write_all(self._late.pop(0)[1], ANSWER_TIMEOUT_S)
        self._listen(now)
        if device.next_ns and now >= device.next_ns:
            self._poll(now)
        while device.streaming and self._deadline_ns <= now and self._resume_ns <= now:
            behind = int((now - self._deadline_ns - MAX_DELAY_NS) // device.period_ns)
            if behind > 0:
                device.skip(behind)
                self._deadline_ns += behind * device.period_ns
            due_ns = int(self._deadline_ns)
            self._deadline_ns += device.period_ns
            self._scan(due_ns)
            now = self._clock()
            self._listen(now)
        for injected in self.player.injected[self._logged :]:
            self._log_event("fault", now, kind=injected.kind, time_s=round(injected.time_s, 6), detail=injected.detail)
        self._logged = len(self.player.injected)

    def _listen(self, now: int) -> None:
        data = self.port.read()
        if not data:
            return
        now = max(now, self._clock())  # the process may have rested since the turn began: bytes met no device of then
        device = self.device
        streaming, rate, first = device.streaming, device.rate_mHz, device.script_start_ns is None
        packets, late_s = self.player.answers(device.receive(data, now), self._time_s(now))
        if late_s and packets:
            self._late.append((now + int(late_s * 1e9), b"".join(packets)))
        elif packets:
            self.port.write_all(b"".join(packets), ANSWER_TIMEOUT_S)
        if device.streaming and (not streaming or device.rate_mHz != rate):
            self._deadline_ns = now + device.scan_ns
            if first:
                self._log_event("start", now, script_time_s=0.0)

    def _poll(self, now: int) -> None:
        """Let the device send its events, and restart it if that is due."""
        packets = self.device.poll(now)
        if packets:
            self.port.write_all(b"".join(packets), ANSWER_TIMEOUT_S)
        if self.device.boots != self._boots:
            self._booted(now)

    def _scan(self, due_ns: int) -> None:
        device, time_s = self.device, self._time_s(due_ns)
        faults = self.player.due(time_s)
        overdriven = sum(int(fault.amount) for fault in faults if fault.kind == "saturate")
        sequence = device.sequence
        packet = device.sweep(due_ns, overdriven, self.player.front_end(time_s))
        for fault in faults:
            packet = self._play(fault, packet, time_s)
        if not packet:
            return
        before_ns = self._clock()
        self._record_wire_time(sequence, before_ns)  # first: a receiver finds it, even if this process ends at once
        if self.port.write(packet):
            self.sent += 1
        else:
            self._record_wire_time(sequence, -before_ns)
            device.drop()

    def _record_wire_time(self, sequence: int, wire_ns: int) -> None:
        if self._wire_ns is not None:
            self._wire_ns[sequence % len(self._wire_ns)] = wire_ns

    def _play(self, fault: Fault, packet: bytes, time_s: float) -> bytes:
        """Return what is left of a packet; starts faults that last."""
        now, lasts_ns = self._clock(), int(fault.amount * 1e9)
        match fault.kind:
            case "stall":
                self._resume_ns = now + lasts_ns
                self._deadline_ns = self._resume_ns + self.device.period_ns
            case "unplug":
                self.port.unplug()
                self._replug_ns = now + lasts_ns
            case "reset":
                self.port.write(packet[: len(packet) // 2])
                self.device.boot(now)
                self._booted(now)
                packet = b""
            case "saturate" | "frozen" | "stuck" | "failing":
                pass
            case _:
                return self.player.damage(packet, fault, time_s)
        self.player.note(fault, time_s, f"{fault.amount:g}")
        return packet

    def _booted(self, now: int) -> None:
        self._boots = self.device.boots
        self._log_event("boot", now)
        if self.port.restart_s and self.port.plugged:
            self.port.unplug()
            self._replug_ns = now + int(self.port.restart_s * 1e9)

    def _time_s(self, now_ns: int) -> float:
        start = self.device.script_start_ns
        return 0.0 if start is None else (now_ns - start) * 1e-9

    def _log_event(self, event: str, now: int, **more: object) -> None:
        self._log({"event": event, "host_ns": now, "device_us": self.device.device_us(now), **more})
