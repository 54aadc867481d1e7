"""The touch gate: a very small network that says "nothing touches" before the large one is asked.

A bent sheet moves every voltage although nothing touches it, so a threshold on |dV| cannot tell touch from bend; what
tells them apart is the pattern. The gate learns it from both ::

    [dV, log(max(1 + dV, 1e-3))] (208) -> standardise -> linear 32 -> ReLU -> linear 1 = logit
    touched: logit > threshold

It sees touched samples and untouched sheets at many bends, some of them drawn between two others: the voltages of a
partial bend are close to a mean of the logarithms of V / V0. Half of the touched samples are moved to another bend, by
the same logarithms. A false alarm costs one inference and a miss hides a touch; the threshold is therefore put at a
stated false-alarm rate on bends that were not trained on, half of which choose it and half of which measure it.
"""

import io
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from eitskin_export.untouched import Bends
from eitskin_proto.errors import SkinError
from eitskin_proto.normalise import relative_change
from eitskin_proto.table import N_ROWS
from eitskin_sim.noise import KINDS, add_noise
from eitskin_training.data import PIXELS_PER_UNIT, TrainingData
from eitskin_training.model import RATIO_FLOOR

HIDDEN: Final = 32
"""Width of the gate's one hidden layer."""

FALSE_ALARM_RATE: Final = 0.1
"""Share of untouched frames that may trip the gate. At 1 % one odd bend of seventy puts the threshold so high that 61 %
of single units are missed, at 5 % 18 %, at 10 % none; a false alarm costs one inference."""

STEPS: Final = 3000
"""Steps of Adam."""

SMALL_TOUCH_PIXELS: Final = 12.0
"""A touch of at most this area, about 11.5 mm square, counts as small."""

_NOISES: Final = tuple(kind for kind in KINDS if kind != "none")

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Gate:
    """A trained gate and what was measured of it on bends it never saw.

    Args:
        arrays: mean, scale (208,), w1 (208, 32), b1 (32,), w2 (32,), b2 (), threshold ().
        false_alarm_rate: Share of untouched frames that trip it.
        missed_rate: Share of touched frames that do not.
        missed_small_rate: The same over touches of at most ``SMALL_TOUCH_PIXELS``; None when there were none.
        bends: How many bends it was measured on.
    """

    arrays: dict[str, npt.NDArray[np.float32]]
    false_alarm_rate: float
    missed_rate: float
    missed_small_rate: float | None
    bends: int

    def to_npz(self) -> bytes:
        """Return the arrays as the bytes of an .npz file."""
        buffer = io.BytesIO()
        np.savez(buffer, **self.arrays)  # type: ignore[arg-type]
        return buffer.getvalue()

    def facts(self) -> dict[str, float | int | None]:
        """Return what a manifest states."""
        return {
            "target_false_alarm_rate": FALSE_ALARM_RATE,
            "false_alarm_rate": self.false_alarm_rate,
            "missed_rate": self.missed_rate,
            "missed_small_rate": self.missed_small_rate,
            "held_out_bends": self.bends,
        }


def gate_features(dv: npt.NDArray[np.floating]) -> Array:
    """Return (n, 208) features of (n, 104) dV."""
    return np.concatenate([dv, np.log(np.maximum(1.0 + dv, RATIO_FLOOR))], axis=1, dtype=np.float64)


def logits(arrays: dict[str, npt.NDArray[np.float32]], dv: npt.NDArray[np.floating]) -> Array:
    """Return (n,) logits of (n, 104) dV, the way the runtime computes them."""
    x = (gate_features(dv) - arrays["mean"]) / arrays["scale"]
    return np.asarray(np.maximum(x @ arrays["w1"] + arrays["b1"], 0.0) @ arrays["w2"] + arrays["b2"])


