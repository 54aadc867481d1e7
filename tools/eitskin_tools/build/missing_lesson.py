"""The last lesson of a bundle whose recipe has [missing_electrodes]: to go on without electrodes, as ``eitskin adapt``.

It takes minutes, and is done once the legs are: a build that is killed meanwhile begins it again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

FOLDER: Final = "missing-electrodes"
"""Among the runs of a half-made bundle."""


@dataclass(frozen=True, slots=True)
class MissingElectrodesWork:
    """How long it learns."""

    fitting_steps: int = 2000
    """Of the filling alone."""
    steps: int = 3000
    """Of filling and network together."""
    seed: int = 0


def learned(work: MissingElectrodesWork, folder: Path, run: Path, tell: Callable[[str], None]) -> Path:
    """Return the run that goes on without electrodes, with the gate of the one that it was made from.

    Args:
        work: How long.
        folder: Of the half-made bundle.
        run: Of the last leg.
        tell: Told what is being done.
    """
    from eitskin_training import adapt
    from eitskin_training.gate.stored import hand_on
    from eitskin_training.run_files import data_of, trained

    out = folder / "runs" / FOLDER
    if not (out / "best.pt").exists():
        tell("learning to go on without electrodes")
        found, plan = trained(run), adapt.Plan(fitting_steps=work.fitting_steps, steps=work.steps)
        adapted = adapt.adapt(found.model, found.recipe, data_of(found), plan, seed=work.seed)
        hand_on(run, out)
        adapt.write(out, found.content, adapted)
    return out
