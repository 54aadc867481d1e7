"""The steps of an epoch, on the device that holds the data: on a GPU each is one launch of a captured graph.

Noise, missing rows and mirror images are drawn with each step, so no epoch sees a sample twice alike. A batch is shown
in one mirror image: the permutation is then the same for every sample, and the clouds stay few. Randomness depends on
(seed, epoch) alone. A run resumed at an epoch therefore continues as if it had never stopped.

A step of these networks consists of many small kernels. Launched one by one they wait for Python; captured once as a
CUDA graph they take a third of the time. Values that change from step to step are in tensors that the graph reads: the
table of batches, the place in it, the learning rate. On the CPU the same steps run one by one.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_proto.sensor.row_gaussian import HIGHEST_LOG, RATIO_RANGE, RowGaussian, missing_weights, rows_of
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS
from eitskin_training.network.mirror import Mirror, mirrors
from eitskin_training.recipes import Noise, Recipe
from eitskin_training.run import Run, check_loss, set_rate
from eitskin_training.samples.batches import MAX_LOST_ROWS, TrainingData, consistency_of, in_order
from eitskin_training.score import training_loss

LOST_ELECTRODES_CHANCES: Final = (0.7, 0.2, 0.1)
"""Chances that one, two or three electrodes are gone, when any is."""

LOST_SETS_PER_BATCH: Final = 6
"""Different sets of electrodes in a batch: samples that lose the same ones are filled in together."""


@dataclass(frozen=True, slots=True)
class Table:
    """An epoch's batches.

    Args:
        samples: (steps, B) places of samples in :attr:`Stored.volts`.
        clouds: (steps, slots) numbers of clouds, each that occurs at least once.
        which: (steps, B) slot of each sample's cloud.
        images: (steps,) number of the mirror image that is shown.
    """

    samples: Tensor
    clouds: Tensor
    which: Tensor
    images: Tensor


def images_shown(data: TrainingData, recipe: Recipe) -> tuple[Mirror, ...]:
    """Return the mirror images that batches are shown in."""
    return mirrors(data.skin)[: None if recipe.flips else 1]


class ResidentData:
    """What batches are made of, on a device.

    Args:
        data: The data set.
        recipe: Batch size, deformations together and flips.
        device: Where to.
    """

    def __init__(self, data: TrainingData, recipe: Recipe, device: torch.device) -> None:
        def there(values: npt.NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values)).to(device)

        self._data, self._recipe, self._device = data, recipe, device
        shown = images_shown(data, recipe)
        self.volts = there(data.voltages[data.train])
        """(n, 104) float32 V of the samples to learn from."""
        self.deformation = there(data.deformation[data.train])
        """(n,)"""
        self.touch_set = there(data.touch_set[data.train])
        """(n,)"""
        self.labels = there(data.labels)
        """(T, outputs) uint8."""
        self.scale = 1.0 if data.labels_kind == "units" else 1.0 / 255.0
        """The factor that scales a label to 0 to 1."""
        self.clouds = there(np.stack([mirror.clouds(data.clouds) for mirror in shown]))
        """(images, D, 3, rows, columns)"""
        self.log_predicted = there(data.log_predicted)
        """(D, 104)"""
        self.inverse = there(inverse_reference(data.reference).astype(np.float32))
        """(104,) 1 / V0, and 0 in the weak rows."""
        columns = [mirror.units if data.labels_kind == "units" else mirror.pixels for mirror in shown]
        self.rows_shown = there(np.stack([mirror.rows for mirror in shown]))
        """(images, 104) permutation of the rows."""
        self.outputs_shown = there(np.stack(columns))
        """(images, outputs) permutation of the labels."""
        self.slots = self._most_clouds()
        """Clouds of a batch."""

    def _most_clouds(self) -> int:
        """Return how many deformations a batch can have: with groups, those of each group that it meets."""
        data, together = self._data, self._recipe.together
        samples = np.bincount(data.deformation[data.train])
        samples = samples[samples > 0]
        size = min(self._recipe.batch, len(data.train))
        most = min(len(samples), size)
        if not together:
            return most
        groups = -(-len(samples) // together)
        least = np.sort(samples)[: len(samples) // groups].sum()  # of a group
        return min(most, together * (1 + -(-size // int(least))))

    def table(self, rng: np.random.Generator) -> Table:
        """Return an epoch's batches.

        Args:
            rng: Draws their order and their mirror images.
        """
        data = self._data
        place = np.empty(len(data.voltages), dtype=np.intp)
        place[data.train] = np.arange(len(data.train))
        rows = in_order(data, self._recipe, rng)
        clouds = np.empty((len(rows), self.slots), dtype=np.intp)
        which = np.empty(rows.shape, dtype=np.intp)
        for number, batch in enumerate(rows):
            occurring, which[number] = np.unique(data.deformation[batch], return_inverse=True)
            clouds[number] = np.resize(occurring, self.slots)  # repeated in turn, which moves no mean over them
        images = rng.integers(len(self.clouds), size=len(rows))
        return Table(*(torch.from_numpy(one).to(self._device) for one in (place[rows], clouds, which, images)))


SIZES: Final = tuple(range(1, len(LOST_ELECTRODES_CHANCES) + 1))
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
    lowest = torch.topk(order, MAX_LOST_ROWS, dim=1, largest=False, sorted=True).values
    last = torch.randint(MAX_LOST_ROWS, (count, 1), device=device, generator=generator)
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
        chance = np.repeat(np.array(LOST_ELECTRODES_CHANCES) / sizes, sizes)
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
        chosen = torch.searchsorted(self.chances, torch.rand(LOST_SETS_PER_BATCH, device=device, generator=generator))
        own = torch.randint(LOST_SETS_PER_BATCH, (count,), device=device, generator=generator)
        losing = torch.rand(count, 1, device=device, generator=generator) < share
        return self.fill(change, chosen.clamp(max=len(self.sets) - 1), own, losing)


def predicted_or_none(log_predicted: Tensor, recipe: Recipe, generator: torch.Generator) -> Tensor:
    """Return (B, 104) log(V_pred / V0), zeros in the recipe's share of the samples."""
    if not recipe.predicted_dropout:
        return log_predicted
    drawn = torch.rand(len(log_predicted), 1, device=log_predicted.device, generator=generator)
    return torch.where(drawn < recipe.predicted_dropout, 0.0, log_predicted)


