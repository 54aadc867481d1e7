"""Where a training run begins: not with random weights, but with those of another run, or of a bundle."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.symmetry import near_images
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin_training.run_files import read, skin_of


@dataclass(frozen=True, slots=True)
class Start:
    """Weights to begin with, instead of random ones.

    Args:
        weights: A network's, by name.
        architecture: Its shape.
        skin: What it is for.
        facts: Where they come from, for the manifest; ``still`` is true where normalisations must stay as they are.
    """

    weights: dict[str, Tensor]
    architecture: Architecture
    skin: Skin
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
        skin = skin_of(content, folder / "best.pt")
        return cls(content["weights"], Recipe.from_dict(content["recipe"]).architecture, skin, facts)

    def require(self, architecture: Architecture, skin: Skin) -> None:
        """Check that a network of this shape, for this skin, can begin here.

        It may have learned another sheet; what it learns now takes the place of that. Its map must fit.

        Raises:
            MismatchError: It was of another shape, or of another map or symmetry.
        """
        what, hint = "network to start from", "start from one of this"
        if (map_found := _map_of(self.skin, architecture)) != (map_expected := _map_of(skin, architecture)):
            raise MismatchError(f"{what}: map", found=map_found, expected=map_expected, hint=f"{hint} map")
        names = [one.name for one in fields(architecture)]
        unlike = [name for name in names if getattr(self.architecture, name) != getattr(architecture, name)]
        if unlike:
            found, expected = (
                ", ".join(f"{name} {getattr(one, name)}" for name in unlike)
                for one in (self.architecture, architecture)
            )
            raise MismatchError(what, found=found, expected=expected, hint=f"{hint} recipe")


def _map_of(skin: Skin, architecture: Architecture) -> str:
    (rows, columns), (unit_rows, unit_columns) = skin.grid.shape, skin.grid.units
    found = f"{rows} x {columns} pixels, {unit_rows} x {unit_columns} units"
    if not architecture.symmetric:
        return found
    mirrored = "".join(f" {'x' * one.x}{'y' * one.y}" for one in near_images(skin)[1:]) or " none"
    return f"{found}, mirror images:{mirrored}"


def keep_statistics(model: VD2T) -> None:
    """Leave every normalisation of a network in training as it is in evaluation."""
    for module in model.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            module.eval()
