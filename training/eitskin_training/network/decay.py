"""What of a network decays while it learns: its matrices; a decayed norm or bias would shrink its layer."""

from collections.abc import Iterable
from typing import Any

from torch.nn import Parameter


def decayed(learning: Iterable[Parameter], decay: float) -> list[dict[str, Any]]:
    """Return the groups of an optimiser's parameters: those that decay, and the others."""
    every = list(learning)
    matrices = [parameter for parameter in every if parameter.ndim > 1]
    others = [parameter for parameter in every if parameter.ndim <= 1]
    return [{"params": matrices, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]
