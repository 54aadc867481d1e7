"""The recipe for training a bundle further on another sheet, such as a calibrated one."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from eitskin.model.manifest import SMALL
from eitskin_proto.skin.parts import Touches
from eitskin_proto.skin.skin import Skin
from eitskin_tools.build.recipe import SKIN, BuildRecipe, CardWork, Data, GateWork, TrainingStage

HARD_CONTRAST: Final = 5.0
"""From this contrast on all touches that raise conductance answer much alike: the usual ones teach more of them."""


@dataclass(frozen=True, slots=True)
class Adaptation:
    """How much a bundle learns of another sheet: 50,000 samples, and four times as many seen."""

    deformations: int = 100
    per_deformation: int = 500
    epochs: int = 4
    learning_rate: float = 2.5e-4
    seed: int = 0
    gate: GateWork = field(default_factory=GateWork)
    card: CardWork = field(default_factory=lambda: CardWork(deformations=4, each=2, draws=1))


def adapted(
    bundle: Path, skin: Skin, facts: dict[str, Any], touch_kind: str, work: Adaptation, own: Skin | None = None
) -> BuildRecipe:
    """Return the recipe of a bundle that goes on learning on another sheet, such as a calibrated one.

    It learns the touches that the skin says, where these are of the bundle's kind and other than those of its own skin,
    as after presses of a stamp; else, and where a stamp raised conductance fivefold and more, the usual ones of its
    kind, as often near to each other as it learned them. Where the bundle has a smaller network that is its own
    narrowed, one of that shape is made of the adapted one and learns on likewise, of data of its own; another kind of
    smaller network is left out.

    Args:
        bundle: The file that it begins with.
        skin: What it learns; devices are drawn from its uncertainties.
        facts: The bundle's manifest.
        touch_kind: Which touches it knows, and goes on knowing.
        work: How much it learns.
        own: The bundle's skin; None leaves the usual touches.
    """
    network = facts.get("recipe", {}).get("name")
    if not isinstance(network, str):
        raise ValueError(f"{bundle} does not record how it was trained; build one with 'eitskin build'")
    touches = {"raise": "hard", "lower": "press", "both": "both"}[touch_kind]
    if own is not None and skin.touch_kind == touch_kind and _others(skin.touches, own.touches):
        touches = SKIN
    kind = "free" if facts.get("labels") == "area" else "units"
    size = work.deformations, work.per_deformation
    data = Data(kind, touches, "random", work.seed, *size, near=_near(facts) if kind == "free" else None)
    stage = TrainingStage(
        work.epochs, learning_rate=work.learning_rate, seed=work.seed, start_from=bundle.name, noise=SKIN
    )
    name, beside = f"{bundle.stem} on {skin.name}", bundle.resolve().parent
    found = BuildRecipe(name, skin, network, {"touches": data}, (stage,), work.gate, work.card, beside)
    smaller = _small_network(facts)
    if smaller is None:
        return found
    other, again = replace(data, seed=data.seed + 1), replace(stage, start_from=None)
    gate = GateWork(0)  # the pair has the larger one's
    small = replace(found, name=f"{name}, small", network=smaller, training=(again,), gate=gate)
    return replace(found, networks={SMALL: replace(small, data={"touches": other})})


def _others(touches: Touches, own: Touches) -> bool:
    """Return whether a skin's touches are others than a bundle's own, and not just as hard."""
    hard = touches.higher and not touches.lower and math.prod(touches.raising_contrast) >= HARD_CONTRAST**2
    return touches != own and not (hard and touches.size_mm == own.size_mm)


def _near(facts: dict[str, Any]) -> float | None:
    """Return the share of sets with touches near to each other in what a bundle learned first; None for the usual."""
    data = facts.get("build", {}).get("data")
    first = next(iter(data.values()), None) if isinstance(data, dict) else None
    near = first.get("near") if isinstance(first, dict) else None
    return float(near) if isinstance(near, int | float) and 0.0 <= near <= 1.0 else None


def _small_network(facts: dict[str, Any]) -> str | None:
    """Return which network of ``eitskin train`` the smaller one of a manifest is; None where there is no narrow one."""
    from eitskin_training.recipes import RECIPES

    about = facts.get(SMALL)
    recipe = about.get("recipe") if isinstance(about, dict) else None
    name = recipe.get("name") if isinstance(recipe, dict) else None
    return name if isinstance(name, str) and name in RECIPES and RECIPES[name].architecture.ranks else None
