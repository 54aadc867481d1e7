"""A scene's voltages, from its own mesh: what ``eitskin simulate`` writes."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin_proto.table import FULL_TABLE, ROW_IN_FULL
from eitskin_sim.bend import bend_metric
from eitskin_sim.cut import factorise
from eitskin_sim.forward import Factor, assemble
from eitskin_sim.meshing import scene_mesh
from eitskin_sim.parts import Scene

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Solution:
    """What a scene's forward solve gives."""

    voltages: Array
    """(104,) V, table order, under the scene's current."""
    voltages208: Array
    """(208,) V, the full table."""
    n_elements: int
    n_nodes: int


def factorise_scene(scene: Scene) -> Factor:
    """Return the factorised system of a scene on the mesh that it asks for."""
    system = assemble(scene_mesh(scene), scene.sheet, scene.electrodes, bend_metric(scene.bend, scene.sheet))
    return factorise(system, scene.touches)


def solve_scene(scene: Scene) -> Solution:
    """Return the voltages of a scene."""
    factor = factorise_scene(scene)
    full = scene.current_A * factor.voltages(FULL_TABLE)
    mesh = factor.system.mesh
    return Solution(full[ROW_IN_FULL], full, mesh.n_elements, mesh.n_nodes)
