"""The way from a recipe to a bundle, step by step; whatever is there already is not made again."""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import Skin
from eitskin_tools.build import missing_lesson, press_lesson
from eitskin_tools.build.folder import keep, stored
from eitskin_tools.build.recipe import BuildRecipe, Data, Leg
from eitskin_tools.command_line import files

Tell = Callable[[str], None]
"""Told what is being done."""


def plan_of(recipe: BuildRecipe, data: Data) -> Any:
    """Return the plan of one of a recipe's data sets.

    Raises:
        ValueError: A number is outside its bounds, or things do not go together.
    """
    return _plan(data, recipe.skin_of(data))


@lru_cache(maxsize=16)
def _plan(data: Data, skin: Skin) -> Any:
    from eitskin_sim.dataset.plan import make_plan

    return make_plan(
        data.set,
        data.seed,
        deformations=data.deformations,
        touch_sets=data.touch_sets,
        per_deformation=data.per_deformation,
        kept=data.kept,
        near=data.near,
        touches=data.touches,
        devices=data.devices,
        skin=skin,
    )


def share_data(recipe: BuildRecipe, folder: Path, other: BuildRecipe, made: Path) -> None:
    """Take the data sets that another recipe has made, where the same are wanted: a link to each."""
    for name, data in recipe.data.items():
        plan, own = plan_of(recipe, data), folder / "data" / name
        same = next((found for found, one in other.data.items() if plan_of(other, one) == plan), None)
        if same is not None and not own.exists():
            own.parent.mkdir(parents=True, exist_ok=True)
            own.symlink_to(os.path.relpath(made / "data" / same, own.parent), target_is_directory=True)


def make_data(recipe: BuildRecipe, folder: Path, workers: int, tell: Tell) -> None:
    """Make every data set, or go on with it."""
    from eitskin_sim.dataset.generate import generate

    for name, data in recipe.data.items():
        tell(f"data {name}")
        generate(plan_of(recipe, data), folder / "data" / name, workers=workers)


def train_legs(
    recipe: BuildRecipe,
    folder: Path,
    tell: Tell,
    finished: Tell = lambda _: None,
    presses: Any = None,
    larger: Path | None = None,
) -> Path:
    """Train every leg, or go on with it, and return the last one's folder.

    Args:
        recipe: What is made.
        folder: Of the half-made bundle.
        tell: Told what is being done.
        finished: Told how each epoch went.
        presses: A recording of some, to be learned from in the end, and kept if it is better for it; None without.
        larger: A run whose network it begins with where that has its shape, or is to be narrowed to it; None as the
            recipe says.
    """
    from eitskin_training import train
    from eitskin_training.gate.stored import gate_of_run
    from eitskin_training.samples.joined import load_all
    from eitskin_training.start import Start

    def epoch(now: Any) -> None:
        if (one := now.finished) is not None:
            scores = f"validation {one.validation_loss:.5f} CC {one.validation_cc:.4f}"
            left = (now.epochs - one.number) * one.seconds / 60
            finished(f"epoch {one.number}/{now.epochs} {scores} {one.seconds:.1f} s, {left:.0f} min left")

    run = folder
    for number, leg in enumerate(recipe.training, 1):
        tell(f"training {number} of {len(recipe.training)}, on {train.device()}")
        start = start_of(recipe, leg, larger) if number == 1 else Start.of_run(run)
        run = folder / "runs" / str(number)
        where = [folder / "data" / name for name in leg.data or recipe.data]
        data = load_all([str(one) for one in where])
        sources = tuple(str(one.resolve()) for one in where)
        chosen = fitted_to(recipe, leg, data.skin)
        train.train(data, chosen, run, seed=leg.seed, resume=True, start=start, sources=sources, progress=epoch)
    if presses is not None:
        run, data = press_lesson.learned(recipe, folder, run, data, presses, tell, epoch)
    bends, steps = _gate(recipe)
    gate_of_run(run, data, recipe.training[-1].seed, tell=tell, bends=bends, steps=steps)
    if recipe.missing_electrodes is None:
        return run
    return missing_lesson.learned(recipe.missing_electrodes, folder, run, tell)


