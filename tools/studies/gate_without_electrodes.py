"""Is the gate still honest without some electrodes? False alarms at fresh bends, and touches missed, by what it sees.

Three ways for a gate to see rows that are gone, on the same noisy frames ::

    whole                       nothing is gone
    as untouched (runtime)      rows as an untouched sheet has them, threshold of drawn sheets: what the runtime does
    as the network sees them    rows as touched and untouched sheets have them on average, the bundle's threshold

The last is what a gate gets that shares its rows with the network. A bend's frames trip a gate together, so an interval
is over bends.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.health.gate_without_rows import GateWithoutRows
from eitskin.health.imputation import Consistency, Imputation
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import Gate
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER as PAPER_SKIN
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_tools.bench.electrodes import Lost, lost_sets
from eitskin_tools.bench.harness import program, report
from eitskin_tools.command_line import files

REFERENCE_FRAMES: Final = 100
"""Noisy frames whose mean is the reference, and whose spread says how much a row varies."""

DRAWS: Final = 3
"""Noise draws of each sheet."""

PAPER: Final = "10 mm of contrast 50, anywhere"
"""A touch of one unit as the paper has them, off the grid."""

TOUCHES: Final = ("10 mm, middle", "10 mm, anywhere", "7 mm, middle", PAPER)
"""The first three are probes of the gate's export, of the weakest contrast that counts as a touch, 20."""

PAPER_CONTRAST: Final = 50.0

PLACES: Final = 20
"""Of the paper's touch, at each bend."""

UNTOUCHED: Final = "untouched"

Array = npt.NDArray[np.float64]
Judge = Callable[[Array], npt.NDArray[np.bool_]]
"""(n, 104) dV -> (n,) touched."""

