"""Phantoms as a picture, a row each, on the bent surface: the truth, and what solvers make of the same voltages."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.plain import plain
from eitskin_sim.evaluation.harness import Case, Conditions, Run, Solver, evaluate_all
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.scene.bend import surface
from eitskin_sim.scene.parts import Phantom
from eitskin_tools.evaluation.solvers import Request, named
from eitskin_tools.pictures.saved import save

Array = npt.NDArray[np.float64]

SOLVERS: Final = ("vd2t", "tikhonov", "l1", "sbl")
"""Columns after the truth; classical ones with the post-deformation reference and the grid of the labels."""

FINE: Final = 2
"""Surface cells a pixel, so that the bent sheet is smooth and pixels keep their edges."""

CELL_INCH: Final = (2.1, 1.6)
DPI: Final = 90


@dataclass(frozen=True, slots=True)
class Row:
    """One phantom and its maps."""

    phantom: Phantom
    truth: Array
    maps: tuple[Array, ...]


def collect(phantoms: Sequence[Phantom], conditions: Conditions, bundle: str | Path | None = None) -> list[Row]:
    """Return the maps of every phantom under the first noise draw.

    Args:
        phantoms: What to look at.
        conditions: Noise; without shifts, which would move the touches away from their truth.
        bundle: The network's file; None takes the shipped one of the phantoms' labels.
    """
    rows = []
    for number, phantom in enumerate(phantoms):
        maps: list[Array] = []
        runs = []
        for name in SOLVERS:
            request = Request(name, bundle=bundle)
            run = named(request, phantom.truth, conditions.skin, phantom.scene.touch_kind).run
            runs.append(Run(_keep(run.solver, maps), run.reference))
        evaluate_all([phantom], runs, conditions, numbers=[number])
        rows.append(Row(phantom, truth_map(phantom, conditions.skin.grid), tuple(maps[: len(SOLVERS)])))
    return rows


def draw(rows: Sequence[Row], path: str | Path) -> None:
    """Write the picture as a PNG file.

    Args:
        rows: One a phantom.
        path: The file.

    Raises:
        OSError: The file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.colors import ListedColormap

    from eitskin_tools.pictures.draw import palette

    colours = ListedColormap(palette() / 255.0)
    columns = 1 + len(SOLVERS)
    size = (CELL_INCH[0] * columns, CELL_INCH[1] * len(rows) + 0.3)
    figure = pyplot.figure(figsize=size, dpi=DPI)
    for index, row in enumerate(rows):
        points = _points(row.phantom, row.truth.shape)
        for column, image in enumerate((row.truth, *row.maps)):
            axes: Any = figure.add_subplot(len(rows), columns, index * columns + column + 1, projection="3d")
            faces = colours(np.kron(np.clip(image, 0.0, 1.0), np.ones((FINE, FINE))))
            axes.plot_surface(
                *points, facecolors=faces, rstride=1, cstride=1, shade=True, antialiased=False, linewidth=0
            )
            axes.set_box_aspect([max(float(np.ptp(axis)), 1.0) for axis in points], zoom=1.08)
            axes.view_init(elev=55, azim=-70)
            axes.set_axis_off()
            title = ("truth", *SOLVERS)[column] if index == 0 else ""
            axes.set_title(title, fontsize=10, pad=0)
            note = f"phantom {plain(row.phantom.name)}" if column == 0 else f"CC {_alike(image, row.truth)}"
            axes.text2D(0.5, 0.02, note, transform=axes.transAxes, ha="center", fontsize=8, parse_math=False)
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.01, top=0.97, wspace=0.0, hspace=0.0)
    try:
        save(figure, path)
    finally:
        pyplot.close(figure)


def _alike(image: Array, truth: Array) -> str:
    """Return the CC of a map in words; a sheet that nothing touches has none."""
    return f"{correlation(image, truth):.3f}" if truth.any() else "-"


def _keep(solver: Solver, maps: list[Array]) -> Solver:
    def solve(case: Case) -> Array:
        image = solver(case)
        maps.append(image)
        return image

    return solve


def _points(phantom: Phantom, shape: tuple[int, ...]) -> tuple[Array, ...]:
    """Return x, y, z of the corners of the surface's cells, (rows FINE + 1, columns FINE + 1) each."""
    length, width = phantom.scene.sheet.size_mm
    rows, columns = shape
    x, y = np.linspace(0.0, length, columns * FINE + 1), np.linspace(0.0, width, rows * FINE + 1)
    flat = np.stack(np.meshgrid(x, y), axis=-1)
    points = surface(phantom.scene.bend, phantom.scene.sheet, flat.reshape(-1, 2)).reshape(*flat.shape[:2], 3)
    return points[..., 0], points[..., 1], points[..., 2]
