"""What calibrating a device, and letting a bundle learn its twin, is worth on that device.

Devices are drawn from the lab mix, as ``eitskin evaluate --devices lab`` draws them. Of each is recorded what
``eitskin calibrate --guided`` asks for (:func:`recorded`): the reference of all 208 rows, flat and
untouched; bends that are held and scanned; presses of a stamp on the flat sheet, each of which misses its place and its
strength as a person's do. Bends and noise are no trial's and no training's. ``eitskin calibrate`` makes a twin
of it, ``eitskin adapt-skin`` lets the bundle learn that, and both bundles are tried on the true device, each told of
the skin that it is for, the adapted one with and without the check by physics. The work is kept in ``--work`` and gone
on with, device by device.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import FULL_TABLE, TABLE
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_sim.calibration.stamp import PLACE_MM, PRESS_CONTRAST_SD, places
from eitskin_sim.devices.readings import FINE_MM, responses_of
from eitskin_sim.evaluation.device import Device
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_tools.bench.harness import program, report
from eitskin_tools.errors import UsageError

Array = npt.NDArray[np.float64]

FRAMES: Final = 100
"""That each moment is the mean of."""

SEED: Final = 1901
"""Of noise, bends and presses."""

STAMP_MM: Final = 16.0
"""Diameter of the stamp."""

PRESS_PROFILES: Final = {"lower": (0.5, 4.0), "raise": (10.0, 2.0)}
"""Contrast and border of the stamp's presses, mm: between the two presses of trials, and as the lab mix's touches."""

PRIOR_SKIN: Final = "lab"
"""The skin whose uncertainties are the priors."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--work", type=Path, required=True, metavar="DIR", help="folder for twins and adapted bundles")
    parser.add_argument("--bundle", default="press", metavar="FILE", help="a file, or a shipped one (default press)")
    parser.add_argument("--devices", type=int, default=3, metavar="N", help="devices of the lab mix (default 3)")
    parser.add_argument("--bends", type=int, default=3, metavar="N", help="to calibrate by; 0 for none (default 3)")
    parser.add_argument("--presses", type=int, default=6, metavar="N", help="of a stamp, likewise (default 6)")
    parser.add_argument("--deformations", type=int, default=8, metavar="N", help="unseen ones (default 8)")
    parser.add_argument("--each", type=int, default=3, metavar="N", help="touches at each of them (default 3)")
    parser.add_argument("--samples", type=int, default=50000, metavar="N", help="of a twin (default 50000)")
    parser.add_argument("--epochs", type=int, default=4, metavar="N", help="of its training (default 4)")
    parser.add_argument("--snr-db", type=float, default=50.0, metavar="S", help="of one frame (default 50)")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes that make data (default 1)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if min(arguments.devices, arguments.deformations, arguments.each, arguments.epochs, arguments.workers) < 1:
        raise UsageError("--devices, --deformations, --each, --epochs and --workers must be at least 1")
    if min(arguments.bends, arguments.presses) < 0:
        raise UsageError("--bends and --presses must be at least 0")
    if arguments.samples < 500:
        raise UsageError(f"--samples is {arguments.samples}, expected at least 500")
    rows = [row for number in range(arguments.devices) for row in _device(number, arguments)]
    return report(arguments, rows, {})


