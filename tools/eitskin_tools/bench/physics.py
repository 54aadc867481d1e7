"""``eitskin bench physics``: what the forward model is measured against, a row each.

Convergence of the untouched voltages with the element size, reciprocity, the bend that must change nothing, the coarse
Jacobian, and (unless ``--no-slab``) the independent solid of :mod:`eitskin_tools.bench.slab` on the paper's sheet: V,
and dV of touches inside, at the border, in a corner and under a contact, flat and bent. The solid takes minutes.
"""

import argparse
import json
import sys
from dataclasses import replace
from time import perf_counter
from typing import Any

Row = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--no-slab", action="store_true", help="leave out the independent solid, which takes minutes")
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows and summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    rows = _convergence() + _invariants() + _jacobians()
    if not arguments.no_slab:
        rows += _slab()
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

    from eitskin_sim.parts import Electrodes, Scene
    from eitskin_sim.solve import solve_scene

    rows = []
    for contact in ("edge", "patch"):
        scene = Scene(electrodes=Electrodes(contact))
        fine = solve_scene(replace(scene, element_size_mm=0.75)).voltages
        for size in (6.0, 3.0, 2.0, 1.5):
            start = perf_counter()
            found = solve_scene(replace(scene, element_size_mm=size))
            rows.append(
                {
                    "what": "convergence",
                    "contact": contact,
                    "element_size_mm": size,
                    "n_nodes": found.n_nodes,
                    "v_error_max": float(np.abs(found.voltages / fine - 1).max()),
                    "seconds": round(perf_counter() - start, 3),
                }
            )
    return rows


def _invariants() -> list[Row]:
    import numpy as np

    from eitskin_sim.forward import reciprocity_error
    from eitskin_sim.parts import Bend, Scene
    from eitskin_sim.solve import factorise_scene, solve_scene

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

    from eitskin_sim.jacobian import COARSE_MM, pixel_jacobian
    from eitskin_sim.parts import Scene

    fine = pixel_jacobian(Scene(), 1.5)
    rows = []
    for size in (6.0, COARSE_MM, 3.0):
        start = perf_counter()
        found = pixel_jacobian(Scene(), size)
        error = float(np.linalg.norm(found - fine) / np.linalg.norm(fine))
        seconds = round(perf_counter() - start, 3)
        rows.append({"what": "jacobian", "element_size_mm": size, "error_rms": error, "seconds": seconds})
    return rows


def _slab() -> list[Row]:
    import numpy as np

    from eitskin_proto.grid import unit_rect_mm
    from eitskin_sim.parts import Bend, Scene, Touch
    from eitskin_sim.shapes import Rect
    from eitskin_sim.solve import solve_scene
    from eitskin_tools.bench.slab import Resolution, solve_slab

    fine = Resolution(largest_mm=8.0, contact_mm=0.3, layers_mm=(1.2, 0.6, 0.2), growth=2.5)
    places = {
        "untouched": None,
        "interior": unit_rect_mm(6, 4),
        "border": unit_rect_mm(6, 0),
        "corner": unit_rect_mm(0, 0),
        "under a contact": (8.0, 0.0, 18.0, 10.0),
    }
    rows = []
    for name, bend in (("flat", Bend()), ("bent", Bend(angle_deg=120, axis_deg=20, stretch_along=1.1))):
        base: tuple[Any, Any] | None = None
        for place, box in places.items():
            print(f"slab: {name}, {place}", file=sys.stderr)
            scene = Scene(bend=bend, touches=() if box is None else (Touch((Rect(*box),)),))
            solid, unknowns = solve_slab(scene, fine)
            sheet = solve_scene(scene).voltages
            ratio = sheet / solid - 1
            row: Row = {
                "what": "slab",
                "sheet": name,
                "touch": place,
                "unknowns": unknowns,
                "v_error_max": float(np.abs(ratio).max()),
                "v_error_rms": float(np.sqrt(np.mean(ratio**2))),
            }
            if base is None:
                base = (sheet, solid)
            else:
                expected = solid / base[1] - 1
                error = np.linalg.norm(sheet / base[0] - 1 - expected) / np.linalg.norm(expected)
                row["dv_error"] = float(error)
            rows.append(row)
    return rows


def _summary(rows: list[Row]) -> dict[str, float]:
    by = {what: [row for row in rows if row["what"] == what] for what in {row["what"] for row in rows}}
    found = {
        "v_error_at_1.5_mm": max(r["v_error_max"] for r in by["convergence"] if r["element_size_mm"] == 1.5),
        "v_error_at_3_mm": max(r["v_error_max"] for r in by["convergence"] if r["element_size_mm"] == 3.0),
        "reciprocity": by["reciprocity"][0]["error_max"],
        "isometric": max(r["error_max"] for r in by["isometric"]),
    }
    if "slab" in by:
        found["slab_v_error_rms"] = max(r["v_error_rms"] for r in by["slab"])
        found["slab_dv_error_corner"] = max(r["dv_error"] for r in by["slab"] if r["touch"] == "corner")
        found["slab_dv_error"] = max(r["dv_error"] for r in by["slab"] if "dv_error" in r)
    return found
