"""Front ends whose rows are alike, come again or turn their sign; and honest ones, to the last frame.

Every lie is drawn at a random moment of the demonstration, bent, touched or flat, on a random front end. It is held if
nothing of it is published: at once where rows are alike or turned, after the repetitions that chance allows where
readings repeat.
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

LONGEST = 100
"""Frames that a lie goes on ..."""

SAID_WITHIN = 50
"""... and of those that repeat, how many may be published before it is known."""

ALIKE = ("full scale", "one count", "nothing", "half of the rows", "a drive's rows", "drives stuck",
         "measurements stuck", "all turned", "half turned", "a drive turned")  # fmt: skip
REPEATED = {"frozen": (1, 104), "half frozen": (1, 52), "most frozen": (1, 100), "a ring": (64, 104)}
"""Frames that come round, and rows of them; the others live."""


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
        case "half of the rows":
            found[rng.choice(104, 52, replace=False)] = some
        case "a drive's rows":
            found[TABLE[:, 0] == rng.integers(0, 7 if sample_bytes > 2 else 6)] = some  # nine rows and more, or seven
        case "all turned":
            found = -found
        case "half turned":
            found[::2] *= -1
        case "a drive turned":
            found[TABLE[:, 0] == rng.integers(0, 7)] *= -1
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
                published = sum(_told(judge, what))
                allowed = SAID_WITHIN if what in REPEATED else 0
                slowest[what] = max(slowest.get(what, 0), published)
                outcome.note(published <= allowed, f"{what}: {published} published, {kind} {snr_db} dB, seed {seed}")
    outcome.figures["most_frames_published"] = slowest
    return outcome


def _told(judge: Judge, what: str) -> Iterator[bool]:
    """Tell one lie, and honest frames before; yield of each of its frames whether it would be published as it is."""
    sheet = judge.sheet
    time_s = float(sheet.rng.uniform(0.0, sheet.period_s))
    frames, rows = REPEATED.get(what, (1, 0))
    while judge.fills:  # what was named of the lie before
        judge.passes(sheet.sample(0.0)[0])
    before = [sheet.sample(time_s)[0] for _ in range(frames + 1)]
    for counts in before:
        judge.passes(counts)
    for number in range(LONGEST if what in REPEATED else 5):
        counts = sheet.sample(time_s)[0]
        if what in REPEATED:
            counts[:rows] = before[1 + number % frames][:rows]
        else:
            counts = alike(what, counts, sheet.sample_bytes, sheet.rng)
        yield judge.passes(counts) and not judge.fills


def honest(effort: Effort) -> Outcome:
    """Play honest sheets that drift, well and ill; not one frame may be withheld, and no row be said to hang.

    Six seeds of the long form are 756,000 frames.
    """
    outcome = Outcome("front-end.honest")
    scenes: list[tuple[str, Callable[[int], Sheet]]] = [
        (
            f"{kind} {snr_db:g} dB {8 * width} bit",
            lambda s, k=kind, d=snr_db, w=width: Sheet(s, k, d, w, drifts=k != "none"),
        )
        for kind, snr_db, width in (*FRONT_ENDS, ("N2", 90.0, 2), ("none", 0.0, 3), ("none", 0.0, 2))
    ]
    scenes += [
        ("an electrode is off", lambda s: Sheet(s, gone=(s % 16,))),
        ("four electrodes read nothing", lambda s: Sheet(s, gone=(1, 5, 9, 13), silent=True)),
        ("rows are cut off now and then", lambda s: Sheet(s, overdrive=1.9)),
    ]
    each = effort.count(200, 9_000)
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
        outcome.withstood += each - intake.withheld_total - len(judge.named)
        if intake.withheld_total or judge.named:
            withheld[name] = {reason: count for reason, count in intake.withheld.items() if count}
            withheld[name] |= dict.fromkeys(judge.named, 1)
            outcome.broken.append(f"{name}: withheld {withheld[name]}, seed {effort.seed}")
    outcome.figures["withheld"] = withheld
    return outcome
