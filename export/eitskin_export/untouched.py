"""Untouched sheets at many deformations, for the gate: what a bend alone does to the voltages.

A data set has a hundred bends, and a gate that saw only those takes every third new one for a touch. Untouched sheets
need no touch sets, so hundreds more are solved on a coarse mesh. Only log(V / V0) is kept, with V0 from the same mesh:
the mesh's own error is the same in both and cancels.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim import bend as surfaces
from eitskin_sim.family import draw
from eitskin_sim.forward import assemble, flat_metric
from eitskin_sim.meshing import scene_mesh
from eitskin_sim.parts import Bend, Electrodes, Scene, Sheet
from eitskin_training.data import TrainingData

COARSE_MM: Final = 4.5
"""Element size: 0.05 s a bend, and log(V / V0) to 2e-4."""

TRAIN_SEED: Final = 701
HELD_OUT_SEED: Final = 702
"""Sequences of bends that no data set uses."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Bends:
    """log(V / V0) of untouched sheets.

    Args:
        train: (n, 104) to learn from.
        choose: (c, 104) that choose a threshold.
        measure: (m, 104) that measure what it does.
    """

    train: Array
    choose: Array
    measure: Array


def bends_of(data: TrainingData) -> Bends:
    """Return the bends of a data set alone: trained ones teach, held-out ones choose and measure in turn."""
    logs = np.log(data.untouched / data.reference)
    held_out = np.concatenate(list(data.held_out.values())) if data.held_out else np.array([], dtype=np.intp)
    apart = np.unique(data.deformation[held_out])
    return Bends(logs[np.unique(data.deformation[data.train])], logs[apart[::2]], logs[apart[1::2]])


def solved_bends(data: TrainingData, train: int = 600, held_out: int = 60) -> Bends:
    """Return a data set's bends and many more.

    Args:
        data: The data set.
        train: Bends of family A to solve for learning.
        held_out: Bends to solve of A, and as many of B, half of which choose and half measure.
    """
    own = bends_of(data)
    more = _solved("A", train, TRAIN_SEED)
    apart = np.concatenate([_solved("A", held_out, HELD_OUT_SEED), _solved("B", held_out, HELD_OUT_SEED)])
    return Bends(
        np.concatenate([own.train, more]),
        np.concatenate([own.choose, apart[::2]]),
        np.concatenate([own.measure, apart[1::2]]),
    )


@cache
def _solved(family: str, count: int, seed: int) -> Array:
    mesh, sheet = scene_mesh(Scene(element_size_mm=COARSE_MM)), Sheet()

    def voltages(bend: Bend | None) -> Array:
        def metric(xy_mm: Array) -> Array:
            return flat_metric(xy_mm) if bend is None else surfaces.metric(bend, sheet, xy_mm)

        return assemble(mesh, sheet, Electrodes(), metric).factorise().voltages()

    flat = voltages(None)
    return np.log(np.array([voltages(bend) for bend in draw(family, count, seed)]) / flat)
