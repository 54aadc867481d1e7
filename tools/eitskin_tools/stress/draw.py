"""Degradation curves as a picture: a panel a sweep, a line a solver, marks where each has lost a tenth and a half."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from eitskin_tools.stress.rows import BROKEN, DEGRADED, Curve

COLUMNS: Final = 5
PANEL_INCH: Final = (3.4, 2.5)
DPI: Final = 100


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

    sweeps = list(dict.fromkeys(curve.sweep for curve in curves))
    solvers = list(dict.fromkeys(curve.solver for curve in curves))
    columns = min(COLUMNS, len(sweeps))
    rows = -(-len(sweeps) // columns)
    size = (columns * PANEL_INCH[0], rows * PANEL_INCH[1] + 0.5)
    figure, panels = pyplot.subplots(rows, columns, figsize=size, dpi=DPI, squeeze=False, layout="constrained")
    for panel in panels.flat[len(sweeps) :]:
        panel.set_axis_off()
    for sweep, panel in zip(sweeps, panels.flat, strict=False):
        for curve in (one for one in curves if one.sweep == sweep):
            colour = f"C{solvers.index(curve.solver) % 10}"
            style = "--" if "(free)" in curve.solver else "-"
            levels = [point.level for point in curve.points]
            panel.plot(levels, [point.accuracy for point in curve.points], style, color=colour, label=curve.solver)
            for level, share, mark in ((curve.degrades_at(), DEGRADED, "v"), (curve.breaks_at(), BROKEN, "x")):
                if level is not None:
                    panel.plot([level], [share * curve.unstressed], mark, color=colour, markersize=5)
            if curve.logarithmic:
                panel.set_xscale("log")
            if levels[-1] < levels[0]:
                panel.xaxis.set_inverted(True)
            panel.set_xlabel(curve.unit, fontsize=7)
        panel.set_title(sweep, fontsize=8)
        panel.set_ylim(-0.2, 1.05)
        panel.tick_params(labelsize=7)
    handles: dict[str, Any] = {}
    for panel in panels.flat:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=6, fontsize=7)
    try:
        figure.savefig(path)
    finally:
        pyplot.close(figure)
