"""``eitskin simulate SCENE.json --out V.npz``: the voltages of one scene, written whole or not at all."""

import argparse
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from eitskin_proto.skin.skin import Skin
from eitskin_tools.command_line import kinds, options
from eitskin_tools.console.terminal import answer

if TYPE_CHECKING:
    from eitskin_sim.fem.solve import Solution
    from eitskin_sim.scene.scene import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scene", metavar="SCENE", help="a scene as JSON: a file, or the name of a shipped one: sample")
    parser.add_argument(
        "--out", type=Path, required=True, help="the .npz to write: voltages (104,), voltages208 (208,)"
    )
    parser.add_argument(
        "--reference",
        action="store_true",
        help="the scene's device when its reference was taken: flat, untouched, and without what came late",
    )
    options.add_skin(parser, "what the scene leaves out: sheet, electrodes, units")


def run(arguments: argparse.Namespace) -> int:
    """Solve the scene and write its voltages."""
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.scene import load_scene
    from eitskin_tools.command_line import files

    skin = options.chosen_skin(arguments)
    scene = load_scene(files.find(arguments.scene, files.SCENE), skin)
    files.writable(arguments.out, kinds.VOLTAGES)
    if arguments.reference:
        scene = scene.reference()
    if sys.stderr.isatty():
        print("eitskin simulate: solving, a minute or so; longer with elements below 1.5 mm", file=sys.stderr)
    start = perf_counter()
    solution = solve_scene(scene, "modes")
    seconds = perf_counter() - start
    _write(arguments.out, scene, solution, skin)
    report = {
        "out": str(arguments.out),
        "rows": len(solution.voltages),
        "n_elements": solution.n_elements,
        "n_nodes": solution.n_nodes,
        "element_size_mm": scene.element_size_mm,
        "seconds": round(seconds, 3),
        "smallest_V": float(abs(solution.voltages).min()),
        "largest_V": float(abs(solution.voltages).max()),
    }
    return answer(
        arguments,
        report,
        f"{arguments.out}: {report['rows']} voltages, {report['smallest_V']:.4g} to {report['largest_V']:.4g} V, "
        f"{solution.n_nodes} nodes, {seconds:.2f} s",
    )


def _write(out: Path, scene: "Scene", solution: "Solution", skin: Skin) -> None:
    """Write the voltages, whole or not at all."""
    import numpy as np

    from eitskin_proto.files.writing import replacing
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_sim.scene.scene import scene_json

    with replacing(out) as file:
        np.savez(
            file,
            voltages=solution.voltages,
            voltages208=solution.voltages208,
            scene=np.array(scene_json(scene)),
            protocol_id=np.array(PROTOCOL_ID),
            grid_id=np.array(skin.grid_id),
            skin_digest=np.array(skin.digest),
        )
