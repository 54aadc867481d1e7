"""Runs a solver on mismatched devices: the true device is solved, the solver assumes the nominal one.

Trials ::

    mm        the paper's phantoms in mm               single    one hard square of 10 mm
    units     the paper's phantoms on the unit grid    press04, press06   discs and squares of 16 mm that conduct 0.4 or
                                                       0.6 of the sheet, borders of 4 mm

The last three at deformations and places that no training has seen; so are the first two of another sheet than the
paper's, up to four rectangles and discs or up to six units. All rows see the same noise, and draw number n of a
device has the same directions in each of them, so that rows differ by the mismatch alone.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.device import DRAW_SEED, Device, draw_device
from eitskin_sim.evaluation.harness import Case, Reference, Run, Sheet
from eitskin_sim.evaluation.metrics import correlation, distances_mm, missed_and_rms
from eitskin_sim.evaluation.mismatch import Mismatch, Row, deviations, random_mismatch
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.measurement.faults import response_of
from eitskin_sim.measurement.front_end import IDEAL, FrontEnd
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.scene.family import is_family
from eitskin_sim.scene.parts import Phantom, Scene
from eitskin_sim.surface.predict import flat_voltages, predict

ELEMENT_MM: Final = 3.0
"""Of the true devices' mesh: 0.1 s a scene; dV is 2e-4 to 4e-4 off (rms), a tenth of N2 at 50 dB."""

PRESS_MM: Final = 16.0
PRESS_BORDER_MM: Final = 4.0
SINGLE_MM: Final = 10.0

Judge = Callable[[Array, Array], bool]
"""Voltages and reference (104,) -> whether the gate calls the sheet touched."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Phantoms of one kind on the nominal sheet."""

    name: str
    phantoms: tuple[Phantom, ...]
    lowering: bool = False
    """Whether its touches lower conductance: then a mismatch leaves their contrast and border as they are."""

    @property
    def labels(self) -> Literal["units", "area"]:
        """The meaning of the truth's pixels."""
        return self.phantoms[0].truth


@dataclass(frozen=True, slots=True)
class Plan:
    """The conditions of every row."""

    draws: int = 1
    """Devices a row."""
    first: int = 0
    """Number of the first of them."""
    seed: int = 0
    noise: Kind = "N2"
    snr_db: float = 50.0
    skin: Skin = PAPER
    """The skin that the solver knows."""
    meant: Skin = PAPER
    """The nominal skin of the devices: the same, unless the solver knows a calibration of one of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """The scores of one map."""

    cc: float
    distances_mm: Array
    """From every true touch to the nearest found one."""
    touched: bool
    """As the gate says."""


def drawn_trials(deformations: int, each: int, skin: Skin = PAPER) -> list[Trial]:
    """Return the trials whose deformations and places are drawn, on any skin."""
    found = [Trial("single", tuple(trials.single(SINGLE_MM, deformations, each, skin=skin)))]
    for name, contrast in (("press04", 0.4), ("press06", 0.6)):
        found.append(Trial(name, presses(contrast, deformations, each, skin), lowering=True))
    return found


def presses(contrast: float, deformations: int, each: int, skin: Skin = PAPER) -> tuple[Phantom, ...]:
    """Return phantoms of one press of a contrast, by turns a soft square and a soft disc."""
    square, disc = (
        trials.single(PRESS_MM, deformations, each, "A", trials.TouchProfile(contrast, PRESS_BORDER_MM, round_), skin)
        for round_ in (False, True)
    )
    return tuple(two[number % 2] for number, two in enumerate(zip(square, disc, strict=True)))


def sets_of_touches(labels: Literal["units", "area"], deformations: int, each: int, skin: Skin) -> tuple[Phantom, ...]:
    """Return sets of touches anywhere, or of units, for a sheet that the paper's phantoms are not on."""
    most = min(6, skin.grid.n_units) if labels == "units" else 4
    return tuple(trials.random((1, most), deformations, each, "A", labels, skin))


