"""A training run in memory: its network, the running mean of its weights, its optimiser, and what epochs gave."""

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import Skin
from eitskin_training.network.decay import decayed
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe


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
