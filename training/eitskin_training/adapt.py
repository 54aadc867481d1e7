"""A short second training for missing electrodes: the network and the filling of their rows are trained together.

Training shows a network rows that the Gaussian filled in, now and then (:mod:`eitskin_training.samples.batches`).
This stage starts from a run's best epoch ::

    1. fitting     the filling alone, towards the rows that are missing
    2. together    filling and network on the training's loss; half of each batch lacks one to four electrodes

Alone, a filling that is nearer to the true rows makes the maps worse: the network knows the Gaussian's errors and not
the new ones (held-out CC 0.857 instead of 0.875). Together both gain. The cloud's half of the network stays as it is,
and so do the statistics of its normalisation. The result is a ``best.pt`` like any other, with the filling in it.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from eitskin_proto.sensor.row_gaussian import log_of_change
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_training.network.filling import WIDTH, Filling, Missing
from eitskin_training.network.mirror import mirrors
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin_training.resident import lose_rows
from eitskin_training.run import decayed
from eitskin_training.run_files import write_file
from eitskin_training.samples.batches import TrainingData, assemble, consistency_of, noisy_change
from eitskin_training.score import correlations, training_loss, truth_of

SCORED: Final = 600
"""Held-out samples, with N2 noise."""

SCORED_SETS: Final = 6
"""Of two and of three lost electrodes; of one, all 16."""


def held_out(model: VD2T, filling: Filling, data: TrainingData) -> dict[str, float]:
    """Return the mean CC of maps on bends never trained on: whole, and without one, two and three electrodes."""
    rng = np.random.default_rng([0, 0x0FF])
    rows = data.apart
    rows = np.sort(rng.choice(rows, size=min(SCORED, len(rows)), replace=False))
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
        return float(correlations(maps[touched], truth[touched]).mean())

    with torch.inference_mode():
        bias = model.bias(batch.clouds)[batch.which]
        found = {"whole": cc(())}
        single = [cc((electrode,)) for electrode in range(N_ELECTRODES)]
        found |= {"one_lost": float(np.mean(single)), "worst_lost": min(single)}
        for name, count in (("two_lost", 2), ("three_lost", 3)):
            drawn = [tuple(sorted(rng.choice(N_ELECTRODES, count, replace=False).tolist())) for _ in range(SCORED_SETS)]
            found[name] = float(np.mean([cc(electrodes) for electrodes in drawn]))
    return {name: round(value, 5) for name, value in found.items()}


def score_line(scores: dict[str, float]) -> str:
    """Return scores as a line."""
    return "held-out CC " + ", ".join(f"{name} {value:.4f}" for name, value in scores.items())


LOST_ELECTRODES_CHANCES: Final = (0.55, 0.25, 0.13, 0.07)
"""Chances that one to four electrodes are gone; the runtime leaves out four at most."""

GROUPS: Final = 8
"""Different sets of electrodes in a batch."""

ROWS_WEIGHT: Final = 2e-3
"""Of the rows' own error beside the cross-entropy: what is filled in stays near voltages, which the gate reads too."""

RISING_STEPS: Final = 50
"""Steps in which a learning rate rises; then it falls as half a cosine."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How long and how fast."""

    fitting_steps: int = 2000
    steps: int = 3000
    batch: int = 512
    fitting_rate: float = 3e-3
    rate: float = 1e-3
    share: float = 0.5
    """Of a batch that loses electrodes."""
    width: int = WIDTH
    """Of the filling."""

    def __post_init__(self) -> None:
        if self.fitting_steps < 0 or self.steps < 0 or self.batch < 2 * GROUPS or not 0.0 < self.share <= 1.0:
            raise ValueError(
                f"a plan of {self.fitting_steps} and {self.steps} steps, batches of {self.batch}, a share of "
                f"{self.share}; expected no negative steps, at least {2 * GROUPS} in a batch, 0 < share <= 1"
            )


@dataclass(frozen=True, slots=True)
class Adapted:
    """What comes out.

    Args:
        model: The network, in evaluation mode.
        filling: What fills missing rows in for it.
        facts: Held-out accuracy before and after.
    """

    model: VD2T
    filling: Filling
    facts: dict[str, Any]


