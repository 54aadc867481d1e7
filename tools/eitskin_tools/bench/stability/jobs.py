"""The bench as a list of jobs, each of a sweep or of a group of rows, with what each will take.

A full run takes minutes, so it says how far it is, shows each row as it is found, and gives what it has when it is
stopped. What a job takes is reckoned in maps and solves, of known cost relative to each other; the time left is that of
the jobs behind it, scaled by what those before it took.
"""

import importlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final

from eitskin.health.imputation import Consistency
from eitskin.model.bundle import load_bundle
from eitskin_tools.bench.stability.harness.rows import Curve, Row
from eitskin_tools.bench.stability.harness.samples import Labels, Sample, samples
from eitskin_tools.bench.stability.harness.solvers import CLASSICAL, ENGINES, Subjects
from eitskin_tools.bench.stability.harness.sweep import Effort, Stress, run_stress, thinned
from eitskin_tools.bench.stability.harness.tally import Tally

SWEPT: Final = ("noise", "frontend", "material", "shape", "meshes")
"""The families that are sweeps of samples through every solver."""

WORST_STEPS: Final = {"quick": 200, "full": 3000}
"""Steps of the search for the worst int8 input, from each scene."""

IMAGE_MS: Final = {"classical": 10.0, "published": 0.6}
"""About what a map costs: of l1, SBL and Tikhonov on average; of a network or the projection."""

SOLVE_MS: Final = {3.0: 130.0, 6.0: 35.0}
"""About what a forward solve costs, by element size in mm."""

OTHER_MS: Final = {"shape": 500.0, "meshes": 4000.0, "precision": 4000.0, "int8": 2.2, "inputs": 15_000.0,
                   "denormals": 2000.0, "repeat": 3000.0}  # fmt: skip
"""About what the rows cost that are no sweeps; ``int8`` for each step."""

Found = list[tuple[Row, Curve | None]]


@dataclass(frozen=True, slots=True)
class Job:
    """One sweep through every solver, or one group of rows."""

    family: str
    name: str
    work_ms: float
    """About what it takes on a free core; only ratios count."""
    run: Callable[[], Found]


@dataclass
class Setup:
    """A bundle's solvers and samples, made when the first job asks for them.

    Args:
        path: Of the bundle.
        effort: How many samples, on which mesh.
        tally: Counts what is published.
    """

    path: Path
    effort: Effort
    tally: Tally

    @cached_property
    def subjects(self) -> Subjects:
        """The solvers."""
        return Subjects(load_bundle(self.path), self.tally)

    @cached_property
    def samples(self) -> tuple[Sample, ...]:
        """The undisturbed sheets."""
        return samples(self.subjects.labels, self.effort.samples, self.effort.element_size_mm)


@dataclass(slots=True)
class Progress:
    """How far a run is.

    Args:
        jobs: All of them, in order.
        start_s: ``perf_counter`` when the first began.
    """

    jobs: Sequence[Job]
    start_s: float = field(default_factory=time.perf_counter)
    done: int = 0

    def step(self) -> str:
        """Count a job as done and return a line on what is left."""
        self.done += 1
        before = sum(job.work_ms for job in self.jobs[: self.done])
        behind = sum(job.work_ms for job in self.jobs[self.done :])
        took_s = time.perf_counter() - self.start_s
        left_s = took_s * behind / before
        return f"[{self.done}/{len(self.jobs)}] {took_s:.0f} s so far, about {left_s:.0f} s left"


