"""The samples that a network learns from, their order in an epoch, and batches of them for scores and statistics.

A data set holds each touch set's label once and each bend's cloud once; a sample is an index into both. A batch carries
the clouds that occur in it, each once, and which of them every sample has. The steps of an epoch
(:mod:`eitskin_training.resident`) draw noise, missing rows and mirror images anew each time.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from eitskin_proto.errors import MismatchError
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import RowGaussian
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.measurement.consistency import MAX_SAMPLES, fit
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.scene.parts import Bend
from eitskin_training.network.mirror import Mirror, mirrors
from eitskin_training.network.model import features
from eitskin_training.recipes import Recipe

MAX_LOST_ROWS: Final = 4
"""A sample that loses rows loses one to this many."""


def pixels_per_unit(grid: Grid) -> npt.NDArray[np.intp]:
    """Return the (n_units,) weights that make a loss over units equal to the loss over the pixels they cover."""
    return np.bincount(grid.unit_of_pixel.ravel(), minlength=grid.n_units)


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Everything that batches are made of.

    Args:
        voltages: (N, 104) V, touched, free of noise.
        deformation: (N,) which bend each sample has.
        touch_set: (N,) which touch set.
        reference: (104,) V of the flat, untouched sheet.
        untouched: (D, 104) V of each bend, untouched.
        clouds: (D, 3, rows, columns) network inputs.
        log_predicted: (D, 104) log(V_pred / V0), or zeros where nothing was predicted.
        labels_kind: "units" or "area".
        labels: (T, n_units) of 0 and 1, or (T, n_pixels) touched fraction in 1/255.
        train: Rows to learn from.
        validation: Rows that choose the best epoch: other touch sets at the same bends.
        held_out: Rows of other touch sets at bends never trained on, by family; for the metrics card.
        digest: Digest of the data set.
        seed: Seed of the data set, of the first of several.
        skin: What it was made for; a network learned from it is for this skin.
        touch_kind: The direction in which its touches change conductance, and that of a network trained on it.
        drift: (N,) by which each sample's resistances had changed since the reference, of random devices of the skin;
            None of the nominal device.
        bends: (D,) deformations, None for an unknown one; empty if all are unknown.
    """

    voltages: npt.NDArray[np.float32]
    deformation: npt.NDArray[np.intp]
    touch_set: npt.NDArray[np.intp]
    reference: npt.NDArray[np.float64]
    untouched: npt.NDArray[np.float64]
    clouds: npt.NDArray[np.float32]
    log_predicted: npt.NDArray[np.float32]
    labels_kind: Literal["units", "area"]
    labels: npt.NDArray[np.uint8]
    train: npt.NDArray[np.intp]
    validation: npt.NDArray[np.intp]
    held_out: dict[str, npt.NDArray[np.intp]]
    digest: str
    seed: int
    protocol_id: str = PROTOCOL_ID
    skin: Skin = PAPER
    touch_kind: TouchKind = "raise"
    drift: npt.NDArray[np.float32] | None = None
    bends: tuple[Bend | None, ...] = ()

    @property
    def apart(self) -> npt.NDArray[np.intp]:
        """(k,) rows at bends never trained on, family after family; without any, those of the validation."""
        return np.concatenate(list(self.held_out.values())) if self.held_out else self.validation

    def require(self, recipe: Recipe) -> None:
        """Check that a recipe can learn from this data.

        Raises:
            MismatchError: It was made for another protocol, or has the other kind of labels.
        """
        hint = "make it again with 'eitskin dataset'"
        if self.protocol_id != PROTOCOL_ID:
            raise MismatchError("data set: protocol_id", found=self.protocol_id, expected=PROTOCOL_ID, hint=hint)
        if self.labels_kind != recipe.labels:
            raise MismatchError(
                f"data set for recipe {recipe.name}: labels",
                found=self.labels_kind,
                expected=recipe.labels,
                hint=f"{hint} --set {'free' if recipe.labels == 'area' else 'units'}",
            )


@dataclass(frozen=True, slots=True)
class Batch:
    """What one step learns from.

    Args:
        dv: (B, 104) noisy relative change.
        clouds: (C, 3, rows, columns) the clouds that occur.
        which: (B,) the cloud of each sample.
        log_predicted: (B, 104) log(V_pred / V0).
        labels: (B, n_units) or (B, n_pixels), in [0, 1].
    """

    dv: Tensor
    clouds: Tensor
    which: Tensor
    log_predicted: Tensor
    labels: Tensor

    def to(self, device: torch.device) -> "Batch":
        """Return the batch on a device."""
        return Batch(*(getattr(self, name).to(device) for name in ("dv", "clouds", "which", "log_predicted", "labels")))


