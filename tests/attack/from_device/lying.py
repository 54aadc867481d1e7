"""Intact packets that lie: numbers, clocks, rates, heads, rows, and greetings at recovery."""

from itertools import pairwise
from typing import Any, Final

from ..device.lies import lies_of_hello
from ..outcome import Effort, Outcome
from .trial import attack, trial

WRAP: Final = 2**32


def numbers(effort: Effort) -> Outcome:
    """Sequence numbers that repeat, jump ahead or go back: nothing twice, nothing wrong, and it goes on."""
    frames = effort.count(150, 1500)
    with attack("device.numbers") as (running, outcome):
        running.endure(outcome, do="repeat", seed=effort.seed, frames=frames)
        running.endure(outcome, do="ahead", seed=effort.seed, frames=frames)
        running.endure(outcome, exact=False, do="back", seed=effort.seed, frames=frames)
        running.endure(outcome, exact=False, do="back_far", by=2**31, frames=50)
        running.endure(outcome, exact=False, do="back_far", by=2**31 + 777, frames=50)
    return outcome


def wrap(effort: Effort) -> Outcome:
    """Sequence numbers and the device's clock wrap at 2^32: not a frame is lost, and both go on upwards."""
    outcome = Outcome("device.wrap")
    for first, clock_us in ((WRAP - 700, WRAP - 4_000_000), (WRAP - 400, 0))[: effort.count(1, 2)]:
        with trial(first=first, clock_us=clock_us) as running:
            held = running.witness.wait(lambda frames: len(frames) > 900, 60.0)
            frames = list(running.witness.frames)
            steps = {b.sequence - a.sequence for a, b in pairwise(frames)}
            ticks = {0 < b.device_us - a.device_us < 2_000_000 for a, b in pairwise(frames)}
            outcome.note(held and steps == {1} and ticks == {True}, f"from {first}: steps {sorted(steps)[:5]}")
            outcome.note(not running.wrong(frames), f"from {first}: {running.wrong(frames)[:2]}")
            lost = running.witness.lost + frames[-1].counts["lost"]
            outcome.frames_lost += lost
    return outcome


def clocks(effort: Effort) -> Outcome:
    """Clocks that run backwards, stand, race or jump, and scans ten times too fast or too slow: all are published."""
    frames = effort.count(100, 800)
    with attack("device.clocks") as (running, outcome):
        for rate in (-1, 0, 10, 0.1):
            running.endure(outcome, do="clock", rate=rate, frames=frames)
        for jump_us in (20_000, 2_000_000_000):
            running.endure(outcome, do="clock", jump_us=jump_us, seed=effort.seed, frames=frames)
        running.endure(outcome, paced=False, do="pace", times=10, frames=5 * frames)
        running.endure(outcome, do="pace", times=0.1, frames=max(20, frames // 10))
    return outcome


def heads(effort: Effort) -> Outcome:
    """Flags that change nothing measured do not matter; frames of another generation or table are withheld."""
    frames = effort.count(100, 1500)
    with attack("device.heads") as (running, outcome):
        common: dict[str, Any] = {"do": "heads", "seed": effort.seed, "frames": frames}
        running.endure(outcome, field="flags", values=[2, 8, 16, 32, 64, 128, 240], xor=True, right=True, **common)
        running.endure(outcome, field="dropped", values=[1, 7, 65_535], right=True, **common)
        running.endure(outcome, field="flags", values=[1, 3], xor=True, **common)
        running.endure(outcome, field="drives", values=[0, 1, 15, 16_382], **common)
        running.endure(outcome, exact=False, field="generation", values=[0, 2, WRAP - 1], share=0.02, **common)
    return outcome


def rows(effort: Effort) -> Outcome:
    """Whole frames that say nonsense of the sheet: nothing that is not finite, and afterwards as before."""
    frames = effort.count(60, 600)
    with attack("device.rows") as (running, outcome):
        for kind in ("saturated", "lowest", "zero", "one", "turned", "garbage", "frozen", "bits"):
            running.endure(outcome, exact=False, content=False, do="rows", kind=kind, seed=effort.seed, frames=frames)
    return outcome


def stuck(effort: Effort) -> Outcome:
    """A front end whose rows are all alike, or one frame over and over: it is said, or nothing is published."""
    outcome = Outcome("device.stuck")
    with trial() as running:
        for kind, seconds in (("saturated", 1), ("lowest", 1), ("frozen", 20))[: effort.count(2, 3)]:
            at, before = len(running.witness.frames), running.witness.frames[-1].counts["withheld"]
            said = running.device.order(do="rows", kind=kind, frames=200 * seconds, seconds=seconds + 20)
            running.recovered(said)
            frames = [frame for frame in running.witness.frames[at:] if frame.sequence < said["next"]]
            events = {event for frame in frames for event in frame.events} - {"saturated"}
            withheld = running.witness.frames[-1].counts["withheld"] - before
            outcome.note(
                bool(events) or withheld > 100, f"{kind}: {len(frames)} published, {withheld} withheld, no event"
            )
        outcome.frames_lost += running.witness.lost
    return outcome


def greetings(effort: Effort) -> Outcome:
    """After a restart HELLO says something else: refused with one line, or the frames are what they were."""
    outcome = Outcome("device.greetings")
    wrong: list[dict[str, Any]] = [{"volts_per_count": -6e-8}, {"rate_mHz": 0}, {"generation": 77}]
    if effort.long:
        found = {
            repr((name, value)): {name: value.hex() if isinstance(value, bytes) else value}
            for number in (effort.seed,)
            for name, value in lies_of_hello(number).items()
        }
        wrong = list(found.values())
    for hello in wrong:
        outcome.tried += 1
        with trial("--reconnect", "60") as running:
            at = len(running.witness.frames)
            said_last = running.device.order(do="changed", hello=hello, frames=200, seconds=4)
            recovered_s = running.recovered(said_last, 20.0)
            status, said = running.stream.runtime.poll(), running.stream.said()
            problems = running.wrong(running.witness.frames[at:])[:1]
            if "Traceback" in said or "\x1b" in said:
                problems.append(f"said {said[-300:]!r}")
            last = said.strip().splitlines()[-1]
            if status is None and recovered_s is None:
                problems.append("neither ended nor recovered")
            elif status is not None and (status != 1 or not last.startswith("eitskin run: ")):
                problems.append(f"ended with {status}: {last!r}")
            outcome.withstood += not problems
            if problems and len(outcome.broken) < 20:
                outcome.broken.append(f"{hello}: {'; '.join(problems)}")
    return outcome
