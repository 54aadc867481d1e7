"""Where a training run begins: not with random weights, but with those of another run, or of a bundle."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from eitskin_training.network.architecture import Architecture
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin_training.run_files import read


@dataclass(frozen=True, slots=True)
class Start:
    """Weights to begin with, instead of random ones.

    Args:
        weights: A network's, by name.
        architecture: Its shape.
        facts: Where they come from, for the manifest; ``still`` is true where normalisations must stay as they are.
    """

    weights: dict[str, Tensor]
    architecture: Architecture
    facts: dict[str, Any]

    @classmethod
    def of_run(cls, folder: Path) -> "Start":
        """Return the best weights of a run, with its scale of the inputs.

        Raises:
            SkinError: It is no run.
        """
        content = read(folder / "best.pt")
        names = ("seed", "data_digest", "started_from")
        facts = {name: content.get(name) for name in names} | {"epochs": len(content["history"])}
        if (content.get("started_from") or {}).get("still"):
            facts["still"] = True
        return cls(content["weights"], Recipe.from_dict(content["recipe"]).architecture, facts)


def keep_statistics(model: VD2T) -> None:
    """Leave every normalisation of a network in training as it is in evaluation."""
    for module in model.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.eval()
