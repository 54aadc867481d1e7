"""Maps in a terminal: two pixels a character, by half blocks with a colour above and one below.

A map of 30 x 45 takes 15 lines of 45 characters; the truth stands beside it where the terminal is wide enough. The
picture is drawn on the alternate screen, so that the terminal afterwards shows what it showed before. y = 0 is at the
bottom.
"""

import os
import shutil
from types import TracebackType
from typing import Final, Self, TextIO

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import GRID_SHAPE

RATE_HZ: Final = 15.0
"""Pictures a second."""

GAP: Final = 4
"""Characters between the two maps."""

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


def plain_lines(image: npt.NDArray[np.floating]) -> list[str]:
    """Return 15 lines of 45 shades, for a terminal without colours or for a text file."""
    shades = " ░▒▓█"
    upright = np.asarray(image, dtype=np.float64)[::-1]
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
        self._plain = bool(os.environ.get("NO_COLOR"))

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
        """Return the 15 lines of one map."""
        if self._plain:
            return plain_lines(image)
        upright = np.asarray(image, dtype=np.float64)[::-1]
        levels = np.clip((upright * LEVELS).astype(int), 0, LEVELS - 1)
        found = []
        for top, bottom in zip(levels[0::2], levels[1::2], strict=True):
            cells = [f"{self._above[a]}{self._below[b]}▀" for a, b in zip(top, bottom, strict=True)]
            found.append("".join(cells) + "\x1b[0m")
        return found

    def show(
        self, title: str, image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating] | None, footer: list[str]
    ) -> None:
        """Draw one picture over the one before.

        Args:
            title: First line.
            image: (30, 45) the streamed map.
            truth: (30, 45) what it should be; left out where the terminal is too narrow.
            footer: Lines below.
        """
        width, height = shutil.get_terminal_size()
        columns = GRID_SHAPE[1]
        left = self.lines(image)
        captions = "streamed".ljust(columns)
        if truth is not None and width >= 2 * columns + GAP:
            left = [a + " " * GAP + b for a, b in zip(left, self.lines(truth), strict=True)]
            captions += " " * GAP + "truth"
        text = [title[:width], "", captions[:width], *left, "", *(line[:width] for line in footer)]
        body = "\n".join(line + "\x1b[K" for line in text[: max(height, 1)])
        self._stream.write("\x1b[H" + body + "\x1b[J")
        self._stream.flush()
