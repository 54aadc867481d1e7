"""Rows of touched units: true devices at unseen deformations, verified, and counted."""

from typing import Any

import numpy as np

from eitskin_proto.sensor.row_gaussian import RowGaussian, rows_of
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.device import Device
from eitskin_sim.evaluation.harness import Case, Run, Sheet
from eitskin_sim.evaluation.metrics import TOUCHED
from eitskin_sim.measurement.consistency import Filler
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.shape_verifier import BUDGET_S
from eitskin_sim.verification.snapped_units import unit_shares
from eitskin_tools.bench.verify.conditions import Condition
from eitskin_tools.bench.verify.truth import SEED, Array, cloud_of, device_of, volts
from eitskin_tools.evaluation.solvers import Request, bundle_for, named
from eitskin_tools.evaluation.verified.solver import Verified

Row = dict[str, Any]


class Units:
    """Measures one row after another; what rows share is made once.

    Args:
        deformations: How many of family A.
        each: Touch sets at each of them.
        budget_s: The verifier's, for each frame; None is its own.
    """

    def __init__(self, deformations: int, each: int, budget_s: float | None) -> None:
        self._bends = trials.deformations_of(deformations, "A")
        self._each, self._budget_s = each, BUDGET_S if budget_s is None else budget_s
        self._network = named(Request("vd2t"), "units").run
        arrays = bundle_for(Request("vd2t"), "units").consistency_arrays()
        assert arrays is not None, "the shipped bundle of units fills in rows"
        self._filler = Filler(RowGaussian(np.asarray(arrays["mean"], float), np.asarray(arrays["covariance"], float)))
        self._image: Array = np.zeros(PAPER.grid.shape)

    def row(self, condition: Condition) -> Row:
        """Return the figures of a condition, its p-values among them.

        Frames of one sheet come one after another: what the first of them show of its material serves the next.
        """
        found, grid = [], PAPER.grid
        network = Run(lambda case: self._image, "pre")
        verified = Verified(
            network, Noise(condition.noise), "units", "raise", PAPER, self._budget_s, at_rest=condition.at_rest
        )
        for number, bend in enumerate(self._bends):
            device = device_of(condition.mismatch, number)
            flat = volts(device.reference())
            untouched = _volts(device, bend) if condition.at_rest else np.full(len(flat), np.nan)
            sheet = Sheet(cloud_of(device, bend, number), untouched)
            touches = np.random.default_rng([SEED, number, *condition.counts])
            rng = np.random.default_rng([SEED, number, 1])
            for _ in range(self._each):
                units, clean = _touched(condition, device, bend, touches)
                gone = (int(rng.integers(N_ELECTRODES)),) if condition.missing else ()
                noisy = add_noise(clean, flat, condition.noise, 50.0, rng)
                self._image = self._network.solver(Case(self._filled(noisy, flat, gone), flat, flat, sheet, "units"))
                kept = np.where(rows_of(gone), 0.0, flat)
                image = verified.solve(Case(noisy, kept, kept, sheet, "units"))
                alone, right = (
                    set(np.flatnonzero(unit_shares(one, grid) >= TOUCHED).tolist()) == set(units)
                    for one in (self._image, image)
                )
                found.append((alone, right, verified.checked[-1]))
        return {"what": condition.name, **figures(found), **counted(found)}

    def _filled(self, voltages_V: Array, flat_V: Array, gone: tuple[int, ...]) -> Array:
        """Return voltages with the rows of electrodes that are gone filled in, as the runtime does for its network."""
        change = (voltages_V / flat_V - 1.0)[None]
        if gone:
            self._filler.fill(change, gone)
        return np.asarray(flat_V * (1.0 + change[0]))


def _touched(condition: Condition, device: Device, bend: Bend, rng: np.random.Generator) -> tuple[list[int], Array]:
    """Return drawn units, the same whatever the device and the contrast, and the (104,) V of the sheet."""
    grid = PAPER.grid
    count = int(rng.integers(condition.counts[0], condition.counts[1] + 1))
    units = np.sort(rng.choice(grid.n_units, count, replace=False)).tolist()
    touches = []
    for unit in units:
        row, column = divmod(unit, grid.units[1])
        rect = Rect(*grid.unit_rect_mm(column, row))
        touches.append(Touch((rect,), contrast=condition.contrast, border_mm=condition.border_mm))
    return units, _volts(device, bend, tuple(touches))


def _volts(device: Device, bend: Bend, touches: tuple[Touch, ...] = ()) -> Array:
    return volts(device.scene(nominal_scene(PAPER, bend, touches), as_it_is=True))


def figures(maps: list[tuple[bool, bool, Any]]) -> Row:
    """Return shares of what is right: (network right, verifier right, verdict) of each map."""
    alone, right = (np.array([one[index] for one in maps]) for index in (0, 1))
    return {"maps": len(maps), "network_exact": float(alone.mean()), "exact": float(right.mean())}


def counted(maps: list[tuple[bool, bool, Any]]) -> Row:
    """Return what is wrong and not flagged, what it took, and the p-values of what is right."""
    right = np.array([one[1] for one in maps])
    flagged = np.array([one.verdict.flagged for _, _, one in maps])
    cpu = np.array([one.cpu_ms for _, _, one in maps])
    setup = [one.setup_ms for _, _, one in maps if one.setup_ms]
    return {
        "wrong": int((~right).sum()),
        "wrong_unflagged": int((~right & ~flagged).sum()),
        "right_flagged": int((right & flagged).sum()),
        "chi_squared_median": float(np.median([one.verdict.chi_squared for _, _, one in maps])),
        "cpu_ms_median": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "setup_ms_median": float(np.median(setup)) if setup else 0.0,
        "p_values": [one.verdict.p_value for _, exact, one in maps if exact],
    }
