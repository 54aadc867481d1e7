"""Makes a recipe's bundle in a folder: starts or resumes it, scales it to a time, and runs the steps."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from eitskin.model.manifest import GENTLE, SMALL
from eitskin_tools.build import folder as half_made
from eitskin_tools.build import steps
from eitskin_tools.build.recipe import BuildRecipe
from eitskin_tools.build.steps import Tell, plan_of

FINAL_STAGES_S: Final = 600.0
"""For gate, export and card: five minutes on two quiet cores."""

TRAINING_SHARES: Final = {SMALL: 0.35, GENTLE: 0.1}
"""For additional networks: they start from the bundle's own and need few epochs, but their data take as long."""

PROBE_SAMPLES: Final = (50, 550)
"""Samples a deformation of the two small data sets, as far from each other as tells a sample's time from noise."""

MIN_DEFORMATIONS: Final = 2


@dataclass(frozen=True, slots=True)
class Pace:
    """What this machine takes, in seconds."""

    deformation_s: float
    """A deformation without its samples, of all processes together."""
    sample_s: float
    """A sample, likewise."""
    trained_s: float
    """A sample, once through training."""


USUAL_PACE: Final = Pace(deformation_s=1.1, sample_s=0.8e-3, trained_s=1.2e-3)
"""Of one core of an x86-64 CPU, for the network ``free`` and random devices."""


def plan_lines(recipe: BuildRecipe, others: dict[str, BuildRecipe], workers: int, hours: float | None) -> list[str]:
    """Return the steps of a build and about how long each takes on CPU cores of the usual pace.

    Args:
        recipe: What is asked for.
        others: Recipes of the additional networks, by name.
        workers: Processes that make data, and cores that train.
        hours: Time to scale everything to; None leaves recipes as they are.
    """
    lines = [f"building {recipe.name} on {workers} {'core' if workers == 1 else 'cores'}"]
    if hours is not None:
        lines[0] += f", scaled to {hours:g} h after a measurement of about a minute"
    for name, one in {"": recipe, **others}.items():
        of = f" for {name}" if name else ""
        samples = {key: data.deformations * data.per_deformation for key, data in one.data.items()}
        deformations = sum(data.deformations for data in one.data.values())
        data_s = deformations * USUAL_PACE.deformation_s + sum(samples.values()) * USUAL_PACE.sample_s
        trained = sum(stage.epochs * sum(samples[key] for key in stage.data or samples) for stage in one.training)
        epochs = sum(stage.epochs for stage in one.training)
        took = [_about(data_s / workers), _about(trained * USUAL_PACE.trained_s / workers)]
        data_took, training_took = (f", {one}" if hours is None else "" for one in took)
        lines += [
            f"  simulate {sum(samples.values()):,} samples at {deformations:,} deformations{of}{data_took}",
            f"  train {epochs} epochs{of}{training_took}{' (minutes on a GPU)' if training_took else ''}",
        ]
    lines.append(
        f"  fit the gate, export, test for the card, {_about(FINAL_STAGES_S if recipe.gate.untouched else 60)}"
    )
    return [*lines, "You can stop it at any time: the same command resumes."]


def _about(time_s: float) -> str:
    minutes = max(1, round(time_s / 60))
    return f"about {minutes} min" if minutes < 90 else f"about {minutes / 60:.0f} h"


