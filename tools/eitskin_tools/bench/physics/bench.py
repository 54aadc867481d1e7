"""``eitskin bench physics``: what the forward model is measured against, a row each.

Convergence of the untouched voltages with the element size, by both contacts and both contact laws, beside independent
triangles; a touch's size by three rules for the elements that its border cuts; reciprocity, the bend that must change
nothing, the coarse Jacobian; and (unless ``--no-slab``) the independent solid of
:mod:`eitskin_tools.bench.physics.solid` on the paper's sheet: V, and dV of touches inside, at the border, in a corner
and under a contact, flat and bent. The solid takes minutes.
"""

import argparse
import json
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal

Row = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--no-slab", action="store_true", help="leave out the independent solid, which takes minutes")
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows and summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    rows = _convergence() + _borders() + _invariants() + _jacobians()
    if not arguments.no_slab:
        from eitskin_tools.bench.physics.against_solid import slab_rows

        rows += slab_rows()
    summary = _summary(rows)
    if arguments.json:
        print(json.dumps({"rows": rows, "summary": summary}))
        return 0
    for row in rows:
        print(
            "  ".join(
                f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()
            )
        )
    print("  ".join(f"{key} {value:.3g}" for key, value in summary.items()))
    return 0


def _convergence() -> list[Row]:
    import numpy as np

    from eitskin_sim.fem.solve import Law, solve_scene
    from eitskin_sim.scene.parts import Electrodes, Scene
    from eitskin_tools.bench.physics.triangles import solve_triangles

    rows: list[Row] = []
    laws: tuple[tuple[Literal["edge", "patch"], Law], ...] = (
        ("edge", "constant"),
        ("patch", "constant"),
        ("patch", "modes"),
    )
    for contact, law in laws:
        scene = Scene(electrodes=Electrodes(contact))
        fine = solve_scene(replace(scene, element_size_mm=0.75 if law == "constant" else 1.0), law).voltages
        triangles = solve_triangles(scene)[0] if law == "constant" else None
        for size in (6.0, 3.0, 2.0, 1.5):
            start = perf_counter()
            found = solve_scene(replace(scene, element_size_mm=size), law)
            row: Row = {"what": "convergence", "contact": contact, "law": law, "element_size_mm": size}
            row |= {"n_nodes": found.n_nodes, "v_error_max": float(np.abs(found.voltages / fine - 1).max())}
            if triangles is not None:
                row["v_against_triangles_max"] = float(np.abs(found.voltages / triangles - 1).max())
            rows.append({**row, "seconds": round(perf_counter() - start, 3)})
    return rows


def _borders() -> list[Row]:
    from eitskin_sim.scene.parts import Scene, Touch
    from eitskin_sim.scene.shapes import Rect
    from eitskin_tools.bench.physics.border_rules import cut_convergence, size_errors

    rows = size_errors(3.0) + size_errors(2.0)
    touches = (Touch((Rect(71.4, 33.1, 81.4, 43.1),)), Touch((Rect(21.7, 14.3, 34.2, 26.9),), 20.0))
    return rows + cut_convergence(Scene(touches=touches), (6.0, 3.0, 2.0, 1.5))


def _invariants() -> list[Row]:
    import numpy as np

    from eitskin_sim.fem.forward import reciprocity_error
    from eitskin_sim.fem.solve import factorise_scene, solve_scene
    from eitskin_sim.scene.parts import Bend, Scene

    flat = Scene(element_size_mm=3.0)
    untouched = solve_scene(flat).voltages
    rows: list[Row] = [{"what": "reciprocity", "error_max": reciprocity_error(factorise_scene(flat))}]
    for angle, axis, skew in ((90, 0, 0.0), (180, 30, 0.5), (350, 90, 0.0), (300, 45, 1.0)):
        bent = replace(flat, bend=Bend(angle_deg=angle, axis_deg=axis, skew=skew))
        error = float(np.abs(solve_scene(bent).voltages / untouched - 1).max())
        rows.append({"what": "isometric", "angle_deg": angle, "axis_deg": axis, "skew": skew, "error_max": error})
    return rows


def _jacobians() -> list[Row]:
    import numpy as np

    from eitskin_proto.skin.skin import PAPER
    from eitskin_sim.fem.jacobian import COARSE_MM, relative_jacobian
    from eitskin_sim.scene.parts import Electrodes, Sheet

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
    found |= {f"size_error_mm_{r['rule']}".replace(" ", "_"): r["size_error_max_mm"] for r in by["border rule"][:3]}
    for law in ("constant", "modes"):
        of_law = [row for row in by.get("slab", []) if row["law"] == law]
        if of_law:
            found[f"slab_v_error_max_{law}"] = max(r["v_error_max"] for r in of_law if r["touch"] == "untouched")
            found[f"slab_dv_error_corner_{law}"] = max(r["dv_error"] for r in of_law if r["touch"] == "corner")
            found[f"slab_dv_error_max_{law}"] = max(r["dv_error"] for r in of_law if "dv_error" in r)
    return found
