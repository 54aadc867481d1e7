"""``eitskin bench stability``: noise, absurd inputs, and the same input twice.

::

    noise       N1 to N3 from 80 to 20 dB through every engine of the runtime: the levels at which a tenth and half of
                the accuracy are lost, interpolated
    inputs      inputs that no working sheet gives (:mod:`eitskin_tools.bench.stability_inputs`)
    repeat      the same input in two sessions, in another process, with two threads

Every published map passes a check: the summary counts those that are not finite, or not from 0 to 1. The command exits
with 1 if there is one, or if an input ended in an exception that is no refusal.
"""

import argparse
import math
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.session import onnxruntime, session_options
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_tools.bench.harness import Row, chosen, report, say, several
from eitskin_tools.bench.stability_inputs import input_rows
from eitskin_tools.bench.stability_probe import Sample, Stream, Tally, samples
from eitskin_tools.command_line import files

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

FAMILIES: Final = ("noise", "inputs", "repeat")
"""What ``--only`` takes."""

KINDS: Final[tuple[Kind, ...]] = ("N1", "N2", "N3")
SNR_DB: Final = (80.0, 70.0, 60.0, 50.0, 45.0, 40.0, 35.0, 30.0, 25.0, 20.0)

INPUTS: Final = 16
"""That are repeated."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--quick", action="store_true", help="thinned: under a minute of one core")
    parser.add_argument(
        "--only", action="append", type=several(FAMILIES), metavar="NAME[,NAME]", help=f"of {', '.join(FAMILIES)}"
    )
    parser.add_argument(
        "--bundle", type=files.bundle, metavar="FILE", help="bundle to stress (default: the shipped one of unit labels)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows and summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0 if nothing absurd was published and nothing escaped."""
    start = time.process_time()
    bundle, tally, quick = load_bundle(arguments.bundle or default_path("units")), Tally(), arguments.quick
    shown = samples("units" if bundle.labels == "units" else "area", 2 if quick else 8, 6.0 if quick else 3.0)
    makers: dict[str, Callable[[], list[Row]]] = {
        "noise": lambda: noise_rows(Stream(bundle, tally), shown, quick=quick),
        "inputs": lambda: input_rows(bundle, shown[0], tally),
        "repeat": lambda: repeat_rows(bundle, shown),
    }
    rows: list[Row] = []
    for family in chosen(arguments.only, FAMILIES):
        say("stability", family)
        rows += [{"family": family, **row} for row in makers[family]()]
    counts = tally.summary()
    summary = {
        "rows": len(rows), "broken": sum(row["breaks_at"] is not None for row in rows), **counts,
        "first_escaped": tally.escaped[0] if tally.escaped else "", "cpu_s": round(time.process_time() - start, 1),
    }  # fmt: skip
    report(arguments, rows, summary)
    return 0 if is_sound(counts) else 1


def is_sound(counts: Row) -> bool:
    """Return whether nothing absurd was published and nothing escaped."""
    faults = ("published_not_finite", "published_out_of_range", "published_saturated_unmarked", "escaped")
    return not any(counts[name] for name in faults)


def short(value: float | None) -> float | None:
    """Return a number with four significant digits; None for none, and for what is not finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.4g}")


def crossing(levels: Sequence[float], values: Sequence[float], threshold: float) -> float | None:
    """Return the level at which values first fall below a threshold, interpolated; None where they never do.

    A first level that is below already is returned as it is. Values that are not numbers are below any threshold.
    """
    before: tuple[float, float] | None = None
    for at, value in zip(levels, values, strict=True):
        if not value >= threshold:
            if before is None or not math.isfinite(value):
                return at
            return before[0] + (before[1] - threshold) / (before[1] - value) * (at - before[0])
        before = (at, value)
    return None


def noise_rows(stream: Stream, shown: Sequence[Sample], *, quick: bool) -> list[Row]:
    """Return a row for each definition of noise and engine; a withheld frame counts as no accuracy.

    The reference says how much each row varies, as one that was captured under the same noise would; N1 is noise of
    what a touch changes, of which a reference has none.
    """
    levels, draws = SNR_DB[:: 3 if quick else 1], 1 if quick else 3
    rows = []
    for kind in KINDS:
        for engine in stream.engines:
            calm = float(np.mean([_cc(stream.show(sample, engine), sample) for sample in shown]))
            accuracy = [
                float(
                    np.mean(
                        [
                            _cc(
                                stream.show(noisy(sample, kind, snr_db, np.random.default_rng([draw, number])), engine),
                                sample,
                            )
                            for draw in range(draws)
                            for number, sample in enumerate(shown)
                        ]
                    )
                )
                for snr_db in levels
            ]
            degraded, broken = (crossing(levels, accuracy, share * calm) for share in (0.9, 0.5))
            rows.append(
                {"sweep": f"noise {kind}", "solver": engine, "unit": "dB", "from": levels[0], "to": levels[-1],
                 "unstressed": short(calm), "worst": short(min(accuracy)), "degrades_10pct_at": short(degraded),
                 "breaks_at": short(broken), "why": f"mean correlation with the truth of {len(shown)} sheets"}
            )  # fmt: skip
    return rows


def noisy(sample: Sample, kind: Kind, snr_db: float, rng: np.random.Generator) -> Sample:
    """Return a sample with noise, against a reference whose frames vary by the same."""
    spread = None if kind == "N1" else spread_of(sample, kind, snr_db)
    return replace(sample, voltages=add_noise(sample.voltages, sample.flat, kind, snr_db, rng), spread=spread)


def spread_of(sample: Sample, kind: Kind, snr_db: float) -> Array:
    """Return (104,) V by which frames of the flat sheet vary under noise N2 or N3."""
    level = 10.0 ** (-snr_db / 20.0)
    if kind == "N2":
        return np.asarray(level * np.abs(sample.flat))
    return np.full_like(sample.flat, level * float(np.sqrt(np.mean(sample.flat**2))))


def _cc(image: Array | None, sample: Sample) -> float:
    """Return a map's correlation with the truth; 0 for a map that was not shown."""
    return 0.0 if image is None else float(correlation(image, sample.truth))


