"""What is said of a taught sheet: the verdict in words, and a picture of where it errs."""

from pathlib import Path
from typing import Any

import numpy as np

from eitskin_tools.pictures import save
from eitskin_tools.teach.teaching import Taught, error_map


def verdict(report: dict[str, Any]) -> str:
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
    return "\n".join(lines)


def draw(path: Path, taught: Taught) -> None:
    """Write a picture: the presses, and the error near each place.

    Raises:
        OSError: It cannot be written.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    grid, (length, width) = taught.skin.grid, taught.skin.outline.size_mm
    errors = error_map(taught, grid.pixel_centres_mm().reshape(-1, 2)).reshape(grid.shape)
    inside = taught.arrays["inside"].reshape(grid.shape)
    figure, axes = plt.subplots(figsize=(6.4, 1.2 + 5.4 * width / length), layout="constrained")
    image = axes.imshow(np.where(inside, errors, np.nan), origin="lower", extent=(0, length, 0, width), vmin=0.0)
    axes.plot(*taught.places_mm.T, ".", color="white", markersize=2)
    axes.set(xlabel="x, mm", ylabel="y, mm", title=f"Error of the place, {len(taught.places_mm)} presses")
    figure.colorbar(image, label="mm")
    save(figure, path, 120.0)
    plt.close(figure)


def _physics(report: dict[str, Any]) -> str:
    if report["physics_weight"]:
        return " The skin's model agrees with them and was used."
    return " The skin's model does not explain them and was not used." if report["physics_tried"] else ""
