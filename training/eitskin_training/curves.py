"""The losses of a run as a picture, where matplotlib is installed; several runs side by side."""

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import read_json
from eitskin_proto.files.writing import replacing
from eitskin_training.run import Epoch

LARGEST_NUMBER: Final = 1e12
"""Of losses, seconds and epochs."""


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


def history_of(run: Path) -> list[Epoch]:
    """Return the epochs of a run's folder.

    Raises:
        SkinError: The folder holds no finished epoch, or its history cannot be read.
    """
    path = run / "history.json"
    try:
        found = [_epoch(epoch) for epoch in read_json(path)]
        if not found:
            raise ValueError("it lists no epoch")
        return found
    except FileNotFoundError as error:
        raise SkinError(f"{run} holds no run ({path.name} is missing); run 'eitskin train --out {run}'") from error
    except (ValueError, TypeError, AttributeError) as error:
        raise SkinError(f"{path} is not the history of a training run: {error}; train again") from error


def _epoch(value: Any) -> Epoch:
    epoch = Epoch(**value)
    for field in fields(epoch):
        found = getattr(epoch, field.name)
        if not isinstance(found, float) and not (type(found) is int and abs(found) <= LARGEST_NUMBER):
            raise ValueError(f"{field.name} is {quoted(found)}, expected a number")
    return epoch


def compare(histories: Mapping[str, Sequence[Epoch]], path: Path) -> None:
    """Draw the losses and the validation correlation of several runs into a PNG, one colour a run.

    Args:
        histories: The epochs of each run, by its name.
        path: The file to write.

    Raises:
        ValueError: There are no runs.
        ModuleNotFoundError: There is no matplotlib.
    """
    if not histories:
        raise ValueError("found no runs to draw; name at least one")
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra that training does not need

    figure = Figure(figsize=(11, 4), layout="constrained")
    loss, correlation = figure.subplots(1, 2)
    for index, (name, history) in enumerate(histories.items()):
        numbers, colour = [epoch.number for epoch in history], f"C{index}"
        best = min(history, key=lambda epoch: epoch.validation_loss)
        loss.semilogy(numbers, [epoch.training_loss for epoch in history], ":", color=colour)
        loss.semilogy(numbers, [epoch.validation_loss for epoch in history], color=colour, label=name)
        loss.plot(best.number, best.validation_loss, "o", color=colour)
        correlation.plot(numbers, [epoch.validation_cc for epoch in history], color=colour, label=name)
        correlation.plot(best.number, best.validation_cc, "o", color=colour)
    loss.set(xlabel="epoch", ylabel="loss: validation solid, training dotted")
    correlation.set(xlabel="epoch", ylabel="mean CC of the validation touch sets")
    for axes in (loss, correlation):
        axes.grid(alpha=0.3)
    correlation.legend(loc="lower right")
    with replacing(path) as stream:
        figure.savefig(stream, dpi=120, format=path.suffix.removeprefix(".") or "png")
