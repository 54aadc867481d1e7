"""What a touch's size becomes when its border cuts elements, by three rules: the error that a 10 mm square shows.

    area fraction   a cut element has the mean of the two conductivities, by area
    laminate        it conducts as layers do: the mean along the border, the harmonic mean across
    enriched        what eitskin does: :mod:`eitskin_sim.fem.borders.cut_elements`

The size is fitted: the exact change of the voltages with the size, on a mesh that follows the square, is the yardstick.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.borders.cut_elements import touch
from eitskin_sim.fem.borders.cut_rule import half_plane_share
from eitskin_sim.fem.forward import Factor, System, assemble
from eitskin_sim.fem.mesh import MM, TensorMesh, graded_lines
from eitskin_sim.fem.meshing import REFERENCE_MM, electrode_lines, on_sheet, scene_mesh
from eitskin_sim.fem.q2 import GAUSS, WEIGHTS, gradients
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.parts import Electrodes, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Rect

Array = npt.NDArray[np.float64]
SQUARE_MM = 10.0
PLACES_MM = ((71.4, 33.1), (21.7, 14.3), (103.26, 57.62))
"""Lower left corners, off every line of the meshes."""
RULES = ("area fraction", "laminate", "enriched")


def size_errors(largest_mm: float, conductivity: float = 50.0) -> list[dict[str, Any]]:
    """Return a row for each rule: the worst and mean size error in mm, and the error of dV, over the places."""
    system = _blind_system(largest_mm)
    untouched = system.factorise().voltages()
    exact_untouched = solve_scene(Scene()).voltages
    errors: dict[str, list[tuple[float, float]]] = {rule: [] for rule in RULES}
    for x, y in PLACES_MM:
        exact, larger = (
            solve_scene(Scene(touches=(_square(x, y, grow, conductivity),))).voltages / exact_untouched - 1
            for grow in (0.0, 0.1)
        )
        slope = (larger - exact) / 0.2
        for rule in RULES:
            off = _solve(system, _square(x, y, 0.0, conductivity), rule) / untouched - 1 - exact
            size = float(slope @ off / (slope @ slope))
            errors[rule].append((abs(size), float(np.linalg.norm(off) / np.linalg.norm(exact))))
    return [
        {
            "what": "border rule",
            "rule": rule,
            "element_mm": largest_mm,
            "conductivity_S_per_m": conductivity,
            "size_error_max_mm": max(size for size, _ in found),
            "size_error_mean_mm": float(np.mean([size for size, _ in found])),
            "dv_error_max": max(dv for _, dv in found),
        }
        for rule, found in errors.items()
    ]


def cut_convergence(scene: Scene, sizes_mm: Sequence[float]) -> list[dict[str, Any]]:
    """Return a row for each element size: dV of a scene's touches on meshes blind to them, against one that follows."""
    follow = replace(scene, element_size_mm=1.0)
    exact = solve_scene(follow).voltages / solve_scene(follow.untouched()).voltages - 1
    rows = []
    for size in sizes_mm:
        system = assemble(scene_mesh(replace(scene.untouched(), element_size_mm=size)), scene.sheet, scene.electrodes)
        touched = touch(system, scene.touches)
        found = Factor(system, touched.blocks, touched.density).voltages() / system.factorise().voltages() - 1
        error = float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
        rows.append({"what": "cut convergence", "element_size_mm": size, "cut": len(touched.cut), "dv_error": error})
    return rows


def _square(x: float, y: float, grow: float, conductivity: float) -> Touch:
    far = SQUARE_MM + grow
    return Touch((Rect(x - grow, y - grow, x + far, y + far),), conductivity)


def _blind_system(largest_mm: float) -> System:
    sheet, electrodes = Sheet(), Electrodes()
    lines = [
        graded_lines(on_sheet(fixed, extent), largest_mm, max(REFERENCE_MM * 2 / largest_mm, 1.0))
        for fixed, extent in zip(electrode_lines(sheet, electrodes), sheet.size_mm, strict=True)
    ]
    return assemble(TensorMesh(*lines), sheet, electrodes)


def _solve(system: System, item: Touch, rule: str) -> Array:
    touched = touch(system, (item,))
    if rule == "enriched":
        return Factor(system, touched.blocks, touched.density).voltages()
    blocks = touched.sigma[:, None, None] * system.stiffness
    if rule == "laminate":
        blocks[touched.cut] = _laminates(system, touched.cut, item)
    return Factor(system, blocks, touched.density).voltages()


def _laminates(system: System, cut: npt.NDArray[np.intp], item: Touch) -> Array:
    """Return the (k, 9, 9) blocks of cut elements of a flat sheet as layers along the border."""
    sizes = system.mesh.sizes_mm[cut]
    distance, normal = item.shapes[0].distance_mm(system.mesh.centres_mm[cut])
    share = half_plane_share(distance, normal, sizes)
    along = share * item.conductivity_S_per_m + (1 - share) * system.background
    across = 1.0 / (share / item.conductivity_S_per_m + (1 - share) / system.background)
    tensor = along[:, None, None] * np.eye(2) + (across - along)[:, None, None] * normal[:, :, None] * normal[:, None]
    slopes = np.stack(gradients(GAUSS), axis=1)  # (points, 2, nodes)
    scaled = slopes[None] / sizes[:, None, :, None]
    weight = WEIGHTS * np.prod(sizes, axis=1)[:, None] * system.thickness_mm * MM
    return np.asarray(np.einsum("eq,eqai,eab,eqbj->eij", weight, scaled, tensor, scaled, optimize=True))