def _device(number: int, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of one device: the bundle as it is, adapted to the twin, and that with physics besides."""
    from eitskin.model.bundle import load_bundle
    from eitskin_proto.skin.skin import PAPER
    from eitskin_tools.command_line import files

    bundle = load_bundle(files.find(arguments.bundle, files.BUNDLE))
    folder = arguments.work / f"device-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    twin, found = _calibrated(number, folder, bundle.touch_kind, arguments)
    began = time.perf_counter()
    adapted = load_bundle(_adapted(bundle, twin, folder, arguments))
    seconds = time.perf_counter() - began
    rows = [{"device": number, "bundle": "as shipped", **_tried(number, bundle, PAPER, arguments)}]
    rows.append({"device": number, "bundle": "adapted", **_tried(number, adapted, twin, arguments)})
    gauge = twin.layer.gauge_factor
    rows[-1] |= {"gauge_factor": round(gauge.value, 3), "its_error": round(gauge.spread, 3)}
    rows[-1] |= {"misfit": round(found["misfit"], 3), "learning_s": round(seconds, 1)}
    checked = _tried(number, adapted, twin, arguments, "verified")
    return [*rows, {"device": number, "bundle": "adapted, verified", **checked}]


def _calibrated(
    number: int, folder: Path, touches: TouchKind, arguments: argparse.Namespace
) -> tuple[Any, dict[str, Any]]:
    """Return the twin of a device, and what calibration said of it."""
    from eitskin_proto.files.writing import write_bytes
    from eitskin_proto.skin.toml import load, named, to_toml
    from eitskin_sim.calibration.report import calibrate
    from eitskin_sim.evaluation.device import draw_device
    from eitskin_sim.evaluation.mismatch import LAB

    way: TouchKind = "lower" if touches == "lower" else "raise"
    bends, presses = arguments.bends, arguments.presses
    name = f"{way}-{bends}-bends-{presses}-presses"
    described, said = folder / f"{name}.toml", folder / f"{name}.json"
    if not said.exists():
        recording = recorded(draw_device(LAB, 0, number), number, arguments.snr_db, bends, presses, way)
        twin, report = calibrate(named(PRIOR_SKIN), recording, arguments.snr_db)
        write_bytes(described, to_toml(twin).encode())
        write_bytes(said, json.dumps(report).encode())
    return load(described), json.loads(said.read_text())


def _adapted(bundle: Any, twin: Any, folder: Path, arguments: argparse.Namespace) -> Path:
    """Return the bundle that learned the twin, as ``eitskin adapt-skin`` makes it, without what the trials ask not.

    That is the card, a smaller network, and most steps of the gate.
    """
    from eitskin_tools.build import folder as half_made
    from eitskin_tools.build import steps
    from eitskin_tools.build.adaptation import DISCARDED_GATE_STEPS, Adaptation, adapted
    from eitskin_tools.build.recipe import GateWork
    from eitskin_tools.console.progress import Stages

    usual = Adaptation()
    deformations = -(-arguments.samples // usual.per_deformation)
    gate = GateWork(0, DISCARDED_GATE_STEPS)
    work = replace(usual, deformations=deformations, epochs=arguments.epochs, gate=gate)
    whole = adapted(bundle.path, twin, bundle.manifest, bundle.touch_kind, work, bundle.skin)
    recipe = replace(whole, networks={})
    place = folder / f"{bundle.path.stem}-{arguments.bends}-{arguments.presses}.build"
    if half_made.begun(place, recipe, None) is None:
        half_made.begin(place, recipe, recipe, None)
    with Stages() as tell:
        steps.make_data(recipe, place, arguments.workers, tell)
        return steps.export_run(recipe, place, steps.train_stages(recipe, place, tell), tell)[0]


def _tried(number: int, bundle: Any, skin: Any, arguments: argparse.Namespace, solver: str = "vd2t") -> dict[str, Any]:
    """Return what a bundle, told of a skin, scores on the true device."""
    from eitskin_sim.evaluation.device_runs import Plan
    from eitskin_sim.evaluation.mismatch import LAB
    from eitskin_tools.evaluation.devices import evaluate_devices, trials_of
    from eitskin_tools.evaluation.solvers import Request

    kinds = ("press04", "press06") if bundle.touch_kind == "lower" else ("mm", "single")
    trials = trials_of(kinds, arguments.deformations, arguments.each)
    plan = Plan(seed=0, first=number, snr_db=arguments.snr_db, skin=skin)
    (row,) = evaluate_devices([("lab mix", LAB)], trials, Request(solver, bundle=str(bundle.path)), plan)["rows"]
    found: dict[str, Any] = {}
    for kind in kinds:
        one = row[kind]
        found |= {f"{kind}_cc": round(one["cc"], 4), f"{kind}_rms_mm": one["localisation_rms_mm"]}
        found[f"{kind}_missed"] = one["missed"]
    return found


def recorded(device: Device, number: int, snr_db: float, bends: int, presses: int, way: TouchKind) -> Recording:
    """Return what is recorded of a device.

    Args:
        device: The true one.
        number: Names its bends, how its presses miss, and the noise.
        snr_db: Of one frame.
        bends: How many bends; 0 for none.
        presses: How many presses; 0 for none.
        way: Which way they change conductance, ``lower`` or ``raise``.
    """
    rng = np.random.default_rng([SEED, number])
    sd = 10.0 ** (-snr_db / 20.0) / FRAMES**0.5

    def read(scene: Scene, table: npt.NDArray[np.uint8] = TABLE) -> Array:
        fine = replace(scene, element_size_mm=FINE_MM)
        volts = device.front_end.read(responses_of(factorise_scene(fine).differences()), table)
        return np.asarray(volts * (1.0 + sd * rng.standard_normal(len(volts))))

    flat = device.reference()
    reference = read(flat, FULL_TABLE)
    bents, pressed = [], []
    for bend in draw("A", bends, SEED + number, device.skin):
        volts = read(device.scene(nominal_scene(device.skin, bend), as_it_is=True))
        bents.append(LaterReading(volts, FRAMES, device.cloud(bend, rng)))
    contrast, border_mm = PRESS_PROFILES[way]
    for said_mm in places(device.skin.outline.size_mm, presses):
        x_mm, y_mm = said_mm + PLACE_MM * rng.standard_normal(2)
        strength = np.exp(PRESS_CONTRAST_SD * rng.standard_normal())
        touch = Touch((Disc(x_mm, y_mm, STAMP_MM / 2.0),), contrast=contrast**strength, border_mm=border_mm)
        volts = read(replace(flat, touches=(touch,)))
        pressed.append(LaterReading(volts, FRAMES, xy_mm=np.array(said_mm), stamp_mm=(STAMP_MM,)))
    return Recording(reference, FRAMES, tuple(bents), tuple(pressed))


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
