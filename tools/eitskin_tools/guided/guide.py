"""What a person is asked to do, step by step, and what came of it: the arrays of a recording to calibrate from.

A step ends by an event: frames that are at rest, away from the reference or back again, or a word that was typed.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_tools.guided.watch import Watch, step_noise

Array = npt.NDArray[np.float64]
LoadScan = Callable[[str], Array]
"""A file's name -> (3, rows, columns) mm; a SkinError or OSError says what is wrong with it."""

SKIP: Final = "s"
BACK: Final = "b"
QUIT: Final = "q"
WORDS: Final = f"{SKIP} skip, {BACK} back, {QUIT} quit"

RETURNED: Final = 0.25
"""Share of a press that may stay: sheets keep a few percent for a while."""


class GuideError(SkinError):
    """A guided calibration ended early; the text says why."""


class Dialogue(Protocol):
    """A person at a terminal."""

    def tell(self, text: str) -> None:
        """Say what to do."""

    def show(self, text: str) -> None:
        """Say how it is going; may be overwritten."""

    def answer(self) -> str | None:
        """Return a line that was typed, without waiting; None where there is none."""

    @property
    def left(self) -> bool:
        """Whether nothing will be typed any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What is asked for."""

    places_mm: tuple[tuple[float, float], ...]
    """Where the stamp goes."""
    stamp_mm: tuple[float, ...]
    """A disc's diameter, or length along x and width along y; empty for no presses."""
    bends: int = 3
    reference_frames: int = 100
    frames: int = 40
    """That a moment is the mean of."""
    lying_mm: Array | None = None
    """(3, rows, columns) the scan of the sheet as it lies for reference and presses; None where it lies flat."""

    @property
    def stamp(self) -> str:
        """For people."""
        size = " x ".join(f"{one:g}" for one in self.stamp_mm)
        return f"disc of {size} mm" if len(self.stamp_mm) == 1 else f"stamp of {size} mm"


@dataclass(slots=True)
class Found:
    """What was recorded so far."""

    reference: Array | None = None
    bents: dict[int, tuple[Array, Array]] = field(default_factory=dict)
    presses: dict[int, Array] = field(default_factory=dict)


