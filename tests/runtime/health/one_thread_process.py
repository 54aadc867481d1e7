"""A failing electrode, in a program whose BLAS has threads of its own: prints how often any of these was woken for it.

A thread of the pool may also leave its wait unasked, by a spurious wake-up or a page that is not there. A product that
is handed to the pool is handed to it each time, so a failure that seems to wake it is shown again.

python one_thread_process.py BUNDLE
"""

import os
import sys
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "4"

import numpy as np

from eitskin.health.imputation import Consistency
from eitskin.health.monitor import Health
from eitskin.health.swapped_wires import rewiring
from eitskin.model.bundle import load_bundle
from eitskin.model.gate import Gate
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

PROJECTION = np.ones((1350, N_ROWS), dtype=np.float32)
FRAMES = 150
SHOWN = 5


def pool():
    """Return (sleeping, times it was woken) of the threads that are not this one."""
    sleeping, woken = True, 0
    for thread in Path("/proc/self/task").iterdir():
        if int(thread.name) != os.getpid():
            fields = dict(line.split(":\t") for line in (thread / "status").read_text().splitlines())
            sleeping = sleeping and fields["State"].startswith("S")
            woken += int(fields["voluntary_ctxt_switches"])
    return sleeping, woken


def at_rest():
    """Wait until the pool, which spins for a while after each product, sleeps; return how often it was woken."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        sleeping, woken = pool()
        time.sleep(0.05)
        if sleeping and pool() == (True, woken):
            return woken
    raise SystemExit("the pool does not come to rest")


def fail(consistency, gate, failing):
    """Let a failure happen, and return how often the pool was woken and what was found."""
    reference = consistency.reference
    rng = np.random.default_rng(1)
    before = at_rest()
    health = Health(consistency)
    health.use_reference(reference, np.abs(reference) * 0.02, gate)  # noisy, so that the gate's threshold is set anew
    health.use_reference(reference, np.abs(reference) * 0.003, gate)
    for number in range(FRAMES):
        change = (0.003 * rng.standard_normal(N_ROWS)).astype(np.float32)
        if number >= 20:
            change = failing(change, reference, rng)
        health.prepare(change)
        gate.change[:] = change
        gate.touched()
        health.complete(change)
        health.put_aside(touched=False)
        if health.due and health.examine(np.zeros(N_ROWS, dtype=np.float32)):
            health.projection(PROJECTION)
    return at_rest() - before, health.electrodes.texts


def detached(change, reference, rng):
    rows = rows_of((5,))
    change[rows] = -1.0 + 0.01 * rng.standard_normal(rows.sum())
    return change


def swapped(change, reference, rng):
    return (rewiring(4, 5).matrix @ ((change + 1.0) * reference) / reference - 1.0).astype(np.float32)


def main():
    bundle = load_bundle(sys.argv[1])
    consistency, gate = Consistency.of(bundle.consistency_arrays()), Gate(bundle.gate_arrays())
    for name, size in (("large", 800), ("small", N_ROWS)):
        square = np.ones((size, size))
        before = at_rest()
        square @ (square[0] if name == "small" else square)
        print(f"a {name} product", at_rest() - before)
    for failing in (detached, swapped):
        for _ in range(SHOWN):
            woken, texts = fail(consistency, gate, failing)
            if not woken:
                break
        print(failing.__name__, woken, *texts, sep="\t")


main()
