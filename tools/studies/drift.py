"""How well a drift of the sheet's conductivity is known, and whether its compensation eats a touch.

Deformations of families A and B that no bundle learned from, each with a common factor on all voltages, with and
without the prediction that a cloud gives; then touches of both signs that lie still for an hour while drift is taken
out.
"""

import argparse
import sys
from itertools import pairwise
from typing import Any, Final

import numpy as np

from eitskin.errors import BundleError
from eitskin.health.drift import HOLD, Drift
from eitskin.health.imputation import Consistency
from eitskin.model.bundle import default_path, load_bundle
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.forward import assemble, flat_metric
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_scene, nominal_sheet
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc, Rect
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import predicted_log
from eitskin_tools.bench.harness import program, report
from eitskin_tools.command_line import files

FACTORS: Final = (-0.2, -0.05, 0.0, 0.1, 0.3)
"""Logarithms of the factor on all voltages that are tried."""

ELEMENT_MM: Final = 4.5
NOISE: Final = 10 ** (-50 / 20)
GRADIENTS: Final = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)
"""Share of the conductivity of 1 S/m that is lost at one end, falling to nothing at the other."""

STRIPS: Final = 6
"""Across the sheet, each of one conductivity."""

TOGETHER: Final = 24
"""Frames that are looked at together, as the runtime does."""

UNTOUCHED: Final = 300
SLOWLY: Final = 400
"""Looks of ``TOGETHER`` frames: 36 s untouched, and a touch that comes on in 48 s, at 200 frames/s."""

HOUR: Final = 720_000
LONG_TOGETHER: Final = 480
"""Frames that a touch lies still, in fewer looks than the runtime takes, since nothing happens."""

