"""The metrics card: what a network scores on bends it never saw, by family and noise, as plain values."""

from typing import Any, Final

from eitskin_sim.measurement.noise import KINDS, Kind
from eitskin_training.network.model import VD2T
from eitskin_training.samples.batches import TrainingData
from eitskin_training.score import score

NOISES: Final[tuple[Kind, ...]] = tuple(kind for kind in KINDS if kind != "none")  # type: ignore[misc]
"""Every definition of 50 dB."""


def card(model: VD2T, data: TrainingData, *, most: int = 2000) -> dict[str, Any]:
    """Return scores on the held-out bends: {family: {noise: {loss, cc, worst_bend_cc, untouched_peak, samples}}}.

    Args:
        model: A trained network.
        data: Its data set.
        most: At most so many samples for each entry.
    """
    return {
        family: {kind: _entry(model, data, rows, kind, most) for kind in NOISES}
        for family, rows in data.held_out.items()
    }


def _entry(model: VD2T, data: TrainingData, rows: Any, kind: Kind, most: int) -> dict[str, float | int]:
    found = score(model, data, rows, (kind,), most=most)
    return {
        "loss": round(found.loss, 6),
        "cc": round(found.cc, 5),
        "worst_bend_cc": round(found.worst_bend_cc, 5),
        "untouched_peak": round(found.untouched_peak, 4),
        "samples": min(most, len(rows)),
    }
