"""VD2T: voltages and a measured cloud in, the touched map out (paper section IV.B, Fig. 3).

Two channels meet in two linear layers. The first of them is linear in both channels, so it is kept as its two column
blocks: what the cloud adds there is a *bias* that changes only when the sheet's shape does. ::

    dv (B, 104) ── features ── voltage channel ──┐ W_v
                                                 + ── BN ── ReLU ── dropout ── linear ── sharpen ── sigmoid ── map
    cloud (D, 3, 30, 45) ── cloud channel ───────┘ W_c, b        = bias (D, H)

``bias`` and ``logits`` are the two halves; training uses them too, so that geometry costs once a bend, not once a
sample. Two voltage channels exist: the paper's (three-layer MLP, then three-layer 1-D CNN) and a residual MLP that
reaches more with the same number of weights. Sharpening (:mod:`eitskin_training.network.sharpen`) is ours, and so are
all widths: the paper gives none.
"""

import itertools
from typing import Final

import torch
from torch import Tensor, nn

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.images import CloudImages, ImageNorm, Parts, RowImages, last_part, linear, part
from eitskin_training.network.mirror import mirrors, of_outputs
from eitskin_training.network.sharpen import Sharpen

MEASURED_FLOOR: Final = 1e-2
"""V / V0 is clamped here before its logarithm: a strongly touched row falls to 5e-4, and noise can cross zero. It is
part of every exported graph; :mod:`eitskin_proto.sensor.normalise` has the floors side by side."""

CHANGE_RANGE: Final = (-1.2, 5.0)
"""V / V0 - 1 is clamped here. Touches and deformations stay inside; noise on a weak row, alone, may not, and one such
value would move the batch's mean and spread, or the map."""

TOUCHED_PRIOR: Final = 0.05
"""Mean of the labels to start from, so that the first epochs do not go into learning that most pixels are 0."""


class Standardise(nn.Module):
    """(x - mean) * scale with numbers of the training data, fitted once; the identity until then.

    Batch normalisation here would show the network each batch's own mean and spread, which the bends that happen to be
    in it move.

    Args:
        width: Features of a sample.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("scale", torch.ones(width))

    def fit(self, samples: Tensor) -> None:
        """Take mean and spread from (n, width) samples."""
        self.mean.copy_(samples.mean(dim=0))
        self.scale.copy_(1.0 / torch.clamp(samples.std(dim=0), min=1e-6))

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, width)."""
        return (x - self.mean) * self.scale


class Residual(nn.Module):
    """x + activation(BN(linear(x)))."""

    def __init__(self, width: int, architecture: Architecture, images: int, number: int) -> None:
        super().__init__()
        self.path = _dense(width, width, architecture, images, number)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, width)."""
        return torch.add(x, self.path(x))


class VD2T(nn.Module):
    """The network as two halves that meet in a bias.

    Args:
        architecture: Its shape.
        skin: What it is for: the map, and the images that a symmetric network keeps.

    Raises:
        ValueError: The skin's map cannot be sharpened.
    """

    def __init__(self, architecture: Architecture, skin: Skin) -> None:
        super().__init__()
        self.architecture = architecture
        self.skin = skin
        self.mirrors = mirrors(skin, near=True)[: None if architecture.symmetric else 1]
        self.row_images = RowImages(architecture.feature_blocks, self.mirrors)
        self.cloud_images = CloudImages(self.mirrors)
        self.standardise = Standardise(architecture.feature_blocks * N_ROWS)
        self.voltage, voltage_width = _voltage_channel(architecture, len(self.mirrors))
        self.cloud, cloud_width = _cloud_channel(architecture, skin.grid.shape)
        layers, images = len(architecture.widths), len(self.mirrors)
        self.fusion_voltage = linear(voltage_width, architecture.hidden, architecture, images, number=layers)
        self.fusion_cloud = nn.Linear(cloud_width, architecture.hidden)
        self.fusion = nn.Sequential(
            _norm(architecture.hidden, architecture), activation(architecture), nn.Dropout(architecture.dropout)
        )
        if architecture.symmetric:
            images_of_outputs = of_outputs(self.mirrors, architecture.outputs)
            outputs = len(part(images_of_outputs))
            self.outputs: nn.Module = Parts(images_of_outputs)
        else:
            outputs, self.outputs = outputs_of(architecture, skin), nn.Identity()
        self.out = linear(architecture.hidden, outputs, architecture, images, number=layers + 1, bias=True)
        self.sharpen = Sharpen(architecture.sharpening, _kind(architecture), skin.grid.shape)
        bias = last_part(self.out).bias
        assert isinstance(bias, nn.Parameter)
        nn.init.constant_(bias, float(torch.logit(torch.tensor(TOUCHED_PRIOR))))
        unit_of_pixel = torch.from_numpy(skin.grid.unit_of_pixel.reshape(-1).copy())
        self.register_buffer("unit_of_pixel", unit_of_pixel, persistent=False)

    @property
    def bias_width(self) -> int:
        """Width of what a cloud adds: H, or that of each image."""
        return len(self.mirrors) * self.architecture.hidden

    def bias(self, clouds: Tensor) -> Tensor:
        """Return (D, H), what each cloud adds in the first fusion layer.

        Args:
            clouds: (D, 3, rows, columns) as :func:`eitskin_proto.skin.cloud.network_input` gives them.
        """
        if not self.architecture.use_cloud:
            clouds = torch.zeros_like(clouds)
        if not self.architecture.symmetric:
            return self.fusion_cloud(self.cloud(clouds))  # type: ignore[no-any-return]
        found: Tensor = self.fusion_cloud(self.cloud(self.cloud_images(clouds).flatten(0, 1)))
        return found.view(len(self.mirrors), len(clouds), -1).transpose(0, 1).flatten(1)

    def logits(self, dv: Tensor, bias: Tensor, log_predicted: Tensor | None = None) -> Tensor:
        """Return (B, outputs) before the sigmoid.

        Args:
            dv: (B, 104) relative change against the flat untouched reference.
            bias: (B, H), one row a sample.
            log_predicted: (B, 104) log(V_pred / V0), where the architecture has that input; None stands for zeros.
        """
        x = features(dv, self.architecture, log_predicted)
        if self.architecture.symmetric:
            x = self.row_images(x)
            bias = bias.view(len(bias), len(self.mirrors), -1).transpose(0, 1)
        hidden = self.fusion(self.fusion_voltage(self.voltage(self.standardise(x))) + bias)
        return self.sharpen(self.outputs(self.out(hidden)))  # type: ignore[no-any-return]

    def forward(
        self, dv: Tensor, clouds: Tensor, which: Tensor | None = None, log_predicted: Tensor | None = None
    ) -> Tensor:
        """Return (B, outputs) before the sigmoid.

        Args:
            dv: (B, 104) relative change.
            clouds: (D, 3, rows, columns), each shape once.
            which: (B,) the cloud of each sample; None when D = B, one each.
            log_predicted: As in :meth:`logits`.
        """
        bias = self.bias(clouds)
        return self.logits(dv, bias if which is None else bias[which], log_predicted)

    def maps(self, logits: Tensor) -> Tensor:
        """Return (B, n_pixels) touched maps in [0, 1] from logits."""
        touched = torch.sigmoid(logits)
        if self.architecture.outputs == "pixels":
            return touched
        return touched[:, self.unit_of_pixel]  # type: ignore[index]

    def parameter_count(self) -> int:
        """Return how many numbers training fits."""
        return sum(parameter.numel() for parameter in self.parameters())

    def streamed_weights(self) -> int:
        """Return how many weights one frame reads: all but the cloud's half."""
        geometry = [*self.cloud.parameters(), *self.fusion_cloud.parameters()]
        return self.parameter_count() - sum(parameter.numel() for parameter in geometry)


