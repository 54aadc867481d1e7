"""Feeds the verifier from the frame loop: called after each published frame, and never waits.

The newest changed frame waits here until the verifier has answered the one before; those in between are skipped and
counted. The verifier's answers go to the subscribers. ::

    always    each frame whose map is another one
    idle      such a frame once the next shows no further change: touches at rest, not moving ones
"""

import math
import socket
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, Final

import numpy as np

from eitskin.errors import SkinError
from eitskin.frame_record import PUBLISH, READ, FrameRecord
from eitskin.messaging.publish import Publisher
from eitskin.messaging.streams.verified import FAILED, PREPARING, READY, STARTING, WAITING, pack_head, pack_verdict
from eitskin.model.stillness import Stillness
from eitskin.reference.captured import Reference
from eitskin.skin import Skin
from eitskin_proto.skin.toml import to_toml
from eitskin_sim.scene.family import is_family
from eitskin_tools.evaluation.verified.untouched_baseline import BASELINE_FRAMES, UntouchedBaseline
from eitskin_tools.verifier.child import VerifierProcess
from eitskin_tools.verifier.letters import (
    BUDGET_S,
    LARGEST_PACKET,
    SHAPE,
    STATE,
    Array,
    BaselineLetter,
    FrameLetter,
    Rows,
    Setup,
    packed,
    unpack,
)

REPEAT_NS: Final = 1_000_000_000
"""After which it is said again how the verifier is."""

RECEIVE_NS: Final = 50_000_000
"""Between two looks for what a verifier says of itself, while no verdict is waited for."""

MAX_DURATIONS: Final = 2000
"""Verdicts whose times are kept."""

LATE_NS: Final = 5_000_000_000
"""A frame that takes so much more than its budget is reported as late; models of a new shape take some seconds."""

LATE_REASON: Final = "it computes for too long; if it hangs, it is killed and restarted"
"""Said meanwhile."""


