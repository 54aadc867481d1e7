"""``eitskin bench electrodes``: how soon failing electrodes are named.

The rows run through moving deformations and touches. The circuit around a sheet
(:mod:`eitskin_sim.measurement.faults`) reads any failure at any moment of a stream, frame by frame. A stream runs from
one deformation to the next, of family A or B, while touches come and move over the sheet; in every second stream a
touch lies on an electrode. Its 16 x 16 response is solved at a few moments and interpolated between them.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.health.electrodes import NOT_RECIPROCAL
from eitskin.health.explanation import Finding
from eitskin.health.imputation import MISSING, UNPREDICTED, Consistency
from eitskin.health.monitor import Health
from eitskin.model.bundle import default_path, load_bundle
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES, N_FULL_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL, TABLE
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.faults import Detached, Fault, Noisy, Shorted, Swapped, measure, response_of
from eitskin_sim.measurement.noise import NOISES, Kind, add_noise
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Disc, Rect, Shape
from eitskin_tools.bench.harness import Row, report, say
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError

Array = npt.NDArray[np.float64]

REFERENCE_FRAMES: Final = 100
"""Noisy frames whose mean is the reference."""

AFTER_FRAMES: Final = 30
"""Frames that a failure is looked at; it counts as named if that takes ``MAX_FRAMES_IN_TIME`` at most."""

MAX_FRAMES_IN_TIME: Final = 20

FAILURES: Final[dict[str, Callable[[int], Fault]]] = {
    "detached x1e5": lambda e: Detached(e, 1e5),
    "detached x1e4": lambda e: Detached(e, 1e4),
    "shorted": lambda e: Shorted(e, (e + 1) % N_ELECTRODES),
    "swapped": lambda e: Swapped(e, (e + 1) % N_ELECTRODES),
    "noisy 3 %": lambda e: Noisy(e, 0.03),
    "noisy 10 %": lambda e: Noisy(e, 0.1),
    "detached x1e5, 208 rows": lambda e: Detached(e, 1e5),
    "detached x1e3, 208 rows": lambda e: Detached(e, 1e3),
}
"""What is tried at every electrode; shorts and exchanges with the next one."""

ALL_ROWS: Final = "208 rows"
"""Failures of this name are scanned both ways."""

BY_RECIPROCITY: Final = frozenset({"detached x1e3, 208 rows"})
"""Failures that 104 rows do not show."""

VOLTS_PER_COUNT: Final = 2e-6
"""For 1 A: the sheet's largest row is 8e7 counts, and a source at its compliance stays within 32 bits."""

ELEMENT_MM: Final = 4.5
"""Of the streams' mesh: 0.1 s a moment; the reference is of the same mesh."""

SNR_DB: Final = 50.0

MOMENTS: Final = 12
"""Solved moments of a stream."""

STEP_FRAMES: Final = 60
"""Between two moments: 0.3 s at 200 frames/s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", type=files.bundle, help="bundle to use (default: the shipped one of unit labels)")
    parser.add_argument("--streams", type=int, default=4, metavar="N", help="streams of each kind (default 4)")
    parser.add_argument("--noise", choices=NOISES, default="N2", help="default: N2")
    parser.add_argument("--quick", action="store_true", help="a thinned form")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report.

    Raises:
        BundleError: The bundle says nothing of healthy frames.
    """
    if arguments.streams < 1:
        raise UsageError("--streams must be at least 1")
    bundle = load_bundle(arguments.bundle or default_path("units"))
    arrays = bundle.consistency_arrays()
    if arrays is None:
        raise BundleError(f"{bundle.path}: telling failed electrodes is {MISSING}")
    consistency = Consistency.of(arrays)
    rows = _measured(consistency, arguments.noise, arguments.streams, quick=arguments.quick)
    return report(arguments, rows, _summary(rows))


def _measured(consistency: Consistency, noise: Kind, count: int, *, quick: bool) -> list[Row]:
    flat = flat_response()
    count, moments = (1, 3) if quick else (count, MOMENTS)
    streams = [
        stream(family, number, moments, covering=covering)
        for family in ("A", "B")
        for covering in (False, True)
        for number in range(count)
    ]
    few, electrodes = (streams[:1], range(0, 16, 5)) if quick else (streams[::count], range(16))
    say("electrodes", f"{len(streams)} streams")
    return [*false_alarms(consistency, flat, streams, noise), *detection(consistency, flat, few, noise, electrodes)]


