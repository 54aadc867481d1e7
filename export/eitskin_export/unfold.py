"""Rebuilds a network from the graphs of a bundle by undoing the folding, so that it can be trained further.

Folding (:mod:`eitskin_export.fold`) makes one layer of a linear layer and its normalisation; of the two only the
product is left. Here the linear layer gets all of it, and the normalisation becomes the identity but for the bias it
carries. In evaluation the network gives the bundle's maps. In training its norms must stay in evaluation too: their
original statistics are lost.
"""

import math
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from eitskin_export.bundle import read
from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import Skin
from eitskin_training.network.images import ImageLinear, Narrow, last_part, signs
from eitskin_training.network.model import VD2T, Residual
from eitskin_training.network.sharpen import LOGITS
from eitskin_training.recipes import Recipe
from eitskin_training.start import Start

Weights = dict[str, npt.NDArray[np.float32]]

FUSION: Final = ("fusion.linear.weight", "fusion.weight", "permute")
"""What the exporter calls the first fusion layer, transposed where it is the third."""


def start_of_bundle(path: Path) -> Start:
    """Return the weights of a bundle, for training to go on from.

    Raises:
        SkinError: It is no bundle, or one whose network cannot be taken apart.
    """
    files, facts, skin = read(path)
    try:
        recipe = Recipe.from_dict(facts["recipe"])
    except (KeyError, ValueError, TypeError) as error:
        raise SkinError(f"{path} does not record how it was trained ({error}); start from a run instead") from error
    model = unfolded(files["geometry.onnx"], files["head.onnx"], recipe, skin)
    lineage = {"bundle_data": facts.get("data_digest"), "seeds": facts.get("seeds"), "still": True}
    return Start(model.state_dict(), recipe.architecture, skin, lineage)


def unfolded(geometry: bytes, head: bytes, recipe: Recipe, skin: Skin) -> VD2T:
    """Return the network of a bundle, in evaluation mode.

    Args:
        geometry: ``geometry.onnx``.
        head: ``head.onnx``.
        recipe: The manifest's, with the architecture.
        skin: What the bundle is for.

    Raises:
        SkinError: The graphs are not those of the architecture.
    """
    try:
        return _filled(VD2T(recipe.architecture, skin), _weights(geometry), _weights(head))
    except (KeyError, RuntimeError, ValueError) as error:
        raise SkinError(
            f"the bundle's graphs are not those of its recipe's network ({error}); start from a run instead"
        ) from error


def _weights(graph: bytes) -> Weights:
    model = onnx.load_model_from_string(graph)
    return {one.name: numpy_helper.to_array(one) for one in model.graph.initializer}


def _filled(model: VD2T, geometry: Weights, head: Weights) -> VD2T:
    with torch.no_grad():
        mixed = ".linear" if model.architecture.symmetric else ""
        first = model.voltage[0]
        assert isinstance(first, nn.Sequential)
        _norm(first[1], _taken(first[0], head, "voltage.0.0", "voltage.0.1"))
        for number, block in enumerate(list(model.voltage)[1:], start=1):
            if not isinstance(block, Residual):
                raise SkinError("only networks with a residual voltage channel can be taken apart; train a new one")
            name = f"voltage.{number}.path"
            _norm(block.path[1], _taken(block.path[0], head, f"{name}.0{mixed}", f"{name}.1{mixed}"))
        name = next(name for name in FUSION if name in head)
        head["fusion.weight"] = head[name].T if name == FUSION[-1] else head[name]
        inner = [f"voltage.{len(model.voltage)}{mixed}"] if isinstance(model.fusion_voltage, Narrow) else []
        _taken(model.fusion_voltage, head, *inner, "fusion")
        _norm(model.fusion[0], np.zeros(model.architecture.hidden, dtype=np.float32))
        names = [f"out.0{mixed}", f"out.1{mixed}"] if isinstance(model.out, Narrow) else [f"out{mixed}"]
        bias = last_part(model.out).bias
        assert isinstance(bias, Tensor)
        bias.copy_(torch.from_numpy(np.array(_taken(model.out, head, *names))))
        for number, sharpening in enumerate(model.sharpen.blocks):
            assert isinstance(sharpening, nn.Sequential)
            for layer, factor in ((0, LOGITS), (2, 1.0)):
                _linear(
                    sharpening[layer],
                    factor * head[f"blocks.{number}.{layer}.weight"],
                    head.get(f"blocks.{number}.{layer}.bias", np.zeros(1, dtype=np.float32)),  # zeros are left out
                )
        for number, convolution in enumerate(list(model.cloud)[: len(model.architecture.cloud_channels)]):
            assert isinstance(convolution, nn.Sequential)
            _linear(convolution[0], geometry[f"convolutions.{number}.0.weight"])
            _norm(convolution[1], geometry[f"convolutions.{number}.0.bias"])
        _linear(model.fusion_cloud, geometry["linear.weight"], geometry["linear.bias"])
    return model.eval()


def _taken(layer: nn.Module, head: Weights, *names: str) -> npt.NDArray[np.float32]:
    """Fill a layer in, or both parts of a narrow one, and return its bias.

    What was added between the two comes through the second, whose own layer has nothing to add there.
    """
    parts = list(layer) if isinstance(layer, Narrow) else [layer]
    bias = np.zeros(1, dtype=np.float32)
    for part, name in zip(parts, names, strict=False):
        weight = head[f"{name}.weight"]
        _linear(part, weight)
        bias = head.get(f"{name}.bias", np.zeros(1, dtype=np.float32)) + (weight @ bias if bias.any() else 0.0)
    return bias


def _linear(layer: nn.Module, weight: npt.NDArray[np.float32], bias: npt.NDArray[np.float32] | None = None) -> None:
    """Fill a layer in; of images, from the one matrix that they were mixed into."""
    own = layer.weight
    assert isinstance(own, Tensor)
    found = torch.from_numpy(np.array(weight))
    if isinstance(layer, ImageLinear):
        images = len(own)
        each = torch.from_numpy(signs(images)).to(found.dtype)
        found = torch.einsum("kg,gio->kio", each, found.T.reshape(images, -1, len(weight)))
    if found.shape != own.shape:
        raise ValueError(f"a layer of shape {tuple(found.shape)}, expected {tuple(own.shape)}")
    own.copy_(found)
    if bias is not None:
        assert isinstance(layer.bias, Tensor)
        layer.bias.copy_(torch.from_numpy(np.array(bias)))


def _norm(norm: nn.Module, bias: npt.NDArray[np.float32]) -> None:
    """Make a normalisation the identity in evaluation, plus a bias."""
    assert isinstance(norm, nn.BatchNorm1d | nn.BatchNorm2d)
    assert norm.running_mean is not None
    assert norm.running_var is not None
    norm.running_mean.zero_()
    norm.running_var.fill_(1.0)
    norm.weight.fill_(math.sqrt(1.0 + norm.eps))
    norm.bias.copy_(torch.from_numpy(np.array(bias)))