NO_SCAN: Final = np.zeros(N_ROWS, dtype=np.float32)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", type=files.bundle, help="bundle to use (default: the shipped one of unit labels)")
    parser.add_argument("--bends", type=int, default=24, metavar="N", help="deformations of each family (default 24)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    bundle = load_bundle(arguments.bundle or default_path("units"))
    healthy = bundle.consistency_arrays()
    if healthy is None:
        raise BundleError(f"{bundle.path} does not say what healthy frames are like; 'eitskin export' adds it")
    rows = drifting(Consistency.of(healthy), arguments.bends)
    return report(arguments, rows, {"rows": len(rows)})


def drifting(consistency: Consistency, bends: int) -> list[dict[str, Any]]:
    """Return rows on drift: its error without and with a cloud, and what compensation takes of a touch.

    Args:
        consistency: Of a bundle.
        bends: Deformations of each family.
    """
    mesh, sheet = scene_mesh(nominal_scene(PAPER, element_size_mm=ELEMENT_MM)), nominal_sheet(PAPER)
    flat = assemble(mesh, sheet, nominal_electrodes(PAPER), flat_metric).factorise().voltages()
    rng = np.random.default_rng(0)
    errors: dict[tuple[str, bool], list[float]] = {}
    unknown: dict[tuple[str, bool], int] = {}
    families: tuple[Family, ...] = ("A", "B")
    for family in families:
        for bend in draw(family, bends, 9900):
            volts = assemble(mesh, sheet, nominal_electrodes(PAPER), bend_metric(bend, sheet)).factorise().voltages()
            logs = np.log(volts / flat)
            expected = predicted_log([measured_cloud(bend, rng)])[0]
            for with_scan in (False, True):
                shown = expected if with_scan else np.zeros_like(expected)
                for factor in FACTORS:
                    found = settle(consistency, logs + factor, shown, rng)
                    key = family, with_scan
                    unknown[key] = unknown.get(key, 0) + (found is None)
                    if found is not None:
                        errors.setdefault(key, []).append(found - factor)
    rows: list[dict[str, Any]] = []
    for (name, scan), silent in unknown.items():
        off = 100.0 * np.array(errors.get((name, scan), [np.nan]))
        rows.append(
            {"what": "drift", "family": name, "scan": scan, "tried": bends * len(FACTORS), "not_said": silent,
             "error_rms_percent": round(float(np.sqrt(np.mean(off**2))), 2),
             "error_max_percent": round(float(np.abs(off).max()), 2)}
        )  # fmt: skip
    return [*rows, *uneven(consistency, flat, rng), *absorbed(consistency, flat, rng)]


def settle(consistency: Consistency, logs: Any, predicted: Any, rng: np.random.Generator) -> float | None:
    """Return the drift, in log, that is reported of a sheet held still; None if none is."""
    drift = still(consistency, logs, predicted, rng)
    return None if np.isnan(drift.percent) else float(np.log1p(drift.percent / 100.0))


def still(consistency: Consistency, logs: Any, predicted: Any, rng: np.random.Generator) -> Drift:
    """Return what is known of a sheet that is held still for a little longer than it takes."""
    drift = Drift(consistency)
    drift.restart(np.full(len(logs), NOISE), 100)
    for _ in range(HOLD // TOGETHER + 2):
        change = np.expm1(logs + NOISE * rng.standard_normal((TOGETHER, len(logs)))).astype(np.float32)
        drift.look(change, predicted, touched=False)
    return drift


def uneven(consistency: Consistency, flat: Any, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return what is said of a flat sheet, measured and untouched, that dried more at one end than at the other."""
    length, width = PAPER.outline.size_mm
    edges = np.linspace(0.0, length, STRIPS + 1)
    rows = []
    for lost in GRADIENTS:
        strips = tuple(
            Touch((Rect(float(a), 0.0, float(b), width),), 1.0 - lost * (a + b) / 2 / length)
            for a, b in pairwise(edges)
        )
        scene = Scene(touches=strips if lost else (), element_size_mm=ELEMENT_MM)
        logs = np.log(factorise_scene(scene).voltages() / flat)
        found = still(consistency, logs, np.full(len(logs), 1e-9, dtype=np.float32), rng)
        said = "uneven" if found.uneven else "nothing" if np.isnan(found.percent) else f"{found.percent:+.1f} %"
        rows.append({"what": "drift", "lost_at_one_end_percent": round(100 * lost, 1), "said": said})
    return rows


def absorbed(consistency: Consistency, flat: Any, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return what is taken out, in an hour, of touches that lie still on a sheet without drift, the gate asleep.

    Touches come on at once or within ``SLOWLY`` looks; shares are of a touch's own rms.
    """
    rows = []
    for snr_db in (50.0, 29.0):
        for contrast in (0.2, 0.6, 0.85, 1.2, 2.0, 50.0):
            shares = []
            for x, y, radius in ((40.0, 30.0, 8.0), (75.0, 50.0, 8.0), (120.0, 80.0, 12.5)):
                border = 0.0 if contrast > 1.0 else 4.0
                touch = Touch((Disc(x, y, radius),), contrast=contrast, border_mm=border)
                scene = Scene(touches=(touch,), element_size_mm=ELEMENT_MM)
                logs = np.log(factorise_scene(scene).voltages() / flat)
                shares += [taken(consistency, logs, 10 ** (-snr_db / 20), looks, rng) for looks in (1, SLOWLY)]
            rows.append(
                {"what": "drift", "touch_contrast": contrast, "snr_db": snr_db,
                 "taken_out_at_once_percent": round(100 * max(shares[::2]), 2),
                 "taken_out_slowly_percent": round(100 * max(shares[1::2]), 2)}
            )  # fmt: skip
    return rows


def taken(consistency: Consistency, logs: Any, noise: float, looks: int, rng: np.random.Generator) -> float:
    """Return the share of a touch that is taken out when it has come on within some looks and lain for an hour."""
    drift = Drift(consistency)
    drift.restart(np.full(len(logs), noise), 100, fresh=True)
    own = noise / 10.0 * rng.standard_normal(len(logs))

    def show(shown: Any, frames: int) -> None:
        mean = np.expm1(own + shown + noise / np.sqrt(frames) * rng.standard_normal(len(logs)))
        drift.look(np.broadcast_to(mean.astype(np.float32), (frames, len(logs))), NO_SCAN, touched=False)

    for _ in range(UNTOUCHED):
        show(0.0, TOGETHER)
    before = drift.resting.drift
    for look in range(looks):
        show(logs * (look + 1) / looks, TOGETHER)
    for _ in range(HOUR // LONG_TOGETHER):
        show(logs, LONG_TOGETHER)
    return float(np.sqrt(np.mean((drift.resting.drift - before) ** 2) / np.mean(logs**2)))


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
