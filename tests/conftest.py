"""Settings of every run, and fixtures of more than one package.

Imports of packages stay inside: tests/runtime also runs where torch is absent.
"""

import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import pytest

# One thread a product, as BLAS and torch read it when they are first imported: tests share the cores already, and
# threads that wait for each other cost more than they bring.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def pytest_configure() -> None:
    """Let programs that tests start hear Ctrl-C, behind a shell's "&" too, where a new program would ignore it."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda *_: None)


@pytest.fixture(scope="session", autouse=True)
def _temporary_directory() -> Iterator[None]:
    """Give the run, and what it starts, a temporary directory of its own, which goes when it ends.

    Its name is short: sockets are created in it, and a socket's path has at most 107 bytes.
    """
    before = os.environ.get("TMPDIR")
    with tempfile.TemporaryDirectory(prefix="t", ignore_cleanup_errors=True) as name:
        os.environ["TMPDIR"] = tempfile.tempdir = name
        yield
        tempfile.tempdir = None
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before


@pytest.fixture(scope="session")
def toy_data() -> Callable[..., Any]:
    """Return a maker of linear toy data that trains in seconds: V = V0 (1 - A x), and bends that scale it."""
    import numpy as np

    from eitskin_proto.sensor.table import N_ROWS
    from eitskin_proto.skin.skin import PAPER
    from eitskin_training.samples.batches import TrainingData

    def make(labels_kind: Any = "units", samples: int = 600, bends: int = 4, seed: int = 0, skin: Any = PAPER) -> Any:
        grid = skin.grid
        rng = np.random.default_rng(seed)
        sets, trained = samples // bends, bends - 2
        units = np.zeros((sets, grid.n_units), dtype=np.uint8)
        units[np.arange(sets), rng.integers(grid.n_units, size=sets)] = 1
        units[0] = 0
        labels = units if labels_kind == "units" else 255 * grid.map_from_units(units).reshape(sets, -1)
        mixing = 0.1 * np.abs(rng.standard_normal((N_ROWS, grid.n_units)))
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
            clouds=rng.standard_normal((bends, 3, *grid.shape)).astype(np.float32),
            log_predicted=np.log(scale)[:, None].repeat(N_ROWS, 1).astype(np.float32),
            labels_kind=labels_kind,
            labels=labels.astype(np.uint8),
            train=np.flatnonzero(~validation & (deformation < trained)),
            validation=np.flatnonzero(validation & (deformation < trained)),
            held_out={"A": np.flatnonzero(validation & (deformation >= trained))},
            digest="toy",
            seed=seed,
            skin=skin,
        )

    return make
