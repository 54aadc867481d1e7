"""What maps are worth on deformations never trained on: with all electrodes, and without one, two and three."""

import numpy as np
import torch

from eitskin_proto.sensor.row_gaussian import log_of_change
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_training.network.filling import Filling, Missing
from eitskin_training.network.model import VD2T
from eitskin_training.samples.batches import TrainingData, assemble, noisy_change
from eitskin_training.score import correlation, truth_of


def held_out(
    model: VD2T, filling: Filling, data: TrainingData, *, most: int = 600, sets: int = 6, seed: int = 0
) -> dict[str, float]:
    """Return the mean CC of maps on bends never trained on: whole, and without one, two and three electrodes.

    Args:
        model: The network.
        filling: Fills missing rows in.
        data: The data set.
        most: Samples, with N2 noise.
        sets: Of two and of three electrodes; of one, all 16.
        seed: Of the draws.
    """
    rng = np.random.default_rng([seed, 0x0FF])
    rows = data.apart
    rows = np.sort(rng.choice(rows, size=min(most, len(rows)), replace=False))
    change = noisy_change(data, rows, ("N2",), 50.0, rng)
    batch = assemble(data, rows, change, data.log_predicted[data.deformation[rows]])
    truth = truth_of(batch.labels.numpy(), data)
    touched = truth.max(axis=1) > 0
    logs = torch.from_numpy(log_of_change(change).astype(np.float32))

    def cc(electrodes: Missing) -> float:
        shown = batch.dv
        if electrodes:
            filled, missing = filling(logs, [(slice(0, len(rows)), electrodes)], batch.log_predicted)
            shown = torch.where(missing, torch.expm1(filled), batch.dv)
        maps = model.maps(model.logits(shown, bias, batch.log_predicted)).numpy()
        return float(correlation(maps[touched], truth[touched]).mean())

    with torch.inference_mode():
        bias = model.bias(batch.clouds)[batch.which]
        found = {"whole": cc(())}
        single = [cc((electrode,)) for electrode in range(N_ELECTRODES)]
        found |= {"one_lost": float(np.mean(single)), "worst_lost": min(single)}
        for name, count in (("two_lost", 2), ("three_lost", 3)):
            drawn = [tuple(sorted(rng.choice(N_ELECTRODES, count, replace=False).tolist())) for _ in range(sets)]
            found[name] = float(np.mean([cc(electrodes) for electrodes in drawn]))
    return {name: round(value, 5) for name, value in found.items()}


def score_line(scores: dict[str, float]) -> str:
    """Return scores as a line."""
    return "held-out CC " + ", ".join(f"{name} {value:.4f}" for name, value in scores.items())