def measure(recipe: BuildRecipe, workers: int, tell: Tell) -> Pace:
    """Make a thousand samples of a recipe's first data set, train on them, and return the pace.

    They are made as the recipe's are, by a process of one thread: how fast many are says nothing of it.
    """
    from eitskin_sim.dataset.generate import processes
    from eitskin_training import train
    from eitskin_training.recipes import fitted
    from eitskin_training.recipes import recipe as network_named
    from eitskin_training.samples.joined import load_all

    tell("measuring this machine")
    first = next(iter(recipe.data.values()))
    with tempfile.TemporaryDirectory(prefix="eitskin-build-") as name:
        folder = Path(name)
        sizes = (PROBE_SAMPLES[0], *PROBE_SAMPLES)  # the first one warms up
        small = [replace(first, deformations=2, kept=0, per_deformation=each, touch_sets=None) for each in sizes]
        with processes(1) as pool:
            taken = pool.submit(_made, [plan_of(recipe, one) for one in small], folder).result()
        data = load_all([str(folder / "2")])
        network = fitted(replace(network_named(recipe.network), epochs=2), data.skin)
        history = train.train(data, network, folder / "run").history
    batch = min(network.batch, len(data.train))
    trained = len(data.train) // batch * batch
    sample_s = max(1e-4, (taken[2] - taken[1]) / (2 * (PROBE_SAMPLES[1] - PROBE_SAMPLES[0])))
    deformation_s = max(1e-3, taken[1] / 2 - PROBE_SAMPLES[0] * sample_s)
    return Pace(deformation_s / workers, sample_s / workers, history[-1].seconds / trained)


def _made(plans: list[Any], folder: Path) -> list[float]:
    """Make data sets in this process, in folders by their numbers, and return how long each took."""
    from eitskin_sim.dataset.generate import generate

    taken = []
    for number, plan in enumerate(plans):
        began = time.perf_counter()
        generate(plan, folder / str(number), workers=0)
        taken.append(time.perf_counter() - began)
    return taken


def scale(recipe: BuildRecipe, hours: float, pace: Pace, share: float = 1.0) -> BuildRecipe:
    """Return a recipe whose data and training fit into a time.

    Args:
        recipe: As it was written.
        hours: For everything.
        pace: Of this machine.
        share: Of the hours that are this recipe's.

    Raises:
        ValueError: Not even the smallest fits; the text says what would.
    """
    budget = 3600.0 * share * hours - FINAL_STAGES_S
    fixed, linear, square = _costs(recipe, pace)
    least = fixed + linear * 1e-2 + square * 1e-4
    if budget < least:
        enough = (FINAL_STAGES_S + least) / (3600.0 * share)
        named = "" if share == 1.0 else f" for {recipe.name}, whose share is {100 * share:.0f} %,"
        raise ValueError(f"--hours {hours:g} is too little{named} on this machine, expected {enough:.2f} or more")
    left = budget - fixed
    factor = 2.0 * left / (linear + (linear * linear + 4.0 * square * left) ** 0.5)
    data = {
        name: replace(one, deformations=max(MIN_DEFORMATIONS, round(factor * one.deformations)))
        for name, one in recipe.data.items()
    }
    stages = tuple(replace(stage, epochs=max(1, round(factor * stage.epochs))) for stage in recipe.training)
    return replace(recipe, data=data, training=stages)


def seconds(recipe: BuildRecipe, pace: Pace) -> float:
    """Return how long a recipe takes at a pace."""
    return FINAL_STAGES_S + sum(_costs(recipe, pace))


def _costs(recipe: BuildRecipe, pace: Pace) -> tuple[float, float, float]:
    """Return seconds that do not depend on the factor, that go with it, and with its square."""
    fixed = linear = square = 0.0
    for one in recipe.data.values():
        plan = plan_of(recipe, one)
        apart = len(plan.bends) - one.deformations
        counts = plan.counts
        fixed += apart * pace.deformation_s + sum(counts[one.deformations :]) * pace.sample_s
        linear += one.deformations * pace.deformation_s + sum(counts[: one.deformations]) * pace.sample_s
    for stage in recipe.training:
        trained = sum(sum(plan_of(recipe, recipe.data[name]).counts) for name in stage.data or recipe.data)
        square += stage.epochs * trained * pace.trained_s
    return fixed, linear, square


@dataclass(frozen=True, slots=True)
class BuiltBundle:
    """What was made."""

    recipe: BuildRecipe
    """As it was scaled."""
    run: Path
    """The folder of its last training run."""
    exported: dict[str, Any]
    """What the export said."""
    bundle: Path
    """The bundle without its card."""
    identity: str
    """Of that bundle."""


