"""How p keeps its word, drawn: how often it was below a level, over the level."""

from pathlib import Path
from typing import Any

from eitskin_tools.pictures import save


def draw(path: Path, stated: list[dict[str, Any]]) -> None:
    """Draw stated and found shares, with two standard errors.

    Args:
        path: Of the picture.
        stated: Rows of :func:`eitskin_tools.bench.verify.matched.matched`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.7", linewidth=1.0, label="p keeps its word")
    for what in dict.fromkeys(one["what"] for one in stated):
        own = [one for one in stated if one["what"] == what]
        axes.errorbar(
            [one["stated"] for one in own],
            [one["found"] for one in own],
            [2.0 * one["error"] for one in own],
            marker="o", markersize=3.0, linewidth=1.0, capsize=2.0, label=what.removeprefix("p, "),
        )  # fmt: skip
    axes.set_xlabel("stated: level of p")
    axes.set_ylabel("found: share of right answers below")
    axes.legend(fontsize=8)
    save(figure, path, dpi=120)
