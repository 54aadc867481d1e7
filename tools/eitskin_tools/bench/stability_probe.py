"""What stability rows are made with: touched sheets of our own drawing, the runtime's pipeline, and a count of maps.

Bends are drawn from family A and touches at random, from seeds that no data set has, on a mesh that no data set has.
Unit touches come from the generator that bars the published phantoms; free touches are rectangles and discs with a
random share of a millimetre in every coordinate. Samples become counts of a device with 32-bit converters, packed as
FRAME payloads; the pipeline decodes, normalises and infers, and the map is taken from where the runtime takes it.
"""

import time
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin.health.monitor import health_of
from eitskin.model.bundle import Bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import Geometry, GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin.reference.predicted import log_ratio
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire.frames import Frame, full_scale, quantise
from eitskin_proto.wire.messages import Hello
from eitskin_sim.evaluation.harness import Sheet
from eitskin_sim.evaluation.metrics import touched_units
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc, Rect
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import flat_voltages
from eitskin_sim.unit_grid.patterns import rich_touch_sets

Array = npt.NDArray[np.float64]
Labels = Literal["units", "area"]

SEED: Final = 71_903
"""Of bends, touches and clouds; data sets have seeds below 10,000."""

FULL_SCALE: Final = 8.0
"""What the front end takes, relative to the largest voltage of the reference, where a sweep says nothing else."""

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


@dataclass(frozen=True, eq=False)
class Sample:
    """One touched sheet, or a noisy copy of one."""

    scene: Scene
    labels: Labels
    voltages: Array
    """(104,) V as measured."""
    flat: Array
    """(104,) V, the reference: flat and untouched."""
    sheet: Sheet
    """The measured bend and its untouched voltages."""
    full_scale_V: float
    """What the front end cuts off at."""
    spread: Array | None = None
    """(104,) V by which a single frame of the reference varies; None where it does not."""

    @cached_property
    def truth(self) -> Array:
        """(rows, columns) map."""
        area = area_map(self.scene.touches, PAPER.grid)
        return (
            np.asarray(PAPER.grid.map_from_units(touched_units(area, PAPER.grid).astype(np.float64)))
            if self.labels == "units"
            else area
        )

    @property
    def read(self) -> Array:
        """(104,) V after the front end's limits."""
        return np.clip(self.voltages, -self.full_scale_V, self.full_scale_V)


@lru_cache(maxsize=256)
def voltages_of(scene: Scene) -> Array:
    """Return a scene's (104,) V, solved once a process."""
    return solve_scene(scene).voltages


def samples(labels: Labels, count: int, element_size_mm: float) -> tuple[Sample, ...]:
    """Return touched sheets, each with its own bend; a larger count begins with the same sheets.

    Args:
        labels: "units" for touched units, "area" for touches anywhere.
        count: How many.
        element_size_mm: Of their meshes.
    """
    generator = np.random.default_rng([SEED, labels == "area"])
    units = rich_touch_sets(count + 1, SEED)[1:]
    found = []
    for index, bend in enumerate(draw("A", count, SEED)):
        touches = _unit_touches(units[index]) if labels == "units" else _free_touches(generator)
        found.append(sample_of(Scene(bend=bend, touches=touches, element_size_mm=element_size_mm), labels))
    return tuple(found)


def sample_of(scene: Scene, labels: Labels) -> Sample:
    """Return a scene as a sample, against the flat, untouched sheet of the same material on the same mesh size."""
    flat, cloud = voltages_of(scene.reference()), measured_cloud(scene.bend, np.random.default_rng(SEED))
    sheet = Sheet(np.asarray(cloud, dtype=np.float64), voltages_of(scene.untouched()))
    return Sample(scene, labels, voltages_of(scene), flat, sheet, FULL_SCALE * float(np.abs(flat).max()))


def _unit_touches(units: npt.NDArray[np.bool_]) -> tuple[Touch, ...]:
    grid = PAPER.grid
    boxes = [grid.unit_rect_mm(int(n % grid.units[1]), int(n // grid.units[1])) for n in np.flatnonzero(units)]
    return tuple(Touch((Rect(*box),)) for box in boxes)


def _free_touches(generator: np.random.Generator) -> tuple[Touch, ...]:
    touches = []
    length, width = PAPER.outline.size_mm
    for _ in range(int(generator.integers(1, 4))):
        x, y = generator.uniform((20.0, 20.0), (length - 20.0, width - 20.0))
        a, b = generator.uniform(5.0, 11.0, 2)
        disc = generator.random() < 0.5
        touches.append(Touch((Disc(x, y, a) if disc else Rect(x - a, y - b, x + a, y + b),)))
    return tuple(touches)


@dataclass(slots=True)
class Tally:
    """What came out of the pipelines of one run."""

    published: int = 0
    """Maps."""
    not_finite: int = 0
    """Maps with a value that is NaN or infinite."""
    out_of_range: int = 0
    """Maps with a value below 0 or above 1."""
    withheld: Counter[str] = field(default_factory=Counter)
    """Frames that were not published, by reason."""
    refused: Counter[str] = field(default_factory=Counter)
    """Inputs that were refused before any frame, by the exception's name."""
    escaped: list[str] = field(default_factory=list)
    """Inputs that ended in an exception which is no refusal: defects."""
    unmarked: int = 0
    """Published maps of frames whose rows were cut off and that do not say so."""

    def count(self, image: npt.NDArray[np.floating]) -> None:
        """Count a published map, of any shape."""
        self.published += 1
        low, high = float(np.min(image)), float(np.max(image))  # both NaN if any value is
        if not (np.isfinite(low) and np.isfinite(high)):
            self.not_finite += 1
        elif low < 0.0 or high > 1.0:
            self.out_of_range += 1

    def summary(self) -> dict[str, Any]:
        """Return the counts as one flat object."""
        return {
            "published": self.published,
            "published_not_finite": self.not_finite,
            "published_out_of_range": self.out_of_range,
            "published_saturated_unmarked": self.unmarked,
            "withheld": sum(self.withheld.values()),
            **{f"withheld_{reason}": count for reason, count in sorted(self.withheld.items())},
            "refused": sum(self.refused.values()),
            "escaped": len(self.escaped),
        }


class Stream:
    """The runtime's pipeline without its gate, and the device before it.

    Args:
        bundle: The solvers.
        tally: Counts what is published.
    """

    def __init__(self, bundle: Bundle, tally: Tally) -> None:
        # Without the bundle's gate every frame is computed.
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
        self._sequence += 1
        frame = Frame(self._sequence, self._sequence * 5000 % (1 << 32), counts, saturation=saturation)
        before = dict(pipeline.intake.withheld)
        if not (pipeline.accept(frame.pack(), time.perf_counter_ns()) and pipeline.compute(True)):
            after = pipeline.intake.withheld
            self.tally.withheld.update(
                {key: count - before[key] for key, count in after.items() if count > before[key]}
            )
            return None
        image = np.frombuffer(pipeline.record.map, dtype=np.float32).reshape(self.bundle.skin.grid.shape)
        self.tally.count(image)
        self.tally.unmarked += bool(saturation) and "saturated" not in pipeline.record.events
        return image.astype(np.float64)

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