def _summary(rows: list[Row]) -> Row:
    alarms = [row for row in rows if row["what"] == "false alarms"]
    named = [row for row in rows if "named_in_time" in row]
    return {
        "healthy_frames": sum(row["frames"] for row in alarms),
        "named_while_healthy": sum(row["named"] for row in alarms),
        "named_in_time": {f"{row['what']}, {row['noise']}": row["named_in_time"] for row in named},
        "frames_max": max((row["frames_max"] or 0 for row in named), default=None),
    }


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A few solved moments."""

    family: Family
    covering: bool
    """Whether a touch lies on an electrode."""
    responses: Array
    """(moments, 16, 16) ohm."""

    def at(self, frame: int) -> Array:
        """Return the (16, 16) response at a frame; after the last moment it stands still."""
        last = len(self.responses) - 1
        place_, share = divmod(frame / STEP_FRAMES, 1.0)
        first = min(int(place_), last)
        return np.asarray((1.0 - share) * self.responses[first] + share * self.responses[min(first + 1, last)])

    @property
    def frames(self) -> int:
        """Length."""
        return (len(self.responses) - 1) * STEP_FRAMES


def flat_response() -> Array:
    """Return the (16, 16) ohm of the flat, untouched sheet on the streams' mesh."""
    return response_of(factorise_scene(Scene(element_size_mm=ELEMENT_MM)))


def stream(family: Family, number: int, moments: int, *, covering: bool) -> Stream:
    """Return one stream, solved.

    Args:
        family: Of its deformations.
        number: Its seed.
        moments: How many are solved.
        covering: Whether a touch lies on an electrode.
    """
    rng = np.random.default_rng([number, moments, covering])
    first, second = draw(family, 2 * number + 2, 8800)[-2:]
    start, stop = rng.uniform((15, 15), (135, 85)), rng.uniform((15, 15), (135, 85))
    radius = rng.uniform(5.0, 9.0)
    found = []
    for step in range(moments):
        share = step / max(moments - 1, 1)
        x, y = (1.0 - share) * start + share * stop
        shapes: list[Shape] = [Disc(float(x), float(y), float(radius))] if step % 4 else []
        touches = [Touch((shape,)) for shape in shapes]
        if covering:
            touches.append(Touch((_on_electrode(int(rng.integers(N_ELECTRODES)) if step == 0 else number),)))
        bend = _between(first, second, share)
        found.append(response_of(factorise_scene(Scene(bend=bend, touches=tuple(touches), element_size_mm=ELEMENT_MM))))
    return Stream(family, covering, np.array(found))


def _between(first: Bend, second: Bend, share: float) -> Bend:
    mixed: Row = {
        name: (1.0 - share) * getattr(first, name) + share * getattr(second, name)
        for name in ("angle_deg", "axis_deg", "skew", "twist_deg", "stretch_along", "stretch_across", "nonuniformity")
    }
    return Bend(**mixed, bumps_mm=first.bumps_mm if share < 0.5 else second.bumps_mm)


def _on_electrode(electrode: int) -> Rect:
    """Return a touch of 10 to 14 mm that covers an electrode's contact."""
    sheet = nominal_sheet(PAPER)
    piece = next(one for one in place(sheet, nominal_electrodes(PAPER)) if one.electrode == electrode % N_ELECTRODES)
    x0, y0, x1, y1 = piece.patch_mm(sheet, 4.0)
    length, width = sheet.size_mm
    return Rect(max(x0 - 5.0, 0.0), max(y0 - 5.0, 0.0), min(x1 + 5.0, length), min(y1 + 5.0, width))