def inputs_of(samples: Sequence[Sample]) -> Floats:
    """Return (n, 104) dV of some samples, repeated with small changes."""
    base = np.stack([relative_change(s.read, s.flat) for s in samples])
    rng = np.random.default_rng(0)
    more = base[np.arange(INPUTS) % len(base)]
    return np.asarray(more + 0.01 * rng.standard_normal(more.shape), dtype=np.float32)


def maps_of(bundle: Bundle, changes: Floats, engine: int = 0) -> Floats:
    """Return (n, 1350) maps on the flat sheet, one at a time through the runtime's engine."""
    buffers = Buffers(bundle)
    found = engines(bundle, buffers)[engine]
    buffers.use_geometry(GeometryGraph(bundle).geometry(None, None, 0))
    maps = []
    for change in changes:
        buffers.change[0] = change
        found.infer()
        maps.append(buffers.map[0].copy())
    return np.stack(maps)


def repeat_rows(bundle: Bundle, samples: Sequence[Sample]) -> list[Row]:
    """Return a row for each way of repeating."""
    changes = inputs_of(samples)
    first = maps_of(bundle, changes)
    rows = [
        _repeat_row("run to run, a new session", "vd2t", first, maps_of(bundle, changes)),
        _repeat_row("run to run, another process", "vd2t", first, _maps_elsewhere(bundle, changes)),
    ]
    for index, name in enumerate(name for name in ("head.onnx", "head_int8.onnx") if name in bundle.files):
        single, two = maps_of(bundle, changes, index), _two_threads(bundle, name, changes)
        rows.append(_repeat_row("one thread, two threads", "vd2t" if index == 0 else "vd2t-int8", single, two))
    scene = samples[0].scene
    once, again = (solve_scene(scene).voltages for _ in range(2))
    return [*rows, _repeat_row("run to run", "forward model", once, again)]


def _repeat_row(sweep: str, solver: str, one: npt.NDArray[Any], other: npt.NDArray[Any]) -> Row:
    difference = float(np.abs(np.asarray(one, float) - np.asarray(other, float)).max())
    equal, size = bool(np.array_equal(one, other)), float(np.abs(one).max())
    apart_by = f"differ by at most {difference:.2g}, {difference / size / 6e-8:.2g} roundings of float32"
    return {
        "sweep": f"repeat: {sweep}", "solver": solver, "unit": "map", "bit_equal": equal, "worst": short(difference),
        "degrades_10pct_at": None, "breaks_at": None, "why": "bit-equal" if equal else apart_by,
    }  # fmt: skip


def _maps_elsewhere(bundle: Bundle, changes: Floats) -> Floats:
    done = subprocess.run(
        [sys.executable, "-m", __name__, str(bundle.path)],
        input=changes.astype("<f4").tobytes(), capture_output=True, check=True, timeout=120,
    )  # fmt: skip
    return np.frombuffer(done.stdout, dtype="<f4").reshape(len(changes), -1)


def _two_threads(bundle: Bundle, name: str, changes: Floats) -> Floats:
    session = onnxruntime.InferenceSession(bundle.files[name], session_options(2), providers=["CPUExecutionProvider"])
    geometry = GeometryGraph(bundle).geometry(None, None, 0)
    feed = {"bias": geometry.bias, **({"log_predicted": geometry.log_predicted} if bundle.uses_prediction else {})}
    return np.concatenate([session.run(["map"], {"dv": change[None], **feed})[0] for change in changes])


if __name__ == "__main__":
    given = np.frombuffer(sys.stdin.buffer.read(), dtype="<f4").reshape(-1, N_ROWS)
    sys.stdout.buffer.write(maps_of(load_bundle(sys.argv[1]), given).astype("<f4").tobytes())
