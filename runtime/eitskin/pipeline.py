"""One frame through decode, normalise, gate and inference, each stage stamped, nothing allocated.

The pipeline owns the memory that a frame passes through and the decisions about it; it knows no socket and no port.
What it leaves out is stated: ``inference:untouched``, ``inference:no_subscriber``, ``geometry:cloud_unchanged``. A
frame that is not fit to publish is withheld, with a reason and a count:

====================  ===============================================================
``malformed``         an intact packet that is no frame of this device
``duplicate``         the same sequence number again
``configuration``     made under another generation than HELLO named
``partial``           an idle scan of some drives only
``implausible``       dV is not finite or beyond 1e6, or the map is not finite
``stale``             over budget, and a newer frame was waiting
====================  ===============================================================
"""

import math
import time
from typing import Final

import numpy as np

from eitskin.bundle import Bundle
from eitskin.clock import DeviceClock
from eitskin.engine import Buffers, Engine, Geometry, engines
from eitskin.errors import BudgetError
from eitskin.frame import STAGES
from eitskin.gate import Gate
from eitskin.ladder import Ladder
from eitskin.normaliser import Normaliser
from eitskin.reference import Reference
from eitskin_proto.errors import ProtocolError
from eitskin_proto.frames import FrameView
from eitskin_proto.grid import N_PIXELS
from eitskin_proto.messages import Hello
from eitskin_proto.scan_rows import ALL_DRIVES
from eitskin_proto.unwrap import StreamCounter

REASONS: Final = ("malformed", "duplicate", "configuration", "partial", "implausible", "stale")
"""Why frames are withheld."""

READ, DECODE, NORMALISE, GATE, INFER, PACK, PUBLISH = range(len(STAGES))
"""Where each stage's stamp stands."""

UNTOUCHED: Final = ("inference:untouched", "geometry:cloud_unchanged")
NO_SUBSCRIBER: Final = ("inference:no_subscriber", "geometry:cloud_unchanged")
COMPUTED: Final = ("geometry:cloud_unchanged",)
COMPUTED_NEW: Final[tuple[str, ...]] = ()

WARM_UPS: Final = 30
"""Runs of each engine before the first frame; ONNX Runtime plans its memory in the first."""


