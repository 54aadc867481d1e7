"""The training loop: Adam on the recipe's loss, best validation epoch kept, resumable after every epoch.

A run is a folder ::

    checkpoint.pt    everything needed to go on: weights, optimiser, schedule, running mean, history
    best.pt          the weights of the best validation epoch so far, with the recipe; what 'eitskin export' reads
    history.json     the losses of every epoch

Both .pt files are written beside and renamed, so an interrupted run leaves the last whole epoch. They hold tensors and
plain values only, and are read with ``weights_only``.
"""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.plain import plain
from eitskin_proto.files.writing import held, write_bytes
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin_training.resident import ResidentSteps
from eitskin_training.run import Epoch, Run, optimiser_of, restore
from eitskin_training.run_files import FORMAT, network, read, skin_entries, skin_of, write_file
from eitskin_training.samples.batches import TrainingData, inputs
from eitskin_training.score import score
from eitskin_training.start import Start, fits, keep_statistics, narrowed


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a run, reported after every batch.

    Args:
        epoch: Number of the epoch, from 1.
        epochs: How many there will be.
        step: Steps done in all.
        steps: Steps that there will be.
        finished: The epoch that just ended, if one did.
    """

    epoch: int
    epochs: int
    step: int
    steps: int
    finished: Epoch | None = None


def device() -> torch.device:
    """Return a GPU where there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def train(
    data: TrainingData,
    recipe: Recipe,
    out: Path,
    *,
    seed: int = 0,
    resume: bool = False,
    stop_after: int | None = None,
    sources: tuple[str, ...] = (),
    start: Start | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Run:
    """Train a network and leave the run in a folder.

    Args:
        data: The data set.
        recipe: How to train; its ``epochs`` fixes the schedule.
        out: The run's folder.
        seed: Of the first weights, the order, the noise and the dropout.
        resume: Whether to go on from the folder's checkpoint.
        stop_after: Stop early after this epoch; the run can be resumed.
        sources: Folders of the data sets, for the export to find them again.
        start: Weights to start from; None draws them. Their network must be of the same shape, or a
            larger one whose layers the recipe's ranks narrow.
        progress: Called after every batch.

    Returns:
        The run, with the last epoch's weights; the best epoch's are in ``best.pt``.

    Raises:
        MismatchError: The data or the checkpoint was made for something else.
        SkinError: The folder already holds a run and ``resume`` is False, another process trains there, or the loss
            stopped being a number.
    """
    data.require(recipe)
    out.mkdir(parents=True, exist_ok=True)
    with held(out, "another process trains there", "wait until it has ended, or name another folder"):
        checkpoint = out / "checkpoint.pt"
        if checkpoint.exists() and not resume:
            raise SkinError(f"{out} already holds a run; continue it with --resume or name another folder")
        run = _start(recipe, seed, data)
        run.sources = sources
        if start is not None:
            _start_from(run, narrowed(start, recipe, data) if fits(start, recipe) else start)
        if checkpoint.exists():
            _restore(run, checkpoint)
        _epochs(run, data, out, min(recipe.epochs, stop_after or recipe.epochs), progress)
    return run


def _epochs(run: Run, data: TrainingData, out: Path, last: int, progress: Callable[[Progress], None]) -> None:
    """Go on until an epoch, and leave each in the folder."""
    recipe = run.recipe
    steps = max(1, len(data.train) // recipe.batch) * recipe.epochs
    resident = ResidentSteps(run, data, device(), steps)
    for number in range(len(run.history) + 1, last + 1):
        began = time.monotonic()
        run.model.train()
        if run.still:
            keep_statistics(run.model)
        loss = resident.epoch(number, partial(_report, progress, run, steps, number))
        epoch = _validate(run, data, number, loss, time.monotonic() - began)
        run.history.append(epoch)
        _save(run, out)
        progress(Progress(number, recipe.epochs, run.step, steps, epoch))


def _report(progress: Callable[[Progress], None], run: Run, steps: int, number: int) -> None:
    progress(Progress(number, run.recipe.epochs, run.step, steps))


def _start(recipe: Recipe, seed: int, data: TrainingData) -> Run:
    torch.manual_seed(seed)
    model = VD2T(recipe.architecture, data.skin).to(device())
    model.standardise.fit(inputs(data, recipe).to(device()))
    averaged = {name: value.clone() for name, value in model.state_dict().items()}
    return Run(recipe, seed, model, averaged, optimiser_of(model, recipe, device()), data.digest, data.skin)


def _start_from(run: Run, start: Start) -> None:
    start.require(run.recipe.architecture, run.skin)
    run.model.load_state_dict(start.weights)
    run.averaged = {name: value.clone() for name, value in run.model.state_dict().items()}
    run.started_from = start.facts


def _validate(run: Run, data: TrainingData, number: int, training_loss: float, seconds: float) -> Epoch:
    model = network(run.recipe, run.averaged, run.skin)
    rows = data.validation if len(data.validation) else data.train
    found = score(model, data, rows, run.recipe.noises, snr_db=run.recipe.snr_db)
    return Epoch(number, training_loss, found.loss, found.cc, seconds)


def _save(run: Run, out: Path) -> None:
    common = {
        "format": FORMAT,
        "protocol_id": PROTOCOL_ID,
        **skin_entries(run.skin),
        "recipe": run.recipe.as_dict(),
        "seed": run.seed,
        "data_digest": run.data_digest,
        "data": list(run.sources),
        "started_from": run.started_from,
        "history": [asdict(epoch) for epoch in run.history],
    }
    state = {
        **common,
        "model": run.model.state_dict(),
        "averaged": run.averaged,
        "optimiser": run.optimiser.state_dict(),
        "step": run.step,
    }
    if run.best is run.history[-1]:
        write_file(out / "best.pt", {**common, "weights": run.averaged})
    write_bytes(out / "history.json", (json.dumps(common["history"], indent=1) + "\n").encode())
    write_file(out / "checkpoint.pt", state)  # the last one: a run stopped before it repeats the epoch


def _restore(run: Run, path: Path) -> None:
    try:
        _restore_checkpoint(run, read(path), path)
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise SkinError(f"{path} is not a file of a training run: {plain(str(error))[:200]}; train again") from error


def _restore_checkpoint(run: Run, content: dict[str, Any], path: Path) -> None:
    for name, found, expected in (
        ("recipe", Recipe.from_dict(content["recipe"]), run.recipe),
        ("seed", content["seed"], run.seed),
        ("data digest", content["data_digest"], run.data_digest),
        ("skin_digest", skin_of(content, path).digest, run.skin.digest),
        ("run it started from", content.get("started_from"), run.started_from),
    ):
        if found != expected:
            raise MismatchError(
                f"checkpoint {path}: {name}", found=found, expected=expected, hint="resume with what it began with"
            )
    run.model.load_state_dict(content["model"])
    run.averaged = {name: value.to(device()) for name, value in content["averaged"].items()}
    restore(run.optimiser, content["optimiser"])
    run.history = [Epoch(**epoch) for epoch in content["history"]]
    run.step = int(content["step"])
