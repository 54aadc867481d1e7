"""``eitskin surface``: measured points of the bent sheet in, the ordered cloud out, with V_pred if asked.

The whole way from a 3-D scanner to a running stream is ``eitskin surface POINTS --out CLOUD.npz --predict --send``.
"""

import argparse
import time
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.console.terminal import answer, note

MM: Final = {"mm": 1.0, "m": 1000.0}
"""Millimetres of a unit."""

STALE_S: Final = 3600.0
"""A file of points that is older than this may show another shape than the sheet has now."""

DEFAULT = "default"
"""What ``--send`` without an endpoint means."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommand's arguments."""
    parser.add_argument(
        "file",
        metavar="POINTS",
        help="points of the sheet: .ply, .pcd, text (.xyz, .txt, .csv, .asc, .pts), .npy, .obj or .stl; or sample",
    )
    parser.add_argument(
        "--unit",
        choices=tuple(MM),
        default="mm",
        help="of the points, --corner, --crop, --depth and D of --plane (default: %(default)s); ROS and depth cameras "
        "write m",
    )
    parser.add_argument("--out", required=True, metavar="CLOUD.npz", help="file to write the cloud to")
    parser.add_argument(
        "--corner",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="a point near the sheet's corner (0, 0), in the points' own frame; it decides between the four ways "
        "in which a rectangle fits. Without it the scanner's coordinates decide: the way that needs the smallest turn",
    )
    parser.add_argument(
        "--rim",
        nargs="+",
        type=float,
        metavar="MM",
        help="width of what the scan shows beyond the conductive layer: one number, or two, at both ends of the longer "
        "sides and along them; 0 says that there is none: a sheet of another size is stretched or compressed",
    )
    parser.add_argument(
        "--crop", nargs=6, type=float, metavar=("X0", "X1", "Y0", "Y1", "Z0", "Z1"), help="use only points in this box"
    )
    parser.add_argument("--depth", nargs=2, type=float, metavar=("NEAR", "FAR"), help="use only points with z from, to")
    parser.add_argument(
        "--plane",
        nargs=4,
        type=float,
        metavar=("A", "B", "C", "D"),
        help="use only points with A x + B y + C z > D, such as those above a table",
    )
    parser.add_argument(
        "--predict",
        action="store_true",
        help="add V_pred, the untouched voltages of this shape by the forward model; maps are more accurate with it",
    )
    parser.add_argument(
        "--send",
        nargs="?",
        const=DEFAULT,
        metavar="ENDPOINT",
        help="give it to a running stream, at the control endpoint of 'eitskin run' (default: the same as its default)",
    )
    options.add_skin(parser, "the sheet's size, its pixels and, for V_pred, its electrodes")


