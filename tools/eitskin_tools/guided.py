"""Guides a person through the steps of a recording: of a calibration, or of presses to learn from.

A step ends by an event: frames that are at rest, away from the reference or back again, or a word that was typed.
"""

import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.plain import plain
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable
from eitskin_tools.console.terminal import StatusLine

Array = npt.NDArray[np.float64]

WINDOW: Final = 20
MIN_CHANGE: Final = 0.002
"""Rms of a row's relative change beside the common one: a light press has about 0.01."""

MIN_CHANGE_SIGMAS: Final = 4.0
"""Changes are that many times what noise alone would make."""

MAX_SIGMAS: Final = 2.0
"""Largest difference between the halves of a window, in multiples of their noise; rms over a hundred rows is known to a
tenth."""

MAX_CREEP: Final = 0.05
"""Of the change itself may still be on its way: soft sheets creep."""

MAX_ROW_NOISE: Final = 0.05
"""Rows with more relative noise than that tell nothing."""


class FrameWindow:
    """The last frames of a skin.

    Args:
        min_change: Rms of a row's relative change below which nothing is taken for a press or a bend.
    """

    def __init__(self, min_change: float = MIN_CHANGE) -> None:
        self._min_change = min_change
        self._frames: list[Array] = []
        self._reference: Array | None = None
        self._rows: npt.NDArray[np.bool_] = np.ones((), dtype=np.bool_)  # of any number

    def add(self, voltages_V: Array) -> None:
        """Take a frame, (104,) or (208,) V, of as many rows as the others."""
        self._frames.append(np.array(voltages_V))
        del self._frames[:-WINDOW]

    def clear(self) -> None:
        """Forget the frames so far: something else is looked at from now on."""
        self._frames.clear()

    def set_reference(self, mean_V: Array, noise_V: Array) -> None:
        """Hold frames against a reference from now on.

        Args:
            mean_V: (rows,) of it.
            noise_V: (rows,) standard deviation of a frame.
        """
        self._reference, self._rows = mean_V, noise_V < MAX_ROW_NOISE * np.abs(mean_V)

    @property
    def last(self) -> Array:
        """The newest frame, (rows,) V."""
        return self._frames[-1]

    @property
    def full(self) -> bool:
        """Whether there are enough frames to tell."""
        return len(self._frames) == WINDOW

    @property
    def steady(self) -> bool:
        """Whether the sheet is at rest."""
        if not self.full:
            return False
        frames = np.array(self._frames)
        scale = np.abs(frames.mean(axis=0))
        rows = self._rows & (scale > 0.0)
        halves = (frames[: WINDOW // 2].mean(axis=0) - frames[WINDOW // 2 :].mean(axis=0))[rows] / scale[rows]
        noise = step_noise(frames)[rows] / scale[rows] * np.sqrt(4.0 / WINDOW)
        moved, expected = _rms(halves), _rms(noise)
        return bool(moved <= MAX_SIGMAS * expected + (MAX_CREEP * self.away if self._reference is not None else 0.0))

    @property
    def away(self) -> float:
        """Rms of the rows' change since the reference, beside the common one."""
        if self._reference is None or not self._frames:
            return 0.0
        change = np.mean(self._frames, axis=0)[self._rows] / self._reference[self._rows] - 1.0
        return _rms(change - np.median(change))

    @property
    def floor(self) -> float:
        """What :attr:`away` must exceed to be more than noise."""
        if self._reference is None or not self.full:
            return np.inf
        noise = step_noise(np.array(self._frames))[self._rows] / np.abs(self._reference[self._rows])
        return max(self._min_change, MIN_CHANGE_SIGMAS * _rms(noise) / float(np.sqrt(len(self._frames))))


def step_noise(frames: Array) -> Array:
    """Return (rows,) standard deviations of a frame, from the steps between those of (n, rows)."""
    return np.asarray(np.sqrt(np.mean(np.diff(frames, axis=0) ** 2, axis=0) / 2.0))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


LoadScan = Callable[[str], Array]
"""A file's name -> (3, rows, columns) mm; a SkinError or OSError says what is wrong with it."""

SKIP: Final = "s"
BACK: Final = "b"
QUIT: Final = "q"
ANSWERS: Final = f"{SKIP} skip, {BACK} back, {QUIT} quit"

MAX_RESIDUAL: Final = 0.25
"""Share of a press that may stay: sheets keep a few percent for a while."""


class GuideError(SkinError):
    """A guided recording ended early; the text says why."""


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
    """(3, rows, columns) the scan of the sheet in its shape for reference and presses; None if it is flat."""

    @property
    def stamp(self) -> str:
        """For people."""
        size = " x ".join(f"{one:g}" for one in self.stamp_mm)
        return f"disc of {size} mm" if len(self.stamp_mm) == 1 else f"stamp of {size} mm"


class Guide:
    """Goes through steps with a person: forward, back, past one.

    Args:
        frames: (rows,) V each, for as long as the device streams.
        talk: The person.
    """

    kept = "nothing was written"
    """What became of the steps before, where it ends early."""

    again = "starts again"

    def __init__(self, frames: Iterator[Array], talk: "Terminal | Silent") -> None:
        self._frames, self._talk = frames, talk
        self._watch, self._size = FrameWindow(), 0.0

    def go_through(self, steps: Sequence[Callable[[], str | None]]) -> None:
        """Take one step after another; each returns a word that was typed, or None once it is done.

        Raises:
            GuideError: The person gave up, or the frames ended.
        """
        at = 0
        while at < len(steps):
            word = steps[at]()
            if word == QUIT:
                raise GuideError(f"stopped on request; {self.kept}; the same command {self.again}")
            at = max(at - 1, 0) if word == BACK else at + 1

    def _steady_frames(self, count: int, holds: Callable[[], bool]) -> tuple[Array, str | None]:
        """Return (count, rows) V of a sheet at rest for which something holds all the while; or a word."""
        while True:
            word = self._wait_until(lambda: self._watch.steady and holds())
            if word:
                return np.zeros((0, 0)), word
            frames: list[Array] = []

            def over(frames: list[Array] = frames) -> bool:
                frames.append(self._watch.last)
                return len(frames) == count or not (self._watch.steady and holds())

            word = self._wait_until(over)
            if word:
                return np.zeros((0, 0)), word
            if len(frames) == count and self._watch.steady and holds():
                return np.array(frames), None
            self._talk.show("it moved; hold it still")

    def _take_press(self, asked: str, which: str, count: int, keep: Callable[[Array], None]) -> str | None:
        """Ask for a press, give its mean to ``keep``, and wait until it is let go; return a word that was typed."""
        watch = self._watch
        self._talk.say(asked)
        frames, word = self._steady_frames(count, lambda: watch.away > watch.floor)
        if word:
            return word
        self._size = watch.away
        keep(frames.mean(axis=0))
        self._talk.say(f"{which}: felt, {self._size:.2%}. Let go")
        return self._wait_until(
            lambda: watch.full and watch.away <= max(watch.floor, MAX_RESIDUAL * self._size), new=True
        )

    def _wait_until(
        self, reached: Callable[[], bool], typed: list[str] | None = None, *, new: bool = False
    ) -> str | None:
        """Take frames until something is reached, or a word was typed, which is returned.

        Args:
            reached: Asked after each frame.
            typed: Takes a line that is no word, and ends the wait.
            new: Look at frames from now on alone.
        """
        if new:
            self._watch.clear()
        for voltages in self._frames:
            self._watch.add(voltages)
            line = self._talk.answer()
            word = (line or "").strip()
            if word in (SKIP, BACK, QUIT):
                self._watch.clear()
                return word
            if word and typed is not None:
                typed.append(word)
                return None
            if word:
                self._talk.say(f"{word!r} is not an answer here: {ANSWERS}")
            if reached():
                return None
        raise GuideError(f"the skin sends no more frames; {self.kept}; check it with 'eitskin doctor'")


class CalibrationGuide(Guide):
    """A guided calibration.

    Args:
        plan: What is asked for.
        frames: (104,) or (208,) V each, for as long as the device streams.
        talk: The person.
        load_scan: Reads the scan of a bend.
    """

    def __init__(self, plan: Plan, frames: Iterator[Array], talk: "Terminal", load_scan: LoadScan) -> None:
        super().__init__(frames, talk)
        self._plan, self._load_scan = plan, load_scan
        self._reference_V: Array | None = None
        self._bents: dict[int, tuple[Array, Array]] = {}
        self._presses: dict[int, Array] = {}

    def run(self) -> dict[str, Any]:
        """Go through all steps and return the arrays of ``docs/calibrate.md``.

        Raises:
            GuideError: The person gave up, or the frames ended.
        """
        steps = [partial(self._bend, k) for k in range(self._plan.bends)]
        if self._plan.stamp_mm:
            steps += [partial(self._press, k) for k in range(len(self._plan.places_mm))]
        self.go_through([self._reference, *steps])
        return self._arrays()

    def _reference(self) -> str | None:
        how = "Lay the sheet flat" if self._plan.lying_mm is None else "Leave the sheet as it was scanned"
        self._talk.say(f"{how} and take your hands off. ({ANSWERS})")
        self._watch = FrameWindow()
        frames, word = self._steady_frames(self._plan.reference_frames, lambda: True)
        if word == SKIP:
            self._talk.say("the reference cannot be skipped: everything is compared with it")
            return self._reference()
        if word is None:
            self._reference_V = frames.mean(axis=0)
            self._watch.set_reference(self._reference_V, step_noise(frames))
            self._talk.say(f"reference: mean of {len(frames)} frames of {frames.shape[1]} rows")
        return word

    def _bend(self, number: int) -> str | None:
        self._bents.pop(number, None)  # of a step that was gone back to
        of = f"Bend {number + 1} of {self._plan.bends}"
        self._talk.say(f"{of}: bend the sheet without touching its surface, hold it still, and scan it. ({ANSWERS})")
        word = self._wait_until(lambda: self._watch.steady and self._watch.away > self._watch.floor)
        if word:
            return word
        self._talk.say("The sheet is bent and still. Name the scan's file (eitskin surface ... --out FILE):")
        while True:
            typed: list[str] = []
            word = self._wait_until(lambda: self._talk.ended, typed)
            if word:
                return word
            if not typed:
                raise GuideError(
                    "standard input has ended, so you cannot name a scan; nothing was written; run it in a terminal, "
                    "or with --bends 0"
                )
            try:
                cloud = self._load_scan(typed[0])
                break
            except (SkinError, OSError) as error:
                self._talk.say(f"{error}; name another file")
        frames, word = self._steady_frames(self._plan.frames, lambda: self._watch.away > self._watch.floor)
        if word is None:
            self._bents[number] = (frames.mean(axis=0), cloud)
            self._talk.say(f"bend {number + 1}: mean of {len(frames)} frames")
        return word

    def _press(self, number: int) -> str | None:
        self._presses.pop(number, None)
        x, y = self._plan.places_mm[number]
        of = f"Press {number + 1} of {len(self._plan.places_mm)}"
        how = "flat" if self._plan.lying_mm is None else "as it was scanned first,"
        self._talk.say(f"{of}: the sheet {how} and untouched. ({ANSWERS})")
        word = self._wait_until(lambda: self._watch.steady and self._watch.away <= self._watch.floor)
        if word:
            return word
        asked = f"press the {self._plan.stamp} at ({x:g}, {y:g}) mm, and hold it"
        keep = self._presses.__setitem__
        return self._take_press(asked, f"press {number + 1}", self._plan.frames, lambda mean_V: keep(number, mean_V))

    def _arrays(self) -> dict[str, Any]:
        bents, presses, plan = self._bents, self._presses, self._plan
        arrays: dict[str, Any] = {"reference_V": self._reference_V, "reference_frames": np.array(plan.reference_frames)}
        if plan.lying_mm is not None:
            arrays["reference_cloud_mm"] = plan.lying_mm
        if bents:
            volts, clouds = zip(*(bents[k] for k in sorted(bents)), strict=True)
            arrays |= {"bent_V": np.array(volts), "bent_cloud_mm": np.array(clouds)}
            arrays["bent_frames"] = np.array(plan.frames)
        if presses:
            order = sorted(presses)
            arrays |= {
                "press_V": np.array([presses[k] for k in order]),
                "press_xy_mm": np.array([plan.places_mm[k] for k in order]),
                "stamp_mm": np.array(plan.stamp_mm),
                "press_frames": np.array(plan.frames),
            }
        return arrays


MAX_LINE_BYTES: Final = 4096
"""Bytes of a line that are kept."""


class Terminal:
    """Tells on standard output, and takes typed lines from standard input; at its end, none come any more."""

    def __init__(self) -> None:
        self._line = StatusLine(sys.stdout)
        self._input = sys.stdin.fileno()
        self._typed = b""
        self._open = True

    def say(self, text: str) -> None:
        """Print a line."""
        self._line.above(plain(text))

    def show(self, text: str) -> None:
        """Show the progress in the last line of a terminal."""
        self._line.show(text)

    def answer(self) -> str | None:
        """Return a line that was typed, or None."""
        while self._open and select.select([self._input], [], [], 0.0)[0]:
            more = os.read(self._input, MAX_LINE_BYTES)
            self._open = bool(more)
            self._typed = (self._typed + more)[-MAX_LINE_BYTES:]
        line, end, rest = self._typed.partition(b"\n")
        if not end and (self._open or not line):
            return None
        self._typed = rest
        return line.decode(errors="replace").strip()

    @property
    def ended(self) -> bool:
        """Whether nothing will be typed any more: standard input is at its end, and every line was taken."""
        return not self._open and not self._typed

    def end(self) -> None:
        """Leave the last line."""
        self._line.end()


class Silent:
    """Nobody: a recording answers by itself."""

    ended = True

    def say(self, text: str) -> None:
        """Say nothing."""

    def show(self, text: str) -> None:
        """Show nothing."""

    def answer(self) -> str | None:
        """Return None."""
        return None


FRAME_TIMEOUT_S: Final = 10.0
"""Without a whole frame for so long, the line is taken for silent."""

MAX_UNFIT_FRAMES: Final = 100
"""Frames in a row that cannot be used: then none will come."""


def frames_of(device: Any, table: RowTable | None = None) -> Iterator[npt.NDArray[np.float64]]:
    """Yield the V of every whole frame that is fit; it ends when none comes.

    Args:
        device: It streams.
        table: Rows of a frame; None for those of the device's scans, all 208 where it has them.

    Raises:
        GuideError: ``MAX_UNFIT_FRAMES`` frames in a row cannot be used.
    """
    from eitskin.acquisition.capture import whole_frames
    from eitskin.reference.front_end import stuck
    from eitskin.reference.normaliser import normaliser_of, rows_of
    from eitskin_proto.wire.volts import step_of

    wanted = rows_of(device.hello) if table is None else table
    normaliser = normaliser_of(device.hello, wanted)
    step = step_of(device.hello) / device.hello.volts_per_count
    came, unfit = True, 0
    while came:
        came = False
        for view in whole_frames(device, time.perf_counter() + FRAME_TIMEOUT_S):
            came = True
            normaliser.load(view.counts)
            counts = normaliser.counts if step == 1.0 else np.rint(normaliser.counts / step)
            own_rows = wanted.id == ADJACENT_104.id
            reason = "rows are cut off" if view.saturation else stuck(counts, own_rows=own_rows)
            unfit = unfit + 1 if reason else 0
            if unfit >= MAX_UNFIT_FRAMES:
                raise GuideError(
                    f"the last {unfit} frames cannot be used: {reason}; check the current and the gain of the "
                    "configuration with 'eitskin flash'"
                )
            if not reason and table is not None:
                yield normaliser.voltages()
            elif not reason:  # not the normaliser's, which averages a row and its reciprocal
                yield view.counts * device.hello.volts_per_count