def run_rows(
    rows: Sequence[Row],
    kinds: Sequence[Trial],
    runs: Mapping[str, Run],
    judges: Mapping[str, Judge],
    plan: Plan,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Return a row of figures for every mismatch.

    Args:
        rows: Names and mismatches.
        kinds: Trials.
        runs: Solver by trial; its reference is "pre" or "predicted".
        judges: Gate by trial.
        plan: Draws, seed, noise.
        progress: Called with devices done and all devices.
    """
    found = []
    for index, (name, mismatch) in enumerate(rows):
        outcomes: dict[str, list[Outcome]] = {one.name: [] for one in kinds}
        drawn = []
        for number, device in devices(mismatch, plan):
            drawn.append(deviations(device.mismatch))
            for kind in kinds:
                if not (kind.labels == "units" and device.mismatch.alters_touches):
                    outcomes[kind.name] += _run(device, kind, runs[kind.name], judges[kind.name], plan, number)
            if progress is not None:
                progress(index * plan.draws + number - plan.first + 1, len(rows) * plan.draws)
        found.append(
            {
                "name": name,
                "devices": drawn,
                **{kind: figures(them) if them else None for kind, them in outcomes.items()},
            }
        )
    if progress is not None:
        progress(len(rows) * plan.draws, len(rows) * plan.draws)
    return found


def devices(mismatch: Mismatch | None, plan: Plan) -> Iterator[tuple[int, Device]]:
    """Yield the devices of a row, each with its number: as many as the plan says, the nominal one once.

    Args:
        mismatch: Of the row; None draws that too.
        plan: Draws and seed.
    """
    for number in range(plan.first, plan.first + (1 if mismatch == Mismatch() else plan.draws)):
        off = mismatch if mismatch is not None else _random(plan, number)
        yield number, draw_device(off, plan.seed, number, plan.meant)


def _random(plan: Plan, number: int) -> Mismatch:
    return random_mismatch(np.random.default_rng([DRAW_SEED + 1, plan.seed, number]), plan.meant)


def _run(device: Device, kind: Trial, run: Run, judge: Judge, plan: Plan, number: int) -> list[Outcome]:
    found = []
    for case, phantom in cases(device, kind, run.reference, plan, number):
        image, truth = run.solver(case), truth_map(phantom, plan.skin.grid)
        touched = judge(case.voltages, case.flat_reference)
        found.append(Outcome(correlation(image, truth), distances_mm(image, truth, plan.skin.grid), touched))
    return found


def cases(
    device: Device,
    kind: Trial,
    reference: Reference,
    plan: Plan,
    number: int,
) -> Iterator[tuple[Case, Phantom]]:
    """Yield what a solver may see of every phantom of a trial on a device, and the phantom.

    Args:
        device: The true one.
        kind: The kind of touches.
        reference: "pre" or "predicted".
        plan: Seed and noise.
        number: Of the device.
    """
    taken, flat = voltages_of(device.reference(), device.front_end), flat_voltages(plan.skin)
    seeds = [DRAW_SEED, plan.seed, number]
    if device.mismatch.reference_snr_db is not None:
        taken = add_noise(taken, taken, "N2", device.mismatch.reference_snr_db, np.random.default_rng([*seeds, 0]))
    if device.mismatch.reference_scan:
        scan = device.cloud(device.reference().bend, np.random.default_rng([*seeds, 2]))
        taken = taken if scan is None else taken * flat / predict(scan, plan.skin)
    for index, phantom in enumerate(kind.phantoms):
        scene = device.scene(phantom.scene, as_it_is=kind.lowering)
        rng = np.random.default_rng([*seeds, 1, index])
        noisy = add_noise(voltages_of(scene, device.front_end), taken, plan.noise, plan.snr_db, rng)
        sheet = _sheet(device, phantom, rng, plan.skin)
        held = sheet.predicted() * taken / flat if reference == "predicted" else taken
        yield Case(noisy, held, taken, sheet, kind.labels, lowering=kind.lowering), phantom


def _sheet(device: Device, phantom: Phantom, rng: np.random.Generator, skin: Skin) -> Sheet:
    cloud = device.cloud(phantom.scene.bend, rng)
    is_guess = cloud is None and is_family(skin.deformations)
    return Sheet(flat_cloud(skin.grid) if cloud is None else cloud, np.full(N_ROWS, np.nan), skin, is_guess)


@lru_cache(maxsize=1024)
def voltages_of(scene: Scene, front_end: FrontEnd = IDEAL) -> Array:
    """Return the (104,) V that is read of a true scene; rows that differ by scans and references alone share them."""
    if front_end == IDEAL:
        return solve_scene(replace(scene, element_size_mm=ELEMENT_MM)).voltages
    return front_end.read(_response(scene), current_A=scene.current_A)


@lru_cache(maxsize=1024)
def _response(scene: Scene) -> Array:
    """Return the (16, 16) ohm of a true scene: rows that differ by front ends share them."""
    return response_of(factorise_scene(replace(scene, element_size_mm=ELEMENT_MM)))


def figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the summary of one trial's maps; the rms is over the touches that are not missed."""
    cc = np.array([one.cc for one in outcomes])
    missed, rms = missed_and_rms(np.concatenate([one.distances_mm for one in outcomes]))
    return {
        "maps": len(outcomes),
        "cc": float(cc.mean()),
        "cc_worst": float(cc.min()),
        "localisation_rms_mm": rms,
        "missed": missed,
        "gate_missed": float(np.mean([not one.touched for one in outcomes])),
    }
