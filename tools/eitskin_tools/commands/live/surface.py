"""``eitskin surface``: a raw scan in, the ordered 3 x 30 x 45 cloud out."""

import argparse
import json
import sys
import time
from pathlib import Path

from eitskin_tools.command_line import files


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommand's arguments."""
    parser.add_argument("file", metavar="FILE", help="scan in mm: .ply (ASCII or binary), .xyz or .npy; or sample")
    parser.add_argument("--out", required=True, metavar="CLOUD.npz", help="where the cloud goes")
    parser.add_argument(
        "--corner",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="a point near the sheet's corner (0, 0), in the scan's own frame, mm; it decides between the four ways in "
        "which a rectangle fits. Without it the scanner's frame decides: the way that needs the smallest turn",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Organise one scan and write the cloud."""
    from eitskin_sim.surface.ordered_cloud import organise, save_cloud
    from eitskin_sim.surface.point_files import read_points

    points = read_points(files.find(arguments.file, files.SCAN))
    files.writable(arguments.out)
    start = time.perf_counter()
    result = organise(points, tuple(arguments.corner) if arguments.corner else None)
    elapsed_ms = 1e3 * (time.perf_counter() - start)
    save_cloud(arguments.out, result)
    if arguments.json:
        report = {
            "file": str(arguments.file),
            "out": str(arguments.out),
            "points": len(points),
            "used": result.points,
            "outliers": result.outliers,
            "noise_mm": result.noise_mm,
            "size_mm": list(result.size_mm),
            "largest_hole_mm": result.largest_hole_mm,
            "corner": result.corner,
            "rotation": result.rotation.tolist(),
            "translation_mm": result.translation_mm.tolist(),
            "elapsed_ms": elapsed_ms,
        }
        print(json.dumps(report))
        return 0
    print(
        f"{Path(arguments.out).name}: {result.points} points, {result.outliers} outliers, "
        f"noise {result.noise_mm:.3f} mm, {result.size_mm[0]:.1f} x {result.size_mm[1]:.1f} mm, "
        f"largest hole {result.largest_hole_mm:.1f} mm, {elapsed_ms:.0f} ms"
    )
    if result.corner != "given":
        print(
            "the corner (0, 0) was taken from the scanner's frame; if that is not the sheet's, say --corner X Y Z",
            file=sys.stderr,
        )
    return 0
