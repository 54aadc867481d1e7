"""The demonstration's twenty seconds: which touches come, move and go, and how the sheet bends meanwhile.

::

    s     0    2    4    6    8    10   12   14   16   18   20
    bend  flat......../ rolls, stretches, turns its axis ... flat
    touch     AAAAAAAA   CCCCCCCCC    EEEEEE     HHHHHHHH
                BBBBBBB    DDDDDDDDD    FFFFFFFFF
                                         GGGGGGGG
    pause ^^^         ^^              ^^           ^^      ^^^  nothing touches; once flat, twice bent

Touches lie off every grid, are 10 to 20 mm across and grow a little as they are pressed. Everything between two events
is smooth, so that a few dozen solves a second describe it (:mod:`eitskin_tools.scripted_scene.keyframes`).
"""

import itertools
from dataclasses import dataclass, fields
from typing import Final

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.scene import Bend, Touch
from eitskin_sim.scene.shapes import Disc, Rect

PERIOD_S: Final = 20.0
"""Length of the loop."""

UNTOUCHED_FLAT_S: Final = 1.8
"""Flat and untouched at the start of the loop: the time in which a reference can be captured."""

PRESS_S: Final = 0.15
"""How long a touch grows after it comes, and shrinks before it goes."""

FIRST_CONTACT: Final = 0.7
"""Size at which a touch comes and goes, relative to its size when pressed."""

RAISED_CONTRAST: Final = 50.0
"""Conductivity of a touched place over the sheet's (paper section V.A)."""

LOWERED_CONTRAST: Final = 0.4
"""The same of a press on a skin that knows only touches that lower it."""

SOFT_MM: Final = 4.0
"""Width of the graded border of such a press: a finger has no edges."""

LENGTH_MM: Final = 150.0
WIDTH_MM: Final = 100.0
"""The sheet that the paths below are written for."""


@dataclass(frozen=True, slots=True)
class Press:
    """One touch, from when it comes until it goes."""

    name: str
    size_mm: tuple[float, float]
    """Extent along x and y when pressed; of a disc, the diameter twice."""
    path: tuple[tuple[float, float, float], ...]
    """(s, x mm, y mm): comes at the first, goes at the last."""
    disc: bool = False

    @property
    def comes_s(self) -> float:
        """When it comes."""
        return self.path[0][0]

    @property
    def goes_s(self) -> float:
        """When it goes."""
        return self.path[-1][0]

    def at(self, time_s: float, skin: Skin) -> Touch:
        """Return the touch at a time between coming and going, both included; its path is stretched to the skin."""
        (x, y), (length, width) = _between(self.path, time_s), skin.outline.size_mm
        x, y = x * (length / LENGTH_MM), y * (width / WIDTH_MM)
        pressed = min(time_s - self.comes_s, self.goes_s - time_s, PRESS_S) / PRESS_S
        scale = FIRST_CONTACT + (1.0 - FIRST_CONTACT) * smooth(pressed)
        width, height = self.size_mm[0] * scale / 2, self.size_mm[1] * scale / 2
        shape = Disc(x, y, width) if self.disc else Rect(x - width, y - height, x + width, y + height)
        if skin.touches.higher:
            return Touch((shape,), RAISED_CONTRAST * float(skin.layer.conductivity_S_per_m.nominal(1)[0]))
        return Touch((shape,), contrast=LOWERED_CONTRAST, border_mm=SOFT_MM)


PRESSES: Final[tuple[Press, ...]] = (
    Press("A", (16.0, 16.0), ((1.8, 41.3, 31.7), (3.8, 68.9, 52.3)), disc=True),
    Press("B", (14.0, 12.0), ((2.4, 106.2, 61.4), (4.6, 106.2, 61.4))),
    Press("C", (15.0, 15.0), ((5.4, 51.2, 66.1), (9.0, 93.8, 41.9)), disc=True),
    Press("D", (18.0, 12.0), ((6.4, 111.7, 24.6), (9.6, 119.3, 71.2))),
    Press("E", (18.0, 18.0), ((10.6, 31.4, 51.8), (13.2, 73.7, 70.6)), disc=True),
    Press("F", (12.0, 16.0), ((11.4, 101.1, 33.9), (15.0, 58.2, 31.3))),
    Press("G", (12.0, 12.0), ((12.2, 124.6, 66.7), (15.6, 124.6, 66.7)), disc=True),
    Press("H", (20.0, 12.0), ((16.4, 44.8, 44.3), (19.0, 101.6, 56.1))),
)
"""Every touch of the loop."""

BENDS: Final[tuple[tuple[float, Bend], ...]] = (
    (4.0, Bend()),
    (7.0, Bend(70.0, 0.0, 0.2, 0.0, 1.04, 0.99, 0.02)),
    (10.0, Bend(110.0, 20.0, -0.2, 8.0, 1.07, 0.98, 0.03)),
    (13.5, Bend(60.0, -25.0, 0.1, -6.0, 1.05, 1.01, 0.02)),
    (16.0, Bend(130.0, 0.0, 0.0, 0.0, 1.08, 0.98, 0.04)),
    (18.5, Bend()),
)
"""The bend at some times; in between every parameter goes smoothly from one to the next."""


def smooth(part: float) -> float:
    """Return 0 to 1 with zero slope at both ends."""
    part = min(max(part, 0.0), 1.0)
    return part * part * (3.0 - 2.0 * part)


def touches_at(time_s: float, skin: Skin, *, before: bool = False) -> tuple[Touch, ...]:
    """Return the touches at a time of the loop; at the moment of an event those after it, or before it."""

    def present(press: Press) -> bool:
        return press.comes_s < time_s <= press.goes_s if before else press.comes_s <= time_s < press.goes_s

    return tuple(press.at(time_s, skin) for press in PRESSES if present(press))


def bend_at(time_s: float) -> Bend:
    """Return the bend at a time of the loop."""
    if time_s <= BENDS[0][0] or time_s >= BENDS[-1][0]:
        return Bend()
    later = next(i for i, (at, _) in enumerate(BENDS) if at > time_s)
    (start, first), (stop, second) = BENDS[later - 1], BENDS[later]
    share = smooth((time_s - start) / (stop - start))
    names = [field.name for field in fields(Bend) if field.name != "bumps_mm"]
    return Bend(**{n: getattr(first, n) * (1.0 - share) + getattr(second, n) * share for n in names})


def events_s() -> tuple[float, ...]:
    """Return the times of the loop at which something is not smooth: touches coming, pressed, going; bends turning."""
    times = {0.0, PERIOD_S, *(at for at, _ in BENDS)}
    for press in PRESSES:
        times |= {press.comes_s, press.comes_s + PRESS_S, press.goes_s - PRESS_S, press.goes_s}
    return tuple(sorted(times))


def _between(path: tuple[tuple[float, float, float], ...], time_s: float) -> tuple[float, float]:
    for (start, x0, y0), (stop, x1, y1) in itertools.pairwise(path):
        if time_s <= stop:
            share = smooth((time_s - start) / (stop - start))
            return x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    return path[-1][1], path[-1][2]
