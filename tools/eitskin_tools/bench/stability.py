"""``eitskin bench stability``: noise, precision, absurd inputs, slow numbers, and the same input twice.

::

    noise       N1 to N3 from 80 to 20 dB through every engine of the runtime: the levels at which a tenth and half of
                the accuracy are lost, interpolated
    precision   float32 against float64 in every precomputed operator, by regularisation
    inputs      inputs that no working sheet gives (:mod:`eitskin_tools.bench.stability_inputs`)
    denormals   CPU time of numbers that a processor computes slowly (:mod:`eitskin.model.denormals`)
    repeat      the same input in two sessions, in another process, with two threads

Every published map passes a check: the summary counts those that are not finite, or not from 0 to 1. The command exits
with 1 if there is one, or if an input ended in an exception that is no refusal.

An operator is *built* in float32 if every step of its making is, and *rounded* if it is made in float64 and stored as
float32. Building loses the digits that the regularisation lets through: the damped Gram matrix has the condition
1 / factor, so the error is about 6e-8 / factor, and Cholesky finds it indefinite when the factor is below rounding.
Rounding costs 6e-8 whatever the factor.

CPU times of slow numbers are ratios in one run, each input in turn with a usual one. ``unguarded`` writes denormals
into the solvers' memory, which the runtime never does. ``worst`` is the slowest input that the runtime can hand over.
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
from scipy import linalg

from eitskin.health.imputation import Consistency
from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.model.denormals import flushed
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.model.session import checked_graph, onnxruntime, open_session, session_options
from eitskin_export.package import FACTOR as PROJECTION_FACTOR
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import network_input
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.consistency import FLOOR
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.solvers.operators import Cells, Operators
from eitskin_sim.solvers.tikhonov import FACTOR, SENSITIVITY_POWER, tikhonov_matrix
from eitskin_tools.bench.harness import Row, chosen, report, say, several
from eitskin_tools.bench.stability_inputs import input_rows
from eitskin_tools.bench.stability_probe import Sample, Stream, Tally, samples
from eitskin_tools.command_line import files

Array = npt.NDArray[np.float64]
AnyFloat = npt.NDArray[np.floating]
Floats = npt.NDArray[np.float32]

FAMILIES: Final = ("noise", "precision", "inputs", "denormals", "repeat")
"""What ``--only`` takes."""

KINDS: Final[tuple[Kind, ...]] = ("N1", "N2", "N3")
SNR_DB: Final = (80.0, 70.0, 60.0, 50.0, 45.0, 40.0, 35.0, 30.0, 25.0, 20.0)

INPUTS: Final = 16
"""That are repeated."""

FACTORS: Final = tuple(10.0**-power for power in range(1, 13))
LOST: Final = 5
"""The electrode whose rows are filled in."""

LIMIT: Final = 1e-3
"""Relative error of an operator that counts as harm: a tenth of what 40 dB noise does to the data."""

TIMES: Final = 60
"""Runs of each input."""

SMALL: Final = (1e-36, 1e-38, 1e-40)
"""Sizes around the smallest float32 of normal size, 1.2e-38: also products with it are slow."""

LEAST: Final = 2.0**-53
"""The smallest dV but 0."""


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
    healthy = bundle.consistency_arrays()
    consistency = None if healthy is None else Consistency.of(healthy)
    makers: dict[str, Callable[[], list[Row]]] = {
        "noise": lambda: noise_rows(Stream(bundle, tally), shown, quick=quick),
        "precision": lambda: precision_rows(shown[0], consistency, quick=quick),
        "inputs": lambda: input_rows(bundle, shown[0], tally),
        "denormals": lambda: denormal_rows(bundle),
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


def built(operator: Array, factor: float, power: float, dtype: type[np.floating]) -> AnyFloat:
    """Return the (n, rows) Tikhonov matrix with every step taken in one precision.

    Args:
        operator: (rows, n) A.
        factor: Regularisation, relative to the largest eigenvalue.
        power: Of the sensitivities that weigh the cells.
        dtype: float32 or float64.

    Raises:
        LinAlgError: The damped Gram matrix is not positive definite in this precision.
    """
    A = np.asarray(operator, dtype=dtype)
    weight = np.linalg.norm(A, axis=0) ** dtype(power)
    scaled = A / weight
    gram = scaled @ scaled.T
    damped = gram + dtype(factor) * linalg.eigvalsh(gram)[-1] * np.eye(len(gram), dtype=dtype)
    inner = linalg.cho_solve(linalg.cho_factor(damped), scaled)
    found = np.asarray((inner / weight).T)
    assert found.dtype == dtype
    return found


def apart(found: AnyFloat, exact: Array) -> float:
    """Return the relative difference of two arrays in the Frobenius norm; infinite where one is not finite."""
    difference = float(np.linalg.norm(np.asarray(found, dtype=np.float64) - exact) / np.linalg.norm(exact))
    return difference if np.isfinite(difference) else float("inf")


def filling_weights(covariance: Array, factor: float, dtype: type[np.floating]) -> AnyFloat:
    """Return what fills an electrode's rows in from the others, (26, 78), with every step taken in one precision.

    Args:
        covariance: (104, 104) of log(V / V0), without any floor.
        factor: The floor, relative to the largest eigenvalue.
        dtype: float32 or float64.

    Raises:
        LinAlgError: The covariance is singular in this precision.
    """
    floor = factor * np.linalg.eigvalsh(covariance)[-1]
    whole = np.asarray(covariance + floor * np.eye(len(covariance)), dtype=dtype)
    precision, gone = linalg.inv(whole), rows_of((LOST,))
    found = np.asarray(linalg.solve(precision[np.ix_(gone, gone)], precision[np.ix_(gone, ~gone)]))
    assert found.dtype == dtype
    return found


def precision_rows(sample: Sample, consistency: Consistency | None = None, *, quick: bool = False) -> list[Row]:
    """Return a row for each operator.

    Args:
        sample: Whose bend the operators are of.
        consistency: Of the bundle; without it nothing is filled in.
        quick: Every other factor.
    """
    factors = FACTORS[:: 2 if quick else 1]
    rows = []
    choices: tuple[tuple[str, Cells, float, float], ...] = (
        ("tikhonov", "units", SENSITIVITY_POWER, FACTOR),
        ("tikhonov", "pixels", SENSITIVITY_POWER, FACTOR),
        ("projection", "pixels", 0.0, PROJECTION_FACTOR),
    )
    for name, cells, power, shipped in choices:
        operators = sample.sheet.operators(cells)
        singular = np.linalg.svd(operators.relative_jacobian, compute_uv=False)
        rows.append(_tikhonov_row(f"{name}, {cells}, built in float32", operators, power, factors, shipped))
        rows[-1]["why"] += f"; undamped, A A^T has the condition {(singular[0] / singular[-1]) ** 2:.2g}"
    if consistency is not None:
        rows.append(_filling_row(consistency, factors))
    return rows


def _tikhonov_row(name: str, operators: Operators, power: float, factors: Sequence[float], shipped: float) -> Row:
    A = operators.relative_jacobian
    errors = [_build_error(A, factor, power) for factor in factors]
    once = apart(tikhonov_matrix(A, shipped, power).astype(np.float32), tikhonov_matrix(A, shipped, power))
    at_shipped = _build_error(A, shipped, power)
    verdict = "must be built in float64" if at_shipped > 10.0 * once else "may be built in float32"
    why = (
        f"error about 6e-8 / factor: {at_shipped:.2g} at the shipped factor {shipped:g}, where rounding once costs "
        f"{once:.2g}: {verdict}, may be stored in float32"
    )
    return _precision_row(name, factors, errors, why)


def _build_error(A: Array, factor: float, power: float) -> float:
    try:
        return apart(built(A, factor, power, np.float32), tikhonov_matrix(A, factor, power))
    except linalg.LinAlgError:
        return float("inf")  # indefinite in float32: there is no matrix at all


def _filling_row(consistency: Consistency, factors: Sequence[float]) -> Row:
    covariance = consistency.covariance - FLOOR * np.eye(len(consistency.covariance))
    largest = float(np.linalg.eigvalsh(covariance)[-1])
    shipped = FLOOR / largest

    def error(factor: float) -> float:
        try:
            return apart(filling_weights(covariance, factor, np.float32), _exact_weights(covariance, factor))
        except linalg.LinAlgError:
            return float("inf")

    once = apart(_exact_weights(covariance, shipped).astype(np.float32), _exact_weights(covariance, shipped))
    at_shipped = error(shipped)
    verdict = "must be built in float64" if at_shipped > 10.0 * once else "may be built in float32"
    why = (
        f"P has the condition {1.0 / shipped:.2g} at the shipped floor, {shipped:.2g} of the largest eigenvalue: error "
        f"{at_shipped:.2g}, where rounding once costs {once:.2g}: {verdict}"
    )
    return _precision_row(
        "filling, an electrode's rows, built in float32", factors, [error(factor) for factor in factors], why
    )


def _exact_weights(covariance: Array, factor: float) -> Array:
    return np.asarray(filling_weights(covariance, factor, np.float64), dtype=np.float64)


def _precision_row(name: str, factors: Sequence[float], errors: Sequence[float], why: str) -> Row:
    kept = [1.0 - error for error in errors]
    finite = [error for error in errors if np.isfinite(error)]
    return {
        "sweep": f"precision: {name}",
        "solver": name.partition(",")[0],
        "unit": "regularisation",
        "from": factors[0],
        "to": factors[-1],
        "unstressed": 1.0,
        "worst": short(1.0 - max(finite, default=float("nan"))),
        "worst_at": factors[int(np.argmax(errors))],
        "harmed_at": short(_factor_at(factors, [-error for error in errors], -LIMIT)),
        "degrades_10pct_at": short(_factor_at(factors, kept, 0.9)),
        "breaks_at": short(_factor_at(factors, kept, 0.5)),
        "break_rule": "relative error of the operator or the image above one half, or none at all",
        "why": why,
    }


def _factor_at(factors: Sequence[float], values: Sequence[float], threshold: float) -> float | None:
    """Return the factor at which values fall below a threshold, interpolated by its logarithm."""
    found = crossing([math.log(factor) for factor in factors], values, threshold)
    return None if found is None else math.exp(found)


def denormal_rows(bundle: Bundle) -> list[Row]:
    """Return a row for each solver of a bundle, and for its geometry graph."""
    rng = np.random.default_rng(0)
    buffers = Buffers(bundle)
    buffers.use_geometry(GeometryGraph(bundle).geometry(None, None, 0))
    usual = rng.normal(0.0, 0.05, N_ROWS).astype(np.float32)
    signs = np.sign(usual)
    half = np.arange(N_ROWS) % 2 == 0
    admitted = [LEAST * signs, np.where(half, usual, LEAST * signs), np.where(half, usual, 0.0), 0.0 * usual]
    small = [size * usual / np.float32(0.05) for size in SMALL]
    rows = []
    for engine in engines(bundle, buffers):

        def infer(change: Floats, engine: Engine = engine) -> None:
            buffers.change[0] = change
            engine.infer()

        rows.append(_slow_row(engine.name, infer, usual, admitted, small))
    session = open_session(bundle, "geometry.onnx", checked_graph(bundle, "geometry.onnx"))

    def bend(points: Floats) -> None:
        session.run(["bias"], {"cloud": points[None]})

    clouds = [_bent(bundle, size, rng) for size in SMALL]
    rows.append(_slow_row("geometry", bend, _bent(bundle, 1.0, rng), [flushed(cloud) for cloud in clouds], clouds))
    return rows


def _bent(bundle: Bundle, size_mm: float, rng: np.random.Generator) -> Floats:
    grid = bundle.skin.grid
    cloud = grid.flat_cloud_mm()
    cloud[2] = 50.0 * size_mm * rng.standard_normal(cloud[2].shape)
    return network_input(cloud, grid)


def _slow_row(
    name: str, work: Callable[[Floats], None], usual: Floats, admitted: list[Floats], small: list[Floats]
) -> Row:
    worst = max(_ratio(work, value.astype(np.float32), usual) for value in admitted)
    unguarded = max(_ratio(work, value.astype(np.float32), usual) for value in small)
    return {
        "sweep": "denormals",
        "solver": name,
        "unit": "times the CPU time of a usual input",
        "from": min(SMALL),
        "to": max(SMALL),
        "worst": short(worst),
        "unguarded": short(unguarded),
        "frames": 0,
        "degrades_10pct_at": None,
        "breaks_at": None,
        "why": f"the smallest numbers that reach it cost {worst:.2f} times a usual input, denormals {unguarded:.1f}",
    }


def _ratio(work: Callable[[Floats], None], hostile: Floats, usual: Floats) -> float:
    """Return how many times the CPU time of a usual input another one takes, by medians of runs in turn."""
    spans: list[list[int]] = [[], []]
    for _ in range(TIMES):
        for taken, value in zip(spans, (usual, hostile), strict=True):
            start = time.thread_time_ns()
            work(value)
            taken.append(time.thread_time_ns() - start)
    return float(np.median(spans[1]) / np.median(spans[0]))


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
