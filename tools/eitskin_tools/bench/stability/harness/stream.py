"""One pipeline of the runtime, fed with frames as the wire brings them, that shows what would be published.

Samples become counts of a device with 32-bit converters, packed as FRAME payloads; the pipeline decodes, normalises,
judges and infers, and the map is taken from where the runtime takes it. Every published map is counted.
"""

import time
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.monitor import health_of
from eitskin.model.buffers import Engine
from eitskin.model.bundle import Bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import Geometry, GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin.reference.predicted import log_ratio
from eitskin_proto.wire.frames import Frame, full_scale, quantise
from eitskin_proto.wire.messages import Hello
from eitskin_sim.evaluation.harness import Sheet
from eitskin_sim.surface.predict import flat_voltages
from eitskin_tools.bench.stability.harness.samples import Sample
from eitskin_tools.bench.stability.harness.tally import Tally

Array = npt.NDArray[np.float64]

SAMPLE_BYTES: Final = 4

HELLO: Final = Hello(
    firmware_version=(1, 0, 0),
    hardware_id=1,
    serial_number="STRESS-0001",
    configuration_digest=0,
    generation=0,
    configuration_name="stress",
    rate_mHz=200_000,
    rows=104,
    sample_bytes=SAMPLE_BYTES,
    volts_per_count=1e-9,
)
"""The device that the samples are of."""


class Stream:
    """A pipeline and the device before it.

    Args:
        bundle: The solvers.
        tally: Counts what is published.
        gated: With the bundle's gate; without it every frame is computed.
    """

    def __init__(self, bundle: Bundle, tally: Tally, *, gated: bool) -> None:
        if not gated:
            files = {name: data for name, data in bundle.files.items() if name != "gate.npz"}
            bundle = replace(bundle, files=files)
        self.bundle, self.tally = bundle, tally
        self.pipeline = Pipeline(bundle, HELLO, health=health_of(bundle))
        self._engines = {engine.name: engine for engine in engines(bundle, self.pipeline.buffers)}
        self._graph = GeometryGraph(bundle)
        self._sequence = 0
        self._cloud: Array | None = None
        self._geometries: dict[int, tuple[Array, Geometry]] = {}
        """By the cloud, which is kept beside it so that its id is not given away again."""
        self._reference: Array = np.zeros(0)
        self._volts_per_count = 0.0

    @property
    def engines(self) -> tuple[str, ...]:
        """The names that :meth:`show` takes, the most accurate first."""
        return tuple(self._engines)

    def show(self, sample: Sample, engine: str = "vd2t") -> Array | None:
        """Return the (rows, columns) map that is published of a sample, None if the frame is withheld.

        Args:
            sample: Its voltages beyond full scale are cut off and marked.
            engine: Which computes it.
        """
        self._prepare(sample)
        pipeline = self.pipeline
        pipeline.engines[0] = self._engines[engine]
        counts, saturation = quantise(sample.voltages, self._volts_per_count, SAMPLE_BYTES)
        for _ in range(sample.held):
            if self._passes(counts, saturation):
                pipeline.note_health()
                if pipeline.has_leisure_work:
                    pipeline.look_at_health()
        if sample.held:
            self._reference = np.zeros(0)  # the next sample is of a stream that has seen nothing yet
        if not self._passes(counts, saturation):
            return None
        image = np.frombuffer(pipeline.record.map, dtype=np.float32).reshape(self.bundle.skin.grid.shape)
        self.tally.take(image)
        self.tally.unmarked += bool(saturation) and "saturated" not in pipeline.record.events
        return image.astype(np.float64)

    def _passes(self, counts: npt.NDArray[np.int32], saturation: int) -> bool:
        """Return whether a frame is computed and fit to publish; if not, it is counted."""
        pipeline = self.pipeline
        self._sequence += 1
        frame = Frame(self._sequence, self._sequence * 5000 % (1 << 32), counts, saturation=saturation)
        before = dict(pipeline.intake.withheld)
        if pipeline.accept(frame.pack(), time.perf_counter_ns()) and pipeline.compute(True):
            return True
        self.tally.withheld.update({k: n - before[k] for k, n in pipeline.intake.withheld.items() if n > before[k]})
        return False

    def engine(self, name: str) -> Engine:
        """Return one of the pipeline's engines, for those who fill its buffers themselves."""
        return self._engines[name]

    @property
    def touched(self) -> bool:
        """What the gate said of the last frame, before the map that is looked at now and then overruled it."""
        return self.pipeline.record.touched and "gate_overruled" not in self.pipeline.record.events

    def _prepare(self, sample: Sample) -> None:
        """Give the pipeline the sample's scale, reference and cloud, where they changed."""
        volts_per_count = sample.full_scale_V / full_scale(SAMPLE_BYTES)
        if volts_per_count != self._volts_per_count:
            self.pipeline.greet(replace(HELLO, volts_per_count=volts_per_count))
            self._volts_per_count = volts_per_count
        spread = np.zeros_like(sample.flat) if sample.spread is None else sample.spread
        reference = np.stack([sample.flat, spread])
        if not np.array_equal(reference, self._reference):
            self.pipeline.use_reference(Reference(sample.flat, spread, 100, HELLO.serial_number, 0, "stress", ""))
            self._reference = reference
        cloud = sample.sheet.cloud_mm
        if cloud is not self._cloud:
            self.pipeline.start_with(self._geometry(sample.sheet))
            self._cloud = cloud

    def _geometry(self, sheet: Sheet) -> Geometry:
        """Return what the network knows of a cloud, computed once: every sweep bends the same sheets."""
        key = id(sheet.cloud_mm)
        if key not in self._geometries:
            predicted = (
                log_ratio(sheet.predicted(), flat_voltages(self.bundle.skin)) if self.bundle.uses_prediction else None
            )
            self._geometries[key] = sheet.cloud_mm, self._graph.geometry(sheet.cloud_mm, predicted, 0)
        return self._geometries[key][1]
