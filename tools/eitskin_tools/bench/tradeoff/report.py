"""What the variants' errors and times look like: a table, and a picture of both with the front as a line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

SMALLEST_ERROR: Final = 1e-4
"""Where the picture's axis ends."""


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table, the most accurate first."""
    lines = ["| variant | 1 - CC | p50, us | p99, us | on the front |", "|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: row["error"]):
        front = "yes" if row["pareto"] else ""
        lines.append(f"| {row['variant']} | {row['error']:.4f} | {row['p50']:.0f} | {row['p99']:.0f} | {front} |")
    return "\n".join(lines)


def plot(found: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Draw error against run time, one panel a file, the Pareto front as a line."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from eitskin_tools.bench.tradeoff.point_names import beside

    figure, panels = pyplot.subplots(
        1, len(found), figsize=(7.0 * len(found), 5.2), layout="constrained", squeeze=False
    )
    for axes, (name, rows) in zip(panels[0], found.items(), strict=True):
        shown = _shown(rows)
        front = sorted((row for row in shown if row["pareto"]), key=lambda row: row["p50"])
        axes.plot(*zip(*map(_point, front), strict=True), color="tab:red", zorder=1)
        for row in shown:
            axes.scatter(*_point(row), color="tab:red" if row["pareto"] else "tab:grey", zorder=2)
        axes.set(xscale="log", yscale="log", xlabel="paced run time, us (p50)", ylabel="1 - CC", title=name)
        axes.grid(alpha=0.3)
    figure.canvas.draw()  # gives the panels their places
    figure.set_layout_engine("none")
    for axes, rows in zip(panels[0], found.values(), strict=True):
        shown = _shown(rows)
        beside(axes, [_point(row) for row in shown], [row["variant"] for row in shown])
    try:
        figure.savefig(path, dpi=100)
    finally:
        pyplot.close(figure)


def _shown(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows that the picture shows: the gate's error is one of another kind."""
    return [row for row in rows if not row["variant"].startswith("gate")]


def _point(row: dict[str, Any]) -> tuple[float, float]:
    """Return where a variant stands in the picture; an error of 0 cannot stand on a logarithmic axis."""
    return row["p50"], max(row["error"], SMALLEST_ERROR)