def fit(data: TrainingData, bends: Bends, *, seed: int = 0, steps: int = STEPS, batch: int = 512) -> Gate:
    """Train a gate and measure it.

    Args:
        data: A data set: its training samples are the touched ones, its held-out ones measure what is missed.
        bends: Untouched sheets.
        seed: Of weights, draws and noise.
        steps: Steps of Adam.
        batch: Samples a step, half of them untouched.

    Raises:
        SkinError: No bends are held out.
    """
    if not len(bends.choose) or not len(bends.measure):
        raise SkinError(
            f"{len(bends.choose)} held-out bends to choose the gate's threshold and {len(bends.measure)} to measure "
            "it, expected at least 1 of each; make the data set with 'eitskin dataset' and more deformations"
        )
    rng = np.random.default_rng([seed, 0x6A7E])
    torch.manual_seed(seed)
    rows = data.train[data.labels[data.touch_set[data.train]].any(axis=1)]
    start = gate_features(_draw(data, rows, bends.train, 4096, rng)[0])
    mean, scale = start.mean(axis=0), start.std(axis=0) + 1e-6
    first, last = nn.Linear(2 * N_ROWS, HIDDEN), nn.Linear(HIDDEN, 1)
    network = nn.Sequential(first, nn.ReLU(), last)
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        dv, touched = _draw(data, rows, bends.train, batch, rng)
        x = torch.from_numpy(((gate_features(dv) - mean) / scale).astype(np.float32))
        loss = nn.functional.binary_cross_entropy_with_logits(network(x)[:, 0], torch.from_numpy(touched))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    arrays = {
        "mean": mean,
        "scale": scale,
        "w1": first.weight.detach().numpy().T,
        "b1": first.bias.detach().numpy(),
        "w2": last.weight.detach().numpy()[0],
        "b2": last.bias.detach().numpy()[0],
    }
    return _measure({name: np.asarray(value, dtype=np.float32) for name, value in arrays.items()}, data, bends, rng)


def _draw(
    data: TrainingData, rows: npt.NDArray[np.intp], bends: Array, count: int, rng: np.random.Generator
) -> tuple[Array, npt.NDArray[np.float32]]:
    """Return (count, 104) noisy dV and (count,) 1 where touched: half of them each, at full and partial bends."""
    half, rest = count // 2, count - count // 2
    chosen = rng.choice(rows, size=half)
    own = np.log(data.untouched[data.deformation[chosen]] / data.reference)
    moved = np.where(rng.random(half) < 0.5, 0.0, 1.0)[:, None]
    logs = np.log(np.maximum(data.voltages[chosen] / data.reference, 1e-6)) - moved * own
    logs += moved * _drawn_bends(bends, half, rng)
    logs = np.concatenate([logs, _drawn_bends(bends, rest, rng)])
    touched = np.repeat(np.array([1, 0], dtype=np.float32), [half, rest])
    return _noisy_change(data.reference * np.exp(logs), data.reference, rng), touched


def _drawn_bends(bends: Array, count: int, rng: np.random.Generator) -> Array:
    """Return (count, 104) log(V / V0): half are bends, half lie between two bends or between one and flat."""
    one, other = bends[rng.integers(len(bends), size=count)], bends[rng.integers(len(bends), size=count)]
    kind, share = rng.random(count)[:, None], rng.random(count)[:, None]
    mixed = share * one + np.where(kind < 0.75, 0.0, 1.0 - share) * other
    return np.asarray(np.where(kind < 0.5, one, mixed))


def _noisy_change(voltages: Array, reference: Array, rng: np.random.Generator) -> Array:
    kind = rng.integers(len(_NOISES), size=len(voltages))
    noisy = np.empty_like(voltages)
    for index, name in enumerate(_NOISES):
        noisy[kind == index] = add_noise(voltages[kind == index], reference, name, 50.0, rng)  # type: ignore[arg-type]
    return relative_change(noisy, reference)


def _measure(
    arrays: dict[str, npt.NDArray[np.float32]],
    data: TrainingData,
    bends: Bends,
    rng: np.random.Generator,
    draws: int = 50,
) -> Gate:
    def untouched(logs: Array) -> Array:
        voltages = np.repeat(data.reference * np.exp(logs), draws, axis=0)
        return logits(arrays, _noisy_change(voltages, data.reference, rng))

    threshold = float(np.quantile(untouched(bends.choose), 1.0 - FALSE_ALARM_RATE))
    rows = np.concatenate(list(data.held_out.values())) if data.held_out else data.validation
    labels = data.labels[data.touch_set[rows]].astype(np.float64)
    pixels = labels.sum(axis=1) / 255.0 if data.labels_kind == "area" else labels @ PIXELS_PER_UNIT
    rows, pixels = rows[pixels > 0], pixels[pixels > 0]
    missed = logits(arrays, _noisy_change(data.voltages[rows].astype(np.float64), data.reference, rng)) <= threshold
    small = pixels <= SMALL_TOUCH_PIXELS
    return Gate(
        arrays={**arrays, "threshold": np.asarray(threshold, dtype=np.float32)},
        false_alarm_rate=float(np.mean(untouched(bends.measure) > threshold)),
        missed_rate=float(missed.mean()),
        missed_small_rate=float(missed[small].mean()) if small.any() else None,
        bends=len(bends.measure),
    )
