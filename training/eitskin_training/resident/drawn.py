"""Noise and missing rows of a batch, drawn on a device: the same laws as :mod:`eitskin_training.samples`, in torch.

Nothing here asks the device for a number, so that all of it can be part of a captured graph.
"""

import itertools
from typing import Final

import numpy as np
import torch
from torch import Tensor

from eitskin_proto.sensor.row_gaussian import HIGHEST_LOG, RATIO_RANGE, RowGaussian, missing_weights, rows_of
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS
from eitskin_training.recipes import Noise, Recipe
from eitskin_training.samples.batches import MOST_LOST_ROWS
from eitskin_training.samples.missing_rows import HOW_MANY, SETS

SIZES: Final = tuple(range(1, len(HOW_MANY) + 1))
"""How many electrodes are gone together."""


def noisy_change(
    volts: Tensor,
    inverse: Tensor,
    kinds: tuple[Noise, ...],
    snr_db: float | tuple[float, float],
    generator: torch.Generator,
) -> Tensor:
    """Return (B, 104) dV with noise (:mod:`eitskin_sim.measurement.noise`), of a kind drawn for each sample.

    Args:
        volts: (B, 104) V, free of noise.
        inverse: (104,) 1 / V0, and 0 in the weak rows.
        kinds: Of noise.
        snr_db: Signal-to-noise ratio; of a range each sample has its own.
        generator: The device's.
    """
    there = (inverse != 0.0).to(volts)
    change = volts * inverse - there
    sizes = {
        "N1": lambda: change.square().mean(dim=1, keepdim=True).sqrt() * there,
        "N2": lambda: volts * inverse,
        "N3": lambda: volts.square().mean(dim=1, keepdim=True).sqrt() * inverse,
    }
    every = torch.stack([sizes[kind]() for kind in kinds])
    drawn = torch.randint(len(kinds), (1, len(volts), 1), device=volts.device, generator=generator)
    size = every.gather(0, drawn.expand(1, *volts.shape))[0]
    low, high = snr_db if isinstance(snr_db, tuple) else (snr_db, snr_db)
    snr = low + (high - low) * torch.rand(len(volts), 1, device=volts.device, generator=generator)
    noise = torch.randn(volts.shape, device=volts.device, generator=generator)
    return change + torch.pow(10.0, -snr / 20.0) * size * noise


def lose_rows(change: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """Return (B, 104) dV with one to four rows at 0 in a share of the samples."""
    count, device = len(change), change.device
    order = torch.rand(change.shape, device=device, generator=generator)
    lowest = torch.topk(order, MOST_LOST_ROWS, dim=1, largest=False, sorted=True).values
    last = torch.randint(MOST_LOST_ROWS, (count, 1), device=device, generator=generator)
    losing = torch.rand(count, 1, device=device, generator=generator) < share
    return torch.where((order <= lowest.gather(1, last)) & losing, 0.0, change)


class LostElectrodes:
    """Fills in the rows of one to three electrodes in some samples, as the other rows say.

    The conditional mean of a Gaussian is affine in l = log(1 + dV): a matrix for each of the 696 sets of electrodes.

    Args:
        gaussian: How rows go together.
        device: Where to.
    """

    def __init__(self, gaussian: RowGaussian, device: torch.device) -> None:
        self.sets = [one for size in SIZES for one in itertools.combinations(range(N_ELECTRODES), size)]
        precision, mean = gaussian.precision(), gaussian.mean
        matrices = np.tile(np.eye(N_ROWS), (len(self.sets), 1, 1))
        constants = np.zeros((len(self.sets), N_ROWS))
        gone = np.stack([rows_of(one) for one in self.sets])
        for matrix, constant, rows in zip(matrices, constants, gone, strict=True):
            weights = missing_weights(precision, rows)
            matrix[rows] = 0.0
            matrix[np.ix_(rows, ~rows)] = -weights
            constant[rows] = mean[rows] + weights @ mean[~rows]
        self.matrices = torch.from_numpy(matrices.astype(np.float32)).to(device)
        self.constants = torch.from_numpy(constants.astype(np.float32)).to(device)
        self.gone = torch.from_numpy(gone).to(device)
        sizes = np.bincount([len(one) for one in self.sets])[1:]
        chance = np.repeat(np.array(HOW_MANY) / sizes, sizes)
        self.chances = torch.from_numpy(np.cumsum(chance / chance.sum()).astype(np.float32)).to(device)

    def fill(self, change: Tensor, chosen: Tensor, own: Tensor, losing: Tensor) -> Tensor:
        """Return (B, 104) dV in which samples have lost electrodes.

        Args:
            change: (B, 104) dV.
            chosen: (k,) numbers of sets.
            own: (B,) which of these each sample loses.
            losing: (B, 1) whether it loses them.
        """
        low, high = RATIO_RANGE
        logs = torch.log(torch.clamp(1.0 + change, low, high))
        matrices = self.matrices.index_select(0, chosen).transpose(1, 2)
        filled = torch.matmul(logs, matrices) + self.constants.index_select(0, chosen)[:, None]
        filled = filled.gather(0, own[None, :, None].expand(1, *change.shape))[0]
        filled = torch.clamp(torch.expm1(torch.clamp(filled, max=HIGHEST_LOG)), low - 1.0, high - 1.0)
        gone = self.gone.index_select(0, chosen).index_select(0, own) & losing
        return torch.where(gone, filled, change)

    def drawn(self, change: Tensor, share: float, generator: torch.Generator) -> Tensor:
        """Return (B, 104) dV in which a share of the samples has lost electrodes, of a few sets a batch."""
        count, device = len(change), change.device
        chosen = torch.searchsorted(self.chances, torch.rand(SETS, device=device, generator=generator))
        own = torch.randint(SETS, (count,), device=device, generator=generator)
        losing = torch.rand(count, 1, device=device, generator=generator) < share
        return self.fill(change, chosen.clamp(max=len(self.sets) - 1), own, losing)


def predicted_or_none(log_predicted: Tensor, recipe: Recipe, generator: torch.Generator) -> Tensor:
    """Return (B, 104) log(V_pred / V0), zeros in the recipe's share of the samples."""
    if not recipe.predicted_dropout:
        return log_predicted
    drawn = torch.rand(len(log_predicted), 1, device=log_predicted.device, generator=generator)
    return torch.where(drawn < recipe.predicted_dropout, 0.0, log_predicted)
