"""Runs one disturbance from mild to harsh through every solver and makes curves of it.

Draws of noise are paired: the same sample at the same draw sees the same random numbers at every level and in every
solver, so that curves differ by what is compared and not by luck.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_tools.bench.stability.harness.rows import Curve, Point, Row
from eitskin_tools.bench.stability.harness.samples import SEED, Disturb, Sample
from eitskin_tools.bench.stability.harness.solvers import GATE, Subjects, accuracy

Array = npt.NDArray[np.float64]

Explain = Callable[[Sequence[Sample], float], str]
"""From the undisturbed samples and a level to what explains a break there, with its figures."""

HALF: Final = 0.5
"""The accuracy of a gate that guesses; its unstressed accuracy is counted from there when it is doubled below."""


@dataclass(frozen=True, slots=True)
class Stress:
    """A disturbance and its levels."""

    name: str
    unit: str
    levels: tuple[float, ...]
    """From mild to harsh."""
    disturb: Disturb
    explain: Explain
    logarithmic: bool = False
    origin: float | None = None
    """The level that stands for "unstressed"; None for the sample itself."""
    random: bool = False
    """Draws random numbers; more than one draw a sample makes sense."""
    solvers: tuple[str, ...] | None = None
    """Only these; None for all."""
    solved: bool = False
    """Each level costs a solve a sample: a break is explained at the swept level next to it."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of a sweep is run."""

    samples: int
    draws: int
    levels: int
    """At most so many of a sweep's levels, its ends among them."""
    element_size_mm: float


FULL: Final = Effort(samples=8, draws=3, levels=99, element_size_mm=3.0)
QUICK: Final = Effort(samples=2, draws=1, levels=4, element_size_mm=6.0)
"""Under a minute of one core for all sweeps."""


def thinned(levels: Sequence[float], most: int) -> tuple[float, ...]:
    """Return at most so many of some levels, evenly, the first and the last among them."""
    if len(levels) <= most:
        return tuple(levels)
    return tuple(levels[i] for i in np.unique(np.linspace(0, len(levels) - 1, max(most, 2)).round().astype(int)))


def run_stress(
    stress: Stress, subjects: Subjects, samples: Sequence[Sample], effort: Effort
) -> list[tuple[Row, Curve]]:
    """Return the row and the curve of every solver.

    Args:
        stress: What is done to the samples.
        subjects: The solvers.
        samples: Undisturbed, of the subjects' labels.
        effort: How much of it.
    """
    levels = thinned(stress.levels, effort.levels)
    draws = effort.draws if stress.random else 1
    at = {level: _disturbed(stress, samples, level, draws) for level in levels}
    bare = [sample.bare() for sample in samples]
    base = list(samples) * draws if stress.origin is None else _disturbed(stress, samples, stress.origin, draws)
    found = []
    for name in subjects.names():
        if stress.solvers is not None and name not in stress.solvers:
            continue
        before = subjects.tally.published
        if name == GATE:
            empty = {level: _disturbed(stress, bare, level, draws) for level in levels}
            calm = bare * draws if stress.origin is None else _disturbed(stress, bare, stress.origin, draws)
            unstressed, points = _gate_points(subjects, base, calm, at, empty)
        else:
            unstressed, points = _map_points(subjects, name, base, at)
        label = name if subjects.labels == "units" else f"{name} (free)"
        curve = Curve(stress.name, label, stress.unit, unstressed, tuple(points), stress.logarithmic)
        ends = curve.breaks_at()
        where = levels[-1] if ends is None else _near(ends, levels, stress)
        why = ("breaks: " if ends is not None else "does not break in the sweep; at its end: ") + stress.explain(
            samples, where
        )
        found.append((curve.row(why, subjects.tally.published - before), curve))
    return found


def _near(found: float, levels: Sequence[float], stress: Stress) -> float:
    """Return the level at which a break is explained."""
    if not stress.solved:
        return found
    along = np.log if stress.logarithmic else np.asarray
    return min(levels, key=lambda level: float(np.abs(along(level) - along(found))))


def _disturbed(stress: Stress, samples: Sequence[Sample], level: float, draws: int) -> list[Sample]:
    return [
        stress.disturb(sample, level, np.random.default_rng([SEED, draw, index]))
        for draw in range(draws)
        for index, sample in enumerate(samples)
    ]


def _map_points(
    subjects: Subjects, name: str, base: Sequence[Sample], at: dict[float, list[Sample]]
) -> tuple[float, list[Point]]:
    calm = [subjects.calm(name, sample) for sample in base]
    unstressed = float(np.mean([accuracy(image, sample) for image, sample in zip(calm, base, strict=True)]))
    points = []
    for level, disturbed in at.items():
        images = [subjects.image(name, sample) for sample in disturbed]
        scores = [accuracy(image, sample) for image, sample in zip(images, disturbed, strict=True)]
        apart = [
            np.mean((image - other) ** 2)
            for image, other in zip(images, calm, strict=True)
            if image is not None and other is not None
        ]
        rms = float(np.sqrt(np.mean(apart))) if apart else float("nan")
        points.append(Point(level, float(np.mean(scores)), rms, sum(image is None for image in images) / len(images)))
    return unstressed, points


def _gate_points(
    subjects: Subjects,
    base: Sequence[Sample],
    calm: Sequence[Sample],
    at: dict[float, list[Sample]],
    empty: dict[float, list[Sample]],
) -> tuple[float, list[Point]]:
    right, _ = subjects.verdicts(base, calm)
    points = []
    for level, disturbed in at.items():
        verdicts, withheld = subjects.verdicts(disturbed, empty[level])
        share = withheld / (len(disturbed) + len(empty[level]))
        points.append(Point(level, _beyond_chance(verdicts), float("nan"), share))
    return _beyond_chance(right), points


def _beyond_chance(right: Sequence[bool]) -> float:
    """Share of right verdicts, stretched so that guessing is 0 and always right is 1; 0 where none was shown."""
    return max(0.0, (float(np.mean(right)) - HALF) / HALF) if right else 0.0
