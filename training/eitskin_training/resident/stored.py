"""A data set in the memory of the device that learns from it, and batches as places in it.

A step of the small networks here takes a GPU two milliseconds, and seven times that where NumPy makes the batches. So
on a GPU nothing of a batch is made outside: an epoch is a table of which samples, which clouds and which mirror image
each of its batches has.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_training.network.mirror import Mirror, mirrors
from eitskin_training.recipes import Recipe
from eitskin_training.samples.batches import TrainingData, in_order

SHARE_OF_MEMORY: Final = 0.6
"""Of a device's free memory that a data set may take; the rest is for the network's own."""


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


def needed_bytes(data: TrainingData, recipe: Recipe) -> int:
    """Return how much memory a data set takes on a device."""
    clouds = data.clouds.nbytes * len(images_shown(data, recipe))
    return int(len(data.train) * data.voltages[0].nbytes + data.labels.nbytes + clouds)


def fits(data: TrainingData, recipe: Recipe, device: torch.device) -> bool:
    """Whether a data set can lie on a device: a GPU with memory for it."""
    if device.type != "cuda":
        return False
    free, _ = torch.cuda.mem_get_info(device)
    return needed_bytes(data, recipe) < SHARE_OF_MEMORY * free


class Stored:
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
        """What a label is multiplied by to lie between 0 and 1."""
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