def adapt(
    model: VD2T,
    recipe: Recipe,
    data: TrainingData,
    plan: Plan | None = None,
    *,
    seed: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> Adapted:
    """Return a network and a filling trained together; changes the given model.

    Args:
        model: A trained network.
        recipe: Of it: noise, flips, missing rows.
        data: The data set that it was trained on.
        plan: Lengths and rates.
        seed: Of every draw.
        tell: Called with the progress.
    """
    plan = Plan() if plan is None else plan
    torch.manual_seed(seed)
    model.eval()
    filling = Filling(consistency_of(data, recipe), plan.width)
    before = held_out(model, filling, data)
    tell(f"before: {score_line(before)}")
    biases = _biases(model, data)
    rng = np.random.default_rng([seed, 0xADA])
    frozen = {id(parameter) for part in (model.cloud, model.fusion_cloud) for parameter in part.parameters()}
    for parameter in model.parameters():
        parameter.requires_grad_(False)

    def towards_rows() -> Tensor:
        return _rows_loss(filling, _draw(data, recipe, plan.batch, 1.0, rng))

    def together() -> Tensor:
        return _map_loss(model, recipe, filling, biases, data, _draw(data, recipe, plan.batch, plan.share, rng))

    _run(plan.fitting_steps, plan.fitting_rate, list(filling.parameters()), 0.0, tell, towards_rows)
    for parameter in model.parameters():
        parameter.requires_grad_(id(parameter) not in frozen)
    learning = [p for p in (*model.parameters(), *filling.parameters()) if p.requires_grad]
    _run(plan.steps, plan.rate, learning, recipe.weight_decay, tell, together)
    for parameter in model.parameters():
        parameter.requires_grad_(True)
    after = held_out(model, filling, data)
    tell(f"after: {score_line(after)}")
    return Adapted(model, filling, {"plan": asdict(plan), "seed": seed, "before": before, "after": after})


@dataclass(frozen=True, slots=True)
class _Drawn:
    """One batch."""

    logs: Tensor
    change: Tensor
    groups: list[tuple[slice, Missing]]
    incomplete: int
    predicted: Tensor
    rows: npt.NDArray[np.intp]
    mirror: int


def _draw(data: TrainingData, recipe: Recipe, size: int, share: float, rng: np.random.Generator) -> _Drawn:
    """Return samples of which the first ``share`` lose electrodes, in groups."""
    rows = rng.choice(data.train, size=size)
    number = int(rng.integers(len(mirrors(data.skin)))) if recipe.flips else 0
    change = noisy_change(data, rows, recipe.noises, recipe.snr_db, rng)
    incomplete = max(GROUPS, int(share * size))
    whole = torch.from_numpy(change[incomplete:])
    change[incomplete:] = lose_rows(whole, recipe.lost_rows, torch.default_generator).numpy()
    predicted = data.log_predicted[data.deformation[rows]]
    predicted[rng.random(size) < recipe.predicted_dropout] = 0.0
    image = mirrors(data.skin)[number].rows
    change, predicted = np.ascontiguousarray(change[:, image]), np.ascontiguousarray(predicted[:, image])
    edges = np.linspace(0, incomplete, GROUPS + 1).astype(int)
    groups = []
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        count = int(rng.choice(len(LOST_ELECTRODES_CHANCES), p=LOST_ELECTRODES_CHANCES)) + 1
        chosen = tuple(sorted(rng.choice(N_ELECTRODES, count, replace=False).tolist()))
        groups.append((slice(start, stop), chosen))
    logs = torch.from_numpy(log_of_change(change[:incomplete]).astype(np.float32))
    return _Drawn(logs, torch.from_numpy(change), groups, incomplete, torch.from_numpy(predicted), rows, number)


def _rows_loss(filling: Filling, drawn: _Drawn) -> Tensor:
    """Return the mean square error of filled-in rows, in variances that the Gaussian leaves them."""
    filled, missing = filling(drawn.logs, drawn.groups, drawn.predicted[: drawn.incomplete])
    return _rows_error(filling, drawn, filled, missing)


def _rows_error(filling: Filling, drawn: _Drawn, filled: Tensor, missing: Tensor) -> Tensor:
    scale = torch.cat(
        [
            filling.gaussian.uncertainty(electrodes).expand(part.stop - part.start, -1)
            for part, electrodes in drawn.groups
        ]
    )
    return (((filled - drawn.logs) / scale).square() * missing).sum() / missing.sum()


def _map_loss(
    model: VD2T, recipe: Recipe, filling: Filling, biases: list[Tensor], data: TrainingData, drawn: _Drawn
) -> Tensor:
    filled, missing = filling(drawn.logs, drawn.groups, drawn.predicted[: drawn.incomplete])
    change = torch.cat(
        [torch.where(missing, torch.expm1(filled), drawn.change[: drawn.incomplete]), drawn.change[drawn.incomplete :]]
    )
    mirror = mirrors(data.skin)[drawn.mirror]
    columns = mirror.units if data.labels_kind == "units" else mirror.pixels
    labels = torch.from_numpy(data.labels[data.touch_set[drawn.rows]][:, columns].astype(np.float32))
    if data.labels_kind == "area":
        labels = labels / 255.0
    bias = biases[drawn.mirror][torch.from_numpy(data.deformation[drawn.rows])]
    logits = model.logits(change, bias, drawn.predicted)
    found = training_loss(logits, labels, recipe.correlation_weight, data.skin.grid)
    return found + ROWS_WEIGHT * _rows_error(filling, drawn, filled, missing)


def _biases(model: VD2T, data: TrainingData) -> list[Tensor]:
    """Return what each cloud adds, (D, H) for each mirror image: the cloud's half does not change."""
    with torch.inference_mode():
        found = [model.bias(torch.from_numpy(mirror.clouds(data.clouds))) for mirror in mirrors(data.skin)]
    return [bias.clone() for bias in found]


def _run(
    steps: int,
    rate: float,
    learning: list[torch.nn.Parameter],
    decay: float,
    tell: Callable[[str], None],
    loss: Callable[[], Tensor],
) -> None:
    optimiser = torch.optim.AdamW(decayed(learning, decay), lr=rate)
    mean = 0.0
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = rate * _share(step, steps)
        value = loss()
        optimiser.zero_grad(set_to_none=True)
        value.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        mean += float(value.detach())
        if (step + 1) % 250 == 0:
            tell(f"step {step + 1}/{steps} loss {mean / 250:.5f}")
            mean = 0.0


def _share(step: int, steps: int) -> float:
    """Return the share of the peak learning rate at a step."""
    return min(1.0, (step + 1) / RISING_STEPS) * (0.5 + 0.5 * math.cos(math.pi * step / steps))


def write(out: Path, content: dict[str, Any], adapted: Adapted) -> Path:
    """Write RUN/best.pt, which ``eitskin export`` reads, and return its path.

    Args:
        out: The new run's folder.
        content: Of the ``best.pt`` that was adapted.
        adapted: The result.
    """
    out.mkdir(parents=True, exist_ok=True)
    arrays = adapted.filling.arrays()
    found = {
        **content,
        "weights": adapted.model.state_dict(),
        "filling": {name: torch.from_numpy(value) for name, value in arrays.items()},
        "adapted": adapted.facts,
    }
    path = out / "best.pt"
    write_file(path, found)
    return path
