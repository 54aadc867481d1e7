"""A trained network as the two halves that are deployed, batch normalisation folded into the weights, dropout gone.

In evaluation batch normalisation is an affine map, so it disappears into the linear layer beside it: the
standardisation of the inputs into the layer after it, every other one into the layer before it. The one in the fusion
scales both column blocks, so the bias comes out already scaled. Folding is done in float64 and rounded once.
"""

import copy

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from eitskin_proto.grid import N_PIXELS
from eitskin_training.model import VD2T, Architecture, Residual, activation, features


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
    """(1, 104) dv [, (1, 104) log_predicted], (1, H) bias -> (1, 1350) map in [0, 1]."""

    def __init__(self, architecture: Architecture, voltage: nn.Module, fusion: nn.Linear, out: nn.Linear) -> None:
        super().__init__()
        self.architecture = architecture
        self.voltage = voltage
        self.fusion = fusion
        self.activation = activation(architecture)
        self.out = out

    def map(self, dv: Tensor, bias: Tensor, log_predicted: Tensor | None, unit_of_pixel: Tensor) -> Tensor:
        """Return (B, 1350)."""
        x = self.voltage(features(dv, self.architecture, log_predicted))
        touched = torch.sigmoid(self.out(self.activation(self.fusion(x) + bias)))
        return touched if self.architecture.outputs == N_PIXELS else torch.index_select(touched, 1, unit_of_pixel)


class PlainHead(Head):
    """The head whose inputs are dv and bias."""

    unit_of_pixel: Tensor

    def forward(self, dv: Tensor, bias: Tensor) -> Tensor:
        """Return (B, 1350)."""
        return self.map(dv, bias, None, self.unit_of_pixel)


class PredictedHead(Head):
    """The head whose inputs are dv, log_predicted and bias."""

    unit_of_pixel: Tensor

    def forward(self, dv: Tensor, log_predicted: Tensor, bias: Tensor) -> Tensor:
        """Return (B, 1350)."""
        return self.map(dv, bias, log_predicted, self.unit_of_pixel)


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
    head = kind(architecture, voltage, fusion, exact.out)
    head.register_buffer("unit_of_pixel", exact.get_buffer("unit_of_pixel"), persistent=False)
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


def _fold_before(norm: nn.BatchNorm1d, linear: nn.Linear) -> None:
    scale, shift = _affine(norm)
    weight, bias = linear.weight.detach(), linear.bias.detach()
    linear.weight = nn.Parameter(weight * scale)
    linear.bias = nn.Parameter(bias + weight @ shift)


def _first_linear(module: nn.Module) -> nn.Linear:
    return next(layer for layer in module.modules() if isinstance(layer, nn.Linear))


def _linear(weight: Tensor, bias: Tensor | None) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None, dtype=weight.dtype)
    layer.weight = nn.Parameter(weight.detach())
    if bias is not None:
        layer.bias = nn.Parameter(bias.detach())
    return layer
