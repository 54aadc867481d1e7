"""A front end that does not live: rows that are all alike, frames that come again; and honest ones, to the last frame.

Every lie is drawn at a random moment of the demonstration, bent, touched or flat, on a random front end. It is held if
nothing of it is published: at once where rows are alike, after the repetitions that chance allows where frames repeat.
"""

from collections.abc import Callable, Iterator

import numpy as np

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.wire.frames import full_scale

from ..outcome import Effort, Outcome
from .sheets import Counts, Judge, Sheet

FRONT_ENDS = (
    ("N2", 52.0, 3), ("N2", 60.0, 3), ("N2", 90.0, 3), ("N3", 52.0, 3), ("N1", 52.0, 3), ("N2", 52.0, 2),
    ("N3", 60.0, 2), ("N2", 60.0, 4),
)  # fmt: skip
"""Kind and level of noise, bytes of a sample."""

LONGEST = 450
"""Frames that a lie goes on: beyond what any front end here allows a repetition."""

ALIKE = ("full scale", "one count", "nothing", "any count", "half of the rows", "a drive's rows", "a drive again",
         "drives stuck", "measurements stuck")  # fmt: skip
REPEATED = ("frozen", "two buffers")


def _stuck_wire(counts: Counts, column: int, rng: np.random.Generator) -> Counts:
    """Return what is read where all drives, or all measurements, are one: each group its own value, and noise."""
    level = np.array([np.abs(counts[TABLE[:, column] == one]).max(initial=1) for one in range(16)], dtype=np.float64)
    sign = np.sign(counts.astype(np.float64).sum())
    read = sign * level[TABLE[:, column]] * (1.0 + 0.003 * rng.standard_normal(len(counts)))
    return np.rint(read).astype(np.int32)


def alike(what: str, counts: Counts, sample_bytes: int, rng: np.random.Generator) -> Counts:
    """Return the counts of a frame whose rows are alike in a way of ``ALIKE``."""
    found, limit = counts.copy(), full_scale(sample_bytes)
    some = int(rng.integers(limit // 8, limit) * rng.choice([-1, 1]))
    match what:
        case "full scale":
            found[:] = int(rng.choice([limit, -limit - 1]))
        case "one count":
            found[:] = int(rng.choice([1, -1]))
        case "nothing":
            found[:] = 0
        case "any count":
            found[:] = some
        case "half of the rows":
            found[rng.choice(104, 52, replace=False)] = some
        case "a drive's rows":
            found[TABLE[:, 0] == rng.integers(0, 7 if sample_bytes > 2 else 6)] = some  # nine rows and more, or seven
        case "a drive again":  # its buffer is sent for another drive as well
            first, second = (int(one) for one in rng.choice(4, 2, replace=False))
            rows = np.flatnonzero(TABLE[:, 0] == first)
            others = np.flatnonzero(TABLE[:, 0] == second)
            count = min(len(rows), len(others))
            found[others[:count]] = found[rows[:count]]
        case "drives stuck":
            found = _stuck_wire(counts, 1, rng)
        case _:
            found = _stuck_wire(counts, 0, rng)
    return found


def lies(effort: Effort) -> Outcome:
    """Tell every lie many times; nothing of it may be published."""
    outcome = Outcome("front-end.lies")
    slowest: dict[str, int] = {}
    draws = effort.count(1, 30)
    for kind, snr_db, sample_bytes in FRONT_ENDS:
        for draw in range(draws):
            seed = effort.seed + 1000 * draw + int(snr_db) + sample_bytes
            sheet = Sheet(seed, kind, snr_db, sample_bytes)
            judge = Judge(sheet)
            for what in (*ALIKE, *REPEATED):
                if what == "a drive again" and sample_bytes == 2:
                    continue  # among 65,536 counts a dozen pairs of rows read the same by chance
                published = sum(_told(judge, what))
                allowed = 0
                if what in REPEATED:
                    allowed = judge.pipeline.intake.most_repeats[0] or 0
                slowest[what] = max(slowest.get(what, 0), published)
                outcome.note(published <= allowed, f"{what}: {published} published, {kind} {snr_db} dB, seed {seed}")
    outcome.figures["most_frames_published"] = slowest
    return outcome


def _told(judge: Judge, what: str) -> Iterator[bool]:
    """Tell one lie, and an honest frame before; yield of each of its frames whether it would be published."""
    sheet = judge.sheet
    time_s = float(sheet.rng.uniform(0.0, sheet.period_s))
    first, second = sheet.sample(time_s)[0], sheet.sample(time_s)[0]
    judge.passes(first)
    judge.passes(second)
    for number in range(LONGEST if what in REPEATED else 5):
        if what == "frozen":
            yield judge.passes(second)
        elif what == "two buffers":
            yield judge.passes((first, second)[number % 2])
        else:
            yield judge.passes(alike(what, sheet.sample(time_s)[0], sheet.sample_bytes, sheet.rng))


def honest(effort: Effort) -> Outcome:
    """Play honest sheets, well and ill; not one frame may be withheld."""
    outcome = Outcome("front-end.honest")
    scenes: list[tuple[str, Callable[[int], Sheet]]] = [
        (f"{kind} {snr_db:g} dB {8 * width} bit", lambda s, k=kind, d=snr_db, w=width: Sheet(s, k, d, w))
        for kind, snr_db, width in (*FRONT_ENDS, ("N2", 90.0, 2), ("none", 0.0, 3), ("none", 0.0, 2))
    ]
    scenes += [
        ("an electrode is off", lambda s: Sheet(s, gone=(s % 16,))),
        ("four electrodes read nothing", lambda s: Sheet(s, gone=(1, 5, 9, 13), silent=True)),
        ("rows are cut off now and then", lambda s: Sheet(s, overdrive=1.9)),
    ]
    each = effort.count(200, 7500)
    withheld: dict[str, dict[str, int]] = {}
    for name, sheet_of in scenes:
        sheet = sheet_of(effort.seed)
        judge = Judge(sheet)
        for number in range(each):
            # A touch that is held, the script as it goes, and moments at random
            time_s = (0.06 * (number // 60) * 12, number * 0.005, sheet.rng.uniform(0.0, 20.0))[number // 20 % 3]
            counts, cut_off = sheet.sample(float(time_s) % sheet.period_s)
            judge.passes(counts, cut_off)
        intake = judge.pipeline.intake
        outcome.tried += each
        outcome.withstood += each - intake.withheld_total
        if intake.withheld_total:
            withheld[name] = {reason: count for reason, count in intake.withheld.items() if count}
            outcome.broken.append(f"{name}: withheld {withheld[name]}, seed {effort.seed}")
    outcome.figures["withheld"] = withheld
    return outcome
