"""Maps in a terminal: two pixels a character, by half blocks with a colour above and one below; and figures in files.

The map and its truth are drawn beside each other, as large as the terminal allows, each pixel the mean over its area.
They are drawn on the alternate screen, so that the terminal afterwards shows what it showed before. y = 0 is at the
bottom.
"""

import os
import shutil
import textwrap
from pathlib import Path
from types import TracebackType
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


def _codes() -> tuple[list[str], list[str]]:
    colours = palette()
    if os.environ.get("COLORTERM", "") in ("truecolor", "24bit"):
        return [f"\x1b[38;2;{r};{g};{b}m" for r, g, b in colours], [f"\x1b[48;2;{r};{g};{b}m" for r, g, b in colours]
    cube = [16 + 36 * round(r / 51) + 6 * round(g / 51) + round(b / 51) for r, g, b in colours]
    return [f"\x1b[38;5;{n}m" for n in cube], [f"\x1b[48;5;{n}m" for n in cube]


HALF: Final = "▀"
SHADES: Final = " .+*#"
"""What a terminal shows that has no colours, or whose encoding has no blocks."""


class Painter:
    """Owns the screen while it is open.

    Args:
        stream: The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._above, self._below = _codes()
        self._plain = bool(os.environ.get("NO_COLOR")) or "utf" not in (stream.encoding or "utf-8").lower()

    def __enter__(self) -> Self:
        self._stream.write("\x1b[?1049h\x1b[?25l\x1b[2J")
        self._stream.flush()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.write("\x1b[0m\x1b[?25h\x1b[?1049l")
        self._stream.flush()

    def lines(self, image: npt.NDArray[np.floating]) -> list[str]:
        """Return the lines of one map, one for two of its rows."""
        shades = len(SHADES) if self._plain else LEVELS
        levels = np.clip((np.asarray(image)[::-1] * shades).astype(int), 0, shades - 1)
        if self._plain:
            return ["".join(SHADES[level] for level in row) for row in np.maximum(levels[0::2], levels[1::2])]
        found = []
        for top, bottom in zip(levels[0::2], levels[1::2], strict=True):
            cells, before = [], (-1, -1)
            for pair in zip(top.tolist(), bottom.tolist(), strict=True):
                if pair != before:  # most of a map has one colour
                    cells.append(f"{self._above[pair[0]]}{self._below[pair[1]]}")
                    before = pair
                cells.append(HALF)
            found.append("".join(cells) + "\x1b[0m")
        return found

    def show(
        self, title: str, image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating], footer: list[str]
    ) -> None:
        """Draw one picture over the one before.

        Args:
            title: First line; it is wrapped where it is too long.
            image: (rows, columns) the streamed map.
            truth: (rows, columns) what it should be.
            footer: Lines below, wrapped as well.
        """
        text = self.picture(*shutil.get_terminal_size(), title, image, truth, footer)
        body = "\n".join(line + "\x1b[K" for line in text)
        self._stream.write("\x1b[H" + body + "\x1b[J")
        self._stream.flush()

    def picture(
        self,
        width: int,
        height: int,
        title: str,
        image: npt.NDArray[np.floating],
        truth: npt.NDArray[np.floating],
        footer: list[str],
    ) -> list[str]:
        """Return the lines of one picture, at most ``height`` of at most ``width`` characters; see :meth:`show`."""
        above, below = _wrapped([title], width), _wrapped(footer, width)
        rows, columns = image.shape
        zoom = min((width - GAP) / 2 / columns, 2 * (height - len(above) - len(below) - 1) / rows)
        across, lines = max(int(zoom * columns), 2), max(int(zoom * rows / 2), 1)
        maps = [self.lines(fitted(one, across, lines)) for one in (image, truth)]
        gap = " " * GAP
        captions = f"{'streamed'.ljust(across)}{gap}truth"[:width]
        return [*above, captions, *(a + gap + b for a, b in zip(*maps, strict=True)), *below][: max(height, 1)]


def _wrapped(lines: list[str], width: int) -> list[str]:
    """Return lines of limited width."""
    return [part for line in lines for part in textwrap.wrap(line, max(width, 8)) or [""]]


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
