"""Touched sheets of our own drawing, solved once: what every sweep disturbs.

Bends are drawn from family A and touches at random, from seeds that no data set has, and are solved on a mesh that no
data set has. Unit touches come from the generator that bars the published phantoms; free touches are rectangles and
discs with a random share of a millimetre in every coordinate.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import UNIT_SHAPE, map_from_units, unit_rect_mm
from eitskin_proto.sensor.table import TABLE
from eitskin_sim.evaluation.harness import Case, Sheet
from eitskin_sim.evaluation.metrics import touched_units
from eitskin_sim.fem.borders.cut_elements import factorise
from eitskin_sim.fem.forward import System, assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc, Rect
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.unit_grid.patterns import rich_touch_sets

Array = npt.NDArray[np.float64]
Labels = Literal["units", "area"]

SEED: Final = 71_903
"""Of bends, touches and clouds; data sets have seeds below 10,000."""

FULL_SCALE: Final = 8.0
"""What the front end takes, relative to the largest voltage of the reference, where a sweep says nothing else."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One touched sheet, or a disturbed copy of one."""

    scene: Scene
    labels: Labels
    voltages: Array
    """(104,) V as measured."""
    flat: Array
    """(104,) V, the reference: flat, untouched and undisturbed unless a sweep disturbs it."""
    sheet: Sheet
    """The measured bend and its untouched voltages."""
    full_scale_V: float
    """What the front end cuts off at."""
    spread: Array | None = None
    """(104,) V by which a single frame of the reference varies; None where it does not."""
    held: int = 0
    """For how many frames the stream has seen this already, and looked at its electrodes."""

    @cached_property
    def truth(self) -> Array:
        """(30, 45) map."""
        area = area_map(self.scene.touches)
        return np.asarray(map_from_units(touched_units(area).astype(np.float64))) if self.labels == "units" else area

    @property
    def read(self) -> Array:
        """(104,) V after the front end's limits."""
        return np.clip(self.voltages, -self.full_scale_V, self.full_scale_V)

    def bare(self) -> "Sample":
        """Return the same sheet untouched."""
        return replace(self, scene=self.scene.untouched(), voltages=self.sheet.untouched)

    def case(self) -> Case:
        """Return what a classical solver may see, with the post-deformation reference."""
        return Case(self.read, self.sheet.untouched, self.flat, self.sheet, self.labels)

    def solved(self, scene: Scene) -> "Sample":
        """Return this sample with another scene's voltages, cloud and untouched sheet; the reference stays."""
        return replace(self, scene=scene, voltages=voltages_of(scene), sheet=sheet_of(scene))


Disturb = Callable[[Sample, float, np.random.Generator], Sample]
"""From a sample and a level to the sample at that level."""


@lru_cache(maxsize=4096)
def voltages_of(scene: Scene) -> Array:
    """Return a scene's (104,) V, solved once a process."""
    return scene.current_A * factorise(system_of(scene), scene.touches).voltages(TABLE)


def system_of(scene: Scene) -> System:
    """Return a scene's assembled system; scenes that differ in conductivities alone share their assembly."""
    touches = tuple(Touch(touch.shapes) for touch in scene.touches)
    sheet = replace(scene.sheet, conductivity_S_per_m=1.0)
    system = _assembled(replace(scene, sheet=sheet, touches=touches, current_A=1.0))
    return replace(system, background=scene.sheet.conductivity_S_per_m)


@lru_cache(maxsize=48)
def _assembled(scene: Scene) -> System:
    """Kept for the touched and the bare sheets of one sweep: a quarter of a solve's time, some megabytes each."""
    return assemble(scene_mesh(scene), scene.sheet, scene.electrodes, bend_metric(scene.bend, scene.sheet))


@lru_cache(maxsize=1024)
def sheet_of(scene: Scene) -> Sheet:
    """Return a scene's measured, untouched sheet, made once a process."""
    return _measured(scene.untouched())


@lru_cache(maxsize=1024)
def _measured(untouched: Scene) -> Sheet:
    cloud = measured_cloud(untouched.bend, np.random.default_rng(SEED))
    sheet = Sheet(np.asarray(cloud, dtype=np.float64), voltages_of(untouched))
    sheet.predicted()  # now, since disturbed copies of the sheet would each do it again
    return sheet


def samples(labels: Labels, count: int, element_size_mm: float) -> tuple[Sample, ...]:
    """Return so many touched sheets, each with its own bend; more of them begin with the same ones.

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
    flat = voltages_of(scene.reference())
    return Sample(scene, labels, voltages_of(scene), flat, sheet_of(scene), FULL_SCALE * float(np.abs(flat).max()))


def _unit_touches(units: npt.NDArray[np.bool_]) -> tuple[Touch, ...]:
    boxes = [unit_rect_mm(int(n % UNIT_SHAPE[1]), int(n // UNIT_SHAPE[1])) for n in np.flatnonzero(units)]
    return tuple(Touch((Rect(*box),)) for box in boxes)


def _free_touches(generator: np.random.Generator) -> tuple[Touch, ...]:
    touches = []
    for _ in range(int(generator.integers(1, 4))):
        x, y = generator.uniform((20.0, 20.0), (130.0, 80.0))
        a, b = generator.uniform(5.0, 11.0, 2)
        disc = generator.random() < 0.5
        touches.append(Touch((Disc(x, y, a) if disc else Rect(x - a, y - b, x + a, y + b),)))
    return tuple(touches)