Shown = dict[str, Array]
"""(sheets, draws, 104) dV of untouched sheets, and of touches by their name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", type=files.bundle, help="bundle to use (default: the shipped one of unit labels)")
    parser.add_argument("--noise", action="append", choices=("N1", "N2", "N3"), help="may be repeated (default N2)")
    parser.add_argument("--snr-db", type=float, default=50.0, metavar="DB", help="signal to noise ratio (default 50)")
    parser.add_argument("--bends", type=int, default=60, metavar="N", help="of A and of B, untouched (default 60)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    bundle = load_bundle(arguments.bundle or default_path("units"))
    gate, healthy = bundle.gate_arrays(), bundle.consistency_arrays()
    if gate is None or healthy is None:
        raise BundleError(f"{bundle.path} lacks a gate, or what healthy frames are like; 'eitskin export' makes both")
    noises = arguments.noise or ["N2"]
    rows = honest(gate, Consistency.of(healthy), noises, arguments.snr_db, bends=arguments.bends)
    return report(arguments, rows, {"rows": len(rows)})


def honest(
    arrays: dict[str, npt.NDArray[np.generic]],
    consistency: Consistency,
    noises: Sequence[Kind],
    snr_db: float,
    *,
    bends: int = 60,
    probed: int = 2,
    most_sets: int = 12,
) -> list[dict[str, Any]]:
    """Return rows on a bundle's gate with none to three electrodes gone.

    Args:
        arrays: Of gate.npz.
        consistency: Of the same bundle.
        noises: Kinds of noise.
        snr_db: Their level.
        bends: Of A and of B, untouched.
        probed: Of A and of B, touched.
        most_sets: Sets of two and of three electrodes.
    """
    logs = _logs(bends, probed)
    rows: list[dict[str, Any]] = []
    for kind in noises:
        rng = np.random.default_rng(len(rows))
        volts = consistency.reference
        reference = np.array([add_noise(volts, volts, kind, snr_db, rng) for _ in range(REFERENCE_FRAMES)])
        sigma = reference.std(axis=0, ddof=1) / np.abs(volts)
        shown = {name: _noisy(part, volts, reference.mean(axis=0), kind, snr_db, rng) for name, part in logs.items()}
        for count in range(4):
            sets = lost_sets(count, most_sets)
            for name, judge_of in _ways(arrays, consistency, sigma, count).items():
                judged = [{part: judge_of(lost)(dv.reshape(-1, N_ROWS)).reshape(dv.shape[:2])
                           for part, dv in shown.items()} for lost in sets]  # fmt: skip
                rows.append({"what": "gate", "noise": kind, "lost": count, "rows": name, **_row(judged, sets)})
    return rows


def _logs(bends: int, probed: int) -> dict[str, Array]:
    """Return log(V / V0) of fresh untouched sheets, and of touches at fresh bends."""
    from eitskin_sim.scene.family import draw
    from eitskin_sim.scene.parts import Bend
    from eitskin_tools.bench.skip import SEED, still
    from eitskin_training.gate.touches import probes, squares, touch_logs
    from eitskin_training.gate.untouched import untouched_logs

    found = {UNTOUCHED: np.concatenate([still("A", bends), still("B", bends)])}
    solved = probes(probed, SEED, PAPER_SKIN)
    found |= {name: np.concatenate([one.logs for one in solved if one.name == name]) for name in TOUCHES[:-1]}
    rng = np.random.default_rng(SEED)
    length, width = PAPER_SKIN.outline.size_mm
    places = [(float(x), float(y)) for x, y in rng.uniform((5.0, 5.0), (length - 5.0, width - 5.0), (PLACES, 2))]
    touches = squares(places, 10.0, PAPER_CONTRAST)
    members = (Bend(), *draw("A", probed, SEED), *draw("B", probed, SEED))
    found[PAPER] = np.concatenate(
        [touch_logs(bend, touches, PAPER_SKIN) + untouched_logs([bend], PAPER_SKIN) for bend in members]
    )
    return found


def _noisy(logs: Array, volts: Array, reference: Array, kind: Kind, snr_db: float, rng: np.random.Generator) -> Array:
    """Return (n, draws, 104) dV against a reference of the same noise."""
    clean = np.repeat((volts * np.exp(logs))[:, None], DRAWS, axis=1)
    return add_noise(clean, volts, kind, snr_db, rng) / reference - 1.0


def _ways(
    arrays: dict[str, npt.NDArray[np.generic]], consistency: Consistency, sigma: Array, count: int
) -> dict[str, Callable[[Lost], Judge]]:
    """Return what makes a judge of each way of seeing rows that are gone."""
    gate = Gate(arrays)
    gate_without_rows = GateWithoutRows(consistency, gate, np.maximum(sigma, 5e-4))

    def runtime(lost: Lost) -> Judge:
        gate_without_rows.leave_out(rows_of(lost))
        gate_without_rows.finish()
        threshold = gate.threshold
        return lambda dv: gate.logits(gate_without_rows.filled(dv)) > threshold

    if not count:
        return {"whole": runtime}
    plain = Gate(arrays)
    filling = Imputation(consistency.mean, consistency.precision(), consistency.ratio_range, consistency.layers)

    def shared(lost: Lost) -> Judge:
        filling.leave_out(rows_of(lost), consistency.precision(), lost)

        def judge(dv: Array) -> npt.NDArray[np.bool_]:
            changes = dv.astype(np.float32)
            for change in changes:
                filling.fill(change)
            return np.asarray(plain.logits(changes) > plain.threshold)

        return judge

    return {"as untouched (runtime)": runtime, "as the network sees them": shared}


def _row(judged: list[dict[str, npt.NDArray[np.bool_]]], sets: Sequence[Lost]) -> dict[str, Any]:
    from eitskin_training.gate.rates import rate_and_interval

    tripped = np.array([one[UNTOUCHED].mean(axis=1) for one in judged])  # (sets, bends)
    rate, interval = rate_and_interval(tripped.mean(axis=0))
    found: dict[str, Any] = {
        "sets": len(sets), "bends": tripped.shape[1], "frames": int(sum(one[UNTOUCHED].size for one in judged)),
        "false_alarms": round(rate, 5), "interval_95": [round(float(value), 5) for value in interval],
        "false_alarms_worst_set": round(float(tripped.mean(axis=1).max()), 5),
    }  # fmt: skip
    for name in TOUCHES:
        missed = np.array([1.0 - one[name].mean() for one in judged])
        worst = int(missed.argmax())
        found[f"missed {name}"] = round(float(missed.mean()), 4)
        found[f"missed {name}, worst set"] = round(float(missed[worst]), 4)
    return found


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
