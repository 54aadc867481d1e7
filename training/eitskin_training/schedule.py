"""How fast a run learns at each step."""

import math
from typing import Final

from torch.optim import Optimizer

from eitskin_training.recipes import Recipe

RISING_SHARE: Final = 0.05
"""Share of the steps in which a cycle rises to its peak."""


def one_cycle(step: int, *, steps: int) -> float:
    """Return the share of the peak learning rate at a step: a linear rise, then half a cosine to nearly nothing."""
    rise = max(1.0, RISING_SHARE * steps)
    if step < rise:
        return (step + 1) / (rise + 1)
    return 1e-3 + 0.5 * (1.0 + math.cos(math.pi * min(1.0, (step - rise) / max(1.0, steps - rise))))


def set_rate(optimiser: Optimizer, recipe: Recipe, step: int, steps: int) -> None:
    """Give an optimiser the learning rate of a step, counted from 0, of a run of ``steps``."""
    share = one_cycle(step, steps=steps) if recipe.schedule == "onecycle" else 1.0
    for group in optimiser.param_groups:
        rate = recipe.learning_rate * share
        if isinstance(group["lr"], float):
            group["lr"] = rate
        else:
            group["lr"].fill_(rate)  # a captured step reads it from there
