"""The losses of a run as a picture, where matplotlib is installed."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from eitskin_proto.files.writing import replacing
from eitskin_training.run import Epoch


def draw(history: Sequence[Epoch], path: Path, *, title: str = "") -> bool:
    """Draw training and validation loss over epochs into a PNG.

    Args:
        history: The epochs of a run.
        path: The file to write.
        title: Stands above the picture.

    Returns:
        Whether the picture was drawn; False without matplotlib or without epochs.
    """
    if not history or importlib.util.find_spec("matplotlib") is None:
        return False
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra that training does not need

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    numbers = [epoch.number for epoch in history]
    axes.semilogy(numbers, [epoch.training_loss for epoch in history], label="training (noise, flips, missing rows)")
    axes.semilogy(numbers, [epoch.validation_loss for epoch in history], label="validation (noise)")
    best = min(history, key=lambda epoch: epoch.validation_loss)
    axes.plot(best.number, best.validation_loss, "o", color="black", label=f"best: epoch {best.number}")
    axes.set(xlabel="epoch", ylabel="binary cross-entropy a pixel", title=title)
    axes.legend()
    axes.grid(alpha=0.3)
    with replacing(path) as stream:
        figure.savefig(stream, dpi=120, format=path.suffix.removeprefix(".") or "png")
    return True
