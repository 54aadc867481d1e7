"""The files of a training run, as training writes them and every later stage reads them.

A run's folder holds ``checkpoint.pt`` and ``best.pt`` (:mod:`eitskin_training.train`) and ``gate.npz``
(:mod:`eitskin_training.gate.stored`). The .pt files hold tensors and plain values only, and are read with
``weights_only``.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.plain import plain, stated
from eitskin_proto.files.reading import opened
from eitskin_proto.files.writing import write_bytes
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import parse, to_toml
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin_training.samples.batches import TrainingData
from eitskin_training.samples.joined import load_all

FORMAT: Final = 1
"""Version of both .pt files."""

LARGEST_FILE: Final = 1 << 30
"""Bytes of a .pt file; the largest of ours has 50 MB."""


@dataclass(frozen=True, slots=True)
class Trained:
    """What a run's best epoch gives.

    Args:
        model: The network, in evaluation mode.
        recipe: How it was trained.
        content: Everything else in ``best.pt``: seed, data digest, history, ids.
        folder: The run's.
    """

    model: VD2T
    recipe: Recipe
    content: dict[str, Any]
    folder: Path

    @property
    def skin(self) -> Skin:
        """What it is for."""
        return self.model.skin

    @property
    def seed(self) -> int:
        """What its first weights and all its draws came from."""
        return int(self.content["seed"])


def trained(run: Path) -> Trained:
    """Return the best epoch of a run.

    Raises:
        SkinError: There is none, or it was made for another protocol.
    """
    content = read(run / "best.pt")
    skin = skin_of(content, run / "best.pt")
    try:
        recipe = Recipe.from_dict(content["recipe"])
        found = Trained(network(recipe, content["weights"], skin), recipe, content, run)
        _ = found.seed, content["data"], content["data_digest"]
        return found
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RuntimeError) as error:
        raise SkinError(
            f"{run / 'best.pt'} is not a file of a training run: {plain(str(error))[:200]}; train again"
        ) from error


def data_of(found: Trained, directories: Sequence[str] | None = None) -> TrainingData:
    """Return the data set of a run, from where it was or from ``directories``.

    Raises:
        MismatchError: It is another data set.
        OSError: It is gone.
    """
    known: str | list[str] = found.content["data"]  # a run of one data set used to keep its folder alone
    data = load_all(directories or ([known] if isinstance(known, str) else known))
    if data.digest != found.content["data_digest"]:
        raise MismatchError(
            "data set of the run: digest",
            found=data.digest,
            expected=found.content["data_digest"],
            hint="name the one it was trained on with --data",
        )
    data.require(found.recipe)
    return data


def network(recipe: Recipe, state: dict[str, Tensor], skin: Skin) -> VD2T:
    """Return a network in evaluation mode with the given weights."""
    model = VD2T(recipe.architecture, skin)
    model.load_state_dict(state)
    return model.eval().to(next(iter(state.values())).device)


def skin_entries(skin: Skin) -> dict[str, str]:
    """Return what a file says of the skin that it is for."""
    return {"grid_id": skin.grid_id, "skin_digest": skin.digest, "skin": to_toml(skin)}


def skin_of(content: Mapping[str, Any], path: Path) -> Skin:
    """Return the skin that a file is for; one from before skins were described is for the paper's.

    Raises:
        MismatchError: Its ids are not those of its skin.
        SkinError: Its skin is no description.
    """
    try:
        skin = parse(content["skin"]) if "skin" in content else PAPER
    except (ValueError, TypeError, AttributeError) as error:
        raise SkinError(f"{path}: skin: {plain(str(error))[:200]}; train again with 'eitskin train'") from error
    for name, expected in (("grid_id", skin.grid_id), ("skin_digest", skin.digest)):
        found = content.get(name, PAPER.digest if name == "skin_digest" else None)
        if found != expected:
            hint = "train again with 'eitskin train'"
            raise MismatchError(f"{path}: {name}", found=stated(found), expected=expected, hint=hint)
    return skin


def write_file(path: Path, content: dict[str, Any]) -> None:
    """Write a run's .pt file beside and rename it, so that an interruption leaves the one before whole."""
    whole = io.BytesIO()
    torch.save(content, whole)  # of a file that cannot take it torch would make an error of its own
    write_bytes(path, whole.getvalue())


def read(path: Path) -> dict[str, Any]:
    """Return what a run's .pt file holds.

    Raises:
        MismatchError: It was made for another protocol or version, or its ids are not those of its skin.
        SkinError: It is no file of a run.
    """
    try:
        with opened(path, LARGEST_FILE) as file:
            content = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise SkinError(
            f"{path.parent} holds no finished epoch ({path.name} is missing); run 'eitskin train'"
        ) from error
    except Exception as error:
        raise SkinError(f"{path} is not a file of a training run: {type(error).__name__}; train again") from error
    for name, expected in (("format", FORMAT), ("protocol_id", PROTOCOL_ID)):
        found = content.get(name) if isinstance(content, dict) else None
        if found != expected:
            raise MismatchError(
                f"{path}: {name}", found=stated(found), expected=expected, hint="train again with 'eitskin train'"
            )
    skin_of(content, path)
    return dict(content)
