"""Maps in a terminal: two pixels a character, by half blocks with a colour above and one below; and figures in files.

The map and its truth are drawn beside each other, as large as the terminal allows, each pixel the mean over its area.
They are drawn on the alternate screen, so that the terminal afterwards shows what it showed before. y = 0 is at the
bottom.
"""

import shutil
from pathlib import Path
from typing import Any, Final, Self, TextIO

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.writing import replacing

GAP: Final = 4
"""Characters between two maps side by side."""


def fitted(image: npt.NDArray[np.floating], columns: int, lines: int) -> npt.NDArray[np.float64]:
    """Return a map as (2 lines, columns), each value the mean over the area that it stands for."""
    rows_in, columns_in = image.shape
    return np.asarray(_means(rows_in, 2 * lines) @ image @ _means(columns_in, columns).T, dtype=np.float64)


def _means(size: int, to: int) -> npt.NDArray[np.float64]:
    """Return (to, size) weights that average intervals of one division of a line over those of another."""
    edges_in, edges = np.arange(size + 1) / size, np.arange(to + 1) / to
    shared = np.minimum(edges[1:, None], edges_in[None, 1:]) - np.maximum(edges[:-1, None], edges_in[None, :-1])
    shared = np.maximum(shared, 0.0)
    return np.asarray(shared / shared.sum(axis=1, keepdims=True), dtype=np.float64)


RATE_HZ: Final = 15.0
"""Pictures a second."""

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


HALF: Final = "▀"


class Painter:
    """Owns the screen of a terminal while it is open.

    Args:
        stream: The terminal: of 256 colours, in UTF-8.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._colours = [16 + round(r / 51) * 36 + round(g / 51) * 6 + round(b / 51) for r, g, b in palette()]

    def __enter__(self) -> Self:
        self._write("\x1b[?1049h\x1b[?25l\x1b[2J")
        return self

    def __exit__(self, *_: object) -> None:
        self._write("\x1b[0m\x1b[?25h\x1b[?1049l")

    def show(self, title: str, image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]) -> None:
        """Draw one picture over the one before.

        Args:
            title: First line; it is cut where it is too long.
            image: (rows, columns) the streamed map.
            truth: (rows, columns) what it should be.
        """
        lines = self.picture(*shutil.get_terminal_size(), title, image, truth)
        self._write("\x1b[H" + "\n".join(f"{line}\x1b[K" for line in lines) + "\x1b[J")

    def picture(
        self, width: int, height: int, title: str, image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]
    ) -> list[str]:
        """Return the lines of one picture, at most ``height`` of at most ``width`` characters; see :meth:`show`."""
        zoom = min((width - GAP) / 2 / image.shape[1], 2 * (height - 2) / image.shape[0])
        across, lines = max(int(zoom * image.shape[1]), 2), max(int(zoom * image.shape[0] / 2), 1)
        gap = " " * GAP
        drawn = [self._lines(fitted(one, across, lines)) for one in (image, truth)]
        captions = f"{'streamed'.ljust(across)}{gap}truth"
        return [title[:width], captions[:width], *(a + gap + b for a, b in zip(*drawn, strict=True))][:height]

    def _lines(self, image: npt.NDArray[np.floating]) -> list[str]:
        """Return the lines of one map, one for two of its rows."""
        levels = np.clip((image[::-1] * LEVELS).astype(int), 0, LEVELS - 1)
        colours = np.array(self._colours)[levels]
        pairs = zip(colours[0::2].tolist(), colours[1::2].tolist(), strict=True)
        return [
            "".join(f"\x1b[38;5;{a};48;5;{b}m{HALF}" for a, b in zip(top, bottom, strict=True)) + "\x1b[0m"
            for top, bottom in pairs
        ]

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


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
