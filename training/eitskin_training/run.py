"""A training run in memory: its network, the running mean of its weights, its optimiser, and its epochs' results."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

import torch
from torch import Tensor
from torch.nn import Parameter
from torch.optim import Optimizer

from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import Skin
from eitskin_training.network.model import VD2T
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


def decayed(learning: Iterable[Parameter], decay: float) -> list[dict[str, Any]]:
    """Return the groups of an optimiser's parameters: those that decay, and the others."""
    every = list(learning)
    matrices = [parameter for parameter in every if parameter.ndim > 1]
    others = [parameter for parameter in every if parameter.ndim <= 1]
    return [{"params": matrices, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]


@dataclass(frozen=True, slots=True)
class Epoch:
    """What one epoch gave.

    Args:
        number: Counted from 1.
        training_loss: Mean over its batches, with noise, flips and dropout.
        validation_loss: Of the weights that would be exported now.
        validation_cc: Likewise, mean correlation.
        seconds: Time it took.
    """

    number: int
    training_loss: float
    validation_loss: float
    validation_cc: float
    seconds: float


@dataclass(slots=True)
class Run:
    """A training run in memory."""

    recipe: Recipe
    seed: int
    model: VD2T
    averaged: dict[str, Tensor]
    optimiser: torch.optim.Optimizer
    data_digest: str
    skin: Skin
    sources: tuple[str, ...] = ()
    started_from: dict[str, Any] | None = None
    history: list[Epoch] = field(default_factory=list)
    step: int = 0

    @property
    def still(self) -> bool:
        """Whether normalisations keep their statistics: those of a network out of a bundle are in its weights."""
        return bool((self.started_from or {}).get("still"))

    @property
    def best(self) -> Epoch | None:
        """The epoch of the lowest validation loss."""
        return min(self.history, key=lambda epoch: epoch.validation_loss, default=None)

    def average(self) -> None:
        """Move the running mean towards the weights; early on it forgets faster, so it never drags the first ones."""
        decay = min(self.recipe.average, (1 + self.step) / (10 + self.step)) if self.recipe.average else 0.0
        current = self.model.state_dict()
        floats = [name for name, value in current.items() if value.is_floating_point()]
        torch._foreach_lerp_([self.averaged[name] for name in floats], [current[name] for name in floats], 1.0 - decay)
        for name in current.keys() - set(floats):
            self.averaged[name].copy_(current[name])


def optimiser_of(model: VD2T, recipe: Recipe, device: torch.device) -> torch.optim.Optimizer:
    """Return the optimiser of a network on a device; on a GPU its step can be captured, with the rate in a tensor."""
    on_gpu = device.type == "cuda"
    rate = torch.tensor(recipe.learning_rate, device=device) if on_gpu else recipe.learning_rate
    groups = decayed(model.parameters(), recipe.weight_decay)
    return torch.optim.AdamW(groups, lr=rate, fused=True, capturable=on_gpu)


def restore(optimiser: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Give an optimiser a stored state, of a run on this kind of device or on another."""
    own = [(group["lr"], group["capturable"]) for group in optimiser.param_groups]
    optimiser.load_state_dict(state)
    for group, (rate, capturable) in zip(optimiser.param_groups, own, strict=True):
        group["lr"], group["capturable"] = rate, capturable


def check_loss(value: float) -> None:
    """Refuse a loss that is not a number.

    Raises:
        SkinError: It is none.
    """
    if value != value:  # noqa: PLR0124 - NaN is the one number that differs from itself
        raise SkinError("the loss is not a number; lower the learning rate, or look for NaN in the data set")