def export_run(recipe: BuildRecipe, folder: Path, run: Path, tell: Tell) -> tuple[Path, dict[str, Any]]:
    """Export a run, or find what was exported; return the bundle and what the export said."""
    from eitskin_export import package
    from eitskin_export.bundle import read, write
    from eitskin_training.run_files import data_of, trained

    out, said = folder / "exported.eitskin", folder / "exported.json"
    if (known := _exported_before(out, said)) is not None:
        return out, known
    found = trained(run)
    bends, gate_steps = _gate(recipe)
    result = package.export(found, data_of(found), out, tell=tell, bends=bends, gate_steps=gate_steps)
    members, facts, skin = read(out)
    result["bundle"] = write(out, members, {**facts, "build": recipe.as_dict()}, skin)
    keep(said, result)
    return out, result


def _exported_before(bundle: Path, said: Path) -> dict[str, Any] | None:
    """Return what the export said of a bundle that is there and whole; None where it has to be exported again."""
    from eitskin.model.bundle import load_bundle

    known = stored(said)
    if known is None or not {"bundle", "labels", "touches", "gate"} <= known.keys():
        return None
    try:
        return known if load_bundle(bundle).id == known["bundle"] else None
    except SkinError:
        return None


def make_card(recipe: BuildRecipe, folder: Path, bundle: Path, identity: str, tell: Tell) -> dict[str, Any]:
    """Try the bundle, part by part, and return its card."""
    from eitskin_tools.evaluation import card

    found: dict[str, Any] = {}
    for name in card.parts(bundle):
        path = folder / "card" / f"{name}.json"
        part = stored(path)
        if part is None or part.get("bundle") != identity or "found" not in part:
            tell(f"card: {name}")
            work = recipe.card
            part = {"bundle": identity, "found": card.part(name, bundle, work.deformations, work.each, work.draws)}
            keep(path, part)
        found[name] = part["found"]
    return card.whole(found, bundle)


def finish(bundle: Path, card: dict[str, Any], out: Path) -> str:
    """Write the bundle with its card to where it belongs and return its id."""
    from eitskin_export.bundle import read, write

    members, facts, skin = read(bundle)
    return write(out, members, {**facts, "metrics": {**facts.get("metrics", {}), "card": card}}, skin)


def start_of(recipe: BuildRecipe, leg: Leg, larger: Path | None = None) -> Any:
    """Return the network that a leg begins with, None for a new one.

    Args:
        recipe: What is made.
        leg: The first one.
        larger: A run to begin with where the recipe's network is that run's, or that one narrowed.

    Raises:
        SkinError: There is no such bundle, or it cannot be taken apart.
    """
    from eitskin_export.unfold import start_of_bundle
    from eitskin_training.narrowed import fits
    from eitskin_training.start import Start

    if larger is not None:
        start = Start.of_run(larger)
        wanted = fitted_to(recipe, leg, start.skin)
        if fits(start, wanted) or start.architecture == wanted.architecture:
            return start
    if leg.start_from is None:
        return None
    own = recipe.beside / leg.start_from
    return start_of_bundle(own if own.is_file() else files.find(leg.start_from, files.BUNDLE))


def _network(recipe: BuildRecipe, leg: Leg) -> Any:
    from eitskin_training.recipes import recipe as network_named

    given: dict[str, Any] = {
        name: getattr(leg, name) for name in ("learning_rate", "schedule") if getattr(leg, name) is not None
    }
    if leg.noise is not None:
        low, high = recipe.skin.front_end.snr_db
        given["snr_db"] = low if low == high else (low, high)
    return replace(network_named(leg.network or recipe.network), epochs=leg.epochs, **given)


def fitted_to(recipe: BuildRecipe, leg: Leg, skin: Any) -> Any:
    """Return the recipe of a leg's network for a skin."""
    from eitskin_training.recipes import fitted

    return fitted(_network(recipe, leg), skin)


def _gate(recipe: BuildRecipe) -> tuple[Callable[[Any], Any], int | None]:
    """Return what gives the gate's untouched sheets, and the steps of its fit."""
    from eitskin_training.gate import untouched

    def bends(data: Any) -> Any:
        if recipe.gate.untouched == 0:
            return untouched.bends_of(data)
        return untouched.solved_bends(data, recipe.gate.untouched)

    return bends, recipe.gate.steps


def processes(workers: int | None) -> int:
    """Return how many processes make data: as many as asked for, or one a core."""
    return workers or len(os.sched_getaffinity(0))