class WatchedSkin:
    """The runtime's health, its reference captured from noisy frames of the flat sheet.

    Frames are looked at as late as the runtime ever does, ``MOST_TOGETHER`` at a time.

    Args:
        consistency: Of a bundle.
        flat: (16, 16) ohm.
        noise: Of every frame.
        rng: Draws it.
        full: Whether all 208 rows are scanned.
    """

    def __init__(
        self,
        consistency: Consistency,
        flat: Array,
        noise: Kind,
        rng: np.random.Generator,
        *,
        full: bool = False,
    ) -> None:
        self._table = FULL_TABLE if full else TABLE
        self._clean = measure(flat, table=self._table)
        self._noise: tuple[Kind, np.random.Generator] = noise, rng
        frames = np.array([self._rows(self._noisy(self._clean)) for _ in range(REFERENCE_FRAMES)])
        self._reference = frames.mean(axis=0)
        self._health = Health(consistency)
        self._health.use_reference(self._reference, frames.std(axis=0))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is named now."""
        return self._health.electrodes.findings

    def show(self, response: Array, faults: Sequence[Fault] = ()) -> bool:
        """Show one frame and return whether something changed."""
        volts = self._noisy(measure(response, faults, table=self._table, rng=self._noise[1]))
        change = relative_change(self._rows(volts), self._reference).astype(np.float32)
        before = self.findings
        self._health.prepare(change)
        self._health.complete(change)
        counts = np.rint(volts / VOLTS_PER_COUNT).astype(np.int32)
        if self._health.put_aside(counts, touched=True):
            self._health.examine(UNPREDICTED)
        return self.findings != before

    @staticmethod
    def _rows(volts: Array) -> Array:
        """Return (104,) V of a frame: both readings of a row averaged, where there are two."""
        if len(volts) != N_FULL_ROWS:
            return volts
        return np.asarray((volts[ROW_IN_FULL] + volts[RECIPROCAL_IN_FULL]) / 2.0)

    def _noisy(self, volts: Array) -> Array:
        kind, rng = self._noise
        return add_noise(volts, self._clean, kind, SNR_DB, rng)


def false_alarms(consistency: Consistency, flat: Array, streams: Sequence[Stream], noise: Kind) -> list[Row]:
    """Return how often a healthy stream has an electrode named, by family and by whether a touch covers one."""
    rows = []
    for family, covering, full in product(("A", "B"), (False, True), (False, True)):
        chosen = [one for one in streams if one.family == family and one.covering is covering]
        frames = alarms = 0
        for number, one in enumerate(chosen):
            rng = np.random.default_rng([number, covering])
            watched = WatchedSkin(consistency, flat, noise, rng, full=full)
            for frame in range(one.frames):
                alarms += watched.show(one.at(frame)) and bool(watched.findings)
            frames += one.frames
        rows.append(
            {"what": "false alarms", "family": family, "touch_on_electrode": covering, "rows": 208 if full else 104,
             "noise": noise, "streams": len(chosen), "frames": frames, "named": int(alarms)}
        )  # fmt: skip
    return rows


def detection(
    consistency: Consistency,
    flat: Array,
    streams: Sequence[Stream],
    noise: Kind,
    electrodes: Sequence[int] = range(N_ELECTRODES),
) -> list[Row]:
    """Return, for every kind of failure, how many are named rightly and in time, and after how many frames."""
    rows = []
    for name, make in FAILURES.items():
        took: list[int] = []
        right = late = tried = 0
        wrong: dict[str, int] = {}
        for number, one in enumerate(streams):
            for electrode in electrodes:
                fault = make(electrode)
                rng = np.random.default_rng([number, electrode])
                watched = WatchedSkin(consistency, flat, noise, rng, full=ALL_ROWS in name)
                begin = (7 * electrode + 11 * number) % max(one.frames - AFTER_FRAMES, 1)
                after = next(
                    (n + 1 for n in range(AFTER_FRAMES) if watched.show(one.at(begin + n), (fault,))), AFTER_FRAMES + 1
                )
                for n in range(after, AFTER_FRAMES):
                    watched.show(one.at(begin + n), (fault,))
                tried += 1
                named = {(f.electrode, f.state) for f in watched.findings}
                if named == expected(fault, reciprocal=name in BY_RECIPROCITY):
                    right, late = right + (after <= MAX_FRAMES_IN_TIME), late + (after > MAX_FRAMES_IN_TIME)
                    took.append(after)
                else:
                    text = " ".join(f.text() for f in watched.findings) or "nothing"
                    wrong[text] = wrong.get(text, 0) + 1
        rows.append(
            {"what": name, "noise": noise, "tried": tried, "named_in_time": round(right / tried, 4), "late": late,
             "frames_median": float(np.median(took)) if took else None, "frames_max": max(took, default=None),
             "named_wrongly": sum(wrong.values()), "most_often": max(wrong, key=lambda key: wrong[key], default="")}
        )  # fmt: skip
    return rows


def expected(fault: Fault, *, reciprocal: bool = False) -> set[tuple[int, str]]:
    """Return the electrodes and states that a failure must be reported as.

    Args:
        fault: What was done.
        reciprocal: It is too slight for 104 rows, and shows by reciprocity alone.
    """
    match fault:
        case Detached(electrode) if reciprocal:
            return {(electrode, NOT_RECIPROCAL)}
        case Detached(electrode):
            return {(electrode, "detached")}
        case Noisy(electrode):
            return {(electrode, "noisy")}
        case Shorted(first, second):
            return {(first, "shorted"), (second, "shorted")}
        case Swapped(first, second):
            return {(first, "swapped"), (second, "swapped")}
