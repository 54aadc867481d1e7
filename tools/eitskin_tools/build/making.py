"""A recipe's bundle in a folder: begun, scaled to a time, made step by step, or gone on with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eitskin_tools.build import folder as half_made
from eitskin_tools.build import hours, steps
from eitskin_tools.build.recipe import BuildRecipe


@dataclass(frozen=True, slots=True)
class Made:
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
    """Told what is being done."""
    say: steps.Tell
    """Told how each epoch went."""

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
        scaled = [recipe for recipe, _, _ in new]
        if given is not None:
            paces = (hours.measure(recipe, self.workers, self.tell) for recipe, _, _ in new)
            scaled = [
                hours.scaled(recipe, given, pace, share) for (recipe, _, share), pace in zip(new, paces, strict=True)
            ]
        for (recipe, work, _), wanted in zip(new, scaled, strict=True):
            half_made.begin(work, recipe, wanted, given)

    def made(
        self,
        recipe: BuildRecipe,
        work: Path,
        given: float | None,
        *,
        share: float = 1.0,
        presses: Any = None,
        larger: Path | None = None,
        beside: tuple[BuildRecipe, Path] | None = None,
    ) -> Made:
        """Make a bundle but for its card, or go on with it.

        Args:
            recipe: What is asked for.
            work: Folder of the half-made bundle.
            given: Hours to scale it to; None leaves it as it is.
            share: Of these hours.
            presses: A recording of some, to be learned from besides; None without.
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
        steps.make_data(wanted, work, self.workers, self.tell)
        trained = steps.train_legs(wanted, work, self.tell, self.say, presses, larger)
        bundle, exported = steps.export_run(wanted, work, trained, self.tell)
        return Made(wanted, trained, exported, bundle, str(exported["bundle"]))

    def finished(self, made: Made, work: Path, out: Path) -> tuple[dict[str, Any], str]:
        """Write what was made with its card; return the card and the bundle's id."""
        card = steps.make_card(made.recipe, work, made.bundle, made.identity, self.tell)
        return card, steps.finish(made.bundle, card, out)

    def with_others(
        self, made: Made, others: dict[str, BuildRecipe], work: Path, given: float | None, gentle_of: Path | None = None
    ) -> Made:
        """Make the networks that go into a bundle besides, or go on with them, and return it with them.

        Args:
            made: The bundle with its own network.
            others: Recipes of those besides, each by its name, which is that of its folder in ``work`` too.
            work: Folder of the half-made bundle.
            given: Hours to scale all of it to; None leaves it as it is.
            gentle_of: A bundle whose network for gentle touches goes in as it is; None for none.
        """
        from eitskin_export.pair import carried, pair

        bundle, identity = made.bundle, made.identity
        for name, recipe in others.items():
            beside = made.recipe, work
            share = hours.SHARES[name]
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
        """Return what tells of a network besides: by its name."""
        return lambda text: tell(f"{name}: {text}")