def run(arguments: argparse.Namespace) -> int:
    """Order the points, write the cloud, and predict and send it where that is asked for."""
    from eitskin_proto.skin.sheet_cloud import check_sheet
    from eitskin_sim.surface.ordered_cloud import DOUBTFUL_RMS, PointCloudError, organise, save_cloud
    from eitskin_sim.surface.point_files import read_points

    skin = options.chosen_skin(arguments)
    if arguments.rim is not None and (
        len(arguments.rim) > 2 or not 0.0 <= min(arguments.rim) <= max(arguments.rim) < 50
    ):
        raise ValueError(f"--rim is {arguments.rim}, expected one or two widths from 0 to 50 mm")
    rim_mm = None if arguments.rim is None else (arguments.rim[0], arguments.rim[-1])
    source = files.find(arguments.file, files.POINTS)
    points = MM[arguments.unit] * _cut(read_points(source), arguments)
    corner = None if arguments.corner is None else tuple(MM[arguments.unit] * place for place in arguments.corner)
    files.writable(arguments.out, kinds.CLOUD)
    start = time.perf_counter()
    try:
        result = organise(points, corner, skin.grid, rim_mm)
        elapsed_ms = 1e3 * (time.perf_counter() - start)
        doubts = (*result.doubts, *check_sheet(result.cloud_mm, skin)[1])
    except (PointCloudError, ValueError) as error:
        raise PointCloudError(f"{arguments.file}: {error}") from error
    old_s = time.time() - source.stat().st_mtime
    if arguments.send is not None and old_s > STALE_S and arguments.file != "sample":
        note(f"eitskin surface: {source} is {old_s / 3600:.1f} h old; scan again if the sheet has moved")
    for doubt in doubts:
        note(f"eitskin surface: {doubt}")
    predicted, predict_ms = None, None
    if arguments.predict:
        from eitskin_sim.surface.predict import flat_voltages, predict

        start = time.perf_counter()
        predicted = predict(result.cloud_mm, skin), flat_voltages(skin)
        predict_ms = 1e3 * (time.perf_counter() - start)
        if result.prediction_rms > DOUBTFUL_RMS:
            note(
                f"eitskin surface: the sheet's outline is not known well enough: V_pred is "
                f"likely off by {100 * result.prediction_rms:.1f} %, more than {100 * DOUBTFUL_RMS:g} %; it may make "
                "maps worse: measure more densely, state --rim, or leave out --predict"
            )
    save_cloud(arguments.out, result, predicted, skin)
    sent = None if arguments.send is None else _sent(arguments.send, arguments.out)
    lines = [
        f"{Path(arguments.out).name}: {result.points} points, {result.outliers} outliers, "
        f"noise {result.noise_mm:.3f} mm, {result.size_mm[0]:.1f} x {result.size_mm[1]:.1f} mm "
        f"within {result.outline_sigma_mm:.2f} mm, largest hole {result.largest_hole_mm:.1f} mm, "
        f"{elapsed_ms:.0f} ms"
    ]
    if predict_ms is not None:
        lines.append(f"V_pred added, likely off by {100 * result.prediction_rms:.1f} %, {predict_ms:.0f} ms")
    if sent is not None:
        lines.append(f"the runtime uses it as cloud {sent}")
    if result.corner != "given" and not arguments.json:
        note("the corner (0, 0) comes from the scanner's coordinates; if that is not the sheet's, give --corner X Y Z")
    report = _report(arguments, result, len(points), elapsed_ms, predict_ms, sent) | {"doubts": doubts}
    return answer(arguments, report, *lines)


def _cut(points: Any, arguments: argparse.Namespace) -> Any:
    """Return the points within the box, the depths and beyond the plane that the arguments name."""
    import numpy as np

    inside = np.ones(len(points), dtype=np.bool_)
    if arguments.crop is not None:
        box = np.array(arguments.crop)
        inside &= np.all((points >= box[::2]) & (points <= box[1::2]), axis=1)
    if arguments.depth is not None:
        inside &= (points[:, 2] >= arguments.depth[0]) & (points[:, 2] <= arguments.depth[1])
    if arguments.plane is not None:
        inside &= points @ np.array(arguments.plane[:3]) > arguments.plane[3]
    if not inside.any():
        raise ValueError(f"{arguments.file}: --crop, --depth and --plane leave no point: widen them")
    return points[inside]


def _sent(endpoint: str, path: str) -> int:
    """Give the cloud's file to the runtime and return the cloud's revision there.

    Raises:
        SkinError: The runtime does not take it; the text says that its file is there all the same.
    """
    import warnings

    import eitskin

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", eitskin.CloudWarning)  # the same check is done here
        try:
            return eitskin.send_cloud(path) if endpoint == DEFAULT else eitskin.send_cloud(endpoint, path)
        except (SkinError, ValueError) as error:
            raise SkinError(f"{path} was written, but not sent: {error}") from error


def _report(
    arguments: argparse.Namespace,
    result: Any,
    points: int,
    elapsed_ms: float,
    predict_ms: float | None,
    sent: int | None,
) -> dict[str, object]:
    return {
        "file": str(arguments.file),
        "out": str(arguments.out),
        "points": points,
        "used": result.points,
        "outliers": result.outliers,
        "noise_mm": result.noise_mm,
        "size_mm": list(result.size_mm),
        "outline_sigma_mm": result.outline_sigma_mm,
        "prediction_rms": result.prediction_rms,
        "largest_hole_mm": result.largest_hole_mm,
        "corner": result.corner,
        "rotation": result.rotation.tolist(),
        "translation_mm": result.translation_mm.tolist(),
        "elapsed_ms": elapsed_ms,
        "predicted": predict_ms is not None,
        "predict_ms": predict_ms,
        "cloud": sent,
    }
