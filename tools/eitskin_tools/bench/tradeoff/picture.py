"""Error against run time as a picture, one panel a file.

A disc stands for a variant that gives the whole map, a ring for one that gives a part of it; red is what no variant
with a whole map beats in both, grey what one beats. The line joins the red discs.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from eitskin_tools.bench.tradeoff.point_names import beside
from eitskin_tools.pictures import save

SMALLEST_ERROR: Final = 1e-4
"""Where the axis ends."""

BESIDE: Final = 2
"""Panels side by side; more stand below each other."""

MEANINGS: Final = (
    (True, True, "not beaten in both"),
    (True, False, "beaten"),
    (False, True, "a part of the map, not beaten by a whole one"),
    (False, False, "a part of the map, beaten"),
)
"""(whole map, on the front, what the legend says)."""


def style(row: dict[str, Any]) -> dict[str, Any]:
    """Return how a variant's point is drawn: a disc or a ring, red or grey."""
    colour = "tab:red" if row["pareto"] else "tab:grey"
    return {"edgecolors": colour, "facecolors": colour if row["whole"] else "white"}


def plot(found: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Draw error against run time, the Pareto front as a line.

    Args:
        found: Rows of ``measure`` by the name of their panel.
        path: The PNG file.

    Raises:
        OSError: The file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    columns = min(len(found), BESIDE)
    lines = -(-len(found) // columns)
    figure, panels = pyplot.subplots(
        lines, columns, figsize=(7.0 * columns, 5.2 * lines), layout="constrained", squeeze=False
    )
    for empty in panels.ravel()[len(found) :]:
        empty.set_axis_off()
    for axes, (name, rows) in zip(panels.ravel(), found.items(), strict=False):
        shown = _shown(rows)
        front = sorted((row for row in shown if row["pareto"] and row["whole"]), key=lambda row: row["p50"])
        axes.plot(*zip(*map(_point, front), strict=True), color="tab:red", zorder=1)
        for whole, pareto, _ in MEANINGS:
            group = [row for row in shown if (row["whole"], row["pareto"]) == (whole, pareto)]
            if group:
                axes.scatter(*zip(*map(_point, group), strict=True), **style(group[0]), zorder=2)
        axes.set(xscale="log", yscale="log", xlabel="paced run time, us (p50)", ylabel="1 - CC", title=name)
        axes.grid(alpha=0.3)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=len(MEANINGS), fontsize=8, frameon=False)
    figure.canvas.draw()  # gives the panels their places
    figure.set_layout_engine("none")
    for axes, rows in zip(panels.ravel(), found.values(), strict=False):
        shown = _shown(rows)
        beside(axes, [_point(row) for row in shown], [row["variant"] for row in shown])
    try:
        save(figure, path)
    finally:
        pyplot.close(figure)


def _legend() -> list[Any]:
    from matplotlib.lines import Line2D

    found = []
    for whole, pareto, meaning in MEANINGS:
        colours = style({"whole": whole, "pareto": pareto})
        found.append(
            Line2D(
                [], [], linestyle="", marker="o", markeredgecolor=colours["edgecolors"],
                markerfacecolor=colours["facecolors"], label=meaning,
            )
        )  # fmt: skip
    return found


def _shown(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows that the picture shows: the gate's error is one of another kind."""
    return [row for row in rows if not row["variant"].startswith("gate")]


def _point(row: dict[str, Any]) -> tuple[float, float]:
    """Return where a variant stands in the picture; an error of 0 cannot stand on a logarithmic axis."""
    return row["p50"], max(row["error"], SMALLEST_ERROR)
