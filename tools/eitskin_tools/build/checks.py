"""What would fail hours later, once data are made or networks trained, is refused before anything is begun."""

from typing import Any

from eitskin_tools.build.recipe import BuildRecipe, Leg
from eitskin_tools.build.steps import fitted_to, plan_of, start_of


def check(recipe: BuildRecipe) -> None:
    """Refuse what would fail hours later: data that cannot be planned or joined, a network or start that does not fit.

    Raises:
        SkinError: A file is missing or is no bundle, or a leg's network does not go on from the one before.
        ValueError: A number is outside its bounds, or things do not go together.
    """
    for name, data in recipe.data.items():
        try:
            plan_of(recipe, data)
        except ValueError as error:
            raise ValueError(f"[data.{name}] {error}") from error
    start = start_of(recipe, recipe.training[0])
    for number, leg in enumerate(recipe.training, 1):
        start = _check_leg(recipe, number, leg, start)
    _check_gate(recipe)


def _check_leg(recipe: BuildRecipe, number: int, leg: Leg, start: Any) -> Any:
    """Refuse data sets that do not go together, and a network that cannot begin with them where the last one ended.

    Returns:
        What the next leg starts from, but for its weights.
    """
    from eitskin_training.narrowed import fits
    from eitskin_training.network.sharpen import cells
    from eitskin_training.start import Start

    names = leg.data or tuple(recipe.data)
    plans = [plan_of(recipe, recipe.data[name]) for name in names]
    for at, (name, plan) in enumerate(zip(names, plans, strict=True)):
        if plan in plans[:at]:
            twice = names[plans.index(plan)]
            raise ValueError(f"[data.{name}] and [data.{twice}] are the same; give one of them another seed")
        if plan.skin.digest != plans[0].skin.digest:
            raise ValueError(
                f"[[training]] {number} learns from skins {plans[0].skin.name} and {plan.skin.name}, in [data.{name}], "
                "expected one; name those of one skin in its data, and the others in a leg of their own"
            )
    skin = plans[0].skin
    wanted = fitted_to(recipe, leg, skin)
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
            f"the gate has {apart} deformations kept apart to choose and measure it, expected at least 2; give more "
            "kept in [data], or untouched in [gate]"
        )
