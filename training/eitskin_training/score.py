"""Scores a network's maps by the loss and the correlation coefficient, over many samples at once."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from eitskin_proto.skin.grid import Grid
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.measurement.noise import Kind
from eitskin_training.network.model import VD2T
from eitskin_training.samples.batches import TrainingData, assemble, noisy_change, pixels_per_unit

CORRELATION_EPSILON: Final = 1e-4
"""Pixels^4: keeps the correlation of a map without any contrast, and its gradient, finite."""


@dataclass(frozen=True, slots=True)
class Score:
    """A mean over samples.

    Args:
        loss: Binary cross-entropy a pixel.
        cc: Mean correlation coefficient over the touched samples.
        worst_bend_cc: The lowest mean over a bend.
        untouched_peak: The highest pixel of any untouched sample; 0 when there is none.
    """

    loss: float
    cc: float
    worst_bend_cc: float
    untouched_peak: float


def loss_of(logits: Tensor, labels: Tensor, grid: Grid) -> Tensor:
    """Return the binary cross-entropy a pixel, also where the outputs are units of several pixels."""
    truth, weight = _as_outputs(labels, logits, grid), None
    if logits.shape[1] != grid.n_pixels:
        weight = _weight_of_units(grid, logits.device)
    return functional.binary_cross_entropy_with_logits(logits, truth, weight=weight)


def training_loss(logits: Tensor, labels: Tensor, correlation_weight: float, grid: Grid) -> Tensor:
    """Return :func:`loss_of` plus so much of 1 - Pearson's r of the touched samples, added up over the number of all.

    Cross-entropy alone spends a network on how surely untouched pixels are untouched; what a map is judged by, and what
    places a touch, is its correlation with the truth (paper section V.B).
    """
    loss = loss_of(logits, labels, grid)
    if not correlation_weight:
        return loss
    truth = _as_outputs(labels, logits, grid)
    a, b = torch.sigmoid(logits), truth
    a, b = a - a.mean(dim=1, keepdim=True), b - b.mean(dim=1, keepdim=True)
    size = torch.sqrt((a * a).sum(dim=1) * (b * b).sum(dim=1) + CORRELATION_EPSILON)
    missing = (1.0 - (a * b).sum(dim=1) / size) * (truth.amax(dim=1) > 0.0)
    return loss + correlation_weight * missing.mean()


def _as_outputs(labels: Tensor, logits: Tensor, grid: Grid) -> Tensor:
    if labels.shape[1] == logits.shape[1]:
        return labels
    return labels.index_select(1, _units_of_pixels(grid, labels.device))


@lru_cache(maxsize=8)
@torch.inference_mode(False)  # who asks first may be in inference, and what is made there cannot be learned with
def _weight_of_units(grid: Grid, device: torch.device) -> Tensor:
    pixels = pixels_per_unit(grid)
    return torch.from_numpy((pixels / pixels.mean()).astype(np.float32)).to(device)


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def _units_of_pixels(grid: Grid, device: torch.device) -> Tensor:
    return torch.from_numpy(grid.unit_of_pixel.reshape(-1).copy()).to(device)


def truth_of(labels: npt.NDArray[np.floating], data: TrainingData) -> npt.NDArray[np.floating]:
    """Return (n, n_pixels) maps of labels of either kind."""
    if data.labels_kind == "units":
        return np.asarray(data.skin.grid.map_from_units(labels)).reshape(len(labels), -1)
    return labels


def correlations(maps: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Return (n,) correlation of each (n, n_pixels) map with its truth."""
    return np.array([correlation(one, true) for one, true in zip(maps, truth, strict=True)])


def score(
    model: VD2T,
    data: TrainingData,
    rows: npt.NDArray[np.intp],
    kinds: tuple[Kind, ...],
    *,
    snr_db: float | tuple[float, float] = 50.0,
    most: int = 6000,
) -> Score:
    """Return the score over rows of a data set, with noise that is always the same.

    Args:
        model: A network; it is used in evaluation mode.
        data: The data set.
        rows: Which samples.
        kinds: Noises, one drawn a sample.
        snr_db: Signal-to-noise ratio.
        most: Most samples, chosen at random.

    Raises:
        ValueError: No rows.
    """
    if len(rows) == 0:
        raise ValueError("no samples to score; expected at least one row of the data set")
    rng = np.random.default_rng([0, len(rows)])
    chosen = np.sort(rng.choice(rows, size=min(most, len(rows)), replace=False))
    device = next(model.parameters()).device
    was_training = model.training
    model.eval()
    loss_sum, untouched_peak = 0.0, 0.0
    cc: list[npt.NDArray[np.float64]] = []
    bend: list[npt.NDArray[np.intp]] = []
    with torch.inference_mode():
        for start in range(0, len(chosen), 1024):
            part = chosen[start : start + 1024]
            dv = noisy_change(data, part, kinds, snr_db, rng)
            batch = assemble(data, part, dv, data.log_predicted[data.deformation[part]]).to(device)
            logits = model(batch.dv, batch.clouds, batch.which, batch.log_predicted)
            loss_sum += float(loss_of(logits, batch.labels, data.skin.grid)) * len(part)
            maps = model.maps(logits).cpu().numpy()
            labels = batch.labels.cpu().numpy()
            truth = truth_of(labels, data)
            touched = truth.max(axis=1) > 0
            cc.append(correlations(maps[touched], truth[touched]))
            bend.append(data.deformation[part][touched])
            if not touched.all():
                untouched_peak = max(untouched_peak, float(maps[~touched].max()))
    model.train(was_training)
    all_cc, all_bends = np.concatenate(cc), np.concatenate(bend)
    if len(all_cc) == 0:
        return Score(loss_sum / len(chosen), 0.0, 0.0, untouched_peak)
    per_bend = np.bincount(all_bends, weights=all_cc) / np.maximum(np.bincount(all_bends), 1)
    return Score(
        loss_sum / len(chosen), float(all_cc.mean()), float(per_bend[np.unique(all_bends)].min()), untouched_peak
    )
