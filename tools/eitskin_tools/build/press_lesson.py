"""The last lesson of a bundle that is adapted: presses that were recorded on the real sheet.

It begins with what was learned from physics alone, and goes on with the same data and the presses among them. Both are
then shown the presses that were kept apart; the better one becomes the bundle.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from eitskin_tools.build.folder import keep, stored
from eitskin_tools.build.recipe import BuildRecipe

EPOCHS: Final = 2
RATE: Final = 0.8
"""Of the learning rate of the leg before it."""

FILE: Final = "presses.json"
"""What it was worth."""

SNR_DB: Final = 80.0
"""Next to no noise is added to what was measured."""


def learned(
    recipe: BuildRecipe,
    folder: Path,
    run: Path,
    data: Any,
    presses: Any,
    tell: Callable[[str], None],
    progress: Callable[[Any], None],
) -> tuple[Path, Any]:
    """Return the run that is better on presses kept apart, and what it learned from.

    Args:
        recipe: What is made.
        folder: Of the half-made bundle.
        run: That learned from physics alone.
        data: What it learned from.
        presses: The recording.
        tell: Told what is being done.
        progress: Told after every batch.
    """
    from eitskin_training import train
    from eitskin_training.run_files import trained
    from eitskin_training.samples import presses as recorded
    from eitskin_training.samples.joined import join
    from eitskin_training.start import Start

    place, after = folder / "data" / "recorded-presses", folder / "runs" / "presses"
    if not (place / recorded.NAME).exists():
        recorded.write(place, presses, data)
    alone = recorded.load(place)
    both, before = join([data, alone]), trained(run)
    tell(f"training on {len(alone.voltages)} recorded presses, on {train.device()}")
    chosen = replace(before.recipe, epochs=EPOCHS, learning_rate=RATE * before.recipe.learning_rate)
    sources = (*_sources(before.content["data"]), str(place.resolve()))
    seed = recipe.training[-1].seed
    start = Start.of_run(run)
    train.train(both, chosen, after, seed=seed, resume=True, start=start, sources=sources, progress=progress)
    if (found := stored(folder / FILE)) is None:
        scores = {"physics_alone": _score(before, alone), "with_presses": _score(trained(after), alone)}
        better = scores["with_presses"]["cc"] > scores["physics_alone"]["cc"]
        found = {"presses": len(alone.voltages), "kept_apart": len(recorded.kept(alone)), **scores, "used": better}
        keep(folder / FILE, found)
    return (after, both) if found["used"] else (run, data)


def told(found: dict[str, Any]) -> str:
    """Return what people read of :data:`FILE`."""
    alone, more = found["physics_alone"], found["with_presses"]
    used = "used" if found["used"] else "not used: physics alone is better"
    return (
        f"{found['kept_apart']} of {found['presses']} recorded presses, kept apart: CC {alone['cc']:.3f}, "
        f"{alone['off_mm']:.1f} mm by physics alone; {more['cc']:.3f}, {more['off_mm']:.1f} mm with the others learned "
        f"from; {used}"
    )


def _sources(known: str | list[str]) -> tuple[str, ...]:
    return (known,) if isinstance(known, str) else tuple(known)


def _score(found: Any, alone: Any) -> dict[str, float]:
    """Return the mean correlation and distance of a network's maps of presses kept apart."""
    import numpy as np

    from eitskin_sim.evaluation.metrics import localisation_error_mm
    from eitskin_training.samples.presses import kept
    from eitskin_training.score import correlation, maps_of

    rows, grid = kept(alone), alone.skin.grid
    maps = maps_of(found.model, alone, rows, snr_db=SNR_DB)
    truth = alone.labels[rows] / 255.0
    pairs = zip(maps.reshape(-1, *grid.shape), truth.reshape(-1, *grid.shape), strict=True)
    off_mm = float(np.mean([localisation_error_mm(image, true, grid) for image, true in pairs]))
    return {"cc": round(float(correlation(maps, truth).mean()), 4), "off_mm": round(off_mm, 2)}
