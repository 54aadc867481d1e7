"""The line of ``eitskin subscribe`` about the newest frames, kept up to date or written every second.

::

    199.8 frames/s  touched  peak 0.93 at x 45.0, y 35.0 mm  vd2t-int8  age 1.3 ms  lost 0
"""

import time
from collections.abc import Callable
from typing import Any, Final, TextIO

import numpy as np

from eitskin.messaging.streams.verified import CONTESTED, DENTED, FITTED, TIME, UNEXPLAINED
from eitskin.touches.force import ForceTable
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.console.terminal import StatusLine
from eitskin_tools.console.words import electrode_words, event_words

REDRAW_S: Final = 0.1
"""Between two texts on a terminal."""

REPEAT_S: Final = 1.0
"""Between two lines elsewhere."""


def peak(image: Any, grid: Grid | None) -> str:
    """Return height and place of the highest pixel: in mm, or by its numbers where the grid is unknown."""
    row, column = np.unravel_index(int(np.argmax(image)), image.shape)
    if grid is not None and image.shape == grid.shape:
        dx, dy = grid.pixel_mm
        return f"peak {image[row, column]:.2f} at x {(column + 0.5) * dx:.1f}, y {(row + 0.5) * dy:.1f} mm"
    return f"peak {float(image[row, column]):.2f} at row {row}, column {column}"


class StreamView:
    """Shows frames as often as a person reads them.

    Args:
        stream: Where the line goes.
        now_s: The clock.
        grid: Of the skin that streams; None if it is unknown.
    """

    def __init__(
        self, stream: TextIO, now_s: Callable[[], float] = time.monotonic, grid: Grid | None = PAPER.grid
    ) -> None:
        self._grid = grid
        self._line = StatusLine(stream)
        self._now_s = now_s
        self._every_s = REDRAW_S if self._line.live else REPEAT_S
        self._begin: tuple[float, int] | None = None
        self._due_s = 0.0
        self._rate_hz = 0.0
        self._newest: Any = None
        self._pending = False

    def show(self, frame: Any) -> None:
        """Take a frame, and show it if it is time."""
        now_s, self._newest, self._pending = self._now_s(), frame, True
        if self._begin is None:
            self._begin = (now_s, frame.number)
            self._due_s = now_s
        if now_s < self._due_s:
            return
        self._due_s = now_s + self._every_s
        begin_s, begin = self._begin
        if now_s - begin_s >= REPEAT_S:  # over a second at least, so that the number can be read
            self._rate_hz = max(frame.number - begin, 0) / (now_s - begin_s)
            self._begin = (now_s, frame.number)
        self._draw()

    def end(self) -> None:
        """Show the last frame, if it was not, and leave the line where it is."""
        if self._pending:
            self._draw()
        self._line.end()

    def _draw(self) -> None:
        self._pending = False
        text = describe(self._newest, self._rate_hz, self._grid)
        if self._line.live:
            self._line.show(text)
        else:
            self._line.above(text)


def describe(frame: Any, rate_hz: float, grid: Grid | None = PAPER.grid) -> str:
    """Return a frame in a line.

    Args:
        frame: :class:`eitskin.Frame`.
        rate_hz: Frames a second that the runtime publishes; 0 while that is unknown.
        grid: Of the skin that streams; None if it is unknown.
    """
    shown = f"touched  {peak(frame.map, grid)}" if frame.touched else "untouched"
    rate = f"{rate_hz:.1f} frames/s" if rate_hz else f"frame {frame.sequence}"
    parts = [rate, shown, frame.solver, f"age {frame.age_s * 1e3:.1f} ms", f"lost {frame.counts['lost']}"]
    if frame.touched:
        parts.append("drift unknown while touched")
    elif frame.drift_percent is not None and frame.drift_sd_percent is not None:
        parts.append(f"drift {frame.drift_percent:+.1f} +- {frame.drift_sd_percent:.1f} %")
    if frame.electrodes:
        parts += [electrode_words(one) for one in frame.electrodes]
    if frame.events:
        parts.append(f"[{'; '.join(event_words(one) for one in frame.events)}]")
    return "  ".join(parts)


FLAGGED: Final = {
    UNEXPLAINED: "FLAGGED: these touches do not explain the frame",
    CONTESTED: "FLAGGED: the network clearly shows a touch that is missing here, or a touch is too small",
    DENTED: "FLAGGED: the sheet has a dent; touches may be some mm off until it was seen untouched",
    TIME: "FLAGGED: no confirmed explanation within the time limit",
}
"""By reason; an older runtime gives none."""


def describe_verdict(found: Any, table: ForceTable | None = None) -> list[str]:
    """Return the lines of a verdict, or of how the verifier is.

    Args:
        found: :class:`eitskin.VerifiedFrame`.
        table: From strength to newtons, of the user's own.
    """
    if not found.verified:
        return [f"{found.sequence} not verified: {state_text(found.state, found.why)}"]
    fitted = " on a shape fitted to frames" if found.why == FITTED else ""
    said = FLAGGED.get(found.why, "FLAGGED") if found.flagged else f"verified{fitted}"
    behind_ms = (found.host_ns["end"] - found.host_ns["publish"]) * 1e-6
    head = (
        f"{found.sequence} {said}, p {found.p_value:.3g}, chi-squared {found.chi_squared:.1f} for "
        f"{found.degrees_of_freedom}, {len(found.touches)} touches, {found.spent_s * 1e3:.1f} ms, {behind_ms:.1f} ms "
        f"behind the frame; {found.counts['checked']} checked, {found.counts['flagged']} flagged, "
        f"{found.counts['skipped']} skipped"
    )
    return [head, *(f"{found.sequence}   {touch}{force_text(touch, table)}" for touch in found.touches)]


def force_text(touch: Any, table: ForceTable | None) -> str:
    """Return the force of a touch and its standard deviation, for the end of its line; nothing without a table.

    Args:
        touch: :class:`eitskin.VerifiedTouch`.
        table: From strength to newtons, of the user's own.
    """
    if table is None:
        return ""
    force = table.newtons(touch.strength_mm2, touch.strength_error_mm2 or 0.0)
    if force is None:
        return f", force unknown: the table covers {table.rows[0][0]:g} to {table.rows[-1][0]:g} mm2"
    more = " from the table alone" if touch.strength_error_mm2 is None else ""
    return f", force {force[0]:.2f} +- {force[1]:.2f} N{more}"


def state_text(state: str, why: str) -> str:
    """Return how a verifier is, in a few words."""
    words = {
        "starting": "the verifier is starting",
        "preparing": "the verifier is modelling the current surface",
        "ready": "the verifier is ready, with no new verdict",
        "waiting": "the verifier ended and will restart",
        "failed": "the verifier failed",
    }
    return words[state] + (f": {why}" if why else "")
