"""Folds a trained network into its two deployed halves: batch normalisation goes into the weights, dropout disappears.

In evaluation batch normalisation is an affine map, so it disappears into the linear layer before it; the
standardisation of the inputs disappears into the layer after it. The normalisation in the fusion scales both column
blocks, so the bias comes out already scaled. Folding is done in float64 and rounded once.
"""

import copy

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.grid import Grid
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.images import ImageLinear, Narrow, fixed, places, signs
from eitskin_training.network.mirror import of_outputs
from eitskin_training.network.model import VD2T, Residual, Standardise, activation, features
from eitskin_training.network.sharpen import CELL_PIXELS, LOGITS, Sharpen, cells, pixel_of_cell

Index = npt.NDArray[np.int64]


class GeometryHalf(nn.Module):
    """(1, 3, rows, columns) cloud -> (1, H) bias, or (1, n H), that of every mirror image."""

    def __init__(self, convolutions: nn.Module, linear: nn.Linear, model: VD2T) -> None:
        super().__init__()
        self.convolutions = convolutions
        self.linear = linear
        self.use_cloud = model.architecture.use_cloud
        self.images = model.cloud_images if model.architecture.symmetric else None
        self.skin = model.skin

    def forward(self, cloud: Tensor) -> Tensor:
        """Return (D, H) for (D, 3, rows, columns)."""
        if not self.use_cloud:
            cloud = cloud * 0.0
        if self.images is not None:
            images = self.images(cloud).transpose(0, 1).flatten(0, 1)
            return self.linear(self.convolutions(images)).view(len(cloud), -1)  # type: ignore[no-any-return]
        return self.linear(self.convolutions(cloud))  # type: ignore[no-any-return]


