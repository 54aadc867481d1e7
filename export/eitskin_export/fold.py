"""A trained network as the two halves that are deployed, batch normalisation folded into the weights, dropout gone.

In evaluation batch normalisation is an affine map, so it disappears into the linear layer before it; the
standardisation of the inputs disappears into the layer after it. The normalisation in the fusion scales both column
blocks, so the bias comes out already scaled. Folding is done in float64 and rounded once.
"""

import copy

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from eitskin_proto.sensor.grid import N_PIXELS, QUARTER_SHAPE, UNIT_OF_PIXEL
from eitskin_proto.sensor.table import N_ROWS
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.images import IMAGES, SIGNS, ImageLinear, images_of_clouds, places
from eitskin_training.network.mirror import MIRRORS
from eitskin_training.network.model import VD2T, Residual, Standardise, activation, features
from eitskin_training.network.sharpen import CELL, CELLS, LOGITS, PIXEL_OF_CELL, Sharpen


class GeometryHalf(nn.Module):
    """(1, 3, 30, 45) cloud -> (1, H) bias, or (1, 4 H), that of every mirror image."""

    def __init__(self, convolutions: nn.Module, linear: nn.Linear, use_cloud: bool, symmetric: bool) -> None:
        super().__init__()
        self.convolutions = convolutions
        self.linear = linear
        self.use_cloud = use_cloud
        self.symmetric = symmetric

    def forward(self, cloud: Tensor) -> Tensor:
        """Return (D, H) for (D, 3, 30, 45)."""
        if not self.use_cloud:
            cloud = cloud * 0.0
        if self.symmetric:
            images = images_of_clouds(cloud).transpose(0, 1).flatten(0, 1)
            return self.linear(self.convolutions(images)).view(len(cloud), -1)  # type: ignore[no-any-return]
        return self.linear(self.convolutions(cloud))  # type: ignore[no-any-return]


