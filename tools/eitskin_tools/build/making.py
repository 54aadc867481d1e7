"""A recipe's bundle in a folder: begun, scaled to a time, made step by step, or gone on with."""

from dataclasses import dataclass
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
    exported: dict[str, Any]
    """What the export said."""
    card: dict[str, Any]
    bundle: Path
    """The bundle without its card."""

    def finish(self, out: Path) -> str:
        """Write the bundle with its card and return its id."""
        return steps.finish(self.bundle, self.card, out)


@dataclass(frozen=True, slots=True)
class Making:
    """How bundles are made on this machine."""

    workers: int
    """Processes that make data."""
    tell: steps.Tell
    """Told what is being done."""
    say: steps.Tell
    """Told how each epoch went."""

    def whole(
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
        """Make a bundle, or go on with it.

        Args:
            recipe: What is asked for.
            work: Folder of the half-made bundle.
            given: Hours to scale it to; None leaves it as it is.
            share: Of these hours.
            presses: A recording of some, to be learned from besides; None without.
            larger: The bundle whose network it begins with, narrowed, if it is of its shape; None as the recipe says.
            beside: Another recipe and its folder, whose data sets are taken where they are the same.

        Raises:
            OtherBuildError: The folder holds another one.
        """
        begun = half_made.begun(work, recipe, given)
        if begun is not None:
            wanted = half_made.scaled_as_before(recipe, begun)
        else:
            wanted = recipe
            if given is not None:
                wanted = hours.scaled(recipe, share * given, hours.measure(recipe, self.workers, self.tell))
            half_made.begin(work, recipe, wanted, given)
        if beside is not None:
            steps.share_data(wanted, work, *beside)
        steps.make_data(wanted, work, self.workers, self.tell)
        trained = steps.train_legs(wanted, work, self.tell, self.say, presses, larger)
        bundle, exported = steps.export_run(wanted, work, trained, self.tell)
        card = steps.make_card(wanted, work, bundle, str(exported["bundle"]), self.tell)
        return Made(wanted, exported, card, bundle)


def with_smaller(
    making: Making,
    recipe: BuildRecipe,
    smaller: BuildRecipe,
    work: Path,
    given: float | None,
    out: Path,
    presses: Any = None,
) -> tuple[Made, str]:
    """Make a bundle with a smaller network besides; return the larger half, and the id of the whole.

    Args:
        making: How.
        recipe: Of the larger one.
        smaller: Of the smaller one, which is made in ``work/small``.
        work: Folder of the half-made bundle.
        given: Hours to scale both to; None leaves them as they are.
        out: Where the whole goes.
        presses: A recording of some, which the larger one learns from besides; None without.
    """
    from eitskin_export.pair import pair

    share = hours.SMALL_SHARE
    large = making.whole(recipe, work, given, share=1.0 - share, presses=presses)
    halves = work / "large.eitskin", work / "small.eitskin"
    large.finish(halves[0])
    small = making.whole(smaller, work / "small", given, share=share, larger=halves[0], beside=(large.recipe, work))
    small.finish(halves[1])
    return large, str(pair(*halves, out)["bundle"])