class VerifierFeed:
    """Hands frames to a verifier, and its verdicts to subscribers.

    Args:
        skin: Open.
        publisher: Bound.
        process: The verifier's.
        mode: "always" or "idle".
        budget_s: What a frame may take.
        cloud: "scan", where none came or it explains no frame that of the frames; "fitted", always that; or "flat".
        gives_shapes: Whether the skin's network gets the shapes that are found in frames.
    """

    def __init__(
        self,
        skin: Skin,
        publisher: Publisher,
        process: VerifierProcess,
        mode: str,
        budget_s: float = BUDGET_S,
        cloud: str = "flat",
        *,
        gives_shapes: bool = True,
    ) -> None:
        self._skin, self._publisher, self._process, self._cloud = skin, publisher, process, cloud
        self.mode, self._budget_s = mode, budget_s
        self._pipeline = skin.pipeline
        self._nothing_missing = np.zeros(len(skin.pipeline.buffers.change[0]), dtype=np.bool_)
        self._stillness = Stillness()
        self._baseline = UntouchedBaseline()
        self._giver = ThreadPoolExecutor(1, "eitskin-shape") if gives_shapes else None
        self._candidate: bytes | None = None
        self._is_due = False
        """Whether the candidate is to be verified as soon as the verifier has no other."""
        self._is_busy = False
        """Whether the verifier has a frame."""
        self._sent_ns = 0
        self._is_late = False
        """Whether that frame takes longer than it may."""
        self._setup_for: tuple[object, Reference | None] = (None, None)
        self._setup = 0
        self._setup_packet = b""
        """What is still to be sent of the setup."""
        self._line: socket.socket | None = None
        self._verifier = STARTING, ""
        self._reported = "", ""
        self._reported_ns = self._receive_ns = self._number = 0
        self._is_wanted = False
        self.counts = {"checked": 0, "flagged": 0, "skipped": 0}
        self._spent_ms: deque[float] = deque(maxlen=MAX_DURATIONS)
        self._setup_ms = 0.0

    @property
    def state(self) -> tuple[str, str]:
        """How the verifier is, and what is wrong."""
        process = self._process
        if process.state in (WAITING, FAILED):
            return process.state, process.why
        return (self._verifier[0], LATE_REASON) if self._is_late else self._verifier

    def after_frame(self, record: FrameRecord) -> None:
        """Take the frame that has just gone out."""
        process, buffers = self._process, self._pipeline.buffers
        if process.line is not self._line:  # another process: it knows nothing
            if self._line is not None:
                self._line.close()  # in the thread that reads it
                if self._reported[0] != WAITING:  # the pause was shorter than what passed between two looks
                    self._report(record, (WAITING, process.ended))
            self._line, self._verifier, self._receive_ns = process.line, (STARTING, ""), 0
            self._is_busy, self._setup_for = False, (None, None)
            self._stillness.reset()
        geometry, (last, reference) = buffers.geometry, self._setup_for
        is_known = geometry is last or self._cloud != "scan" or (geometry is not None and geometry.why == "fitted")
        if not is_known or self._skin.reference is not reference:
            self._send_setup()
            self._report(record)  # before the answer, which may be quick
        if self._publisher.verified != self._is_wanted:
            self._is_wanted, self._reported_ns, self._receive_ns = self._publisher.verified, 0, 0
            self._withdraw()
        if self._is_wanted:
            self._consider(record)
        now_ns = record.stamps[PUBLISH]
        if self._is_busy or now_ns >= self._receive_ns:
            self._receive_ns = now_ns + RECEIVE_NS
            self._receive()
            self._is_late = self._is_busy and now_ns - self._sent_ns > self._budget_s * 1e9 + LATE_NS
            self._report(record)
        if self._setup_packet and self._send(self._setup_packet):
            self._setup_packet = b""
        if self._is_due and not self._is_busy and self._verifier[0] == READY and not self._setup_packet:
            assert self._candidate is not None
            if self._send(self._candidate):
                self._candidate, self._is_due, self._is_busy, self._sent_ns = None, False, True, now_ns

    def _consider(self, record: FrameRecord) -> None:
        if not record.touched or record.map_is_zero:
            self._withdraw()
            if not (record.touched or record.idle):  # an idle frame leaves dV as the last whole one had it
                self._send_baseline()
                return
        elif record.inferred and not self._is_known(record.fused):
            self._stillness.keep(self._pipeline.buffers.change[0], record.fused)
            self._drop()
            self._candidate = self._frame_packet(record)
            geometry = self._pipeline.buffers.geometry
            self._is_due = self.mode == "always" or (geometry is not None and bool(geometry.unlike))
        elif self._candidate is not None:
            self._is_due = True
        self._baseline.reset()

    def _send_baseline(self) -> None:
        """Tell what the untouched sheet reads, once it has been still for a while and that is news."""
        if not self._setup or self._setup_packet or self._missing.any():
            return
        if (mean := self._baseline.add(self._pipeline.buffers.change[0])) is not None:
            self._send(packed(BaselineLetter(self._setup, BASELINE_FRAMES, mean)))

    def _is_known(self, fused: int) -> bool:
        """Return whether the frame in hand is the one that was handed over last, but for noise, however long ago."""
        known = self._stillness
        return known.frames >= fused and known.still(self._pipeline.buffers.change[0], fused)

    def _withdraw(self) -> None:
        """Take back what waits: it is touched no more, or otherwise known."""
        self._drop()
        self._stillness.reset()

    @property
    def _missing(self) -> Rows:
        health = self._pipeline.health
        return self._nothing_missing if health is None else health.electrodes.missing

    def _frame_packet(self, record: FrameRecord) -> bytes:
        buffers, stamps = self._pipeline.buffers, record.stamps
        return packed(
            FrameLetter(
                self._setup, record.sequence, record.device_us, stamps[READ], stamps[PUBLISH], record.cloud,
                record.fused, self._missing, buffers.change[0], buffers.map[0],
            )
        )  # fmt: skip

    def _send(self, packet: bytes) -> bool:
        """Send a packet if there is room for it; return whether it was sent."""
        try:
            return self._line is not None and self._line.send(packet) > 0
        except (BlockingIOError, BrokenPipeError, ConnectionResetError):
            return False  # it computes, or has ended, and its process says why

    def _drop(self) -> None:
        if self._candidate is not None:
            self._candidate, self._is_due = None, False
            self.counts["skipped"] += 1

    def _send_setup(self) -> None:
        """Announce another surface or reference: the verifier makes a new model and verifies resting touches again."""
        pipeline, reference = self._pipeline, self._skin.reference
        self._setup_for = pipeline.buffers.geometry, reference
        if reference is None:
            return
        flat, step_V = reference.flat(), pipeline.step_V
        given = None if pipeline.buffers.geometry is None else pipeline.buffers.geometry.given
        skin = pipeline.skin
        cloud = None if given is None or given.is_fitted or self._cloud != "scan" else given.cloud
        self._setup += 1
        self._setup_packet = packed(
            Setup(
                self._setup, pipeline.bundle.labels, pipeline.bundle.touch_kind, to_toml(skin),
                np.asarray(skin.grid.flat_cloud_mm() if cloud is None else cloud, dtype=np.float32), flat.voltages_V,
                np.hypot(flat.spread_V, step_V / math.sqrt(12.0)),
                np.zeros((len(flat.voltages_V), 0)) if flat.shared_V is None else flat.shared_V, self._budget_s,
                cloud is None and self._cloud != "flat" and is_family(skin.deformations), self._cloud == "flat",
            )
        )  # fmt: skip
        noise = flat.voltages_V, flat.spread_V, flat.frames, step_V, flat.shared_V
        self._stillness.use_reference(*noise)
        self._baseline.start(*noise)
        self._withdraw()
        if self._verifier[0] != STARTING:
            self._verifier = PREPARING, ""

    def _receive(self) -> None:
        """Take what the verifier has answered."""
        while self._line is not None:
            try:
                packet = self._line.recv(LARGEST_PACKET)
            except (BlockingIOError, ConnectionResetError):
                return
            if not packet:
                return  # it has ended, and its process says why
            self._handle(*unpack(packet))

    def _handle(self, kind: int, *items: Any) -> None:
        if kind == STATE:
            state, setup, why, setup_ms = items
            if setup == self._setup:
                self._verifier = state, why
                self._setup_ms = setup_ms or self._setup_ms
            return
        if kind == SHAPE:
            if items[0] == self._setup and self._giver is not None:
                self._giver.submit(self._give, *items[1:])
            return
        message, flagged, spent_ms = items
        self._is_busy = False
        if flagged is None:
            self.counts["skipped"] += 1
        else:
            self.counts["checked"] += 1
            self.counts["flagged"] += flagged
            self._spent_ms.append(spent_ms)
        self._publish(message)

    def _give(self, *shape: Array) -> None:
        """Have the network use a shape, in a thread of its own; one that it refuses leaves it the shape that it has."""
        with suppress(SkinError, ValueError):
            self._skin.use_cloud(*shape, is_fitted=True)

    def _report(self, record: FrameRecord, was: tuple[str, str] | None = None) -> None:
        """Publish the verifier's state: on changes, for new subscribers, and every second."""
        found, now_ns = was or self.state, record.stamps[PUBLISH]
        if found != self._reported:
            if found[0] != self._reported[0]:
                self._pipeline.intake.add_event(f"verifier:{found[0]}")
            self._reported, self._reported_ns = found, 0
        if self._is_wanted and now_ns - self._reported_ns >= REPEAT_NS:
            self._reported_ns = now_ns
            stamps = record.stamps[READ], record.stamps[PUBLISH], 0, 0
            self._publish(pack_verdict(record.sequence, record.device_us, record.cloud, *found, stamps))

    def _publish(self, told: bytes) -> None:
        self._number += 1
        self._publisher.send_beside(pack_head(self._number, self._skin.loop.run_id, self.counts) + told)

    def status(self) -> dict[str, Any]:
        """Return how verifying goes; may be called from any thread."""
        state, why = self.state
        spent = list(self._spent_ms)
        p50, p99 = (0.0, 0.0) if not spent else map(float, np.percentile(spent, [50, 99]))
        place = self._process.place
        return {
            "mode": self.mode, "state": state, "why": why, **self.counts, "setup_ms": round(self._setup_ms, 1),
            "frame_ms_p50": round(p50, 2), "frame_ms_p99": round(p99, 2), "restarts": self._process.restarts,
            "pid": self._process.pid, "nice": place.nice, "cpus": list(place.cpus),
        }  # fmt: skip