def noisy_change(
    data: TrainingData,
    rows: npt.NDArray[np.intp],
    kinds: tuple[Kind, ...],
    snr_db: float | tuple[float, float],
    rng: np.random.Generator,
) -> npt.NDArray[np.float32]:
    """Return (n, 104) dV of samples, each with noise of a kind drawn from ``kinds``, and of a level of a range."""
    voltages = data.voltages[rows]
    level = snr_db if isinstance(snr_db, float | int) else rng.uniform(*snr_db, (len(rows), 1))
    noisy = np.empty(voltages.shape, dtype=np.float64)
    kind = rng.integers(len(kinds), size=len(rows))
    for index, name in enumerate(kinds):
        chosen = kind == index
        own = level if isinstance(level, float | int) else level[chosen]
        noisy[chosen] = add_noise(voltages[chosen], data.reference, name, own, rng)
    return relative_change(noisy, data.reference).astype(np.float32)


def in_order(data: TrainingData, recipe: Recipe, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """Return (steps, B) training samples, batch by batch; the last few, which fill no batch, are left out.

    Each batch has few deformations where that is asked for: samples come group of deformations by group of
    deformations, cut into batches, so one has those of two groups at most where a group fills a batch.
    """
    size = min(recipe.batch, len(data.train))
    rows = rng.permutation(data.train)
    if recipe.together:
        bends = rng.permutation(np.unique(data.deformation[data.train]))
        group = np.empty(len(data.clouds), dtype=np.intp)
        group[bends] = np.arange(len(bends)) % -(-len(bends) // recipe.together)
        rows = rows[np.argsort(group[data.deformation[rows]], kind="stable")]
    whole = rows[: len(rows) // size * size].reshape(-1, size)
    return np.asarray(rng.permutation(whole) if recipe.together else whole)


def assemble(
    data: TrainingData,
    rows: npt.NDArray[np.intp],
    dv: npt.NDArray[np.float32],
    predicted: npt.NDArray[np.float32],
    mirror: Mirror | None = None,
) -> Batch:
    """Return a batch of given rows, in one mirror image.

    Args:
        data: The data set.
        rows: (B,) samples.
        dv: (B, 104) their relative change, in the table's order.
        predicted: (B, 104) log(V_pred / V0), likewise.
        mirror: The image to show; the skin itself by default.
    """
    mirror = mirrors(data.skin)[0] if mirror is None else mirror
    occurring, which = np.unique(data.deformation[rows], return_inverse=True)
    columns = mirror.units if data.labels_kind == "units" else mirror.pixels
    labels = data.labels[data.touch_set[rows]][:, columns].astype(np.float32)
    if data.labels_kind == "area":
        labels *= np.float32(1.0 / 255.0)
    return Batch(
        torch.from_numpy(np.ascontiguousarray(dv[:, mirror.rows])),
        torch.from_numpy(mirror.clouds(data.clouds[occurring])),
        torch.from_numpy(which.astype(np.int64)),
        torch.from_numpy(np.ascontiguousarray(predicted[:, mirror.rows])),
        torch.from_numpy(labels),
    )


def consistency_of(data: TrainingData, recipe: Recipe) -> RowGaussian:
    """Return how rows go together in the training samples under the recipe's noise; the same at every call."""
    return fit(noisy_change(data, _spread(data), recipe.noises, recipe.snr_db, np.random.default_rng(0)))


def inputs(data: TrainingData, recipe: Recipe) -> Tensor:
    """Return (n, 104 * blocks) features of training samples in every mirror image that the network sees."""
    rng, rows = np.random.default_rng(0), _spread(data)
    found = []
    symmetric = recipe.architecture.symmetric
    for mirror in mirrors(data.skin, near=symmetric)[: None if recipe.flips or symmetric else 1]:
        dv = noisy_change(data, rows, recipe.noises, recipe.snr_db, rng)
        batch = assemble(data, rows, dv, data.log_predicted[data.deformation[rows]], mirror)
        found.append(features(batch.dv, recipe.architecture, batch.log_predicted))
    return torch.cat(found)


def _spread(data: TrainingData) -> npt.NDArray[np.intp]:
    """Return the rows of ``MAX_SAMPLES`` training samples, spread evenly over them; of all if there are fewer."""
    return data.train[np.unique(np.linspace(0, len(data.train) - 1, MAX_SAMPLES).astype(np.intp))]
