"""Maps in a terminal: two pixels a character, by half blocks with a colour above and one below; and figures in files.

A map of 30 x 45 takes 15 lines of 45 characters. The truth stands beside or below it. Both are drawn as large as the
terminal allows, whole pixels enlarged where there is room, and averaged over areas where there is not. The picture is
drawn on the alternate screen, so that the terminal afterwards shows what it showed before. y = 0 is at the bottom.
"""

import os
import shutil
import struct
import textwrap
import zlib
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Self, TextIO

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.writing import replacing

GAP: Final = 4
"""Characters between two maps side by side."""

MIN_COLUMNS: Final = 24
"""A narrower map shows nothing of a touch any more."""

MAX_ZOOM: Final = 4
"""Most characters across of an enlarged pixel."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where maps stand."""

    columns: int
    """Characters across a map."""
    lines: int
    """Lines of a map."""
    arrangement: Literal["beside", "below", "alone"]
    """Where the truth stands, or that there is only one map."""
    left_out: bool = False
    """Whether there is a truth that is not shown."""


def arrange(width: int, height: int, shape: tuple[int, int], *, truth: bool) -> Layout:
    """Return how maps fit.

    Args:
        width: Characters of the screen.
        height: Lines that are left for maps and captions.
        shape: Rows and columns of a map's pixels.
        truth: Whether there are two maps.
    """
    alone = _largest(width, height - 1, shape)
    if not truth:
        return Layout(*alone, "alone")
    beside = _largest((width - GAP) // 2, height - 1, shape)
    below = _largest(width, (height - 2) // 2, shape)
    if max(beside[0], below[0]) < MIN_COLUMNS:
        return Layout(*alone, "alone", left_out=True)
    return Layout(*below, "below") if below[0] > beside[0] else Layout(*beside, "beside")


def _largest(width: int, lines: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return (columns, lines) of the largest map in a box, at least 2 by 1."""
    rows, columns = shape
    times = min(width // columns, 2 * lines // (rows + rows % 2), MAX_ZOOM)
    if times >= 1:
        return times * columns, -(-times * rows // 2)
    share = min(width / columns, 2 * lines / rows)
    return max(int(share * columns), 2), max(round(share * rows / 2), 1)


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

TRUTH_LEFT_OUT: Final = "truth left out; make this 80 x 24"
"""What a terminal says that is too small for both maps."""

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
SHADES: Final = " ░▒▓█"
ASCII_SHADES: Final = " .+*#"
"""What a terminal shows whose encoding has no blocks."""


def has_blocks(encoding: str | None) -> bool:
    """Return whether what is drawn with can be written in an encoding; None for a stream without one, of texts."""
    try:
        (HALF + SHADES).encode(encoding or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


def plain_lines(image: npt.NDArray[np.floating], shades: str = SHADES) -> list[str]:
    """Return a line of shades for two rows of a map, for a terminal without colours or for a text file.

    Args:
        image: (rows, columns), 0 to 1.
        shades: From the lowest to the highest.
    """
    upright = np.asarray(image, dtype=np.float64)[::-1]
    if len(upright) % 2:
        upright = np.concatenate([np.zeros((1, upright.shape[1])), upright])
    pairs = np.maximum(upright[0::2], upright[1::2])
    levels = np.clip((pairs * len(shades)).astype(int), 0, len(shades) - 1)
    return ["".join(shades[level] for level in row) for row in levels]


class Painter:
    """Owns the screen while it is open.

    Args:
        stream: The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._above, self._below = _codes()
        self._shades = SHADES if has_blocks(stream.encoding) else ASCII_SHADES
        self._plain = bool(os.environ.get("NO_COLOR")) or self._shades is ASCII_SHADES

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
        if self._plain:
            return plain_lines(image, self._shades)
        upright = np.asarray(image, dtype=np.float64)[::-1]
        levels = np.clip((upright * LEVELS).astype(int), 0, LEVELS - 1)
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
        self, title: str, image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating] | None, footer: list[str]
    ) -> None:
        """Draw one picture over the one before.

        Args:
            title: First line; it is wrapped where it is too long.
            image: (rows, columns) the streamed map.
            truth: (rows, columns) what it should be.
            footer: Lines below, wrapped as well; they say what is left out where the terminal is too small.
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
        truth: npt.NDArray[np.floating] | None,
        footer: list[str],
    ) -> list[str]:
        """Return the lines of one picture, at most ``height`` of at most ``width`` characters.

        Args:
            width: Characters of the terminal.
            height: Lines of the terminal.
            title: See :meth:`show`.
            image: See :meth:`show`.
            truth: See :meth:`show`.
            footer: See :meth:`show`.
        """
        above, below = _wrapped([title], width), _wrapped(footer, width)
        layout = arrange(width, height - len(above) - len(below), image.shape, truth=truth is not None)
        if layout.left_out:  # texts get a line each, so that the map keeps the rest
            above, below = [title[:width]], [line[:width] for line in (TRUTH_LEFT_OUT, *footer)]
            layout = arrange(width, height - len(above) - len(below), image.shape, truth=False)
        maps = self._maps(layout, image, truth)
        spare = height - len(above) - len(maps) - len(below)
        return [*above, *[""][: max(spare - 1, 0)], *maps, *[""][: max(spare, 0)], *below][: max(height, 1)]

    def _maps(
        self, layout: Layout, image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating] | None
    ) -> list[str]:
        """Return the maps under their captions."""
        streamed = self.lines(fitted(image, layout.columns, layout.lines))
        if truth is None or layout.arrangement == "alone":
            return ["streamed", *streamed]
        right = self.lines(fitted(truth, layout.columns, layout.lines))
        if layout.arrangement == "below":
            return ["streamed", *streamed, "truth", *right]
        gap = " " * GAP
        captions = f"{'streamed'.ljust(layout.columns)}{gap}truth"
        return [captions, *(a + gap + b for a, b in zip(streamed, right, strict=True))]


def _wrapped(lines: list[str], width: int) -> list[str]:
    """Return lines of limited width."""
    return [part for line in lines for part in textwrap.wrap(line, max(width, 8)) or [""]]


def png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Return a picture as the content of a PNG file.

    Args:
        pixels: (height, width, 3), red, green and blue.
    """
    height, width, _ = pixels.shape
    rows = np.pad(pixels.reshape(height, -1), ((0, 0), (1, 0)))  # each begins with 0, the filter that changes nothing
    head, data = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0), zlib.compress(rows.tobytes())
    chunks = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in ((b"IHDR", head), (b"IDAT", data), (b"IEND", b""))
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


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
