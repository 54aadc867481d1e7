"""An epoch's steps on a device that holds the data: on a GPU each is one launch of a captured graph.

A step of these networks is a great many small kernels. Launched one by one they wait for Python; captured once as a
CUDA graph they take a third of the time. What changes from step to step lies in tensors that the graph reads: the
table of batches, the place in it, the learning rate. The same steps run uncaptured on any device, for tests.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from torch import Tensor

from eitskin_training.resident.drawn import LostElectrodes, lose_rows, noisy_change, predicted_or_none
from eitskin_training.resident.stored import Stored, Table
from eitskin_training.run import Run, check_loss
from eitskin_training.samples.batches import TrainingData, consistency_of
from eitskin_training.schedule import set_rate
from eitskin_training.score import training_loss

WARM_STEPS: Final = 4
"""Steps before the capture, as libraries choose their kernels in the first ones; they are undone."""

LOOKED_AT: Final = 256
"""Steps between two looks at the loss, each of which waits for the device."""


class ResidentSteps:
    """The steps of a run whose data lie on the device.

    Args:
        run: The run.
        data: What it learns from.
        device: Where.
        steps: Of the whole run, for the learning rate.
    """

    def __init__(self, run: Run, data: TrainingData, device: torch.device, steps: int) -> None:
        self._run, self._device, self._steps = run, device, steps
        recipe = run.recipe
        self._stored = Stored(data, recipe, device)
        self._lost = LostElectrodes(consistency_of(data, recipe), device) if recipe.lost_electrode else None
        self._generator = torch.Generator(device)
        self._table: Table | None = None
        self._at = torch.zeros(1, dtype=torch.int64, device=device)
        self._loss = torch.zeros((), device=device)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None  # type: ignore[no-untyped-call]

    def epoch(self, number: int, told: Callable[[], None]) -> float:
        """Go through the data once and return the mean loss.

        Args:
            number: Of the epoch, from 1; with the run's seed it fixes every draw.
            told: Called after every step.

        Raises:
            SkinError: The loss stopped being a number.
        """
        table = self._stored.table(np.random.default_rng([self._run.seed, number]))
        self._take(table)
        if self._stream is None:
            self._pass(number, len(table.samples), told)
        else:
            self._stream.wait_stream(torch.cuda.current_stream(self._device))
            with torch.cuda.stream(self._stream):
                if self._graph is None:
                    self._graph = self._captured(self._stream)
                self._pass(number, len(table.samples), told)
            torch.cuda.current_stream(self._device).wait_stream(self._stream)
        return float(self._loss) / len(table.samples)

    def _take(self, table: Table) -> None:
        """Show the steps another epoch's batches, in the memory where they read them."""
        if self._table is None:
            self._table = table
        else:
            for name in ("samples", "clouds", "which", "images"):
                getattr(self._table, name).copy_(getattr(table, name))
        self._at.zero_()
        self._loss.zero_()

    def _pass(self, number: int, steps: int, told: Callable[[], None]) -> None:
        run = self._run
        seed = run.seed * 1_000_003 + number
        torch.manual_seed(seed)  # of dropout
        self._generator.manual_seed(seed)
        for step in range(1, steps + 1):
            set_rate(run.optimiser, run.recipe, run.step, self._steps)
            if self._graph is None:
                run.optimiser.zero_grad(set_to_none=True)
                self._step()
            else:
                self._graph.replay()
            run.step += 1
            run.average()
            if step % LOOKED_AT == 0 or step == steps:
                check_loss(float(self._loss))
            told()

    def _step(self) -> None:
        """Learn from the batch at the present place, and go on to the next place."""
        loss = self._loss_of_batch()
        loss.backward()  # type: ignore[no-untyped-call]
        self._run.optimiser.step()
        self._loss += loss.detach()
        self._at += 1

    def _loss_of_batch(self) -> Tensor:
        stored, table, recipe, draws = self._stored, self._table, self._run.recipe, self._generator
        assert table is not None
        samples, clouds, which, image = (
            one.index_select(0, self._at)[0] for one in (table.samples, table.clouds, table.which, table.images)
        )
        volts = stored.volts.index_select(0, samples)
        change = noisy_change(volts, stored.inverse, recipe.noises, recipe.snr_db, draws)
        if recipe.lost_rows:
            change = lose_rows(change, recipe.lost_rows, draws)
        if self._lost is not None:
            change = self._lost.drawn(change, recipe.lost_electrode, draws)
        predicted = stored.log_predicted.index_select(0, stored.deformation.index_select(0, samples))
        predicted = predicted_or_none(predicted, recipe, draws)
        labels = stored.labels.index_select(0, stored.touch_set.index_select(0, samples))
        shown = stored.clouds.flatten(0, 1).index_select(0, clouds + image * stored.clouds.shape[1])
        if len(stored.clouds) > 1:
            rows, outputs = (one.index_select(0, image[None])[0] for one in (stored.rows_shown, stored.outputs_shown))
            change, predicted = change.index_select(1, rows), predicted.index_select(1, rows)
            labels = labels.index_select(1, outputs)
        model = self._run.model
        logits = model.logits(change, model.bias(shown).index_select(0, which), predicted)
        return training_loss(logits, labels.float() * stored.scale, recipe.correlation_weight, self._run.skin.grid)

    def _captured(self, stream: torch.cuda.Stream) -> torch.cuda.CUDAGraph:
        """Return a step as a graph; network, optimiser and place are then as they were."""
        run = self._run
        weights = {name: value.clone() for name, value in run.model.state_dict().items()}
        moments = {
            parameter: {name: value.clone() for name, value in state.items() if isinstance(value, Tensor)}
            for parameter, state in run.optimiser.state.items()
        }
        for _ in range(WARM_STEPS):
            run.optimiser.zero_grad(set_to_none=True)
            self._step()
        run.optimiser.zero_grad(set_to_none=True)
        graph = torch.cuda.CUDAGraph()
        graph.register_generator_state(self._generator)
        torch.cuda.synchronize(self._device)
        with torch.cuda.graph(graph, stream=stream):
            self._step()
        torch.cuda.synchronize(self._device)
        run.model.load_state_dict(weights)
        for parameter, state in run.optimiser.state.items():
            for name, value in state.items():
                if isinstance(value, Tensor):
                    known = moments.get(parameter, {}).get(name)
                    value.zero_() if known is None else value.copy_(known)
        self._at.zero_()
        self._loss.zero_()
        return graph
