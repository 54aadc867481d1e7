"""Leads through presses at known places, and feels each of them come and go.

Before each press the sheet rests: that is the untouched reading that the press is held against, because sheets drift as
much as a press changes them. The same steps take the presses out of a recording, in the order of a list of places.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.files.arrays import save_arrays
from eitskin_proto.files.writing import replacing
from eitskin_tools.guided import ANSWERS, Array, FrameWindow, Guide, GuideError, Silent, Terminal, step_noise
from eitskin_tools.teach.places import Place
from eitskin_tools.teach.presses import load_presses

MIN_PRESS: Final = 5e-4
"""Rms of a row's relative change: presses of some sheets change half of the rows by 0.002 and less."""

SAME_PLACE_MM: Final = 0.06
"""Places are rounded to a tenth."""


class PressRecorder:
    """The presses so far.

    Args:
        path: The file, which is written after each; what it holds already is kept. None writes nothing.
        places: All of them.
        facts: Further arrays of the file, such as ``size_mm``.

    Raises:
        GuideError: The file holds presses at other places.
        SkinError: It is no file of presses.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path | None, places: Sequence[Place], facts: dict[str, Any]) -> None:
        self._path, self._places, self._facts = path, places, facts
        self.presses: dict[Place, tuple[Array, Array]] = {}
        """Untouched and pressed, (rows,) V each."""
        if path is not None and path.exists() and path.stat().st_size:
            self._resume(path)

    def _resume(self, path: Path) -> None:
        before = load_presses(path)
        volts, xy = before.readings, before.xy_mm
        for index in np.flatnonzero(~np.isnan(xy[:, 0])):
            x, y = xy[index]
            near = [one for one in self._places if np.hypot(one.x_mm - x, one.y_mm - y) < SAME_PLACE_MM]
            if not near or not index:
                raise GuideError(
                    f"{path} holds a press at ({x:g}, {y:g}) mm, expected one of this command's "
                    f"{len(self._places)} places: name another file"
                )
            self.presses[near[0]] = volts[index - 1], volts[index]

    @property
    def left(self) -> list[Place]:
        """Places without a press."""
        return [place for place in self._places if place not in self.presses]

    def add(self, place: Place, untouched_V: Array, pressed_V: Array) -> None:
        """Keep a press."""
        self.presses.pop(place, None)  # the newest is the last one in time
        self.presses[place] = untouched_V, pressed_V
        if self._path is not None:
            self.save(self._path)

    def save(self, path: Path) -> None:
        """Write all presses."""
        with replacing(path) as file:
            save_arrays(file, self.arrays())

    def arrays(self) -> dict[str, Any]:
        """Return the arrays of a file of presses, in order of time."""
        nowhere = (np.nan, np.nan)
        volts = [one for pair in self.presses.values() for one in pair]
        xy = [one for place in self.presses for one in (nowhere, (place.x_mm, place.y_mm))]
        return {"voltages_V": np.array(volts), "xy_mm": np.array(xy), **self._facts}


class PressGuide(Guide):
    """Leads through presses.

    Args:
        recorder: Takes them, and knows what is left.
        frames: (rows,) V each, for as long as the device streams.
        talk: The person.
        shown: Called with the next place to press, and with None after the last.
        count: Frames that a reading is the mean of.
    """

    kept = "the presses so far are kept"
    again = "goes on from there"

    def __init__(
        self,
        recorder: PressRecorder,
        frames: Iterator[Array],
        talk: "Terminal | Silent",
        shown: Callable[[Place | None], None] = lambda place: None,
        *,
        count: int = 40,
    ) -> None:
        super().__init__(frames, talk)
        self._recorder, self._shown, self._count = recorder, shown, count
        self._watch = FrameWindow(MIN_PRESS)

    def run(self) -> None:
        """Go through all places that are left.

        Raises:
            GuideError: The person gave up, or the frames ended.
        """
        left = self._recorder.left
        self._talk.say(f"{len(left)} presses to go. ({ANSWERS})")
        self.go_through([self._step(place, number + 1, len(left)) for number, place in enumerate(left)])
        self._shown(None)

    def feels_another(self) -> bool:
        """Return whether one more press comes before the frames end, half as strong as the last or more."""
        watch = self._watch
        try:
            frames = self._steady_frames(self._count, lambda: True)[0]
            watch.set_reference(frames.mean(axis=0), step_noise(frames))
            self._steady_frames(self._count, lambda: watch.away > max(watch.floor, 0.5 * self._size))
        except GuideError:
            return False
        return True

    def _step(self, place: Place, number: int, of: int) -> Callable[[], str | None]:
        return lambda: self._press(place, f"{number} of {of}")

    def _press(self, place: Place, which: str) -> str | None:
        watch = self._watch
        self._shown(place)
        frames, word = self._steady_frames(self._count, lambda: True)
        if word:
            return word
        untouched = frames.mean(axis=0)
        watch.set_reference(untouched, step_noise(frames))

        def keep(pressed: Array) -> None:
            self._recorder.add(place, untouched, pressed)

        return self._take_press(f"{which}: press {place} and hold", which, self._count, keep)


def places_of(path: Path) -> list[Place]:
    """Return the places of a text file: x and y in mm on each line, in the order of the presses.

    Raises:
        GuideError: A line is something else, or there are none.
        OSError: It cannot be read.
    """
    found: list[Place] = []
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            x, y = (float(word) for word in words)
        except ValueError:
            if not found and number == 1:
                continue  # names of the columns
            raise GuideError(f"{path}:{number}: found {line[:40]!r}, expected x and y in mm") from None
        found.append(Place("", x, y))
    if not found:
        raise GuideError(f"{path} holds no places; expected x and y in mm on each line")
    return found