class Pipeline:
    """Everything between a payload and a map.

    Args:
        bundle: The solvers.
        hello: Of the device.
        budget_ns: From read to publish; None for no budget.

    Raises:
        BundleError: A solver of the bundle cannot be used.
        BudgetError: Not even the fastest solver meets the budget.
    """

    def __init__(self, bundle: Bundle, hello: Hello, budget_ns: int | None = None) -> None:
        arrays = bundle.gate_arrays()
        self._gate = Gate(arrays) if arrays is not None else None
        self.buffers = Buffers(bundle.bias_width, None if self._gate is None else self._gate.change)
        self.engines: list[Engine] = engines(bundle, self.buffers)
        self.ladder = Ladder(budget_ns, len(self.engines))
        self.counter = StreamCounter()
        self.clock = DeviceClock()
        self.normaliser = Normaliser(hello.volts_per_count)
        self.generation = hello.generation
        """Of the configuration that frames must carry."""
        self.generation_differs = False
        """A frame carried another one: the device must be asked what it runs now."""
        self.withheld = dict.fromkeys(REASONS, 0)
        """Frames that were not fit to publish."""
        self.stamps = [0] * len(STAGES)
        """``perf_counter_ns`` at the end of each stage of this frame."""
        self.sequence = 0
        self.device_us = 0
        self.scanned_ns = 0
        """When this frame was scanned, on the host's clock."""
        self.touched = False
        self.gate_logit = 0.0
        self.solver = "none"
        self.skipped: tuple[str, ...] = ()
        self.events: tuple[str, ...] = ()
        self._next_geometry: Geometry | None = None
        self._view = FrameView()
        self._change = self.buffers.change[0]
        self._map = self.buffers.map[0]
        self.map_bytes = memoryview(self._map).cast("B")
        """The map of this frame as float32, little-endian; the next frame overwrites it."""
        self.zero_bytes = memoryview(bytes(4 * N_PIXELS))
        """What an untouched frame publishes."""
        self.engine_ns = self._warm_up()
        """{engine: median time in ns}, measured at the start."""
        if budget_ns is not None and self.engine_ns[self.engines[-1].name] > budget_ns:
            fastest = self.engines[-1].name
            raise BudgetError(
                f"a budget of {budget_ns / 1e6:g} ms cannot be met: the fastest solver, {fastest}, takes "
                f"{self.engine_ns[fastest] / 1e6:.3f} ms here; give --budget-ms more than that"
            )

    def _warm_up(self) -> dict[str, float]:
        medians = {}
        for engine in self.engines:
            spans = []
            for _ in range(WARM_UPS):
                start = time.perf_counter_ns()
                engine.infer()
                spans.append(time.perf_counter_ns() - start)
            medians[engine.name] = float(np.median(spans))
        return medians

    @property
    def map_is_zero(self) -> bool:
        """Whether this frame's map is all zero because nothing was computed."""
        return self.solver == "none"

    def greet(self, hello: Hello) -> None:
        """Take over what a device said after it was greeted anew."""
        self.generation = hello.generation
        self.generation_differs = False
        self.normaliser.use_scale(hello.volts_per_count)

    def use_reference(self, reference: Reference) -> None:
        """Normalise against a reference from the next frame on."""
        self.normaliser.use(reference.voltages_V)

    def use_geometry(self, geometry: Geometry) -> None:
        """Use a geometry from the next frame on; may be called from another thread."""
        self._next_geometry = geometry

    def accept(self, payload: bytes, read_ns: int) -> bool:
        """Decode a frame and return whether it may go on; the first half of a frame's way.

        Args:
            payload: Of a FRAME message.
            read_ns: When its last byte was in hand.
        """
        view = self._view
        try:
            view.load(payload)
        except ProtocolError:
            return self._withhold("malformed")
        step = self.counter.step(view.sequence, view.device_us)
        if step.duplicate:
            return self._withhold("duplicate")
        self.events = ()
        if step.reset:
            self.clock.restart()
            self.events = ("device_reset",)
        elif step.lost:
            self.events = ("lost",)
        if view.generation != self.generation:
            self.generation_differs = True
            return self._withhold("configuration")
        if view.drives != ALL_DRIVES:
            return self._withhold("partial")
        if view.saturation:
            self.events += ("saturated",)
        self.sequence, self.device_us = step.sequence, step.device_us
        self.scanned_ns = self.clock.scanned_ns(step.device_us, read_ns)
        self.normaliser.load(view.counts)
        self.stamps[READ] = read_ns
        self.stamps[DECODE] = time.perf_counter_ns()
        return True

    def compute(self, wanted: bool) -> bool:
        """Normalise, judge and infer the accepted frame, and return whether it is fit to publish.

        Args:
            wanted: Somebody takes frames; otherwise the gate is all that runs.
        """
        stamps = self.stamps
        geometry = self._next_geometry
        if geometry is not None:
            self._next_geometry = None
            self.buffers.take(geometry)
            self.events += ("cloud",)
        if not self.normaliser.change_into(self._change):
            return self._withhold("implausible")
        stamps[NORMALISE] = time.perf_counter_ns()
        gate = self._gate
        if gate is not None:
            self.touched = gate.touched()
            self.gate_logit = gate.logit
        else:
            self.touched = True  # without a gate every frame is computed
        stamps[GATE] = time.perf_counter_ns()
        if not self.touched or not wanted:
            self.solver = "none"
            self.skipped = NO_SUBSCRIBER if self.touched else UNTOUCHED
        else:
            engine = self.engines[self.ladder.engine]
            engine.infer()
            if not math.isfinite(np.dot(self._map, self._map)):
                return self._withhold("implausible")
            self.solver = engine.name
            self.skipped = COMPUTED if geometry is None else COMPUTED_NEW
        stamps[INFER] = time.perf_counter_ns()
        return True

    def judge(self, now_ns: int) -> None:
        """Hold the frame against the budget; an overrun is an event of this very frame."""
        if self.ladder.judge(now_ns - self.stamps[READ], inferred=self.solver != "none"):
            self.events += ("overrun",)

    def discard(self, payload: bytes) -> None:
        """Take note of a frame that is left out because a newer one waits; it is not counted as lost."""
        try:
            self._view.load(payload)
        except ProtocolError:
            self._withhold("malformed")
            return
        self.counter.step(self._view.sequence, self._view.device_us)
        self._withhold("stale")

    def _withhold(self, reason: str) -> bool:
        self.withheld[reason] += 1
        return False
