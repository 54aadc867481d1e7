"""Checks that hold for every test, and fixtures of more than one package.

Imports of packages stay inside: tests/runtime also runs where torch is absent.
"""

import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from .checks.cpu_limit import LIMIT_S, CpuLimit
from .checks.leftovers import Leftovers, temporary_directory
from .checks.started_processes import StartedProcesses

# One thread a product, as BLAS and torch read it when they are first imported: tests share the cores already, and
# threads that wait for each other cost more than they bring.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def pytest_configure(config: pytest.Config) -> None:
    """Have every test checked for its CPU time and its processes, and let what it starts hear Ctrl-C."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as behind a shell's "&", and a new program would inherit it
        signal.signal(signal.SIGINT, lambda *_: None)  # no less deaf here, but a new program starts with the default
    config.pluginmanager.register(CpuLimit(LIMIT_S), "cpu-limit")
    config.pluginmanager.register(StartedProcesses(), "started-processes")


@pytest.fixture(scope="session")
def _leftovers() -> Iterator[Leftovers]:
    """Give the run a temporary directory of its own, and fail at the end if anything is left there.

    Its name is short: sockets lie in it, and a socket's path has at most 107 bytes.
    """
    with tempfile.TemporaryDirectory(prefix="t", ignore_cleanup_errors=True) as name, temporary_directory(name):
        found = Leftovers(Path(name))
        yield found
        left = found.left()
    if left:
        pytest.fail("left in the temporary directory: " + "; ".join(left), pytrace=False)


@pytest.fixture(autouse=True)
def _leaves_nothing(_leftovers: Leftovers, request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    _leftovers.look(request.node.nodeid)


@pytest.fixture(scope="session")
def toy_data() -> Callable[..., Any]:
    """Return a maker of linear toy data that trains in seconds: V = V0 (1 - A x), and bends that scale it."""
    import numpy as np

    from eitskin_proto.sensor.grid import N_UNITS, map_from_units
    from eitskin_proto.sensor.table import N_ROWS
    from eitskin_training.samples.batches import TrainingData

    def make(labels_kind: Any = "units", samples: int = 600, bends: int = 4, seed: int = 0) -> Any:
        rng = np.random.default_rng(seed)
        sets, trained = samples // bends, bends - 2
        units = np.zeros((sets, N_UNITS), dtype=np.uint8)
        units[np.arange(sets), rng.integers(N_UNITS, size=sets)] = 1
        units[0] = 0
        labels = units if labels_kind == "units" else 255 * map_from_units(units).reshape(sets, -1)
        mixing = 0.1 * np.abs(rng.standard_normal((N_ROWS, N_UNITS)))
        reference = -np.exp(rng.uniform(-3, 0, N_ROWS))
        scale = 1.0 + 0.1 * rng.permutation(bends) / bends
        touch_set = np.tile(np.arange(sets), bends)
        deformation = np.repeat(np.arange(bends), sets)
        voltages = reference * scale[deformation, None] * (1.0 - units[touch_set] @ mixing.T)
        validation = touch_set % 10 == 0
        return TrainingData(
            voltages=voltages.astype(np.float32),
            deformation=deformation,
            touch_set=touch_set,
            reference=reference,
            untouched=reference * scale[:, None],
            clouds=rng.standard_normal((bends, 3, 30, 45)).astype(np.float32),
            log_predicted=np.log(scale)[:, None].repeat(N_ROWS, 1).astype(np.float32),
            labels_kind=labels_kind,
            labels=labels.astype(np.uint8),
            train=np.flatnonzero(~validation & (deformation < trained)),
            validation=np.flatnonzero(validation & (deformation < trained)),
            held_out={"A": np.flatnonzero(validation & (deformation >= trained))},
            digest="toy",
            seed=seed,
        )

    return make
