"""What is said of a taught sheet: the verdict in words, and a picture of where it errs."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_tools.pictures import save
from eitskin_tools.teach.teaching import Taught, error_map

ENOUGH_UNTOUCHED: Final = 50
"""Of untouched readings, from which one alarm in a hundred can be told."""


def of_shapes(reports: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the report of all shapes: of a single one its own, else the means over presses, and each shape's."""
    several = list(reports.values())
    found = {**several[0], "shapes": reports} if len(several) > 1 else several[0]
    for name in ("localisation_median_mm", "localisation_p90_mm", "missed", "stated_within_1sd"):
        found[name] = float(np.average([one[name] for one in several], weights=[one["presses"] for one in several]))
    return found


def verdict(reports: dict[str, dict[str, Any]]) -> str:
    """Return a few lines for each shape."""
    lines = []
    for name, report in reports.items():
        lines += [f"In the shape {name}:"] if len(reports) > 1 else []
        lines.append(_verdict(report))
    known = f"shape{'s' if len(reports) > 1 else ''} {', '.join(reports)}"
    return "\n".join([*lines, f"This holds in the {known}, in which the sheet was pressed; frames name the shape."])


def _verdict(report: dict[str, Any]) -> str:
    """Return a few lines, the accuracy first."""
    wrong = report["missed"]
    lines = [
        f"A press is placed within {report['localisation_median_mm']:.1f} mm (median; 90 % within "
        f"{report['localisation_p90_mm']:.1f} mm), and {1.0 - wrong:.0%} of presses open the gate at "
        f"{report['false_alarms']:.1%} false alarms.",
        f"This was measured on {report['presses']} presses, each left out of the teaching. Twice as many would reach "
        f"about {report['twice_as_many_mm']:.1f} mm.",
        f"The sheet is weakest at ({report['weakest_mm'][0]:.0f}, {report['weakest_mm'][1]:.0f}) mm: presses near it "
        f"are off by {report['weakest_error_mm']:.1f} mm.",
        f"Presses {report['touches']} conductance." + _physics(report),
    ]
    if wrong > 0.3:
        lines.append(
            "Single readings hide these presses in noise; a running skin averages while it is still, and finds more."
        )
    if report["untouched"] < ENOUGH_UNTOUCHED:
        lines.append(
            f"The gate rests on {report['untouched']} untouched readings: its false alarms may be other ones. More "
            "untouched readings make them sure."
        )
    return "\n".join(lines)


def draw(path: Path, taught: dict[str, Taught]) -> None:
    """Write a picture: the presses in each shape, and the error near each place.

    Raises:
        OSError: It cannot be written.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    skin = next(iter(taught.values())).skin
    grid, (length, width) = skin.grid, skin.outline.size_mm
    size = 6.4, len(taught) * (1.2 + 5.4 * width / length)
    figure, several = plt.subplots(len(taught), figsize=size, layout="constrained", squeeze=False)
    for axes, (name, one) in zip(several[:, 0], taught.items(), strict=True):
        errors = error_map(one, grid.pixel_centres_mm().reshape(-1, 2)).reshape(grid.shape)
        inside = one.arrays["inside"].reshape(grid.shape)
        image = axes.imshow(np.where(inside, errors, np.nan), origin="lower", extent=(0, length, 0, width), vmin=0.0)
        axes.plot(*one.places_mm.T, ".", color="white", markersize=2)
        axes.set(xlabel="x, mm", ylabel="y, mm", title=f"{name}: error of the place, {len(one.places_mm)} presses")
        figure.colorbar(image, label="mm")
    save(figure, path, 120.0)
    plt.close(figure)


def _physics(report: dict[str, Any]) -> str:
    if report["physics_weight"]:
        return " The skin's model agrees with them and was used."
    return " The skin's model does not explain them and was not used." if report["physics_tried"] else ""
