"""Electrodes that fail while the sheet bends and is touched: how soon they are named, and what is named wrongly.

The circuit around a sheet (:mod:`eitskin_sim.measurement.faults`) reads any failure at any moment of a stream
(:mod:`eitskin_tools.bench.electrodes.streams`), frame by frame.
"""

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, Final

import numpy as np

from eitskin.health.electrodes import NOT_RECIPROCAL
from eitskin.health.explanation import Finding
from eitskin.health.imputation import UNPREDICTED, Consistency
from eitskin.health.monitor import Health
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES, N_FULL_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL, TABLE
from eitskin_sim.measurement.faults import Detached, Fault, Noisy, Shorted, Swapped, measure
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_tools.bench.electrodes.streams import Array, Stream

REFERENCE_FRAMES: Final = 100
"""Noisy frames whose mean is the reference."""

AFTER_FRAMES: Final = 30
"""Frames that a failure is looked at; it counts as named if that takes ``IN_TIME`` at most."""

IN_TIME: Final = 20

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


class Looking:
    """The runtime's health, its reference captured from noisy frames of the flat sheet.

    Frames are looked at as late as the runtime ever does, ``MOST_TOGETHER`` at a time.

    Args:
        consistency: Of a bundle.
        flat: (16, 16) ohm.
        noise: Of every frame.
        snr_db: Its level.
        rng: Draws it.
        full: Whether all 208 rows are scanned.
    """

    def __init__(
        self,
        consistency: Consistency,
        flat: Array,
        noise: Kind,
        snr_db: float,
        rng: np.random.Generator,
        *,
        full: bool = False,
    ) -> None:
        self._table = FULL_TABLE if full else TABLE
        self._clean = measure(flat, table=self._table)
        self._noise: tuple[Kind, float, np.random.Generator] = noise, snr_db, rng
        frames = np.array([self._rows(self._noisy(self._clean)) for _ in range(REFERENCE_FRAMES)])
        self._reference = frames.mean(axis=0)
        self._health = Health(consistency)
        self._health.use(self._reference, frames.std(axis=0))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is named now."""
        return self._health.electrodes.findings

    def show(self, response: Array, faults: Sequence[Fault] = ()) -> bool:
        """Show one frame and return whether something changed."""
        volts = self._noisy(measure(response, faults, table=self._table, rng=self._noise[2]))
        change = relative_change(self._rows(volts), self._reference).astype(np.float32)
        before = self.findings
        self._health.prepare(change)
        self._health.complete(change)
        counts = np.rint(volts / VOLTS_PER_COUNT).astype(np.int32)
        if self._health.put_aside(counts, touched=True):
            self._health.look(UNPREDICTED)
        return self.findings != before

    @staticmethod
    def _rows(volts: Array) -> Array:
        """Return (104,) V of a frame: both readings of a row averaged, where there are two."""
        if len(volts) != N_FULL_ROWS:
            return volts
        return np.asarray((volts[ROW_IN_FULL] + volts[RECIPROCAL_IN_FULL]) / 2.0)

    def _noisy(self, volts: Array) -> Array:
        kind, snr_db, rng = self._noise
        return add_noise(volts, self._clean, kind, snr_db, rng)


def false_alarms(
    consistency: Consistency, flat: Array, streams: Sequence[Stream], noise: Kind, snr_db: float
) -> list[dict[str, Any]]:
    """Return how often a healthy stream has an electrode named, by family and by whether a touch covers one."""
    rows = []
    for family, covering, full in product(("A", "B"), (False, True), (False, True)):
        chosen = [one for one in streams if one.family == family and one.covering is covering]
        frames = alarms = 0
        for number, one in enumerate(chosen):
            rng = np.random.default_rng([number, covering])
            looking = Looking(consistency, flat, noise, snr_db, rng, full=full)
            for frame in range(one.frames):
                alarms += looking.show(one.at(frame)) and bool(looking.findings)
            frames += one.frames
        rows.append(
            {"what": "false alarms", "family": family, "touch_on_electrode": covering, "rows": 208 if full else 104,
             "noise": noise, "streams": len(chosen), "frames": frames, "named": int(alarms)}
        )  # fmt: skip
    return [*rows, *_together(rows, noise)]


def _together(rows: Sequence[dict[str, Any]], noise: Kind) -> list[dict[str, Any]]:
    """Return the false alarms of each width of scan over all streams, with what they say of a million frames."""
    found = []
    for width in (104, 208):
        own = [row for row in rows if row["rows"] == width]
        named, frames = sum(row["named"] for row in own), sum(row["frames"] for row in own)
        low, high = events_interval(named)
        found.append(
            {"what": "false alarms together", "rows": width, "noise": noise, "streams": sum(r["streams"] for r in own),
             "frames": frames, "named": named, "per_million_frames": round(1e6 * named / frames, 1),
             "interval_95": [round(1e6 * low / frames, 1), round(1e6 * high / frames, 1)]}
        )  # fmt: skip
    return found


def events_interval(count: int) -> tuple[float, float]:
    """Return the 95 % interval of the mean of which a Poisson count was seen; of none, the upper end alone (3.0)."""
    from scipy.stats import chi2

    if not count:
        return 0.0, float(chi2.ppf(0.95, 2) / 2.0)
    return float(chi2.ppf(0.025, 2 * count) / 2.0), float(chi2.ppf(0.975, 2 * count + 2) / 2.0)


def detection(
    consistency: Consistency,
    flat: Array,
    streams: Sequence[Stream],
    noise: Kind,
    snr_db: float,
    electrodes: Sequence[int] = range(N_ELECTRODES),
) -> list[dict[str, Any]]:
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
                looking = Looking(consistency, flat, noise, snr_db, rng, full=ALL_ROWS in name)
                begin = (7 * electrode + 11 * number) % max(one.frames - AFTER_FRAMES, 1)
                after = next(
                    (n + 1 for n in range(AFTER_FRAMES) if looking.show(one.at(begin + n), (fault,))), AFTER_FRAMES + 1
                )
                for n in range(after, AFTER_FRAMES):
                    looking.show(one.at(begin + n), (fault,))
                tried += 1
                named = {(f.electrode, f.state) for f in looking.findings}
                if named == expected(fault, reciprocal=name in BY_RECIPROCITY):
                    right, late = right + (after <= IN_TIME), late + (after > IN_TIME)
                    took.append(after)
                else:
                    text = " ".join(f.text() for f in looking.findings) or "nothing"
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
