"""Finds the objects of a measured tank, frame by frame, and says which of those that its names tell of are right."""

from pathlib import Path
from typing import Any

import numpy as np

from eitskin_proto.skin.skin import Skin
from eitskin_sim.tank.objects import find_objects, front_end_of, judge, tank_model, widths_deg
from eitskin_sim.tank.recording import load_tank
from eitskin_tools.evaluation.solvers import Progress


def evaluate_tank(path: str | Path, progress: Progress | None = None, skin: Skin | None = None) -> dict[str, Any]:
    """Return the object that ``eitskin evaluate --tank --json`` prints.

    Args:
        path: Of :func:`eitskin_sim.tank.recording.load_tank`.
        progress: Called with the frames done and all frames.
        skin: What is known of the tank: its electrodes' widths; None tries the usual ones.

    Raises:
        TankError: The file holds no frames of a tank.
        ValueError: A frame's front end cannot be told.
    """
    frames = load_tank(path)
    model = tank_model(frames) if skin is None else tank_model(frames, widths_deg(skin))
    rows = []
    for number, frame in enumerate(frames):
        front_end = front_end_of(model, frame)
        found = find_objects(model, front_end.change(frame.water_V, frame.objects_V))
        judged = judge(frame.objects, found)
        rows.append(
            {
                "name": frame.name,
                "offset_V": [front_end.offset_V.real, front_end.offset_V.imag],
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
                "ghosts": len(found) - sum(one.right for one in judged) if frame.objects else None,
                "found": [
                    {"angle_deg": one.angle_deg, "radius": one.radius, "material": one.material,
                     "strength": one.strength}
                    for one in found
                ],
            }
        )  # fmt: skip
        if progress is not None:
            progress(number + 1, len(frames))
    every: list[dict[str, Any]] = [one for row in rows for one in row["objects"]]  # type: ignore[attr-defined]
    errors = [one["error_deg"] for one in every if one["right"]]
    return {
        "frames": rows,
        "electrode_width_deg": model.disc.electrode_width_deg,
        "objects": len(every),
        "right": sum(one["right"] for one in every),
        "ghosts": sum(row["ghosts"] or 0 for row in rows),
        "angle_error_deg": {"median": float(np.median(errors)), "worst": max(errors)} if errors else None,
    }


def table(found: dict[str, Any]) -> str:
    """Return what was found as people read it."""
    lines = [line for row in found["frames"] for line in _lines(row)]
    if found["objects"]:
        angles = found["angle_error_deg"]
        lines.append(
            f"{found['right']} of {found['objects']} objects in the right sector with the right sign, "
            f"{found['ghosts']} besides"
        )
        if angles:
            lines.append(f"angles off by {angles['median']:.1f} degrees median, {angles['worst']:.1f} at most")
    return "\n".join(lines)


def _lines(row: dict[str, Any]) -> list[str]:
    lines = [
        f"{row['name']}: offset {1e3 * abs(complex(*row['offset_V'])):.1f} mV, water explained to "
        f"{row['residual']:.1%}, reciprocal to {row['reciprocity']:.1%}"
    ]
    for one in row["objects"]:
        where = "not found" if one["found_deg"] is None else f"off by {one['error_deg']:.1f} degrees"
        wrong = "" if one["right"] else ", WRONG"
        lines.append(f"  electrode {one['electrode']:2d} {one['material']:8}{where}{wrong}")
    if not row["objects"]:
        lines += [
            f"  {one['material']:8}at {one['angle_deg']:.0f} degrees, {one['radius']:.2f} of the radius"
            for one in row["found"]
        ]
    return lines