def outputs_of(architecture: Architecture, skin: Skin) -> int:
    """Return how many numbers a network gives for a skin."""
    return skin.grid.n_pixels if architecture.outputs == "pixels" else skin.grid.n_units


def features(dv: Tensor, architecture: Architecture, log_predicted: Tensor | None = None) -> Tensor:
    """Return (B, 104 * blocks): dv, then log(V / V0), then log(V / V_pred), as the architecture asks."""
    dv = torch.clamp(dv, *CHANGE_RANGE)
    blocks = [dv]
    if architecture.log_ratio or architecture.log_predicted:
        log_ratio = torch.log(torch.clamp(1.0 + dv, min=MEASURED_FLOOR))
        if architecture.log_ratio:
            blocks.append(log_ratio)
        if architecture.log_predicted:
            blocks.append(log_ratio if log_predicted is None else log_ratio - log_predicted)
    return torch.cat(blocks, dim=1)


def activation(architecture: Architecture) -> nn.Module:
    """Return the nonlinearity after each linear layer."""
    return _kind(architecture)()


def _kind(architecture: Architecture) -> type[nn.Module]:
    return nn.SiLU if architecture.activation == "silu" else nn.ReLU


def _norm(width: int, architecture: Architecture) -> nn.Module:
    return ImageNorm(width) if architecture.symmetric else nn.BatchNorm1d(width)


def _dense(inputs: int, outputs: int, architecture: Architecture, images: int, number: int) -> nn.Sequential:
    return nn.Sequential(
        linear(inputs, outputs, architecture, images, number=number),
        _norm(outputs, architecture),
        activation(architecture),
        nn.Dropout(architecture.dropout),
    )


def _voltage_channel(architecture: Architecture, images: int) -> tuple[nn.Sequential, int]:
    """Return the channel and the width of what it gives."""
    widths = architecture.widths
    width_in = architecture.feature_blocks * N_ROWS
    layers: list[nn.Module] = [_dense(width_in, widths[0], architecture, images, 0)]
    if architecture.voltage_channel == "residual":
        layers += [Residual(width, architecture, images, number) for number, width in enumerate(widths[1:], 1)]
        return nn.Sequential(*layers), widths[-1]
    for number, (before, after) in enumerate(itertools.pairwise(widths), 1):
        layers.append(_dense(before, after, architecture, images, number))
    layers.append(nn.Unflatten(1, (1, widths[-1])))
    length, channels = widths[-1], 1
    for index, after in enumerate(architecture.convolutions):
        stride = 2 if index == len(architecture.convolutions) - 1 else 1
        layers.append(
            nn.Sequential(
                nn.Conv1d(channels, after, 3, stride=stride, padding=1, bias=False), nn.BatchNorm1d(after), nn.ReLU()
            )
        )
        length, channels = (length - 1) // stride + 1, after
    layers.append(nn.Flatten())
    return nn.Sequential(*layers), length * channels


def _cloud_channel(architecture: Architecture, shape: tuple[int, int]) -> tuple[nn.Sequential, int]:
    """Return two strided 2-D convolutions and the width of what they give."""
    rows, columns = shape
    channels = 3
    layers: list[nn.Module] = []
    for after in architecture.cloud_channels:
        layers.append(
            nn.Sequential(
                nn.Conv2d(channels, after, 3, stride=2, padding=1, bias=False), nn.BatchNorm2d(after), nn.ReLU()
            )
        )
        rows, columns, channels = (rows + 1) // 2, (columns + 1) // 2, after
    layers.append(nn.Flatten())
    return nn.Sequential(*layers), rows * columns * channels
