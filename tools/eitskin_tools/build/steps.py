"""The steps from a recipe to a bundle; finished parts are not made again."""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import Skin
from eitskin_tools.build.folder import keep, stored
from eitskin_tools.build.recipe import BuildRecipe, Data, MissingElectrodesWork, TrainingStage
from eitskin_tools.command_line import files

PROGRESS_S: Final = 5.0
"""Least time between two lines on the samples made."""

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


def make_data(recipe: BuildRecipe, folder: Path, workers: int, tell: Tell, say: Tell = lambda _: None) -> None:
    """Make every data set, or go on with it; say every few seconds how many samples are done."""
    from eitskin_sim.dataset.generate import generate

    for name, data in recipe.data.items():
        tell(f"simulating data set {name}")
        generate(plan_of(recipe, data), folder / "data" / name, workers=workers, progress=samples_said(say))


def samples_said(say: Tell, unit: str = "samples") -> Callable[[int, int], None]:
    """Return what says how many are done, at most once in :data:`PROGRESS_S`."""
    last_s = time.monotonic()

    def progress(done: int, total: int) -> None:
        nonlocal last_s
        if time.monotonic() - last_s > PROGRESS_S:
            last_s = time.monotonic()
            say(f"{done:,} of {total:,} {unit}")

    return progress


def train_stages(
    recipe: BuildRecipe,
    folder: Path,
    tell: Tell,
    finished: Tell = lambda _: None,
    larger: Path | None = None,
) -> Path:
    """Train every stage, or resume, and return the last one's folder.

    Args:
        recipe: What is made.
        folder: Of the half-made bundle.
        tell: Told what is being done.
        finished: Told how each epoch went.
        larger: A run whose network it begins with where that has its shape, or is to be narrowed to it; None as the
            recipe says.
    """
    from eitskin_training import train
    from eitskin_training.gate.stored import gate_of_run
    from eitskin_training.samples.joined import load_all
    from eitskin_training.start import Start

    def epoch(now: Any) -> None:
        if (one := now.finished) is not None:
            scores = f"validation loss {one.validation_loss:.5f}, CC {one.validation_cc:.4f}"
            left = (now.epochs - one.number) * one.seconds / 60
            finished(f"epoch {one.number} of {now.epochs}: {scores}, {one.seconds:.1f} s, {left:.0f} min left")

    run = folder
    for number, stage in enumerate(recipe.training, 1):
        tell(f"training, stage {number} of {len(recipe.training)}, on {train.device()}")
        start = start_of(recipe, stage, larger) if number == 1 else Start.of_run(run)
        run = folder / "runs" / str(number)
        where = [folder / "data" / name for name in stage.data or recipe.data]
        data = load_all([str(one) for one in where])
        sources = tuple(str(one.resolve()) for one in where)
        chosen = fitted_to(recipe, stage, data.skin)
        train.train(data, chosen, run, seed=stage.seed, resume=True, start=start, sources=sources, progress=epoch)
    gate_of_run(run, data, recipe.training[-1].seed, tell=tell, bends=_bends_of(recipe))
    if recipe.missing_electrodes is None:
        return run
    return learn_missing_electrodes(recipe.missing_electrodes, folder, run, tell)


def export_run(recipe: BuildRecipe, folder: Path, run: Path, tell: Tell) -> tuple[Path, dict[str, Any]]:
    """Export a run, or find what was exported; return the bundle and what the export said."""
    from eitskin_export import package
    from eitskin_export.bundle import read, write
    from eitskin_training.run_files import data_of, trained

    out, said = folder / "exported.eitskin", folder / "exported.json"
    if (known := _exported_before(out, said)) is not None:
        return out, known
    found = trained(run)
    result = package.export(found, data_of(found), out, tell=tell, bends=_bends_of(recipe))
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
            tell(f"testing for the card: {name}")
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


def start_of(recipe: BuildRecipe, stage: TrainingStage, larger: Path | None = None) -> Any:
    """Return the network that a stage begins with, None for a new one.

    Args:
        recipe: What is made.
        stage: The first one.
        larger: A run to begin with where the recipe's network is that run's, or that one narrowed.

    Raises:
        SkinError: There is no such bundle, or it cannot be taken apart.
    """
    from eitskin_export.unfold import start_of_bundle
    from eitskin_training.start import Start, fits

    if larger is not None:
        start = Start.of_run(larger)
        wanted = fitted_to(recipe, stage, start.skin)
        if fits(start, wanted) or start.architecture == wanted.architecture:
            return start
    if stage.start_from is None:
        return None
    own = recipe.beside / stage.start_from
    return start_of_bundle(own if own.is_file() else files.find(stage.start_from, files.BUNDLE))


