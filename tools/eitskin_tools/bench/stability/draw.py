"""Degradation curves as a picture: a panel for each sweep that harms somebody, a line a solver, mild on the left.

A solver has one colour, whole for the bundle ``units`` and dashed for ``free``. A triangle stands where a tenth of the
accuracy is lost, a cross where it breaks. Sweeps in which nobody loses a tenth are named below instead of drawn, and an
int8 network that keeps to its float32 twin has no line of its own.
"""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import numpy as np

from eitskin_tools.bench.stability.harness.rows import Curve
from eitskin_tools.pictures import save

COLUMNS: Final = 5
PANEL_INCH: Final = (3.3, 2.3)
DPI: Final = 100

COLOURS: Final = {
    "vd2t": "#0b4fa8",
    "vd2t-int8": "#58a6ff",
    "vd2t-small": "#12a3a3",
    "projection": "#2a8f3c",
    "tikhonov": "#c0392b",
    "l1": "#e08a1e",
    "sbl": "#8e5bb5",
    "gate": "#444444",
}

TWINS: Final = 0.02
"""An int8 network is drawn where it leaves its float32 twin by more than this."""

FREE: Final = " (free)"


def harmed(curves: Sequence[Curve]) -> list[str]:
    """Return the sweeps in which some solver loses a tenth."""
    return list(dict.fromkeys(curve.sweep for curve in curves if curve.degrades_at() is not None))


def drawn(curves: Sequence[Curve]) -> list[Curve]:
    """Return one sweep's curves without those int8 networks that keep to their twins."""
    accuracy = {curve.solver: np.array([point.accuracy for point in curve.points]) for curve in curves}

    def is_own(curve: Curve) -> bool:
        twin = accuracy.get(curve.solver.replace("-int8", ""))
        if "-int8" not in curve.solver or twin is None:
            return True
        return bool(np.abs(accuracy[curve.solver] - twin).max() > TWINS)

    return [curve for curve in curves if is_own(curve)]


def draw_curves(curves: Sequence[Curve], path: Path) -> None:
    """Draw curves into a PNG file.

    Args:
        curves: Of any number of sweeps.
        path: File to write.

    Raises:
        ValueError: There are no curves.
        OSError: The file cannot be written.
    """
    if not curves:
        raise ValueError("there are no curves to draw: these families have rows only")
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    sweeps = harmed(curves) or list(dict.fromkeys(curve.sweep for curve in curves))
    unharmed = [sweep for sweep in dict.fromkeys(curve.sweep for curve in curves) if sweep not in sweeps]
    columns = min(COLUMNS, len(sweeps))
    rows = -(-len(sweeps) // columns)
    size = (columns * PANEL_INCH[0], rows * PANEL_INCH[1] + 0.8)
    figure, panels = pyplot.subplots(rows, columns, figsize=size, dpi=DPI, squeeze=False, layout="constrained")
    for panel in panels.flat[len(sweeps) :]:
        panel.set_axis_off()
    for sweep, panel in zip(sweeps, panels.flat, strict=False):
        _draw_panel(panel, drawn([curve for curve in curves if curve.sweep == sweep]))
    for panel in panels[:, 0]:
        panel.set_ylabel("CC; gate: right verdicts", fontsize=7)
    handles: dict[str, Any] = {}
    for panel in panels.flat:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    names = sorted(handles, key=lambda label: (FREE in label, list(COLOURS).index(label.replace(FREE, ""))))
    figure.legend([handles[name] for name in names], names, loc="outside upper center", ncols=7, fontsize=8)
    below = "triangle: a tenth lost; cross: broken (half lost, or half of the frames withheld)."
    if unharmed:
        below += " Nobody loses a tenth by: " + "; ".join(unharmed) + "."
    figure.supxlabel(fill(below, 44 * columns), fontsize=8)
    try:
        save(figure, path)
    finally:
        pyplot.close(figure)


def _draw_panel(panel: Any, curves: Sequence[Curve]) -> None:
    """Draw one sweep."""
    for curve in curves:
        colour = COLOURS[curve.solver.replace(FREE, "")]
        style = "--" if FREE in curve.solver else "-"
        levels = [point.level for point in curve.points]
        accuracy = [point.accuracy for point in curve.points]
        panel.plot(levels, accuracy, style, color=colour, linewidth=1.2, label=curve.solver)
        for level, mark in ((curve.degrades_at(), "v"), (curve.breaks_at(), "X")):
            if level is not None:
                panel.plot([level], [_at(curve, level)], mark, color=colour, markersize=5, markeredgewidth=0)
    first, levels = curves[0], [point.level for point in curves[0].points]
    if first.logarithmic:
        from matplotlib.ticker import LogLocator, NullFormatter

        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0,) if max(levels) > 100.0 * min(levels) else (1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
    if levels[-1] < levels[0]:
        panel.xaxis.set_inverted(True)
    panel.set_title(first.sweep, fontsize=8)
    panel.set_xlabel(first.unit, fontsize=7)
    panel.set_ylim(-0.1, 1.05)
    panel.grid(alpha=0.25, linewidth=0.5)
    panel.tick_params(labelsize=7)


def _at(curve: Curve, level: float) -> float:
    """Return the accuracy at a level between those of the sweep."""
    scale = np.log if curve.logarithmic else np.asarray
    levels = scale(np.array([point.level for point in curve.points]))
    order = np.argsort(levels)
    accuracy = np.array([point.accuracy for point in curve.points])
    return float(np.interp(scale(np.array(level)), levels[order], accuracy[order]))