class Mixed(nn.Module):
    """An :class:`ImageLinear` as one matrix: (4 B, inputs) -> (4 B, outputs), the four images of a sample in a row.

    Image g reads those g, g with x mirrored, g with y, g with both, in this order; then the weights are the same for
    each g, and a frame reads them once.
    """

    order: Tensor

    def __init__(self, layer: ImageLinear) -> None:
        super().__init__()
        signs = torch.tensor(SIGNS, dtype=torch.float64)
        weight = 0.25 * torch.einsum("kg,kio->gio", signs, layer.weight.detach()).flatten(0, 1)
        self.linear = _linear(weight.T.contiguous(), layer.bias).eval()
        image = torch.arange(IMAGES)
        self.register_buffer("order", (image[:, None] ^ image).reshape(-1), persistent=False)

    def gathered(self, x: Tensor) -> Tensor:
        """Return (4 B, 4 inputs)."""
        first = IMAGES * torch.arange(len(x) // IMAGES)
        return torch.index_select(x, 0, (first[:, None] + self.order).flatten()).view(len(x), -1)

    def forward(self, x: Tensor) -> Tensor:
        """Return (4 B, outputs)."""
        return self.linear(self.gathered(x))  # type: ignore[no-any-return]


class Head(nn.Module):
    """(1, 104) dv [, (1, 104) log_predicted], (1, H) bias -> (1, 1350) map in [0, 1].

    Every permutation is a gather of single elements (``GatherElements``): ONNX Runtime does 1350 in under 2 us, where a
    Gather or a Transpose of them takes 10 to 35. The first one gives cells as the convolutions read them and is what
    the runtime changes to cut a region out (:mod:`eitskin.model.onnx.crop_sharpened`); the last one gives pixels.
    """

    channel_of_cell: Tensor
    pixel: Tensor
    images: Tensor

    def __init__(
        self, architecture: Architecture, voltage: nn.Module, fusion: nn.Module, out: nn.Module, sharpen: Sharpen
    ) -> None:
        super().__init__()
        self.architecture = architecture
        self.voltage = voltage
        self.fusion = fusion
        self.activation = activation(architecture)
        self.out = out
        self.blocks = sharpen.blocks
        channel_of_cell = PIXEL_OF_CELL.reshape(-1, CELL**2).T.reshape(1, -1)
        pixel = np.argsort(channel_of_cell) if len(self.blocks) else UNIT_OF_PIXEL.reshape(1, -1)
        if architecture.symmetric:
            place = places()[0].reshape(1, -1)
            channel_of_cell = place[:, channel_of_cell[0]]
            pixel = pixel if len(self.blocks) else place
            rows = np.stack([mirror.rows for mirror in MIRRORS])
            blocks = N_ROWS * np.arange(architecture.feature_blocks)
            self.register_buffer(
                "images", torch.from_numpy((rows[:, None] + blocks[:, None]).reshape(1, -1)), persistent=False
            )
        self.register_buffer("channel_of_cell", torch.from_numpy(channel_of_cell.copy()), persistent=False)
        self.register_buffer("pixel", torch.from_numpy(pixel.astype(np.int64)), persistent=False)

    def map(self, dv: Tensor, bias: Tensor, log_predicted: Tensor | None) -> Tensor:
        """Return (B, 1350)."""
        x = features(dv, self.architecture, log_predicted)
        if self.architecture.symmetric:
            x = _gather(x, self.images).view(IMAGES * len(dv), -1)
            bias = bias.view(IMAGES * len(dv), -1)
        logits = self.out(self.activation(self._fused(self.voltage(x), bias)))
        if self.architecture.symmetric:
            logits = logits.view(len(dv), -1)
        if len(self.blocks):
            return torch.sigmoid(_gather(self._sharpened(logits), self.pixel))
        touched = torch.sigmoid(logits)
        plain = self.architecture.outputs == N_PIXELS and not self.architecture.symmetric
        return touched if plain else _gather(touched, self.pixel)

    def _fused(self, x: Tensor, bias: Tensor) -> Tensor:
        if isinstance(self.fusion, Mixed):
            return torch.addmm(bias, self.fusion.gathered(x), self.fusion.linear.weight.T)
        assert isinstance(self.fusion, nn.Linear)
        return torch.addmm(bias, x, self.fusion.weight.T)

    def _sharpened(self, logits: Tensor) -> Tensor:
        """Return (B, 1350) in the order of channels, then cells."""
        cells = _gather(logits, self.channel_of_cell).view(-1, CELL**2, *CELLS)
        for block in self.blocks:
            cells = torch.add(cells, block(cells))
        return cells.flatten(1)


def _gather(values: Tensor, index: Tensor) -> Tensor:
    return torch.gather(values, 1, index.expand(len(values), -1))


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


def split(model: VD2T) -> tuple[GeometryHalf, Head]:
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
    if isinstance(exact.fusion_voltage, ImageLinear):
        mixed = Mixed(exact.fusion_voltage)
        mixed.linear.weight = nn.Parameter(mixed.linear.weight.detach() * scale[:, None])
        fusion: nn.Module = mixed
        out: nn.Module = Mixed(_central(exact.out))
    else:
        assert isinstance(exact.fusion_voltage, nn.Linear)
        fusion = _linear(exact.fusion_voltage.weight * scale[:, None], None)
        out = exact.out
    linear = _linear(exact.fusion_cloud.weight * scale[:, None], exact.fusion_cloud.bias * scale + shift)
    kind = PredictedHead if architecture.log_predicted else PlainHead
    for block in exact.sharpen.blocks:
        assert isinstance(block, nn.Sequential)
        _divide(block[0], LOGITS)
    head = kind(architecture, voltage, fusion, out, exact.sharpen)
    geometry = GeometryHalf(_folded(exact.cloud), linear, architecture.use_cloud, architecture.symmetric)
    return geometry.float().eval(), head.float().eval()


def _folded(module: nn.Module) -> nn.Module:
    """Return a module in which every (linear or convolution, batch norm) pair is one layer and no dropout is left."""
    if isinstance(module, Residual):
        module.path = _folded(module.path)  # type: ignore[assignment]
        return module
    if isinstance(module, ImageLinear):
        return Mixed(module)
    if not isinstance(module, nn.Sequential):
        return module
    layers: list[nn.Module] = []
    for layer in (_folded(child) for child in module):
        if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d) and layers:
            before = layers[-1]
            if isinstance(before, Mixed):
                before.linear = fuse_linear_bn_eval(before.linear, layer)
                continue
            fuse = fuse_linear_bn_eval if isinstance(before, nn.Linear) else fuse_conv_bn_eval
            layers[-1] = fuse(before, layer)  # type: ignore[type-var]
        elif not isinstance(layer, nn.Dropout):
            layers.append(layer)
    return nn.Sequential(*layers)


def _central(layer: nn.Module) -> ImageLinear:
    """Return the last layer with pixels on the middle line even in x, as the mean over both halves makes them."""
    assert isinstance(layer, ImageLinear)
    middle = torch.arange(layer.weight.shape[2]) % QUARTER_SHAPE[1] == QUARTER_SHAPE[1] - 1
    odd = torch.tensor([signs[1] < 0 for signs in SIGNS])
    layer.weight = nn.Parameter(torch.where(odd[:, None, None] & middle, 0.0, layer.weight.detach()))
    return layer


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


def _divide(layer: nn.Module, divisor: float) -> None:
    """Let a layer take what was divided before."""
    assert isinstance(layer, nn.Conv2d)
    layer.weight = nn.Parameter(layer.weight.detach() / divisor)


def _linear(weight: Tensor, bias: Tensor | None) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None, dtype=weight.dtype)
    layer.weight = nn.Parameter(weight.detach())
    if bias is not None:
        layer.bias = nn.Parameter(bias.detach())
    return layer
