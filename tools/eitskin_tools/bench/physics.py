"""``eitskin bench physics``: the errors of the forward model, a row each.

The rows are the convergence of untouched voltages with the element size, for both contacts and both contact laws; the
size of a touch whose border cuts elements; reciprocity; a bend that must change no voltage; and the coarse Jacobian.
A test compares the voltages with independent triangles.

The size error of a 10 mm square whose border cuts elements is fitted to the exact change of the voltages with the size,
on a mesh that follows the square.
"""

import argparse
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.borders.cut_elements import touch
from eitskin_sim.fem.forward import Factor, System, assemble, reciprocity_error
from eitskin_sim.fem.jacobian import COARSE_MM, relative_jacobian
from eitskin_sim.fem.mesh import TensorMesh, graded_lines
from eitskin_sim.fem.meshing import REFERENCE_MM, electrode_lines, on_sheet
from eitskin_sim.fem.solve import Law, factorise_scene, solve_scene
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.bench.harness import Row, report

Array = npt.NDArray[np.float64]
SQUARE_MM = 10.0
PLACES_MM = ((71.4, 33.1), (21.7, 14.3), (103.26, 57.62))
"""Lower left corners, off every line of the meshes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows and summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    rows = [*_convergence(), size_error(3.0), size_error(2.0), *_invariants(), *_jacobians()]
    return report(arguments, rows, _summary(rows))


def _convergence() -> list[Row]:
    rows: list[Row] = []
    laws: tuple[tuple[Literal["edge", "patch"], Law], ...] = (
        ("edge", "constant"),
        ("patch", "constant"),
        ("patch", "modes"),
    )
    for contact, law in laws:
        scene = Scene(electrodes=Electrodes(contact))
        fine = solve_scene(replace(scene, element_size_mm=0.75 if law == "constant" else 1.0), law).voltages
        for size in (6.0, 3.0, 2.0, 1.5):
            start = perf_counter()
            found = solve_scene(replace(scene, element_size_mm=size), law)
            row: Row = {"what": "convergence", "contact": contact, "law": law, "element_size_mm": size}
            row |= {"n_nodes": found.n_nodes, "v_error_max": float(np.abs(found.voltages / fine - 1).max())}
            rows.append({**row, "seconds": round(perf_counter() - start, 3)})
    return rows


def _invariants() -> list[Row]:
    flat = Scene(element_size_mm=3.0)
    untouched = solve_scene(flat).voltages
    rows: list[Row] = [{"what": "reciprocity", "error_max": reciprocity_error(factorise_scene(flat))}]
    for angle, axis, skew in ((90, 0, 0.0), (180, 30, 0.5), (350, 90, 0.0), (300, 45, 1.0)):
        bent = replace(flat, bend=Bend(angle_deg=angle, axis_deg=axis, skew=skew))
        error = float(np.abs(solve_scene(bent).voltages / untouched - 1).max())
        rows.append({"what": "isometric", "angle_deg": angle, "axis_deg": axis, "skew": skew, "error_max": error})
    return rows


def _jacobians() -> list[Row]:
    def jacobian(size_mm: float) -> Any:
        return relative_jacobian(Sheet(), Electrodes(), shape=PAPER.grid.shape, element_size_mm=size_mm)[1]

    fine = jacobian(1.5)
    rows = []
    for size in (6.0, COARSE_MM, 3.0):
        start = perf_counter()
        found = jacobian(size)
        error = float(np.linalg.norm(found - fine) / np.linalg.norm(fine))
        seconds = round(perf_counter() - start, 3)
        rows.append({"what": "jacobian", "element_size_mm": size, "error_rms": error, "seconds": seconds})
    return rows


def _summary(rows: list[Row]) -> dict[str, float]:
    by = {what: [row for row in rows if row["what"] == what] for what in {row["what"] for row in rows}}
    found = {
        "v_error_at_1.5_mm": max(r["v_error_max"] for r in by["convergence"] if r["element_size_mm"] == 1.5),
        "v_error_at_3_mm": max(r["v_error_max"] for r in by["convergence"] if r["element_size_mm"] == 3.0),
        "reciprocity": by["reciprocity"][0]["error_max"],
        "isometric": max(r["error_max"] for r in by["isometric"]),
    }
    return {**found, "size_error_mm": by["cut border"][0]["size_error_max_mm"]}


def size_error(largest_mm: float, conductivity: float = 50.0) -> Row:
    """Return the worst and mean size error in mm of a square that cuts elements, and the worst error of dV."""
    system = _blind_system(largest_mm)
    untouched = system.factorise().voltages()
    exact_untouched = solve_scene(Scene()).voltages
    sizes, errors = [], []
    for x, y in PLACES_MM:
        exact, larger = (
            solve_scene(Scene(touches=(_square(x, y, grow, conductivity),))).voltages / exact_untouched - 1
            for grow in (0.0, 0.1)
        )
        slope = (larger - exact) / 0.2
        touched = touch(system, (_square(x, y, 0.0, conductivity),))
        off = Factor(system, touched.blocks, touched.density).voltages() / untouched - 1 - exact
        sizes.append(abs(float(slope @ off / (slope @ slope))))
        errors.append(float(np.linalg.norm(off) / np.linalg.norm(exact)))
    return {
        "what": "cut border",
        "element_mm": largest_mm,
        "conductivity_S_per_m": conductivity,
        "size_error_max_mm": max(sizes),
        "size_error_mean_mm": float(np.mean(sizes)),
        "dv_error_max": max(errors),
    }


def _square(x: float, y: float, grow: float, conductivity: float) -> Touch:
    far = SQUARE_MM + grow
    return Touch((Rect(x - grow, y - grow, x + far, y + far),), conductivity)


def _blind_system(largest_mm: float) -> System:
    sheet, electrodes = nominal_sheet(PAPER), nominal_electrodes(PAPER)
    lines = [
        graded_lines(on_sheet(fixed, extent), largest_mm, max(REFERENCE_MM * 2 / largest_mm, 1.0))
        for fixed, extent in zip(electrode_lines(sheet, electrodes), sheet.size_mm, strict=True)
    ]
    return assemble(TensorMesh(*lines), sheet, electrodes)
