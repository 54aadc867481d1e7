"""A trained network as the two halves that are deployed, batch normalisation folded into the weights, dropout gone.

In evaluation batch normalisation is an affine map, so it disappears into the linear layer before it; the
standardisation of the inputs disappears into the layer after it. The normalisation in the fusion scales both column
blocks, so the bias comes out already scaled. Folding is done in float64 and rounded once.
"""

import copy

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from eitskin_proto.grid import N_PIXELS, UNIT_OF_PIXEL
from eitskin_training.model import VD2T, Architecture, Residual, Standardise, activation, features
from eitskin_training.sharpen import CELL, CELLS, LOGITS, PIXEL_OF_CELL, Sharpen


class Geometry(nn.Module):
    """(1, 3, 30, 45) cloud -> (1, H) bias."""

    def __init__(self, convolutions: nn.Module, linear: nn.Linear, use_cloud: bool) -> None:
        super().__init__()
        self.convolutions = convolutions
        self.linear = linear
        self.use_cloud = use_cloud

    def forward(self, cloud: Tensor) -> Tensor:
        """Return (D, H) for (D, 3, 30, 45)."""
        if not self.use_cloud:
            cloud = cloud * 0.0
        return self.linear(self.convolutions(cloud))  # type: ignore[no-any-return]


class Head(nn.Module):
    """(1, 104) dv [, (1, 104) log_predicted], (1, H) bias -> (1, 1350) map in [0, 1].

    A sharpened head's last layer gives cell after cell, nine pixels each, so that a gather of whole cells can stand
    behind it: where the runtime cuts a region out (:mod:`eitskin.onnx_rows`), cells that were left out are taken from
    one untouched cell at the end.
    """

    cell: Tensor
    unit_of_pixel: Tensor

    def __init__(
        self, architecture: Architecture, voltage: nn.Module, fusion: nn.Linear, out: nn.Linear, sharpen: Sharpen
    ) -> None:
        super().__init__()
        self.architecture = architecture
        self.voltage = voltage
        self.fusion = fusion
        self.activation = activation(architecture)
        self.out = out
        self.sharpen = sharpen
        self.register_buffer("cell", torch.arange(CELLS[0] * CELLS[1]), persistent=False)
        unit_of_pixel = torch.from_numpy(UNIT_OF_PIXEL.reshape(-1).astype(np.int64))
        self.register_buffer("unit_of_pixel", unit_of_pixel, persistent=False)

    def map(self, dv: Tensor, bias: Tensor, log_predicted: Tensor | None) -> Tensor:
        """Return (B, 1350)."""
        x = self.voltage(features(dv, self.architecture, log_predicted))
        logits = self.out(self.activation(self.fusion(x) + bias))
        if len(self.sharpen.blocks):
            cells = functional.pad(logits, (0, CELL**2), value=-LOGITS).view(len(logits), -1, CELL**2)
            cells = torch.index_select(cells, 1, self.cell).transpose(1, 2).reshape(-1, CELL**2, *CELLS)
            return torch.sigmoid(functional.pixel_shuffle(self.sharpen.cells(cells), CELL).flatten(1))
        touched = torch.sigmoid(logits)
        return touched if self.architecture.outputs == N_PIXELS else torch.index_select(touched, 1, self.unit_of_pixel)


class PlainHead(Head):
    """The head whose inputs are dv and bias."""

    def forward(self, dv: Tensor, bias: Tensor) -> Tensor:
        """Return (B, 1350)."""
        return self.map(dv, bias, None)


class PredictedHead(Head):
    """The head whose inputs are dv, log_predicted and bias."""

    def forward(self, dv: Tensor, log_predicted: Tensor, bias: Tensor) -> Tensor:
        """Return (B, 1350)."""
        return self.map(dv, bias, log_predicted)


def split(model: VD2T) -> tuple[Geometry, Head]:
    """Return the geometry's half and the head of a network, folded, in float32.

    Args:
        model: A trained network; it is left as it was.
    """
    exact = copy.deepcopy(model).cpu().double().eval()
    architecture = exact.architecture
    voltage = _folded(exact.voltage)
    _fold_before(exact.standardise, _first_linear(voltage))
    norm = exact.fusion[0]
    assert isinstance(norm, nn.BatchNorm1d)
    scale, shift = _affine(norm)
    fusion = _linear(exact.fusion_voltage.weight * scale[:, None], None)
    linear = _linear(exact.fusion_cloud.weight * scale[:, None], exact.fusion_cloud.bias * scale + shift)
    kind = PredictedHead if architecture.log_predicted else PlainHead
    out = exact.out
    if len(exact.sharpen.blocks):
        order = torch.from_numpy(PIXEL_OF_CELL)
        out = _linear(out.weight[order], out.bias[order])
    head = kind(architecture, voltage, fusion, out, exact.sharpen)
    geometry = Geometry(_folded(exact.cloud), linear, architecture.use_cloud)
    return geometry.float().eval(), head.float().eval()


def _folded(module: nn.Module) -> nn.Module:
    """Return a module in which every (linear or convolution, batch norm) pair is one layer and no dropout is left."""
    if isinstance(module, Residual):
        module.path = _folded(module.path)  # type: ignore[assignment]
        return module
    if not isinstance(module, nn.Sequential):
        return module
    layers: list[nn.Module] = []
    for layer in (_folded(child) for child in module):
        if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d) and layers:
            before = layers[-1]
            fuse = fuse_linear_bn_eval if isinstance(before, nn.Linear) else fuse_conv_bn_eval
            layers[-1] = fuse(before, layer)  # type: ignore[type-var]
        elif not isinstance(layer, nn.Dropout):
            layers.append(layer)
    return nn.Sequential(*layers)


def _affine(norm: nn.BatchNorm1d) -> tuple[Tensor, Tensor]:
    """Return the (n,) scale and shift that a batch normalisation is in evaluation."""
    mean, variance = norm.running_mean, norm.running_var
    assert mean is not None
    assert variance is not None
    scale = norm.weight * torch.rsqrt(variance + norm.eps)
    return scale.detach(), (norm.bias - mean * scale).detach()


def _fold_before(standardise: Standardise, linear: nn.Linear) -> None:
    weight = linear.weight.detach() * standardise.scale
    linear.bias = nn.Parameter(linear.bias.detach() - weight @ standardise.mean)
    linear.weight = nn.Parameter(weight)


def _first_linear(module: nn.Module) -> nn.Linear:
    return next(layer for layer in module.modules() if isinstance(layer, nn.Linear))


def _linear(weight: Tensor, bias: Tensor | None) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None, dtype=weight.dtype)
    layer.weight = nn.Parameter(weight.detach())
    if bias is not None:
        layer.bias = nn.Parameter(bias.detach())
    return layer
