"""Starts a training run from the weights of another run or of a bundle."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.symmetry import near_images
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.images import ImageLinear, Narrow
from eitskin_training.network.model import VD2T, Residual
from eitskin_training.recipes import Recipe
from eitskin_training.run_files import read, skin_of
from eitskin_training.samples.batches import TrainingData, assemble, noisy_change


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


FEATURE_SAMPLES: Final = 20_000
"""Whose features are looked at."""

SAMPLES_PER_PASS: Final = 1000
"""Samples of a pass."""

MIN_MOMENT_SHARE: Final = 1e-7
"""Of the largest moment: directions in which features vary less are taken for as little as that."""


def fits(start: Start, recipe: Recipe) -> bool:
    """Whether a recipe's network is that of a start but for its ranks."""
    narrower = recipe.architecture.ranks and not start.architecture.ranks
    return bool(narrower) and replace(recipe.architecture, ranks=()) == start.architecture


def narrowed(start: Start, recipe: Recipe, data: TrainingData) -> Start:
    """Return a start for a recipe's network, whose layers are narrower than those of ``start``.

    Args:
        start: Weights of the larger network.
        recipe: Of the smaller one; :func:`fits` tells whether it is one.
        data: Whose features decide what of a layer is kept.
    """
    whole, found = VD2T(start.architecture, start.skin), VD2T(recipe.architecture, start.skin)
    whole.load_state_dict(start.weights)
    moments = _moments(whole.eval(), recipe, data)
    weights = {name: value for name, value in start.weights.items() if name in found.state_dict()}
    found.load_state_dict(weights, strict=False)
    for (name, layer), (_, narrow) in zip(_layers(whole), _layers(found), strict=True):
        assert isinstance(narrow, Narrow)
        _fill(narrow, layer, moments[name])
    ranks = list(recipe.architecture.ranks)
    return Start(found.state_dict(), recipe.architecture, start.skin, {**start.facts, "narrowed_to": ranks})


def _layers(model: VD2T) -> list[tuple[str, nn.Module]]:
    """Return the linear layers that a frame passes, in order."""
    first, *others = model.voltage
    assert isinstance(first, nn.Sequential)
    found = [("first", first[0])]
    for number, block in enumerate(others):
        assert isinstance(block, Residual)
        found.append((f"residual-{number}", block.path[0]))
    return [*found, ("fusion", model.fusion_voltage), ("out", model.out)]


def _moments(model: VD2T, recipe: Recipe, data: TrainingData) -> dict[str, Tensor]:
    """Return (n, inputs, inputs) second moments of each layer's features, summed over samples."""
    rng = np.random.default_rng([0, 0x7A])
    rows = np.sort(rng.choice(data.train, size=min(FEATURE_SAMPLES, len(data.train)), replace=False))
    found: dict[str, Tensor] = {}

    def seen(name: str) -> Callable[..., None]:
        def hook(layer: nn.Module, inputs: tuple[Tensor], _: Any) -> None:
            x = layer.sums(inputs[0]) if isinstance(layer, ImageLinear) else inputs[0].flatten(0, -2)[None]
            found[name] = found.get(name, torch.zeros(())) + torch.einsum("kbi,kbj->kij", x, x).double()

        return hook

    hooks = [layer.register_forward_hook(seen(name)) for name, layer in _layers(model)]
    with torch.inference_mode():
        for start in range(0, len(rows), SAMPLES_PER_PASS):
            some = rows[start : start + SAMPLES_PER_PASS]
            dv = noisy_change(data, some, recipe.noises, recipe.snr_db, rng)
            batch = assemble(data, some, dv, data.log_predicted[data.deformation[some]])
            model(batch.dv, batch.clouds, batch.which, batch.log_predicted)
    for hook in hooks:
        hook.remove()
    return found


def _fill(narrow: Narrow, layer: nn.Module, moments: Tensor) -> None:
    """Give a narrow layer the factors that come nearest to a whole one."""
    weight, *parts = (one.weight for one in (layer, *narrow))
    assert isinstance(weight, Tensor)
    assert isinstance(parts[0], Tensor)
    images = isinstance(layer, ImageLinear)
    matrices = weight.detach().double() if images else weight.detach().double().T[None]
    rank = parts[0].shape[2 if images else 0]
    factors = [_factors(matrix, moment, rank) for matrix, moment in zip(matrices, moments, strict=True)]
    with torch.no_grad():
        for own, each in zip(parts, zip(*factors, strict=True), strict=True):
            assert isinstance(own, Tensor)
            own.copy_(torch.stack(each) if images else each[0].T)
        if isinstance(bias := narrow[1].bias, Tensor):
            assert isinstance(layer.bias, Tensor)
            bias.copy_(layer.bias)


def _factors(matrix: Tensor, moments: Tensor, rank: int) -> tuple[Tensor, Tensor]:
    """Return (inputs, rank) and (rank, outputs) whose product is nearest to a matrix, for features of these moments."""
    values, vectors = torch.linalg.eigh(moments)
    root = values.clamp(min=MIN_MOMENT_SHARE * float(values.max())).sqrt()
    left, size, right = torch.linalg.svd(root[:, None] * (vectors.T @ matrix), full_matrices=False)
    half = size[:rank].sqrt()
    missing = rank - len(half)  # a layer may be wider in between than it is
    a = (vectors / root) @ left[:, :rank] * half
    b = half[:, None] * right[:rank]
    return nn.functional.pad(a, (0, missing)), nn.functional.pad(b, (0, 0, 0, missing))
