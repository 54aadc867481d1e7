"""A scene's voltages, solved on its own mesh, as ``eitskin simulate`` writes them."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from eitskin_proto.sensor.table import FULL_TABLE, ROW_IN_FULL
from eitskin_sim.arrays import Array
from eitskin_sim.fem.borders.cut_elements import factorise, touch
from eitskin_sim.fem.depth import plates
from eitskin_sim.fem.forward import Factor, assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Scene, SceneError
from eitskin_sim.scene.soft_touch import check_touches

Law = Literal["constant", "modes"]
"""How a face contact passes current."""

REMEDY: Final = "conductivities, thickness and contact impedances lie too far apart, or a touch is too thin"


@dataclass(frozen=True, slots=True)
class Solution:
    """The result of a scene's forward solve."""

    voltages: Array
    """(104,) V, table order, under the scene's current."""
    voltages208: Array
    """(208,) V, the full table."""
    n_elements: int
    n_nodes: int


def factorise_scene(scene: Scene, law: Law = "constant") -> Factor:
    """Return the factorised system of a scene on the mesh that it asks for.

    Raises:
        SceneError: A touch would change nothing, or its border cannot be represented; or the scene cannot be solved.
    """
    check_touches(scene)
    metric = bend_metric(scene.bend, scene.sheet, scene.touches)
    mesh = scene_mesh(scene)
    try:
        system = assemble(mesh, scene.sheet, scene.electrodes, metric)
        if law == "constant" or scene.electrodes.contact == "edge":
            return factorise(system, scene.touches)
        touched = touch(system, scene.touches)
        return Factor(system, touched.blocks, np.zeros_like(touched.density), plates(system, scene, metric))
    except (np.linalg.LinAlgError, RuntimeError) as error:  # splu says so of a singular matrix
        raise SceneError(f"the scene cannot be solved: {error}; {REMEDY}") from error


def solve_scene(scene: Scene, law: Law = "constant") -> Solution:
    """Return the voltages of a scene.

    Args:
        scene: The scene.
        law: How a face contact passes current: "constant", by an effective impedance with one fitted constant, which
            data sets and bundles are made with, or "modes", by the modes of the layer's depth, which needs no fit.
            An edge contact has no such modes: both are the same for it.

    Raises:
        SceneError: A touch would change nothing, or its border cannot be represented; or the scene cannot be solved.
    """
    factor = factorise_scene(scene, law)
    full = scene.current_A * factor.voltages(FULL_TABLE)
    if not np.isfinite(full).all():
        raise SceneError(f"the scene cannot be solved: its voltages are not finite; {REMEDY}")
    mesh = factor.system.mesh
    return Solution(full[ROW_IN_FULL], full, mesh.n_elements, mesh.n_nodes)
