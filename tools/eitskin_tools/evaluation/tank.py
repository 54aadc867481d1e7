"""Finds the objects in a measured tank, frame by frame, and compares them with those named in the file."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.sensor.wiring import read_wiring
from eitskin_proto.skin.skin import Skin
from eitskin_sim.tank.front_end import levels_of
from eitskin_sim.tank.images import IMAGES
from eitskin_sim.tank.model import TankModel, front_end_of, tank_model, widths_deg
from eitskin_sim.tank.objects import find_objects, ghosts, judge
from eitskin_sim.tank.recording import SIGNED_MATERIALS, TankFrame, load_tank
from eitskin_tools.evaluation.solvers import Progress

SOLVERS: Final = tuple(IMAGES)
"""That image a tank."""


def evaluate_tank(
    path: str | Path, progress: Progress | None = None, skin: Skin | None = None, solver: str = "l1"
) -> dict[str, Any]:
    """Return the object that ``eitskin evaluate --tank --json`` prints.

    Args:
        path: Of :func:`eitskin_sim.tank.recording.load_tank`.
        progress: Called with the frames done and all frames.
        skin: What is known of the tank: its electrodes' widths; None tries the usual ones.
        solver: One of ``SOLVERS``.

    Raises:
        TankError: The file holds no frames of a tank.
        ValueError: A frame's front end cannot be told, or the solver makes no image of it.
    """
    frames = load_tank(path)
    model = tank_model(frames) if skin is None else tank_model(frames, widths_deg(skin))
    rows = []
    for number, frame in enumerate(frames):
        rows.append(_row(model, frame, solver))
        if progress is not None:
            progress(number + 1, len(frames))
    every: list[dict[str, Any]] = [one for row in rows for one in row["objects"]]
    errors = [one["error_deg"] for one in every if one["right"]]
    levels = np.mean([levels_of(frame.water_V) for frame in frames], axis=0)
    return {
        "solver": solver,
        "wiring": read_wiring(levels, np.abs(model.water_V)).text,
        "frames": rows,
        "electrode_width_deg": model.disc.electrode_width_deg,
        "objects": len(every),
        "right": len(errors),
        "not_judged": sum(len(row["not_judged"]) for row in rows),
        "ghosts": sum(row["ghosts"] or 0 for row in rows),
        "angle_error_deg": {"median": float(np.median(errors)), "worst": max(errors)} if errors else None,
    }


def _row(model: TankModel, frame: TankFrame, solver: str) -> dict[str, Any]:
    """One frame of what is printed."""
    front_end = front_end_of(model, frame)
    found = find_objects(model, IMAGES[solver](model, front_end.change(frame.water_V, frame.objects_V)))
    judged = judge(frame.objects, found)
    return {
        "name": frame.name,
        "offset_V": [front_end.offset_V.real, front_end.offset_V.imag],
        "raw": front_end.raw,
        "residual": front_end.residual,
        "reciprocity": front_end.reciprocity,
        "objects": [
            {
                "electrode": one.object.electrode,
                "material": one.object.material,
                "found_deg": None if one.found is None else one.found.angle_deg,
                "error_deg": one.error_deg,
                "right": one.right,
            }
            for one in judged
        ],
        "not_judged": [{"electrode": one.electrode, "material": one.material} for one in frame.unknown],
        "ghosts": ghosts(judged, found, frame.unknown) if frame.objects else None,
        "found": [
            {"angle_deg": one.angle_deg, "radius": one.radius, "material": one.material, "strength": one.strength}
            for one in found
        ],
    }


def table(found: dict[str, Any]) -> str:
    """Return what was found as people read it."""
    lines = [f"wiring: {found['wiring']}", *(line for row in found["frames"] for line in _lines(row))]
    if found["objects"]:
        angles = found["angle_error_deg"]
        lines.append(
            f"{found['solver']}: {found['right']} of {found['objects']} objects in the right sector with the right "
            f"sign, {found['ghosts']} more"
        )
        if angles:
            lines.append(f"angles off by {angles['median']:.1f} degrees median, {angles['worst']:.1f} at most")
    if found["not_judged"]:
        lines.append(
            f"{found['not_judged']} not judged: of no material whose sign is known ({' or '.join(SIGNED_MATERIALS)})"
        )
    return "\n".join(lines)


def _lines(row: dict[str, Any]) -> list[str]:
    offset_mV = 1e3 * abs(complex(*row["offset_V"]))
    lines = [
        f"{row['name']}: {'rows as read' if row['raw'] else f'offset {offset_mV:.1f} mV'}, water explained to "
        f"{row['residual']:.1%}, reciprocal to {row['reciprocity']:.1%}",
    ]
    for one in row["objects"]:
        where = "not found" if one["found_deg"] is None else f"off by {one['error_deg']:.1f} degrees"
        wrong = "" if one["right"] else ", WRONG"
        lines.append(f"  electrode {one['electrode']:2d} {one['material']:8}{where}{wrong}")
    lines += [
        f"  electrode {one['electrode']:2d} {one['material'] or 'unnamed':8}not judged: its sign is not known"
        for one in row["not_judged"]
    ]
    if not row["objects"]:
        lines += [
            f"  {one['material']:8}at {one['angle_deg']:.0f} degrees, {one['radius']:.2f} of the radius"
            for one in row["found"]
        ]
    return lines
