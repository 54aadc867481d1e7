"""Layers that know the sheet's two mirror symmetries: what they make of a mirror image is the image of what they make.

A hidden feature exists in the sheet's four mirror images, as (4, B, C). A layer may mix images, but only as a mirror
allows: image g takes from image h what depends on "g then h" alone. Sums and differences over the images, each even or
odd in x and in y, do not mix at all ::

    even, odd  =  images summed with signs          4 x 4, its own inverse but for the scale
    y_k        =  x_k W_k                           k: even-even, odd-even, even-odd, odd-odd

so a layer from 4 C to 4 C features has 4 C^2 weights instead of 16 C^2: for as many weights a frame, twice the width,
and nothing to learn twice. Voltages, clouds and pixels have images of their own:
:mod:`eitskin_training.network.mirror`.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from eitskin_proto.sensor.grid import GRID_SHAPE, QUARTER_SHAPE
from eitskin_training.network.mirror import MIRRORS

IMAGES: Final = len(MIRRORS)
"""The sheet itself, mirrored in x, in y, and in both."""

SIGNS: Final = ((1, 1, 1, 1), (1, -1, 1, -1), (1, 1, -1, -1), (1, -1, -1, 1))
"""Of image g in sum k, [k][g]; an image's number is its mirrors' as bits: 1 for x, 2 for y."""


def images_of_rows(values: Tensor, blocks: int) -> Tensor:
    """Return (4, B, blocks * 104) images of (B, blocks * 104) features of the table's rows."""
    rows = torch.from_numpy(np.stack([mirror.rows for mirror in MIRRORS]))
    return values.view(len(values), blocks, -1)[:, :, rows].permute(2, 0, 1, 3).flatten(2)


def images_of_clouds(clouds: Tensor) -> Tensor:
    """Return (4, D, 3, 30, 45) images of (D, 3, 30, 45) clouds that are centred on the sheet's middle."""
    found = []
    for mirror in MIRRORS:
        axes = [axis for axis, mirrored in ((3, mirror.x), (2, mirror.y)) if mirrored]
        signs = clouds.new_tensor([-1.0 if mirror.x else 1.0, -1.0 if mirror.y else 1.0, 1.0])
        found.append(torch.flip(clouds, axes) * signs[:, None, None])
    return torch.stack(found)


class ImageLinear(nn.Module):
    """(4, B, inputs) -> (4, B, outputs); 4 * inputs * outputs weights.

    Args:
        inputs: Features in, of each image.
        outputs: Features out, of each image.
        bias: Whether a number is added, the same in every image.
    """

    signs: Tensor

    def __init__(self, inputs: int, outputs: int, *, bias: bool = False) -> None:
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(IMAGES, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(outputs)) if bias else None
        self.register_buffer("signs", 0.5 * torch.tensor(SIGNS, dtype=torch.float32), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return (4, B, outputs)."""
        y = self._sums(torch.bmm(self._sums(x), self.weight))
        return y if self.bias is None else y + self.bias

    def _sums(self, x: Tensor) -> Tensor:
        return torch.mm(self.signs, x.reshape(IMAGES, -1)).view(x.shape)


class ImageNorm(nn.BatchNorm1d):
    """Batch normalisation of (4, B, C) with the same statistics in every image."""

    def forward(self, input: Tensor) -> Tensor:
        """Return (4, B, C)."""
        return super().forward(input.flatten(0, 1)).view(input.shape)


def places() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return two (1350,) places in 4 quarters where a pixel is; they differ in the middle column alone."""
    row, column = np.indices(GRID_SHAPE)
    y, x = row >= QUARTER_SHAPE[0], column >= QUARTER_SHAPE[1]
    quarter = np.where(y, GRID_SHAPE[0] - 1 - row, row) * QUARTER_SHAPE[1] + np.where(
        x, GRID_SHAPE[1] - 1 - column, column
    )
    image = x + 2 * y
    other = np.where(column == QUARTER_SHAPE[1] - 1, image ^ 1, image)
    size = QUARTER_SHAPE[0] * QUARTER_SHAPE[1]
    return (image * size + quarter).reshape(-1), (other * size + quarter).reshape(-1)


class Quarters(nn.Module):
    """(4, B, 345) values of a quarter's pixels in each image -> (B, 1350) pixels."""

    one: Tensor
    other: Tensor

    def __init__(self) -> None:
        super().__init__()
        one, other = places()
        self.register_buffer("one", torch.from_numpy(one), persistent=False)
        self.register_buffer("other", torch.from_numpy(other), persistent=False)

    def forward(self, quarters: Tensor) -> Tensor:
        """Return (B, 1350)."""
        flat = quarters.transpose(0, 1).flatten(1)
        return 0.5 * (flat[:, self.one] + flat[:, self.other])
