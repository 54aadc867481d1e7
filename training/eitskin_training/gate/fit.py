"""The touch gate: matched filters that detect untouched frames before the network runs.

A bent sheet moves every voltage although nothing touches it, so a threshold on |dV| cannot distinguish touch from bend,
but the pattern can. Untouched sheets of all bends fill few of the 104 directions of log(V / V0), and a touch, however
small, leaves them. But those directions are the ones of least variance, a thousandth of the largest. So the factor
common to all rows is removed from the logarithms, and what is left is whitened by the covariance of noisy untouched
sheets; the filters work on that (:mod:`eitskin_training.gate.filters`).

The threshold is set at a stated false-alarm rate on bends of families A and B that were not learned from; half of those
choose it and half measure it. A second, smaller gate judges the rows of the few drives that an idle device scans.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import pack_arrays
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.scan_rows import drives_to_list, table_rows
from eitskin_sim.arrays import Array
from eitskin_training.gate import filters
from eitskin_training.gate.idle import idle_choice
from eitskin_training.gate.material import Material
from eitskin_training.gate.rates import found_presses, measured, threshold_at, untouched_frames
from eitskin_training.gate.untouched import Bends
from eitskin_training.samples.batches import TrainingData

FALSE_ALARM_RATE: Final = 0.003
"""Share of untouched frames that may trip the gate. A false alarm costs one inference, and a miss hides a touch."""

IDLE_FALSE_ALARM_RATE: Final = 0.01
"""The same of idle frames: one costs half a second of whole scans."""

FRAMES: Final = 16_384
"""Untouched frames for the covariance, and touched ones for testing filters."""

COVARIANCES: Final = 4
BANKS: Final = 6
"""Draws of untouched frames, and of filters with the covariance of each, of which the best are taken."""

Arrays = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True, slots=True)
class Gate:
    """A gate and what was measured of it on bends it never saw.

    Args:
        arrays: floor, mean and scale (208,), w1 (208, h), b1 (h,), w2 (h, g), b2 (g,), w3 (g,), b3, threshold; the same
            with the prefix idle_ over the idle drives' rows, and idle_drives, 16 bits.
        measures: What a manifest states.
    """

    arrays: Arrays
    measures: dict[str, Any]

    def to_npz(self) -> bytes:
        """Return the arrays as the bytes of an .npz file."""
        return pack_arrays(self.arrays)

    def audited(self, pixels: int) -> "Gate":
        """Return the same gate, overruled by maps with at least this many touched pixels."""
        arrays = {**self.arrays, "audit_pixels": np.asarray(pixels, dtype=np.uint16)}
        return Gate(arrays, {**self.measures, "audit_pixels": pixels})

    def facts(self) -> dict[str, Any]:
        """Return what a manifest states."""
        return self.measures


def gate_features(dv: npt.NDArray[np.floating], floor: float = filters.MIN_RATIO) -> Array:
    """Return (n, 2 r) features of (n, r) dV, as the runtime forms them."""
    return np.concatenate([dv, np.log(np.maximum(1.0 + dv, floor))], axis=1, dtype=np.float64)


def logits(arrays: Arrays, dv: npt.NDArray[np.floating], prefix: str = "") -> Array:
    """Return (n,) logits of (n, r) dV, the way the runtime computes them.

    Args:
        arrays: Of a gate.
        dv: Of the rows that the gate judges.
        prefix: "idle_" for the idle gate.
    """
    part = {name: np.asarray(arrays[prefix + name], dtype=np.float64) for name in _FIELDS}
    x = (gate_features(dv, float(part["floor"])) - part["mean"]) / part["scale"]
    hidden = np.maximum(np.maximum(x @ part["w1"] + part["b1"], 0.0) @ part["w2"] + part["b2"], 0.0)
    return np.asarray(hidden @ part["w3"] + part["b3"])


_FIELDS: Final = ("floor", "mean", "scale", "w1", "b1", "w2", "b2", "w3", "b3")


def fit(data: TrainingData, bends: Bends, *, seed: int = 0) -> Gate:
    """Fit both gates and measure them.

    Args:
        data: A data set: its training samples are touched ones to learn from, its held-out ones measure what is missed.
        bends: Untouched sheets, and small touches.
        seed: Of draws and noise.

    Raises:
        SkinError: No bends are held out.
    """
    if not len(bends.choose) or not len(bends.measure):
        raise SkinError(
            f"{len(bends.choose)} held-out bends to choose the gate's threshold and {len(bends.measure)} to measure "
            "it, expected at least 1 of each; make the data set with 'eitskin dataset' and more deformations"
        )
    rng = np.random.default_rng([seed, 0x6A7E])
    material = Material.of(data, bends, rng)
    found: Arrays = {}
    measures: dict[str, Any] = {}
    drives = idle_choice(material, rng)
    for prefix, rows, rate in (
        ("", np.arange(N_ROWS), FALSE_ALARM_RATE),
        ("idle_", table_rows(False, drives), IDLE_FALSE_ALARM_RATE),
    ):
        arrays = _matched(material, rows, rate, bends, data, rng)

        def judge(dv: Array, arrays: Arrays = arrays, rows: npt.NDArray[np.intp] = rows) -> Array:
            return logits(arrays, dv[:, rows])

        threshold = threshold_at(rate, judge, bends.choose, data.reference, rng, data.skin, bends.devices)
        arrays["threshold"] = np.asarray(threshold, dtype=np.float32)
        found |= {prefix + name: value for name, value in arrays.items()}
        measures[prefix] = {"target_false_alarm_rate": rate, **measured(judge, threshold, data, bends, rng)}
        if not prefix and bends.probes and (bends.devices is not None or data.touch_kind != "raise"):
            measures[prefix]["found_presses"] = found_presses(judge, threshold, bends, data, rng)
    found["idle_drives"] = np.asarray(drives, dtype=np.uint16)
    idle = {"drives": drives_to_list(drives), **measures["idle_"]}
    return Gate(found, {**measures[""], "idle": idle})


def _matched(
    material: Material,
    rows: npt.NDArray[np.intp],
    rate: float,
    bends: Bends,
    data: TrainingData,
    rng: np.random.Generator,
) -> Arrays:
    """Return the arrays of a gate of matched filters but for its threshold, which is next to 0.

    Which moments the covariance is of, and which touches the filters, is drawn; what far-off moments do to a filter is
    luck. So several are drawn, and the one that finds most small touches at its own limit is taken.
    """
    kinds = untouched_frames(bends.choose, data.reference, rng, data.skin, bends.devices)
    untouched = _logarithms(np.concatenate(list(kinds.values())), rows)
    small = filters.seen(bends.touches if len(bends.touches) else material.touches)
    touched = _logarithms(material.touched(small, FRAMES, rng), rows)
    best, found = -1.0, Arrays()
    for _ in range(COVARIANCES):
        mean, whitening = filters.whitening_of(_logarithms(material.noisy_untouched(FRAMES, rng), rows))
        still, pressed = ((logarithms - mean) @ whitening for logarithms in (untouched, touched))
        for _ in range(BANKS):
            bank = filters.bank(filters.patterns(material.touches[:, rows], len(bends.touches), rng) @ whitening, rng)
            limit = float(np.quantile(filters.ratios(still, bank), 1.0 - rate))
            share = float((filters.ratios(pressed, bank) > limit).mean())
            if share > best:
                best = share
                first, second, bias = filters.layers(whitening, bank, limit)
                found = filters.in_form(mean, first, np.zeros(first.shape[1]), second, bias, np.ones(len(bank)), 0.0)
    return found


def _logarithms(dv: Array, rows: npt.NDArray[np.intp]) -> Array:
    return np.log(np.maximum(1.0 + dv[:, rows], filters.MIN_RATIO))