def jobs_of(
    bundles: Sequence[Path], effort: Effort, families: Sequence[str], tally: Tally, *, quick: bool
) -> Iterator[Job]:
    """Yield every job of a run.

    Args:
        bundles: The first is stressed by every family, others by the sweeps (noise alone where it is quick).
        effort: How much of each sweep.
        families: Those that are asked for.
        tally: Counts what is published.
        quick: Short searches.
    """
    for number, path in enumerate(bundles):
        setup = Setup(path, effort, tally)
        labels: Labels = setup.subjects.labels
        for family in [name for name in SWEPT if name in families and (number == 0 or name == "noise" or not quick)]:
            for stress in stresses_of(family):
                work_ms = _sweep_ms(stress, effort, setup.subjects)
                yield Job(family, f"{labels}: {stress.name}", work_ms, partial(_sweep, stress, setup))
        if number == 0:
            yield from _other_jobs(setup, families, quick=quick)


def stresses_of(family: str) -> list[Stress]:
    """Return the sweeps of a family, of the module of its name."""
    found: list[Stress] = importlib.import_module(f"eitskin_tools.bench.stability.sweeps.{family}").stresses()
    return found


def _sweep(stress: Stress, setup: Setup) -> Found:
    return list(run_stress(stress, setup.subjects, setup.samples, setup.effort))


def _sweep_ms(stress: Stress, effort: Effort, subjects: Subjects) -> float:
    """Return about what a sweep takes: a map a solver and level, a solve of the touched and one of the bare sheet."""
    names = subjects.names() if stress.solvers is None else stress.solvers
    a_map_ms = IMAGE_MS["classical"] * sum(name in CLASSICAL for name in names)
    a_map_ms += IMAGE_MS["published"] * (sum(name in ENGINES for name in names) + 2)
    draws = effort.draws if stress.random else 1
    solves_ms = 2.0 * SOLVE_MS.get(effort.element_size_mm, SOLVE_MS[6.0]) if stress.solved else 0.0
    return len(thinned(stress.levels, effort.levels)) * effort.samples * (draws * a_map_ms + solves_ms)


def _other_jobs(setup: Setup, families: Sequence[str], *, quick: bool) -> Iterator[Job]:
    """Yield the jobs that are no sweeps of samples."""
    from eitskin_tools.bench.stability.sweeps.constant import constant_rows
    from eitskin_tools.bench.stability.sweeps.denormals import denormal_rows
    from eitskin_tools.bench.stability.sweeps.inputs import input_rows
    from eitskin_tools.bench.stability.sweeps.meshes import triangle_rows
    from eitskin_tools.bench.stability.sweeps.repeat import repeat_rows
    from eitskin_tools.bench.stability.sweeps.worst import worst_row

    subjects, steps = setup.subjects, WORST_STEPS["quick" if quick else "full"]
    makers: dict[str, tuple[str, Callable[[], list[Row]]]] = {
        "shape": ("scenes without contrast", lambda: constant_rows(subjects, setup.samples)),
        "meshes": ("sliver triangles", triangle_rows),
        "precision": ("float32 and float64", lambda: _precision(setup)),
        "int8": ("worst input", lambda: [worst_row(subjects.plain, setup.samples, steps)]),
        "inputs": ("absurd inputs", lambda: input_rows(subjects.bundle, setup.samples[0], subjects.tally)),
        "denormals": ("numbers that are slow to compute", lambda: denormal_rows(subjects.bundle)),
        "repeat": ("the same twice", lambda: repeat_rows(subjects.bundle, setup.samples)),
    }
    if "vd2t-int8" not in subjects.plain.engines:
        del makers["int8"]
    for family, (name, make) in makers.items():
        if family in families:
            work_ms = OTHER_MS[family] * (steps * setup.effort.samples if family == "int8" else 1.0)
            yield Job(family, name, work_ms, partial(_without_curves, make))


def _precision(setup: Setup) -> list[Row]:
    from eitskin_tools.bench.stability.sweeps.precision import precision_rows

    arrays = setup.subjects.bundle.consistency_arrays()
    consistency = None if arrays is None else Consistency.of(arrays)
    return precision_rows(setup.samples[0], max(setup.effort.levels, 7), consistency)


def _without_curves(make: Callable[[], list[Row]]) -> Found:
    rows: list[tuple[Row, Any]] = [(row, None) for row in make()]
    return rows
