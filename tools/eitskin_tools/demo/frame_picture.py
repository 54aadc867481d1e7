"""A real frame as a picture: the bent surface with the truth on it, the streamed map on it, and the same map laid flat.

Everything drawn was streamed: the map comes from a subscriber's record, the surface and the truth from the script at
that frame's device time. The colours are those of the terminal's picture.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_tools.demo.recorder import Record
from eitskin_tools.pictures import palette, save

MIN_ANGLE_DEG: Final = 50.0
"""A frame worth showing is bent at least so far."""

SIZE_INCH: Final = (14.0, 4.4)
DPI: Final = 110

CELLS_PER_PIXEL: Final = 4
"""Surface cells a pixel, so that the bent sheet is smooth and pixels keep their edges."""


def choose(record: Record, script: Any, start_us: int) -> tuple[int, float]:
    """Return (number of the kept map, its script time) of a bent frame with most touches and the median correlation.

    Raises:
        ValueError: No kept frame is bent and touched.
    """
    from eitskin_sim.evaluation.metrics import correlation

    first_us = int(record.device_us[0])
    times_s = ((first_us - start_us) % (1 << 32) + record.device_us - first_us)[:: record.stride] * 1e-6
    found = []
    for index, time_s in enumerate(times_s):
        scene = script.scene_at(time_s)
        if scene.touches and abs(scene.bend.angle_deg) >= MIN_ANGLE_DEG:
            found.append((len(scene.touches), index, time_s))
    if not found:
        raise ValueError(f"no frame of this record is touched and bent by {MIN_ANGLE_DEG:g} deg; record more seconds")
    most = max(count for count, _, _ in found)
    rated = [
        (correlation(record.maps[index].astype(np.float64), script.truth_at(time_s)), index, time_s)
        for count, index, time_s in found
        if count == most
    ]
    rated.sort()
    _, index, time_s = rated[len(rated) // 2]
    return index, float(time_s)


def picture(record: Record, script: Any, start_us: int, path: Path) -> None:
    """Draw one frame of a record into a PNG file.

    Args:
        record: What a subscriber noted.
        script: What the virtual skin played.
        start_us: Device clock when the script began.
        path: File to write.

    Raises:
        ValueError: The record has no frame worth drawing.
        OSError: The file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.colors import ListedColormap

    from eitskin_sim.evaluation.metrics import correlation

    index, time_s = choose(record, script, start_us)
    image = record.maps[index].astype(np.float64)
    truth = script.truth_at(time_s).astype(np.float64)
    colours = ListedColormap(palette() / 255.0)
    figure = pyplot.figure(figsize=SIZE_INCH, dpi=DPI, layout="constrained")
    bend = script.scene_at(time_s).bend
    points = _surface(script, time_s)
    for place, (values, title) in enumerate(((truth, "truth, as it is bent"), (image, "streamed, as it is bent"))):
        axes = figure.add_subplot(1, 3, place + 1, projection="3d")
        faces = colours(np.kron(values, np.ones((CELLS_PER_PIXEL, CELLS_PER_PIXEL))))
        axes.plot_surface(*points, facecolors=faces, rstride=1, cstride=1, shade=True, antialiased=False, linewidth=0)
        axes.set_box_aspect([max(np.ptp(axis), 1.0) for axis in points], zoom=1.25)
        axes.view_init(elev=38, azim=-70)
        axes.set_axis_off()
        axes.set_title(title)
    flat = figure.add_subplot(1, 3, 3)
    length, width = script.skin.outline.size_mm
    extent = (0.0, length, 0.0, width)
    shown = flat.imshow(image, origin="lower", extent=extent, cmap=colours, vmin=0.0, vmax=1.0, interpolation="nearest")
    _outline(flat, script.scene_at(time_s).touches)
    flat.set(title="streamed, laid flat; white: the true touches", xlabel="x, mm", ylabel="y, mm")
    figure.colorbar(shown, ax=flat, shrink=0.8, label="touched share of a pixel")
    figure.suptitle(
        f"bent by {bend.angle_deg:.0f}°, stretched {100 * (bend.stretch_along - 1):.1f} %; "
        f"correlation with the truth {correlation(image, truth):.3f}"
    )
    try:
        save(figure, path)
    finally:
        pyplot.close(figure)


def _outline(axes: Any, touches: Any) -> None:
    """Draw the borders of touches."""
    from matplotlib.patches import Circle, Rectangle

    from eitskin_sim.scene.shapes import Disc

    style: dict[str, Any] = {"fill": False, "edgecolor": "white", "linewidth": 1.2}
    for shape in (shape for touch in touches for shape in touch.shapes):
        x0, y0, x1, y1 = shape.bounds_mm
        if isinstance(shape, Disc):
            axes.add_patch(Circle((shape.x_mm, shape.y_mm), shape.radius_mm, **style))
        else:
            axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, **style))


def _surface(script: Any, time_s: float) -> tuple[npt.NDArray[np.float64], ...]:
    """Return x, y, z of the corners of the surface's cells, (n rows + 1, n columns + 1) each, n cells a pixel."""
    from eitskin_sim.scene.bend import surface

    scene = script.scene_at(time_s)
    (rows, columns), (length, width) = script.skin.grid.shape, script.skin.outline.size_mm
    x = np.linspace(0.0, length, columns * CELLS_PER_PIXEL + 1)
    y = np.linspace(0.0, width, rows * CELLS_PER_PIXEL + 1)
    flat = np.stack(np.meshgrid(x, y), axis=-1)
    points = surface(scene.bend, scene.sheet, flat.reshape(-1, 2)).reshape(*flat.shape[:2], 3)
    return points[..., 0], points[..., 1], points[..., 2]
