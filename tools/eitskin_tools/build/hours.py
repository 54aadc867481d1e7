"""``--hours``: how large data and training may be so that a bundle is built in so long on this machine.

A thousand samples are made and trained on. What a deformation, a sample and a sample trained on take follows from
that; the deformations and the epochs of the recipe are then scaled alike, up or down. Gate, export and card take what
they take, ``REST_S`` is kept for them. A network that is built besides gets its share of the time, ``SHARES``.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from eitskin.model.manifest import GENTLE, SMALL
from eitskin_tools.build.recipe import BuildRecipe
from eitskin_tools.build.steps import Tell, plan_of

REST_S: Final = 600.0
"""For gate, export and card: five minutes on two quiet cores."""

SHARES: Final = {SMALL: 0.35, GENTLE: 0.1}
"""Of networks besides: they begin as the bundle's own and need few epochs, but data of their own take as long."""

SAMPLES: Final = (50, 550)
"""Samples a deformation of the two small data sets, as far from each other as tells a sample's time from noise."""

LEAST_DEFORMATIONS: Final = 2


@dataclass(frozen=True, slots=True)
class Pace:
    """What this machine takes, in seconds."""

    deformation_s: float
    """A deformation without its samples, of all processes together."""
    sample_s: float
    """A sample, likewise."""
    trained_s: float
    """A sample, once through training."""


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
        sizes = (SAMPLES[0], *SAMPLES)  # the first one warms up
        small = [replace(first, deformations=2, kept=0, per_deformation=each, touch_sets=None) for each in sizes]
        with processes(1) as pool:
            taken = pool.submit(_made, [plan_of(recipe, one) for one in small], folder).result()
        data = load_all([str(folder / "2")])
        network = fitted(replace(network_named(recipe.network), epochs=2), data.skin)
        history = train.train(data, network, folder / "run").history
    batch = min(network.batch, len(data.train))
    trained = len(data.train) // batch * batch
    sample_s = max(1e-4, (taken[2] - taken[1]) / (2 * (SAMPLES[1] - SAMPLES[0])))
    deformation_s = max(1e-3, taken[1] / 2 - SAMPLES[0] * sample_s)
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


def scaled(recipe: BuildRecipe, hours: float, pace: Pace, share: float = 1.0) -> BuildRecipe:
    """Return a recipe whose data and training fit into a time.

    Args:
        recipe: As it was written.
        hours: For everything.
        pace: Of this machine.
        share: Of the hours that are this recipe's.

    Raises:
        ValueError: Not even the smallest fits; the text says what would.
    """
    budget = 3600.0 * share * hours - REST_S
    fixed, linear, square = _costs(recipe, pace)
    least = fixed + linear * 1e-2 + square * 1e-4
    if budget < least:
        enough = (REST_S + least) / (3600.0 * share)
        named = "" if share == 1.0 else f" for {recipe.name}, whose share is {100 * share:.0f} %,"
        raise ValueError(f"--hours {hours:g} is too little{named} on this machine, expected {enough:.2f} or more")
    left = budget - fixed
    factor = 2.0 * left / (linear + (linear * linear + 4.0 * square * left) ** 0.5)
    data = {
        name: replace(one, deformations=max(LEAST_DEFORMATIONS, round(factor * one.deformations)))
        for name, one in recipe.data.items()
    }
    legs = tuple(replace(leg, epochs=max(1, round(factor * leg.epochs))) for leg in recipe.training)
    return replace(recipe, data=data, training=legs)


def seconds(recipe: BuildRecipe, pace: Pace) -> float:
    """Return how long a recipe takes at a pace."""
    return REST_S + sum(_costs(recipe, pace))


def _costs(recipe: BuildRecipe, pace: Pace) -> tuple[float, float, float]:
    """Return seconds that do not depend on the factor, that go with it, and with its square."""
    fixed = linear = square = 0.0
    for one in recipe.data.values():
        plan = plan_of(recipe, one)
        apart = len(plan.bends) - one.deformations
        counts = plan.counts
        fixed += apart * pace.deformation_s + sum(counts[one.deformations :]) * pace.sample_s
        linear += one.deformations * pace.deformation_s + sum(counts[: one.deformations]) * pace.sample_s
    for leg in recipe.training:
        trained = sum(sum(plan_of(recipe, recipe.data[name]).counts) for name in leg.data or recipe.data)
        square += leg.epochs * trained * pace.trained_s
    return fixed, linear, square