class MixedImages(nn.Module):
    """An :class:`ImageLinear` as one matrix: (n B, inputs) -> (n B, outputs), the n images of a sample in a row.

    Image g reads those g then each of all, in their order (of four: g, g with x mirrored, g with y, g with both); then
    the weights are the same for each g, and a frame reads them once.
    """

    order: Tensor

    def __init__(self, layer: ImageLinear) -> None:
        super().__init__()
        self.images = len(layer.weight)
        each = torch.from_numpy(signs(self.images)).double()
        weight = torch.einsum("kg,kio->gio", each, layer.weight.detach()).flatten(0, 1) / self.images
        self.linear = _linear(weight.T.contiguous(), layer.bias).eval()
        image = torch.arange(self.images)
        self.register_buffer("order", (image[:, None] ^ image).reshape(-1), persistent=False)

    def gathered(self, x: Tensor) -> Tensor:
        """Return (n B, n inputs)."""
        first = self.images * torch.arange(len(x) // self.images)
        return torch.index_select(x, 0, (first[:, None] + self.order).flatten()).view(len(x), -1)

    def forward(self, x: Tensor) -> Tensor:
        """Return (n B, outputs)."""
        return self.linear(self.gathered(x))  # type: ignore[no-any-return]


class Head(nn.Module):
    """(1, 104) dv [, (1, 104) log_predicted], (1, H) bias -> (1, n_pixels) map in [0, 1].

    Every permutation is a gather of single elements (``GatherElements``): ONNX Runtime does 1350 in under 2 us, where a
    Gather or a Transpose of them takes 10 to 35. The first one gives cells as the convolutions read them; the last one
    gives pixels.
    """

    channel_of_cell: Tensor
    pixel: Tensor
    images: Tensor

    def __init__(self, model: VD2T, voltage: nn.Module, fusion: nn.Module, out: nn.Module, sharpen: Sharpen) -> None:
        super().__init__()
        self.architecture: Architecture = model.architecture
        self.skin = model.skin
        self.bias_width = model.bias_width
        self.n_images = len(model.mirrors)
        self.voltage = voltage
        self.fusion = fusion
        self.activation = activation(self.architecture)
        self.out = out
        self.blocks = sharpen.blocks
        sharpened = bool(len(self.blocks))
        channel_of_cell, pixel = _permutations(self.skin.grid, self.architecture, sharpened)
        if self.architecture.symmetric:
            place = places(of_outputs(model.mirrors, self.architecture.outputs))[0]
            channel_of_cell = place[channel_of_cell]
            pixel = pixel if sharpened else place[pixel]
            rows = np.stack([mirror.rows for mirror in model.mirrors])
            blocks = N_ROWS * np.arange(self.architecture.feature_blocks)
            self.register_buffer(
                "images", torch.from_numpy((rows[:, None] + blocks[:, None]).reshape(1, -1)), persistent=False
            )
        self.register_buffer("channel_of_cell", torch.from_numpy(channel_of_cell.copy()), persistent=False)
        self.register_buffer("pixel", torch.from_numpy(pixel.astype(np.int64)), persistent=False)

    def map(self, dv: Tensor, bias: Tensor, log_predicted: Tensor | None) -> Tensor:
        """Return (B, n_pixels)."""
        x = features(dv, self.architecture, log_predicted)
        if self.architecture.symmetric:
            x = _gather(x, self.images).view(self.n_images * len(dv), -1)
            bias = bias.view(self.n_images * len(dv), -1)
        logits = self.out(self.activation(self._fused(self.voltage(x), bias)))
        if self.architecture.symmetric:
            logits = logits.view(len(dv), -1)
        if len(self.blocks):
            return torch.sigmoid(_gather(self._sharpened(logits), self.pixel))
        touched = torch.sigmoid(logits)
        plain = self.architecture.outputs == "pixels" and not self.architecture.symmetric
        return touched if plain else _gather(touched, self.pixel)

    def _fused(self, x: Tensor, bias: Tensor) -> Tensor:
        if isinstance(self.fusion, MixedImages):
            return torch.addmm(bias, self.fusion.gathered(x), self.fusion.linear.weight.T)
        assert isinstance(self.fusion, nn.Linear)
        return torch.addmm(bias, x, self.fusion.weight.T)

    def _sharpened(self, logits: Tensor) -> Tensor:
        """Return (B, n_pixels) in the order of channels, then cells."""
        z = _gather(logits, self.channel_of_cell).view(-1, CELL_PIXELS**2, *cells(self.skin.grid.shape))
        for block in self.blocks:
            z = torch.add(z, block(z))
        return z.flatten(1)


def _permutations(grid: Grid, architecture: Architecture, sharpened: bool) -> tuple[Index, Index]:
    """Return two (1, n_pixels): pixels in the order of channels, then cells, and what each pixel takes at the end."""
    if not sharpened:
        pixels = np.arange(grid.n_pixels) if architecture.outputs == "pixels" else grid.unit_of_pixel
        return np.zeros((1, 0), dtype=np.int64), pixels.reshape(1, -1)
    channel_of_cell = pixel_of_cell(grid.shape).reshape(-1, CELL_PIXELS**2).T.reshape(1, -1)
    return channel_of_cell, np.argsort(channel_of_cell)


def _gather(values: Tensor, index: Tensor) -> Tensor:
    return torch.gather(values, 1, index.expand(len(values), -1))


class PlainHead(Head):
    """The head whose inputs are dv and bias."""

    def forward(self, dv: Tensor, bias: Tensor) -> Tensor:
        """Return (B, n_pixels)."""
        return self.map(dv, bias, None)


class PredictedHead(Head):
    """The head whose inputs are dv, log_predicted and bias."""

    def forward(self, dv: Tensor, log_predicted: Tensor, bias: Tensor) -> Tensor:
        """Return (B, n_pixels)."""
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
    *before_fusion, fusion_voltage = _parts(exact.fusion_voltage)
    *before_out, last = _parts(exact.out)
    assert isinstance(voltage, nn.Sequential)
    voltage = nn.Sequential(*voltage, *map(_folded, before_fusion))
    if isinstance(fusion_voltage, ImageLinear):
        mixed = MixedImages(fusion_voltage)
        mixed.linear.weight = nn.Parameter(mixed.linear.weight.detach() * scale[:, None])
        fusion: nn.Module = mixed
        last = MixedImages(_central(last, of_outputs(exact.mirrors, architecture.outputs)))
    else:
        assert isinstance(fusion_voltage, nn.Linear)
        fusion = _linear(fusion_voltage.weight * scale[:, None], None)
    out = nn.Sequential(*map(_folded, before_out), last) if before_out else last
    linear = _linear(exact.fusion_cloud.weight * scale[:, None], exact.fusion_cloud.bias * scale + shift)
    kind = PredictedHead if architecture.log_predicted else PlainHead
    for block in exact.sharpen.blocks:
        assert isinstance(block, nn.Sequential)
        _divide(block[0], LOGITS)
    head = kind(exact, voltage, fusion, out, exact.sharpen)
    geometry = GeometryHalf(_folded(exact.cloud), linear, exact)
    return geometry.float().eval(), head.float().eval()


def _folded(module: nn.Module) -> nn.Module:
    """Return a module in which every (linear or convolution, batch norm) pair is one layer and no dropout is left."""
    if isinstance(module, Residual):
        module.path = _folded(module.path)  # type: ignore[assignment]
        return module
    if isinstance(module, ImageLinear):
        return MixedImages(module)
    if isinstance(module, Narrow):
        return Narrow(*map(_folded, module))
    if not isinstance(module, nn.Sequential):
        return module
    layers: list[nn.Module] = []
    for layer in (_folded(child) for child in module):
        if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d) and layers:
            before = layers[-1]
            if isinstance(before, MixedImages):
                before.linear = fuse_linear_bn_eval(before.linear, layer)
                continue
            fuse = fuse_linear_bn_eval if isinstance(before, nn.Linear) else fuse_conv_bn_eval
            layers[-1] = fuse(before, layer)  # type: ignore[type-var]
        elif isinstance(layer, Narrow):
            layers += layer
        elif not isinstance(layer, nn.Dropout):
            layers.append(layer)
    return nn.Sequential(*layers)


def _parts(layer: nn.Module) -> list[nn.Module]:
    """Return a layer alone, or the two of a narrow one."""
    return list(layer) if isinstance(layer, Narrow) else [layer]


def _central(layer: nn.Module, images: Index) -> ImageLinear:
    """Return the last layer with outputs on a mirror's own line even in it, as the mean over their places makes them.

    Args:
        layer: The last one.
        images: (n, outputs) permutation of the outputs by each mirror.
    """
    assert isinstance(layer, ImageLinear)
    odd = signs(len(images)) < 0
    vanish = torch.from_numpy(odd.astype(int) @ fixed(images).astype(int) > 0)
    layer.weight = nn.Parameter(torch.where(vanish[:, None, :], 0.0, layer.weight.detach()))
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
    bias = 0.0 if linear.bias is None else linear.bias.detach()
    linear.bias = nn.Parameter(bias - weight @ standardise.mean)
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
