"""Colours of maps, and figures in files."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.writing import replacing

_STOPS: Final = np.array(
    [[13, 16, 42], [47, 42, 118], [126, 48, 140], [204, 71, 120], [248, 149, 64], [252, 253, 191]], dtype=np.float64
)

LEVELS: Final = 32
"""Colours of the scale."""


def palette() -> npt.NDArray[np.intp]:
    """Return the (32, 3) red, green and blue of the scale, from untouched to touched."""
    at = np.linspace(0.0, len(_STOPS) - 1.0, LEVELS)
    channels = [np.interp(at, np.arange(len(_STOPS)), _STOPS[:, c]) for c in range(3)]
    return np.rint(np.stack(channels, axis=1)).astype(np.intp)


def draw_map(
    axes: Any, values: npt.NDArray[np.floating], title: str, size_mm: tuple[float, float] | None = None
) -> Any:
    """Draw a map on axes of matplotlib and return the image.

    Args:
        axes: The axes; they get no frame.
        values: (rows, columns), 0 to 1; row 0 is at the bottom.
        title: Above the map.
        size_mm: Length and width of the sheet, for marks in mm; None for marks in pixels.
    """
    extent = None if size_mm is None else (0.0, size_mm[0], 0.0, size_mm[1])
    image = axes.imshow(values, origin="lower", vmin=0.0, vmax=1.0, cmap="viridis", extent=extent)
    axes.set_title(title, fontsize=7)
    axes.set_axis_off()
    return image


def save(figure: Any, path: str | Path, dpi: float = 100.0) -> None:
    """Write a figure of matplotlib; a name without an end becomes a PNG.

    Args:
        figure: It is left open.
        path: Whose end is among :data:`eitskin_tools.command_line.files.PICTURES`.
        dpi: Pixels an inch, where the format has pixels.

    Raises:
        OSError: It cannot be written.
    """
    with replacing(path) as stream:
        figure.savefig(stream, format=Path(path).suffix.lower().removeprefix(".") or "png", dpi=dpi)