WARM_STEPS: Final = 4
"""Steps before the capture, as libraries choose their kernels in the first ones; they are undone."""

STEPS_PER_LOSS_CHECK: Final = 256
"""Steps between two looks at the loss, each of which waits for the device."""


class ResidentSteps:
    """The steps of a run with its data on the device.

    Args:
        run: The run.
        data: What it learns from.
        device: Where.
        steps: Of the whole run, for the learning rate.
    """

    def __init__(self, run: Run, data: TrainingData, device: torch.device, steps: int) -> None:
        self._run, self._device, self._steps = run, device, steps
        recipe = run.recipe
        self._stored = ResidentData(data, recipe, device)
        self._lost = LostElectrodes(consistency_of(data, recipe), device) if recipe.lost_electrode else None
        self._generator = torch.Generator(device)
        self._table: Table | None = None
        self._at = torch.zeros(1, dtype=torch.int64, device=device)
        self._loss = torch.zeros((), device=device)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None  # type: ignore[no-untyped-call]

    def epoch(self, number: int, report: Callable[[], None]) -> float:
        """Go through the data once and return the mean loss.

        Args:
            number: Of the epoch, from 1; with the run's seed it fixes every draw.
            report: Called after every step.

        Raises:
            SkinError: The loss stopped being a number.
        """
        table = self._stored.table(np.random.default_rng([self._run.seed, number]))
        self._load(table)
        if self._stream is None:
            self._pass(number, len(table.samples), report)
        else:
            self._stream.wait_stream(torch.cuda.current_stream(self._device))
            with torch.cuda.stream(self._stream):
                if self._graph is None:
                    self._graph = self._captured(self._stream)
                self._pass(number, len(table.samples), report)
            torch.cuda.current_stream(self._device).wait_stream(self._stream)
        return float(self._loss) / len(table.samples)

    def _load(self, table: Table) -> None:
        """Show the steps another epoch's batches, in the memory where they read them."""
        if self._table is None:
            self._table = table
        else:
            for name in ("samples", "clouds", "which", "images"):
                getattr(self._table, name).copy_(getattr(table, name))
        self._at.zero_()
        self._loss.zero_()

    def _pass(self, number: int, steps: int, report: Callable[[], None]) -> None:
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
            if step % STEPS_PER_LOSS_CHECK == 0 or step == steps:
                check_loss(float(self._loss))
            report()

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