def _network(recipe: BuildRecipe, stage: TrainingStage) -> Any:
    from eitskin_training.recipes import recipe as network_named

    given: dict[str, Any] = {
        name: getattr(stage, name) for name in ("learning_rate", "schedule") if getattr(stage, name) is not None
    }
    if stage.noise is not None:
        low, high = recipe.skin.front_end.snr_db
        given["snr_db"] = low if low == high else (low, high)
    return replace(network_named(stage.network or recipe.network), epochs=stage.epochs, **given)


def fitted_to(recipe: BuildRecipe, stage: TrainingStage, skin: Any) -> Any:
    """Return the recipe of a stage's network for a skin."""
    from eitskin_training.recipes import fitted

    return fitted(_network(recipe, stage), skin)


def _bends_of(recipe: BuildRecipe) -> Callable[[Any], Any]:
    """Return what gives the gate's untouched sheets."""
    from eitskin_training.gate import untouched

    def bends(data: Any) -> Any:
        if recipe.gate.untouched == 0:
            return untouched.bends_of(data)
        return untouched.solved_bends(data, recipe.gate.untouched)

    return bends


def processes(workers: int | None) -> int:
    """Return how many processes make data: as many as asked for, or one a core."""
    return workers or len(os.sched_getaffinity(0))


MISSING_RUN: Final = "missing-electrodes"
"""Among the runs of a half-made bundle."""


def learn_missing_electrodes(work: MissingElectrodesWork, folder: Path, run: Path, tell: Callable[[str], None]) -> Path:
    """Return the run trained for missing electrodes, with the gate of the original run.

    Args:
        work: How long.
        folder: Of the half-made bundle.
        run: Of the last stage.
        tell: Told what is being done.
    """
    from eitskin_training import adapt
    from eitskin_training.gate.stored import hand_on
    from eitskin_training.run_files import data_of, trained

    out = folder / "runs" / MISSING_RUN
    if not (out / "best.pt").exists():
        tell("training with electrodes missing")
        found, plan = trained(run), adapt.Plan(fitting_steps=work.fitting_steps, steps=work.steps)
        adapted = adapt.adapt(found.model, found.recipe, data_of(found), plan, seed=work.seed)
        hand_on(run, out)
        adapt.write(out, found.content, adapted)
    return out


def check(recipe: BuildRecipe) -> None:
    """Refuse what would fail hours later: data that cannot be planned or joined, a network or start that does not fit.

    Raises:
        SkinError: A file is missing or is no bundle, or a stage's network does not go on from the one before.
        ValueError: A number is outside its bounds, or things do not go together.
    """
    for name, data in recipe.data.items():
        try:
            plan_of(recipe, data)
        except ValueError as error:
            raise ValueError(f"[data.{name}] {error}") from error
    start = start_of(recipe, recipe.training[0])
    for number, stage in enumerate(recipe.training, 1):
        start = _check_stage(recipe, number, stage, start)
    _check_gate(recipe)


def _check_stage(recipe: BuildRecipe, number: int, stage: TrainingStage, start: Any) -> Any:
    """Refuse data sets that do not go together, and a network that cannot begin with them where the last one ended.

    Returns:
        What the next stage starts from, but for its weights.
    """
    from eitskin_training.network.sharpen import cells
    from eitskin_training.start import Start, fits

    names = stage.data or tuple(recipe.data)
    plans = [plan_of(recipe, recipe.data[name]) for name in names]
    for at, (name, plan) in enumerate(zip(names, plans, strict=True)):
        if plan in plans[:at]:
            twice = names[plans.index(plan)]
            raise ValueError(f"[data.{name}] and [data.{twice}] are the same; give one of them another seed")
        if plan.skin.digest != plans[0].skin.digest:
            raise ValueError(
                f"[[training]] {number} learns from skins {plans[0].skin.name} and {plan.skin.name}, in [data.{name}], "
                "expected one; name those of one skin in its data, and the others in a stage of their own"
            )
    skin = plans[0].skin
    wanted = fitted_to(recipe, stage, skin)
    if wanted.architecture.sharpening:
        cells(skin.grid.shape)
    if start is not None and not fits(start, wanted):
        start.require(wanted.architecture, skin)
    return Start({}, wanted.architecture, skin, {})


def _check_gate(recipe: BuildRecipe) -> None:
    """Refuse a gate without untouched sheets that it did not learn from."""
    plans = [plan_of(recipe, recipe.data[name]) for name in recipe.training[-1].data or recipe.data]
    apart = sum(len(plan.bends) - plan.splits.count("train") for plan in plans)
    if recipe.gate.untouched == 0 and apart < 2:
        raise ValueError(
            f"the gate has {apart} held-out deformations to choose and measure it, expected at least 2: raise kept in "
            "[data], or untouched in [gate]"
        )
