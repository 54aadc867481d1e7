"""``eitskin bench stability``: at which level of noise each solver breaks.

N1 to N3 from 80 to 20 dB go through every engine of the runtime. A row gives the levels at which a tenth and half of
the accuracy are lost, interpolated. Touched sheets at drawn deformations pass the runtime's own pipeline, as FRAME
payloads of a device with 32-bit converters. The summary counts the published maps that are not finite, or not from 0 to
1. The command exits with 1 if there is one.
"""

import argparse
import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.model.engine import engines
from eitskin.model.geometry import GeometryGraph
from eitskin.reference.predicted import log_ratio
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.harness import Case, Sheet
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import NOISES, Kind, add_noise, spread_of
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import flat_voltages
from eitskin_tools.bench.harness import Row, report
from eitskin_tools.bench.skip import Frames, without_gate
from eitskin_tools.command_line import files

Array = npt.NDArray[np.float64]
TouchedSheet = tuple[Case, Array]
"""A touched sheet without noise, and its true (rows, columns) map."""


SNR_DB: Final = (80.0, 70.0, 60.0, 50.0, 45.0, 40.0, 35.0, 30.0, 25.0, 20.0)


CLOUD_SEED: Final = 71_903


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--quick", action="store_true", help="fewer sheets and levels: under a minute of one core")
    parser.add_argument(
        "--bundle", type=files.bundle, metavar="FILE", help="bundle to stress (default: the shipped one of unit labels)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows and summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0 if every published map is finite and from 0 to 1."""
    start = time.process_time()
    bundle, counts, quick = load_bundle(arguments.bundle or default_path("units")), Counter[str](), arguments.quick
    sheets = touched_sheets(
        "units" if bundle.labels == "units" else "area", 2 if quick else 8, element_size_mm=6.0 if quick else 3.0
    )
    rows = noise_rows(Stream(bundle, sheets[0][0].flat_reference, counts), sheets, quick=quick)
    broken, spent_s = sum(row["breaks_at"] is not None for row in rows), round(time.process_time() - start, 1)
    summary = {"rows": len(rows), "broken": broken, **counts, "withheld": counts["withheld"], "cpu_s": spent_s}
    report(arguments, rows, summary)
    return 1 if counts["published_not_finite"] or counts["published_out_of_range"] else 0


def touched_sheets(labels: Literal["units", "area"], count: int, element_size_mm: float) -> list[TouchedSheet]:
    """Return sheets with one to three touches, each at its own deformation; a larger count begins with the same ones.

    Args:
        labels: "units" for touched units, "area" for touches anywhere.
        count: How many.
        element_size_mm: Of their meshes.
    """
    found = []
    for phantom in trials.random((1, 3), count, 1, "A", labels):
        scene = replace(phantom.scene, element_size_mm=element_size_mm)
        voltages, flat, untouched = (solve_scene(one).voltages for one in (scene, scene.reference(), scene.untouched()))
        cloud = measured_cloud(scene.bend, np.random.default_rng(CLOUD_SEED))
        sheet = Sheet(np.asarray(cloud, dtype=np.float64), untouched)
        found.append((Case(voltages, flat, flat, sheet, labels), truth_map(phantom)))
    return found


def judged(image: npt.NDArray[np.floating]) -> dict[str, int]:
    """Return what a published map, of any shape, adds to the counts."""
    low, high = float(np.min(image)), float(np.max(image))  # both NaN if any value is
    finite = bool(np.isfinite(low) and np.isfinite(high))
    return {
        "published": 1,
        "published_not_finite": int(not finite),
        "published_out_of_range": int(finite and (low < 0.0 or high > 1.0)),
    }


class Stream:
    """The runtime's pipeline without its gate, so that every frame is computed, and the device before it.

    Args:
        bundle: The solvers.
        flat_V: (104,) V of the flat, untouched sheet.
        counts: Of published maps and withheld frames, in the words of the summary.
    """

    def __init__(self, bundle: Bundle, flat_V: Array, counts: Counter[str]) -> None:
        self.bundle, self.counts = without_gate(bundle), counts
        self._frames = Frames(flat_V, np.zeros_like(flat_V))
        self.pipeline = self._frames.pipeline(self.bundle)
        self._engines = {engine.name: engine for engine in engines(self.bundle, self.pipeline.buffers)}
        self._graph = GeometryGraph(self.bundle)
        self._sequence = 0
        self._sheet: Sheet | None = None

    @property
    def engines(self) -> tuple[str, ...]:
        """The names that :meth:`show` takes, the most accurate first."""
        return tuple(self._engines)

    def use_spread(self, spread_V: Array) -> None:
        """Take a reference whose single frames vary by (104,) V."""
        self.pipeline.use_reference(replace(self._frames.reference, spread_V=spread_V))

    def show(self, case: Case, engine: str = "vd2t") -> Array | None:
        """Return the (rows, columns) map that is published of a case, None if the frame is withheld."""
        pipeline, skin = self.pipeline, self.bundle.skin
        if case.sheet is not self._sheet:
            uses_prediction = self.bundle.uses_prediction
            predicted = log_ratio(case.sheet.predicted(), flat_voltages(skin)) if uses_prediction else None
            pipeline.start_with(self._graph.geometry(case.sheet.cloud_mm, predicted, 0))
            self._sheet = case.sheet
        pipeline.engines[0] = self._engines[engine]
        self._sequence += 1
        before = Counter(pipeline.intake.withheld)
        payload = self._frames.payload(case.voltages, self._sequence)
        if not (pipeline.accept(payload, time.perf_counter_ns()) and pipeline.compute(True)):
            reasons = Counter(pipeline.intake.withheld) - before
            self.counts.update(withheld=reasons.total(), **{f"withheld_{why}": n for why, n in reasons.items()})
            return None
        image = np.frombuffer(pipeline.record.map, dtype=np.float32).reshape(skin.grid.shape)
        self.counts.update(judged(image))
        return image.astype(np.float64)


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


def noise_rows(stream: Stream, sheets: Sequence[TouchedSheet], *, quick: bool) -> list[Row]:
    """Return a row for each definition of noise and engine; a withheld frame counts as no accuracy.

    The reference says how much each row varies, as a reference captured under the same noise does. N1 is noise of what
    a touch changes, which a reference does not have.
    """
    levels, draws = SNR_DB[:: 3 if quick else 1], 1 if quick else 3
    rows = []
    for kind in NOISES:
        for engine in stream.engines:
            stream.use_spread(np.zeros(N_ROWS))
            calm = float(np.mean([_cc(stream.show(case, engine), truth) for case, truth in sheets]))
            accuracy = [_noisy_cc(stream, sheets, engine, kind, snr_db, draws) for snr_db in levels]
            degraded, broken = (crossing(levels, accuracy, share * calm) for share in (0.9, 0.5))
            rows.append(
                {"sweep": f"noise {kind}", "solver": engine, "unit": "dB", "from": levels[0], "to": levels[-1],
                 "unstressed": short(calm), "worst": short(min(accuracy)), "degrades_10pct_at": short(degraded),
                 "breaks_at": short(broken), "why": f"mean correlation with the truth of {len(sheets)} sheets"}
            )  # fmt: skip
    return rows


def _noisy_cc(
    stream: Stream, sheets: Sequence[TouchedSheet], engine: str, kind: Kind, snr_db: float, draws: int
) -> float:
    flat_V = sheets[0][0].flat_reference
    stream.use_spread(spread_of(flat_V, kind, snr_db))
    found, place = [], stream.engines.index(engine)
    for number, (case, truth) in enumerate(sheets):
        for draw in range(draws):
            rng = np.random.default_rng(
                [draw, number, place]
            )  # the same noise once more counts as a frame that repeats
            volts = add_noise(case.voltages, flat_V, kind, snr_db, rng)
            found.append(_cc(stream.show(replace(case, voltages=volts), engine), truth))
    return float(np.mean(found))


def _cc(image: Array | None, truth: Array) -> float:
    """Return a map's correlation with the truth; 0 for a map that was not shown."""
    return 0.0 if image is None else float(correlation(image, truth))
