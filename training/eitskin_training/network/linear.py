"""The linear layers of a network's head: whole, or narrow, as two with few features in between.

104 numbers make a frame, so behind 340 features a layer's matrix is nearly of a much smaller rank: with 26 to 30
features in between a head has a fifth of its weights ::

    y = x W        W (n, inputs, outputs)                     whole
    y = x A B      A (n, inputs, rank)   B (n, rank, outputs) narrow

Drawn at random the two learn little; they begin with those that come nearest to a whole layer, for the features that
it sees (:mod:`eitskin_training.narrowed`).
"""

from torch import nn

from eitskin_training.network.architecture import Architecture
from eitskin_training.network.images import ImageLinear


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
