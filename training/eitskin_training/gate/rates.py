"""A gate's error rates on unseen bends: false alarms with their uncertainty, and misses.

Frames of one bend trip a gate together, so the number of bends, not that of frames, determines how well a rate is
known. The interval is that of a mean over bends, 95 % two-sided; where no bend ever tripped the gate, n bends say that
with 95 % confidence fewer than 3 / n do.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from eitskin_proto.sensor.row_gaussian import log_of_ratio
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.measurement.noise import NOISES
from eitskin_training.gate.material import drifted, images_of, noisy_change
from eitskin_training.gate.untouched import Bends
from eitskin_training.samples.batches import TrainingData, pixels_per_unit

SMALL_TOUCH_PIXELS: Final = 12.0
"""A touch of at most this area, about 11.5 mm square, counts as small."""

DRAWS: Final = 16
"""Noise draws of a bend over all its mirror images, for each noise."""

DRIFT: Final = 0.01
"""Standard deviation of the common log factor of presses that are to be found: that of a hundred presses."""

SNR_DB: Final = 52.0
"""N2 noise of measured skins."""

FRAMES_TO_FIND_A_PRESS: Final = 5
"""In which a press is to be found."""

DEVICES: Final = 400
"""Presses on random devices."""

Judge = Callable[[Array], Array]
"""(n, 104) dV -> (n,) logits."""


def untouched_frames(
    logs: Array, reference: Array, rng: np.random.Generator, skin: Skin, devices: Skin | None = None
) -> dict[str, Array]:
    """Return by noise the (bends * draws, 104) dV of untouched sheets, shown in each of their mirror images.

    Args:
        logs: (bends, 104) log(V / V0).
        reference: (104,) V0.
        rng: Source of the noise.
        skin: Whose images.
        devices: By whose law every frame drifts; None where nothing does.
    """
    images = images_of(skin)
    shown = np.concatenate([logs[:, rows][:, None] for rows in images], axis=1).repeat(DRAWS // len(images), axis=1)
    flat = drifted(shown.reshape(-1, logs.shape[1]), devices, rng)
    return {kind: noisy_change(flat, reference, rng, kind) for kind in NOISES}


def untouched_logits(
    judge: Judge,
    logs: Array,
    reference: Array,
    rng: np.random.Generator,
    skin: Skin,
    devices: Skin | None = None,
) -> dict[str, Array]:
    """Return by noise the (bends, draws) logits of a gate on :func:`untouched_frames`."""
    frames = untouched_frames(logs, reference, rng, skin, devices)
    return {kind: judge(changes).reshape(len(logs), -1) for kind, changes in frames.items()}


def threshold_at(
    rate: float,
    judge: Judge,
    logs: Array,
    reference: Array,
    rng: np.random.Generator,
    skin: Skin,
    devices: Skin | None = None,
) -> float:
    """Return the logit above which a share ``rate`` of untouched frames lies, over bends, images and noises."""
    found = untouched_logits(judge, logs, reference, rng, skin, devices)
    return float(np.quantile(np.concatenate([logits.ravel() for logits in found.values()]), 1.0 - rate))


def rate_and_interval(tripped: Array) -> tuple[float, list[float]]:
    """Return the share of frames that trip and its 95 % interval.

    Args:
        tripped: (bends,) the share of each bend's frames.
    """
    rate, count = float(tripped.mean()), len(tripped)
    if rate == 0.0:
        return 0.0, [0.0, min(1.0, 3.0 / count)]
    half = 1.96 * float(tripped.std(ddof=1)) / np.sqrt(count) if count > 1 else 1.0
    return rate, [max(0.0, rate - half), min(1.0, rate + half)]


def measured(
    judge: Judge, threshold: float, data: TrainingData, bends: Bends, rng: np.random.Generator
) -> dict[str, Any]:
    """Return what a gate's manifest entry states."""
    found = untouched_logits(judge, bends.measure, data.reference, rng, data.skin, bends.devices)
    tripped = {kind: (logits > threshold).mean(axis=1) for kind, logits in found.items()}
    rate, interval = rate_and_interval(np.mean(list(tripped.values()), axis=0))
    missed, small = _missed_samples(judge, threshold, data, rng)
    return {
        "false_alarm_rate": rate,
        "false_alarm_interval_95": interval,
        "false_alarm_rate_by_noise": {kind: float(value.mean()) for kind, value in tripped.items()},
        "held_out_bends": len(bends.measure),
        "missed_rate": missed,
        "missed_small_rate": small,
        "missed_by_touch": missed_probes(judge, threshold, bends, data.reference, rng),
    }


def found_presses(
    judge: Judge, threshold: float, bends: Bends, data: TrainingData, rng: np.random.Generator, draws: int = 10
) -> dict[str, dict[str, dict[str, float]]]:
    """Return by touch and bends the share that the first, and any of ``FRAMES_TO_FIND_A_PRESS`` frames, finds.

    Noise is N2 of ``SNR_DB``, and all voltages have drifted by ``DRIFT`` since the reference, the same in all frames of
    one press. Bends are those of a family, of the nominal device, or "devices": the sheets that measure false alarms.
    """
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in dict.fromkeys(probe.name for probe in bends.probes):
        own = [probe for probe in bends.probes if probe.name == name]
        members = {probe.family: probe.logs for probe in own}
        if bends.devices is not None:
            alone = np.concatenate([probe.logs - probe.before for probe in own])
            some = bends.measure[rng.integers(len(bends.measure), size=DEVICES)]
            members["devices"] = some + alone[rng.integers(len(alone), size=DEVICES)]
        found[name] = {}
        for family, logs in members.items():
            still = np.repeat(logs, draws, axis=0)
            still = np.repeat(still + DRIFT * rng.standard_normal((len(still), 1)), FRAMES_TO_FIND_A_PRESS, axis=0)
            seen = (
                judge(noisy_change(still, data.reference, rng, "N2", SNR_DB)).reshape(-1, FRAMES_TO_FIND_A_PRESS)
                > threshold
            )
            found[name][family] = {
                "1": float(seen[:, 0].mean()),
                f"{FRAMES_TO_FIND_A_PRESS}": float(seen.any(axis=1).mean()),
            }
    return found


def missed_probes(
    judge: Judge, threshold: float, bends: Bends, reference: Array, rng: np.random.Generator
) -> dict[str, dict[str, dict[str, float]]]:
    """Return the share of frames missed: by touch, then family of bends, then noise."""
    missed: dict[str, dict[str, dict[str, float]]] = {}
    for probe in bends.probes:
        logs = np.repeat(probe.logs, 10, axis=0)
        missed.setdefault(probe.name, {})[probe.family] = {
            kind: float(np.mean(judge(noisy_change(logs, reference, rng, kind)) <= threshold)) for kind in NOISES
        }
    return missed


def _missed_samples(
    judge: Judge, threshold: float, data: TrainingData, rng: np.random.Generator
) -> tuple[float, float | None]:
    """Return the share of a data set's touched samples, at bends kept apart, that is missed, and that of small ones."""
    rows = data.apart
    labels = data.labels[data.touch_set[rows]].astype(np.float64)
    pixels = labels.sum(axis=1) / 255.0 if data.labels_kind == "area" else labels @ pixels_per_unit(data.skin.grid)
    rows, pixels = rows[pixels > 0], pixels[pixels > 0]
    missed = judge(noisy_change(log_of_ratio(data.voltages[rows], data.reference), data.reference, rng)) <= threshold
    small = pixels <= SMALL_TOUCH_PIXELS
    return float(missed.mean()), float(missed[small].mean()) if small.any() else None
