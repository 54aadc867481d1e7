"""Sharpens a map's logits with small convolutions over their neighbourhood.

The last linear layer gives a map that is right to about a pixel, with different weights for each place. A touch looks
the same everywhere: a region with a border, apart from its neighbours. So three by three pixels are taken as the nine
channels of a cell, 10 mm on the paper's sheet, and each block adds a function of a cell and the eight around it ::

    z (B, 1350) -- cells (B, 9, 10, 15) -- [ z + conv1x1(act(conv3x3(z / 4))) ] ... -- pixels (B, 1350)

A map's rows and columns are therefore multiples of three.

Six thousand weights, 0.9 million products a frame. What it gains beside a wider network: docs/results/ablations.md.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

CELL_PIXELS: Final = 3
"""Pixels along a cell's side."""

LOGITS: Final = 4.0
"""Typical size of a logit; convolutions see them divided by it."""


def cells(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns of cells of a map.

    Raises:
        ValueError: A side is no multiple of three.
    """
    rows, columns = shape
    if rows % CELL_PIXELS or columns % CELL_PIXELS:
        whole = [-(-side // CELL_PIXELS) * CELL_PIXELS for side in shape]
        raise ValueError(
            f"a map of {rows} x {columns} pixels cannot be sharpened: expected multiples of {CELL_PIXELS}; "
            f"give the skin's [map] shape = {whole}"
        )
    return rows // CELL_PIXELS, columns // CELL_PIXELS


def pixel_of_cell(shape: tuple[int, int]) -> npt.NDArray[np.int64]:
    """Return the (n_pixels,) pixels in the order of cells, nine of each after another."""
    rows, columns = cells(shape)
    pixels = np.arange(shape[0] * shape[1]).reshape(rows, CELL_PIXELS, columns, CELL_PIXELS)
    return pixels.transpose(0, 2, 1, 3).reshape(-1)


class Sharpen(nn.Module):
    """Logits of pixels -> logits of pixels; without blocks it is the identity.

    Args:
        channels: Width of each block.
        activation: Makes the nonlinearity.
        shape: Rows and columns of the map.

    Raises:
        ValueError: There are blocks and the map has no whole cells.
    """

    def __init__(self, channels: Sequence[int], activation: type[nn.Module], shape: tuple[int, int]) -> None:
        super().__init__()
        self.shape = shape
        if channels:
            cells(shape)
        self.blocks = nn.ModuleList()
        for width in channels:
            last = nn.Conv2d(width, CELL_PIXELS**2, 1)
            nn.init.zeros_(last.weight)
            assert last.bias is not None
            nn.init.zeros_(last.bias)
            self.blocks.append(nn.Sequential(nn.Conv2d(CELL_PIXELS**2, width, 3, padding=1), activation(), last))
        for parameter in self.blocks.parameters():
            if parameter.ndim == 4:
                parameter.data = parameter.data.to(memory_format=torch.channels_last)  # trains faster

    def cells(self, z: Tensor) -> Tensor:
        """Return (B, 9, rows, columns) of the same."""
        for block in self.blocks:
            z = torch.add(z, block(z / LOGITS))
        return z

    def forward(self, logits: Tensor) -> Tensor:
        """Return (B, n_pixels)."""
        if not len(self.blocks):
            return logits
        z = functional.pixel_unshuffle(logits.view(-1, 1, *self.shape), CELL_PIXELS)
        return functional.pixel_shuffle(self.cells(z), CELL_PIXELS).flatten(1)
