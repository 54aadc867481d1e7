"""Draw sheet.svg: the flat sheet with its axes, electrodes by number, pixels and units, from the tables that are used.

Needs the extra ``plot``: ``python docs/pictures/draw_sheet.py``.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Rectangle

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import PAPER

GRID = PAPER.grid

mpl.use("svg")
mpl.rcParams["svg.hashsalt"] = "eitskin"
CONTACT_MM = 4.0
PIXEL = (7, 33)  # row, column of the pixel that is shown
UNIT = (3, 6)  # column, row of the unit that is shown
ROW = 3  # of the table: a drive and a measure that are shown


def place(arc_mm: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return a point of the border and the direction to the outside, for an arc length from the corner (0, 0)."""
    width, height = PAPER.outline.size_mm
    sides = (
        (width, lambda s: ((s, 0.0), (0.0, -1.0))),
        (height, lambda s: ((width, s), (1.0, 0.0))),
        (width, lambda s: ((width - s, height), (0.0, 1.0))),
        (height, lambda s: ((0.0, height - s), (-1.0, 0.0))),
    )
    for length, at in sides:
        if arc_mm < length:
            return at(arc_mm)
        arc_mm -= length
    raise ValueError(f"arc length beyond the border by {arc_mm:g} mm")


figure, axes = plt.subplots(figsize=(9.0, 6.6))
width, height = PAPER.outline.size_mm
axes.vlines(np.arange(1, GRID.shape[1]) * GRID.pitch_mm, 0, height, color="0.88", linewidth=0.5)
axes.hlines(np.arange(1, GRID.shape[0]) * GRID.pitch_mm, 0, width, color="0.88", linewidth=0.5)
axes.vlines(
    np.arange(1, GRID.units[1]) * width / GRID.units[1],
    0,
    height,
    color="tab:blue",
    linewidth=0.4,
    alpha=0.5,
)
axes.hlines(
    np.arange(1, GRID.units[0]) * height / GRID.units[0],
    0,
    width,
    color="tab:blue",
    linewidth=0.4,
    alpha=0.5,
)
axes.add_patch(Rectangle((0, 0), width, height, fill=False, linewidth=1.5))
spots = [place(arc) for arc in PAPER.arc_length_mm]
drive, measure = (int(value) for value in TABLE[ROW])
colours = {drive: "tab:red", drive + 1: "tab:red", measure: "tab:green", measure + 1: "tab:green"}
for number, ((x, y), (out_x, out_y)) in enumerate(spots):
    middle = (x - out_x * CONTACT_MM / 2, y - out_y * CONTACT_MM / 2)
    corner = (middle[0] - CONTACT_MM / 2, middle[1] - CONTACT_MM / 2)
    axes.add_patch(Rectangle(corner, CONTACT_MM, CONTACT_MM, color=colours.get(number, "0.25")))
    axes.text(x + 4 * out_x, y + 4 * out_y, str(number), ha="center", va="center", color=colours.get(number, "0"))
row, column = PIXEL
centre = GRID.pixel_centres_mm()[row, column]
axes.add_patch(Rectangle(tuple(centre - GRID.pitch_mm / 2), GRID.pitch_mm, GRID.pitch_mm, color="tab:orange"))
axes.annotate(
    f"map[{row}, {column}]: a pixel, {GRID.pitch_mm:.2f} mm\ncentre x {centre[0]:.2f}, y {centre[1]:.2f} mm",
    tuple(centre), (85, 8), fontsize=9, bbox={"facecolor": "white", "edgecolor": "0.7"},
    arrowprops={"arrowstyle": "-", "color": "tab:orange"},
)  # fmt: skip
x0, y0, x1, y1 = GRID.unit_rect_mm(*UNIT)
axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, color="tab:blue", alpha=0.6))
axes.annotate(
    f"unit [{UNIT[0]}, {UNIT[1]}]: {x1 - x0:.2f} x {y1 - y0:.2f} mm",
    (x1, y1), (52, 85), fontsize=9, bbox={"facecolor": "white", "edgecolor": "0.7"},
    arrowprops={"arrowstyle": "-", "color": "tab:blue"},
)  # fmt: skip
note = f"row {ROW} of the table: current into {drive}, out of {drive + 1} (red),\nV = U[{measure}] - U[{measure + 1}]"
axes.text(width / 2, height / 2, f"{note} (green)", ha="center", va="center", fontsize=9, backgroundcolor="white")
axes.set(xlim=(-12, width + 12), ylim=(-12, height + 12), aspect="equal", xlabel="x, mm", ylabel="y, mm")
axes.set_title("The flat sheet: origin in the corner (0, 0), electrodes counter-clockwise", fontsize=10)
figure.tight_layout()
figure.savefig(Path(__file__).with_name("sheet.svg"), metadata={"Date": None})
