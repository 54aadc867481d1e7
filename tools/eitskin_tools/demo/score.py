"""Scores the record of a demonstration: latency, completeness and accuracy.

Latency of a frame counts from the moment before the virtual skin's write to its port to the moment after the
subscriber's receive; both processes read the same clock (CLOCK_MONOTONIC), so nothing has to be estimated. The truth
of a frame is the script's at the frame's device time, which is what the sheet was when it was scanned.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_tools.demo.recorder import STAGES, Record

SPANS: Final = ("wire", *STAGES[1:], "deliver")
"""What a frame goes through: wire is from the device's write to the last byte in hand, deliver from there on."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How well maps agree with the truth."""

    cc_median: float | None
    """Over the frames of which something was touched; None if there were none."""
    cc_median_flat: float | None
    cc_median_bent: float | None
    scored: int
    """Touched frames of which the map was kept."""
    missed: float | None
    """Share of touched frames that the gate took for untouched."""
    false_alarms: float | None
    """Share of untouched frames that the gate took for touched."""


def percentiles_us(values_ns: npt.NDArray[np.integer]) -> dict[str, float]:
    """Return p50, p99, p999 and max of some times, in us."""
    if not len(values_ns):
        return {}
    found = np.percentile(values_ns, [50, 99, 99.9, 100]) / 1000
    return {name: round(float(value), 1) for name, value in zip(("p50", "p99", "p999", "max"), found, strict=True)}


def timing(record: Record, wire_ns: npt.NDArray[np.int64]) -> dict[str, Any]:
    """Return frames, rate, losses, latency and stages of a record.

    Args:
        record: What the subscriber noted.
        wire_ns: (capacity,) when each sequence number went onto the wire; 0 where none did, negative where the line had
            no room because the runtime did not read in time.

    Raises:
        ValueError: The record is empty.
    """
    count = len(record.sequence)
    if count == 0:
        raise ValueError("not one frame was recorded")
    written = wire_ns[record.sequence % len(wire_ns)]
    known = written > 0
    spans = np.concatenate(
        [(record.host_ns[:, :1] - written[:, None]), np.diff(record.host_ns, axis=1),
         record.received_ns[:, None] - record.host_ns[:, -1:]], axis=1,
    )  # fmt: skip
    latency = record.received_ns - written
    between = np.arange(record.sequence[0], record.sequence[-1])
    elapsed_s = (record.received_ns[-1] - record.received_ns[0]) * 1e-9
    return {
        "frames": count,
        "seconds": round(float(elapsed_s), 3),
        "rate_hz": round((count - 1) / elapsed_s, 2) if count > 1 else 0.0,
        "lost": int(record.sequence[-1] - record.sequence[0] + 1 - count),
        "corrupt": record.corrupt,
        "overruns": int(np.count_nonzero(wire_ns[between % len(wire_ns)] < 0)),
        "latency_us": percentiles_us(latency[known]),
        "inferred": int(np.count_nonzero(record.inferred)),
        "latency_inferred_us": percentiles_us(latency[known & record.inferred]),
        "stages_us": {name: percentiles_us(spans[known, column]) for column, name in enumerate(SPANS)},
        "clouds": int(np.count_nonzero(np.diff(record.cloud))),
    }


def accuracy(record: Record, script: Any, start_us: int) -> Accuracy:
    """Return how well a record's maps agree with the script's truth.

    Args:
        record: What the subscriber noted.
        script: What the virtual skin played.
        start_us: Device clock when the script began.
    """
    from eitskin_sim.evaluation.metrics import correlation
    from eitskin_sim.scene.scene import Bend

    first_us = int(record.device_us[0])
    times_s = ((first_us - start_us) % (1 << 32) + record.device_us - first_us) * 1e-6
    touched = np.array([bool(script.scene_at(time_s).touches) for time_s in times_s])
    correlations: Mapping[bool, list[float]] = {True: [], False: []}
    for index in np.flatnonzero(touched[:: record.stride]):
        time_s = times_s[index * record.stride]
        image = record.maps[index].astype(np.float64)
        flat = script.scene_at(time_s).bend == Bend()
        correlations[flat].append(correlation(image, script.truth_at(time_s)))
    both = correlations[True] + correlations[False]
    return Accuracy(
        cc_median=_median(both),
        cc_median_flat=_median(correlations[True]),
        cc_median_bent=_median(correlations[False]),
        scored=len(both),
        missed=_share(~record.touched[touched]),
        false_alarms=_share(record.touched[~touched]),
    )


def _median(values: list[float]) -> float | None:
    return round(float(np.median(values)), 4) if values else None


def _share(flags: npt.NDArray[np.bool_]) -> float | None:
    return round(float(flags.mean()), 4) if len(flags) else None
