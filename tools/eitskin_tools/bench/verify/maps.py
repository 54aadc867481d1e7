"""Maps of one condition: true devices at unseen deformations, solved on their own mesh, verified, and counted."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from eitskin_proto.sensor.row_gaussian import RowGaussian
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.devices.device import draw_device
from eitskin_sim.evaluation.harness import Case, Sheet
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.consistency import Filler
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.units import UnitVerifier
from eitskin_tools.bench.verify.conditions import Condition
from eitskin_tools.evaluation.solvers import Request, bundle_for, named
from eitskin_tools.evaluation.verified.units import Checked, Verified

ELEMENT_MM: Final = 2.0
"""Of the true sheets' mesh, whose lines are not those of the model's."""

SEED: Final = 61_007
"""Names touches, noise and scans; deformations are those of the trials."""


def measure(conditions: Sequence[Condition], deformations: int, each: int, budget_s: float) -> list[dict[str, Any]]:
    """Return a row of figures for every condition.

    Args:
        conditions: The rows.
        deformations: How many of family A.
        each: Touch sets at each of them.
        budget_s: The verifier's.
    """
    network = named(Request("vd2t"), "units").run
    arrays = bundle_for(Request("vd2t"), "units").consistency_arrays()
    filler = None
    if arrays is not None:
        filler = Filler(RowGaussian(np.asarray(arrays["mean"], float), np.asarray(arrays["covariance"], float)))
    found: dict[str, list[tuple[bool, bool, Checked[Any]]]] = {one.name: [] for one in conditions}
    for number, bend in enumerate(trials.deformations_of(deformations, "A")):
        made: dict[bytes, UnitVerifier] = {}
        for condition in conditions:
            if condition.missing and filler is None:
                continue
            device = draw_device(condition.mismatch, 0, number)
            flat = _volts(replace(device.reference(), element_size_mm=ELEMENT_MM))
            cloud = device.cloud(bend, np.random.default_rng([SEED, number]))
            assert cloud is not None
            sheet = Sheet(cloud, np.full(len(flat), np.nan))
            rng = np.random.default_rng([SEED, number, 1])
            gone: tuple[int, ...] = ()
            verified = Verified(network, Noise(condition.noise), PAPER, budget_s, made=made)
            for _ in range(each):
                units, volts = _touched(condition, device, bend, rng)
                if condition.missing:
                    gone = (int(rng.integers(N_ELECTRODES)),)
                    verified = Verified(network, Noise(condition.noise), PAPER, budget_s, gone, filler, made)
                noisy = add_noise(volts, flat, condition.noise, 50.0, rng)
                verified.solve(Case(noisy, flat, flat, sheet, "units"))
                checked = verified.checked[-1]
                right = {one.unit for one in checked.verdict.touches} == set(units)
                alone = set(np.flatnonzero(checked.network).tolist()) == set(units)
                found[condition.name].append((alone, right, checked))
    return [figures(one, found[one.name]) for one in conditions if found[one.name]]


def _touched(condition: Condition, device: Any, bend: Bend, rng: np.random.Generator) -> tuple[list[int], Any]:
    grid = PAPER.grid
    count = int(rng.integers(condition.counts[0], condition.counts[1] + 1))
    units = np.sort(rng.choice(grid.n_units, count, replace=False)).tolist()
    contrasts = condition.contrasts(count, rng)
    touches = []
    for unit, contrast in zip(units, contrasts, strict=True):
        row, column = divmod(unit, grid.units[1])
        touches.append(Touch((Rect(*grid.unit_rect_mm(column, row)),), contrast=contrast))
    scene = device.scene(nominal_scene(PAPER, bend, tuple(touches)), as_it_is=True)
    return units, _volts(replace(scene, element_size_mm=ELEMENT_MM))


def _volts(scene: Any) -> Any:
    return solve_scene(scene).voltages


def figures(condition: Condition, maps: list[tuple[bool, bool, Checked[Any]]]) -> dict[str, Any]:
    """Return what the maps of a condition come to: (network right, verifier right, verdict) each."""
    alone, right = (np.array([one[index] for one in maps]) for index in (0, 1))
    flagged = np.array([one.verdict.flagged for _, _, one in maps])
    cpu = np.array([one.cpu_ms for _, _, one in maps])
    setup = [one.setup_ms for _, _, one in maps if one.setup_ms]
    return {
        "what": condition.name,
        "maps": len(maps),
        "network_exact": float(alone.mean()),
        "exact": float(right.mean()),
        "wrong": int((~right).sum()),
        "wrong_unflagged": int((~right & ~flagged).sum()),
        "right_flagged": int((right & flagged).sum()),
        "chi_squared_median": float(np.median([one.verdict.chi_squared for _, _, one in maps])),
        "cpu_ms_median": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "setup_ms_median": float(np.median(setup)) if setup else 0.0,
        "p_values": [one.verdict.p_value for _, exact, one in maps if exact],
    }