@dataclass(frozen=True, slots=True)
class Making:
    """How bundles are made on this machine."""

    workers: int
    """Processes that make data."""
    tell: steps.Tell
    """Called with each step."""
    say: steps.Tell
    """Called with the result of each epoch."""

    def begin(self, parts: Sequence[tuple[BuildRecipe, Path, float]], given: float | None) -> None:
        """Begin the folders of half-made bundles that are none yet, once all recipes fit into their time.

        Args:
            parts: What is asked for, where, and with which share of the time.
            given: Hours to scale all of it to; None leaves recipes as they are.

        Raises:
            OtherBuildError: A folder holds another one.
            ValueError: The time is too little for one.
        """
        new = [(recipe, work, share) for recipe, work, share in parts if half_made.begun(work, recipe, given) is None]
        wanted = [recipe for recipe, _, _ in new]
        if given is not None:
            paces = (measure(recipe, self.workers, self.tell) for recipe, _, _ in new)
            wanted = [scale(recipe, given, pace, share) for (recipe, _, share), pace in zip(new, paces, strict=True)]
        for (recipe, work, _), scaled in zip(new, wanted, strict=True):
            half_made.begin(work, recipe, scaled, given)

    def made(
        self,
        recipe: BuildRecipe,
        work: Path,
        given: float | None,
        *,
        share: float = 1.0,
        larger: Path | None = None,
        beside: tuple[BuildRecipe, Path] | None = None,
    ) -> BuiltBundle:
        """Make a bundle without its card, or resume.

        Args:
            recipe: What is asked for.
            work: Folder of the half-made bundle.
            given: Hours to scale it to; None leaves it as it is.
            share: Of these hours.
            larger: The run whose network it begins with, narrowed or as it is; None as the recipe says.
            beside: Another recipe and its folder, whose data sets are taken where they are the same.

        Raises:
            OtherBuildError: The folder holds another one.
        """
        self.begin([(recipe, work, share)], given)
        begun = half_made.begun(work, recipe, given)
        assert begun is not None
        wanted = half_made.scaled_as_before(recipe, begun)
        if beside is not None:
            steps.share_data(wanted, work, *beside)
        steps.make_data(wanted, work, self.workers, self.tell, self.say)
        trained = steps.train_stages(wanted, work, self.tell, self.say, larger)
        bundle, exported = steps.export_run(wanted, work, trained, self.tell)
        return BuiltBundle(wanted, trained, exported, bundle, str(exported["bundle"]))

    def finished(self, made: BuiltBundle, work: Path, out: Path) -> tuple[dict[str, Any], str]:
        """Write what was made with its card; return the card and the bundle's id."""
        card = steps.make_card(made.recipe, work, made.bundle, made.identity, self.tell)
        return card, steps.finish(made.bundle, card, out)

    def with_others(
        self,
        made: BuiltBundle,
        others: dict[str, BuildRecipe],
        work: Path,
        given: float | None,
        gentle_of: Path | None = None,
    ) -> BuiltBundle:
        """Make the additional networks of a bundle, or resume, and return the bundle with them.

        Args:
            made: The bundle with its own network.
            others: Recipes of the additional networks by name, which is that of its folder in ``work`` too.
            work: Folder of the half-made bundle.
            given: Hours to scale all of it to; None leaves it as it is.
            gentle_of: A bundle whose network for gentle touches goes in as it is; None for none.
        """
        from eitskin_export.pair import carried, pair

        bundle, identity = made.bundle, made.identity
        for name, recipe in others.items():
            beside = made.recipe, work
            share = TRAINING_SHARES[name]
            making = replace(self, tell=self._of(name, self.tell), say=self._of(name, self.say))
            other = making.made(recipe, work / name, given, share=share, larger=made.run, beside=beside)
            own = work / f"{name}.eitskin"
            making.finished(other, work / name, own)
            out = work / f"with-{name}.eitskin"
            bundle, identity = out, str(pair(bundle, own, out, name)["bundle"])
        if gentle_of is not None:
            out = work / "with-given.eitskin"
            bundle, identity = out, carried(bundle, gentle_of, out)
        return replace(made, bundle=bundle, identity=identity)

    @staticmethod
    def _of(name: str, tell: steps.Tell) -> steps.Tell:
        """Return a callback that adds the network's name to each message."""
        return lambda text: tell(f"{name}: {text}")
