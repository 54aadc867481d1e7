"""Layers that know a skin's mirror symmetries: what they make of a mirror image is the image of what they make.

A hidden feature exists in each of the skin's n mirror images, as (n, B, C); n is 4, 2 or 1. A layer may mix images, but
only as a mirror allows: image g takes from image h what depends on "g then h" alone. Sums and differences over the
images, each even or odd in every mirror, do not mix at all ::

    even, odd  =  images summed with signs          n x n, its own inverse but for the scale
    y_k        =  x_k W_k                           n = 4: even-even, odd-even, even-odd, odd-odd

so a layer from n C to n C features has n C^2 weights instead of n^2 C^2: for as many weights a frame, sqrt(n) times the
width, and nothing to learn twice. Voltages, clouds and pixels have images of their own:
:mod:`eitskin_training.network.mirror`.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from eitskin_training.network.mirror import Mirror


def signs(count: int) -> npt.NDArray[np.int64]:
    """Return the (n, n) signs of image g in sum k, [k][g].

    An image's number is its mirrors' as bits; "g then h" has the number g ^ h. Of four, 1 is x and 2 is y.
    """
    return np.array([[(-1) ** (k & g).bit_count() for g in range(count)] for k in range(count)], dtype=np.int64)


def images_of_rows(values: Tensor, blocks: int, mirrors: Sequence[Mirror]) -> Tensor:
    """Return (n, B, blocks * 104) images of (B, blocks * 104) features of the table's rows."""
    rows = torch.from_numpy(np.stack([mirror.rows for mirror in mirrors]))
    return values.view(len(values), blocks, -1)[:, :, rows].permute(2, 0, 1, 3).flatten(2)


def images_of_clouds(clouds: Tensor, mirrors: Sequence[Mirror]) -> Tensor:
    """Return (n, D, 3, rows, columns) images of (D, 3, rows, columns) clouds that are centred on the sheet's middle."""
    found = []
    for mirror in mirrors:
        axes = [axis for axis, mirrored in ((3, mirror.x), (2, mirror.y)) if mirrored]
        turned = clouds.new_tensor([-1.0 if mirror.x else 1.0, -1.0 if mirror.y else 1.0, 1.0])
        found.append(torch.flip(clouds, axes) * turned[:, None, None])
    return torch.stack(found)


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


def part(mirrors: Sequence[Mirror]) -> npt.NDArray[np.intp]:
    """Return the (p,) pixels whose images are the map: the first of each set that mirrors exchange.

    With four images it is the quarter at (0, 0), with two a half, with one the whole.
    """
    return np.unique(_first(mirrors))


def places(mirrors: Sequence[Mirror]) -> npt.NDArray[np.int64]:
    """Return (k, n_pixels) places in n parts where each pixel is; k is 1, 2 or 4.

    They differ for pixels on a mirror's own line alone, which are their own image.
    """
    first = _first(mirrors)
    own = np.unique(first)
    where = np.searchsorted(own, first)
    shows = np.stack([mirror.pixels[first] == np.arange(len(first)) for mirror in mirrors])
    most = int(shows.sum(axis=0).max())
    found = np.empty((most, len(first)), dtype=np.int64)
    for pixel in range(len(first)):
        images = np.flatnonzero(shows[:, pixel])
        found[:, pixel] = np.tile(images, most // len(images)) * len(own) + where[pixel]
    return found


def fixed(mirrors: Sequence[Mirror]) -> npt.NDArray[np.bool_]:
    """Return (n, p) which pixels of :func:`part` each image leaves where they are."""
    own = part(mirrors)
    return np.stack([mirror.pixels[own] == own for mirror in mirrors])


def _first(mirrors: Sequence[Mirror]) -> npt.NDArray[np.intp]:
    return np.asarray(np.min([mirror.pixels for mirror in mirrors], axis=0))


class Parts(nn.Module):
    """(n, B, p) values of a part's pixels in each image -> (B, n_pixels).

    Args:
        mirrors: The skin's images.
    """

    places: Tensor

    def __init__(self, mirrors: Sequence[Mirror]) -> None:
        super().__init__()
        self.register_buffer("places", torch.from_numpy(places(mirrors)), persistent=False)

    def forward(self, parts: Tensor) -> Tensor:
        """Return (B, n_pixels)."""
        flat = parts.transpose(0, 1).flatten(1)
        found = flat[:, self.places[0]]
        for place in self.places[1:]:
            found = found + flat[:, place]
        return found / len(self.places)
