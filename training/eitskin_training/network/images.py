"""Layers that are equivariant under a skin's mirror symmetries: mirrored inputs give mirrored outputs.

A hidden feature exists in each of the skin's n mirror images, as (n, B, C); n is 4, 2 or 1. A layer may mix images, but
only as a mirror allows: image g takes from image h what depends on "g then h" alone. Sums and differences over the
images, each even or odd in every mirror, do not mix at all ::

    even, odd  =  images summed with signs          n x n, its own inverse but for the scale
    y_k        =  x_k W_k                           n = 4: even-even, odd-even, even-odd, odd-odd

so a layer from n C to n C features has n C^2 weights instead of n^2 C^2: for as many weights a frame, sqrt(n) times the
width, and nothing to learn twice. Voltages, clouds and outputs have images of their own:
:mod:`eitskin_training.network.mirror`.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from eitskin_sim.arrays import Index
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.mirror import Mirror


def signs(count: int) -> npt.NDArray[np.int64]:
    """Return the (n, n) signs of image g in sum k, [k][g].

    An image's number is its mirrors' as bits; "g then h" has the number g ^ h. Of four, 1 is x and 2 is y.
    """
    return np.array([[(-1) ** (k & g).bit_count() for g in range(count)] for k in range(count)], dtype=np.int64)


class RowImages(nn.Module):
    """(B, blocks * 104) features of the table's rows -> (n, B, blocks * 104) images of them.

    Args:
        blocks: How many times 104 features there are.
        mirrors: The skin's.
    """

    columns: Tensor

    def __init__(self, blocks: int, mirrors: Sequence[Mirror]) -> None:
        super().__init__()
        rows = np.stack([mirror.rows for mirror in mirrors])
        starts = rows.shape[1] * np.arange(blocks)
        columns = (rows[:, None] + starts[:, None]).reshape(len(rows), -1)
        self.register_buffer("columns", torch.from_numpy(columns), persistent=False)

    def forward(self, features: Tensor) -> Tensor:
        """Return (n, B, blocks * 104)."""
        return torch.stack([features.index_select(1, columns) for columns in self.columns])


class CloudImages(nn.Module):
    """(D, 3, rows, columns) clouds that are centred on the sheet's middle -> (n, D, 3, rows, columns) images of them.

    Args:
        mirrors: The skin's.
    """

    turned: Tensor

    def __init__(self, mirrors: Sequence[Mirror]) -> None:
        super().__init__()
        self.axes = [[axis for axis, mirrored in ((3, one.x), (2, one.y)) if mirrored] for one in mirrors]
        turned = [[-1.0 if one.x else 1.0, -1.0 if one.y else 1.0, 1.0] for one in mirrors]
        self.register_buffer("turned", torch.tensor(turned)[:, :, None, None], persistent=False)

    def forward(self, clouds: Tensor) -> Tensor:
        """Return (n, D, 3, rows, columns)."""
        images = zip(self.axes, self.turned, strict=True)
        return torch.stack([torch.flip(clouds, axes) * turned for axes, turned in images])


class ImageLinear(nn.Module):
    """(n, B, inputs) -> (n, B, outputs); n * inputs * outputs weights.

    Args:
        images: n.
        inputs: Features in, of each image.
        outputs: Features out, of each image.
        bias: Whether a number is added, the same in every image.
    """

    signs: Tensor

    def __init__(self, images: int, inputs: int, outputs: int, *, bias: bool = False) -> None:
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(images, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.zeros(outputs)) if bias else None
        scaled = images**-0.5 * torch.from_numpy(signs(images)).float()
        self.register_buffer("signs", scaled, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, B, outputs)."""
        y = self.sums(torch.bmm(self.sums(x), self.weight))
        return y if self.bias is None else y + self.bias

    def sums(self, x: Tensor) -> Tensor:
        """Return (n, B, C) sums of images with signs, which the layer does not mix; twice is the identity."""
        return torch.mm(self.signs, x.reshape(len(x), -1)).view(x.shape)


class ImageNorm(nn.BatchNorm1d):
    """Batch normalisation of (n, B, C) with the same statistics in every image."""

    def forward(self, input: Tensor) -> Tensor:
        """Return (n, B, C)."""
        return super().forward(input.flatten(0, 1)).view(input.shape)


def part(images: Index) -> npt.NDArray[np.intp]:
    """Return the (p,) outputs whose images are all of them: the first of each set that mirrors exchange.

    With four images it is the quarter at (0, 0), with two a half, with one the whole.

    Args:
        images: (n, outputs) permutation of the outputs by each mirror (:func:`~.mirror.of_outputs`).
    """
    return np.unique(_first(images))


def places(images: Index) -> npt.NDArray[np.int64]:
    """Return (k, outputs) places in n parts where each output is; k is 1, 2 or 4.

    They differ for outputs on a mirror's own line alone, which are their own image.
    """
    first = _first(images)
    own = np.unique(first)
    where = np.searchsorted(own, first)
    shows = images[:, first] == np.arange(len(first))
    counts = shows.sum(axis=0)
    showing = np.argsort(~shows, axis=0, kind="stable")  # the parts that show an output come first
    turn = np.arange(counts.max())[:, np.newaxis] % counts
    return np.take_along_axis(showing, turn, axis=0) * len(own) + where


def fixed(images: Index) -> npt.NDArray[np.bool_]:
    """Return (n, p) which outputs of :func:`part` each mirror leaves where they are."""
    own = part(images)
    return np.asarray(images[:, own] == own)


def _first(images: Index) -> npt.NDArray[np.intp]:
    return np.asarray(images.min(axis=0))


class Parts(nn.Module):
    """(n, B, p) values of a part's outputs in each image -> (B, outputs).

    Args:
        images: (n, outputs) permutations.
    """

    places: Tensor

    def __init__(self, images: Index) -> None:
        super().__init__()
        self.register_buffer("places", torch.from_numpy(places(images)), persistent=False)

    def forward(self, parts: Tensor) -> Tensor:
        """Return (B, outputs)."""
        flat = parts.transpose(0, 1).flatten(1)
        found = flat.index_select(1, self.places[0])
        for place in self.places[1:]:
            found = found + flat.index_select(1, place)
        return found / len(self.places)


class Narrow(nn.Sequential):
    """A linear layer as two, the second with the bias."""


def linear(
    inputs: int, outputs: int, architecture: Architecture, images: int, *, number: int, bias: bool = False
) -> nn.Module:
    """Return a linear layer.

    Args:
        inputs: Features in.
        outputs: Features out.
        architecture: Whether there are images, and its rank.
        images: n; the first layer is the same for every image, whose rows are its inputs.
        number: Which of the layers that a frame passes, from 0.
        bias: Whether a number is added.
    """

    def whole(inputs: int, outputs: int, bias: bool) -> nn.Module:
        if architecture.symmetric and number:
            return ImageLinear(images, inputs, outputs, bias=bias)
        return nn.Linear(inputs, outputs, bias=bias)

    if not architecture.ranks:
        return whole(inputs, outputs, bias)
    rank = architecture.ranks[number]
    return Narrow(whole(inputs, rank, False), whole(rank, outputs, bias))


def last_part(layer: nn.Module) -> nn.Module:
    """Return what gives a layer's outputs: itself, or the second half of a narrow one."""
    return layer[-1] if isinstance(layer, Narrow) else layer