class Guide:
    """A guided recording.

    Args:
        plan: What is asked for.
        frames: (104,) or (208,) V each, for as long as the device streams.
        talk: The person.
        load_scan: Reads the scan of a bend.
    """

    def __init__(self, plan: Plan, frames: Iterator[Array], talk: Dialogue, load_scan: LoadScan) -> None:
        self._plan, self._frames, self._talk, self._load_scan = plan, frames, talk, load_scan
        self._watch = Watch()
        self._found = Found()

    def run(self) -> dict[str, Any]:
        """Go through all steps and return the arrays of ``docs/calibrate.md``.

        Raises:
            GuideError: The person gave up, or the frames ended.
        """
        steps: list[Callable[[], str | None]] = [self._reference]
        steps += [lambda k=k: self._bend(k) for k in range(self._plan.bends)]  # type: ignore[misc]
        if self._plan.stamp_mm:
            steps += [lambda k=k: self._press(k) for k in range(len(self._plan.places_mm))]  # type: ignore[misc]
        at = 0
        while at < len(steps):
            word = steps[at]()
            if word == QUIT:
                raise GuideError("stopped on request; nothing was written; the same command begins anew")
            if word == SKIP and at:
                self._leave_out(at - 1)
            at = max(at - 1, 0) if word == BACK else at + (1 if word != SKIP or at else 0)
        return self._arrays()

    def _leave_out(self, number: int) -> None:
        """Forget what came of a step that was gone back to, of those after the reference."""
        bends, found = self._plan.bends, self._found
        gone = found.bents.pop(number, None) if number < bends else found.presses.pop(number - bends, None)
        if gone is not None:
            self._talk.tell("what was recorded of it before is left out")

    def _reference(self) -> str | None:
        how = "Lay the sheet flat" if self._plan.lying_mm is None else "Leave the sheet as it was scanned"
        self._talk.tell(f"{how} and take your hands off. ({WORDS})")
        self._watch = Watch()
        frames, word = self._taken(self._plan.reference_frames, lambda: True)
        if word == SKIP:
            self._talk.tell("the reference cannot be skipped: everything is held against it")
        if word is None:
            self._found.reference = frames.mean(axis=0)
            noise = step_noise(frames)
            self._watch.refer(self._found.reference, noise)
            self._talk.tell(f"reference: mean of {len(frames)} frames of {frames.shape[1]} rows")
        return word

    def _bend(self, number: int) -> str | None:
        of = f"Bend {number + 1} of {self._plan.bends}"
        self._talk.tell(f"{of}: bend the sheet without touching its surface, hold it still, and scan it. ({WORDS})")
        word = self._until(lambda: self._watch.steady and self._watch.away > self._watch.floor)
        if word:
            return word
        self._talk.tell("it is bent and at rest. Name the scan's file (eitskin surface ... --out FILE):")
        while True:
            typed: list[str] = []
            word = self._until(lambda: self._talk.left, typed)
            if word:
                return word
            if not typed:
                raise GuideError(
                    "standard input has ended, so no scan can be named; nothing was written; run it at a terminal, or "
                    "with --bends 0"
                )
            try:
                cloud = self._load_scan(typed[0])
                break
            except (SkinError, OSError) as error:
                self._talk.tell(f"{error}; name another file")
        frames, word = self._taken(self._plan.frames, lambda: self._watch.away > self._watch.floor)
        if word is None:
            self._found.bents[number] = (frames.mean(axis=0), cloud)
            self._talk.tell(f"bend {number + 1}: mean of {len(frames)} frames")
        return word

    def _press(self, number: int) -> str | None:
        x, y = self._plan.places_mm[number]
        of = f"Press {number + 1} of {len(self._plan.places_mm)}"
        how = "flat" if self._plan.lying_mm is None else "as it was scanned first,"
        self._talk.tell(f"{of}: the sheet {how} and free. ({WORDS})")
        word = self._until(lambda: self._watch.steady and self._watch.away <= self._watch.floor)
        if word:
            return word
        self._talk.tell(f"press the {self._plan.stamp} at ({x:g}, {y:g}) mm, and hold it")
        frames, word = self._taken(self._plan.frames, lambda: self._watch.away > self._watch.floor)
        if word:
            return word
        size = self._watch.away
        self._talk.tell(f"press {number + 1}: changed by {size:.1%}. Let go")
        word = self._until(
            lambda: self._watch.full and self._watch.away <= max(self._watch.floor, RETURNED * size), new=True
        )
        if word is None:
            self._found.presses[number] = frames.mean(axis=0)
        return word

    def _taken(self, count: int, holds: Callable[[], bool]) -> tuple[Array, str | None]:
        """Return (count, rows) V of a sheet at rest for which something holds all the while; or a word."""
        while True:
            word = self._until(lambda: self._watch.steady and holds())
            if word:
                return np.zeros((0, 0)), word
            frames: list[Array] = []

            def over(frames: list[Array] = frames) -> bool:
                frames.append(self._watch.last)
                return len(frames) == count or not (self._watch.steady and holds())

            word = self._until(over)
            if word:
                return np.zeros((0, 0)), word
            if len(frames) == count and self._watch.steady and holds():
                return np.array(frames), None
            self._talk.show("it moved; hold it still")

    def _until(self, reached: Callable[[], bool], typed: list[str] | None = None, *, new: bool = False) -> str | None:
        """Take frames until something is reached, or a word was typed, which is returned.

        Args:
            reached: Asked after each frame.
            typed: Takes a line that is no word, and ends the wait.
            new: Look at frames from now on alone.
        """
        if new:
            self._watch.begin()
        for voltages in self._frames:
            self._watch.add(voltages)
            line = self._talk.answer()
            word = (line or "").strip()
            if word in (SKIP, BACK, QUIT):
                self._watch.begin()
                return word
            if word and typed is not None:
                typed.append(word)
                return None
            if word:
                self._talk.tell(f"{word!r} is no answer here: {WORDS}")
            if reached():
                return None
        raise GuideError("no more frames come from the skin; nothing was written; look at it with 'eitskin doctor'")

    def _arrays(self) -> dict[str, Any]:
        found, plan = self._found, self._plan
        arrays: dict[str, Any] = {"reference_V": found.reference, "reference_frames": np.array(plan.reference_frames)}
        if plan.lying_mm is not None:
            arrays["reference_cloud_mm"] = plan.lying_mm
        if found.bents:
            volts, clouds = zip(*(found.bents[k] for k in sorted(found.bents)), strict=True)
            arrays |= {"bent_V": np.array(volts), "bent_cloud_mm": np.array(clouds)}
            arrays["bent_frames"] = np.array(plan.frames)
        if found.presses:
            order = sorted(found.presses)
            arrays |= {
                "press_V": np.array([found.presses[k] for k in order]),
                "press_xy_mm": np.array([plan.places_mm[k] for k in order]),
                "stamp_mm": np.array(plan.stamp_mm),
                "press_frames": np.array(plan.frames),
            }
        return arrays
