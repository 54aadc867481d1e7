"""A toy data set whose voltages really depend on the touch, so that a network can learn it in seconds."""

from collections.abc import Callable

import numpy as np
import pytest

from eitskin_proto.grid import N_UNITS, map_from_units
from eitskin_proto.table import N_ROWS
from eitskin_training.data import TrainingData

MakeData = Callable[..., TrainingData]


@pytest.fixture(scope="session")
def toy_data() -> MakeData:
    """Return a maker of linear toy data: V = V0 (1 - A x), a handful of bends that scale it."""

    def make(labels_kind: str = "units", samples: int = 600, bends: int = 3, seed: int = 0) -> TrainingData:
        rng = np.random.default_rng(seed)
        sets = samples // bends
        units = np.zeros((sets, N_UNITS), dtype=np.uint8)
        units[np.arange(sets), rng.integers(N_UNITS, size=sets)] = 1
        units[0] = 0
        labels = units if labels_kind == "units" else 255 * map_from_units(units).reshape(sets, -1)
        mixing = 0.1 * np.abs(rng.standard_normal((N_ROWS, N_UNITS)))
        reference = -np.exp(rng.uniform(-3, 0, N_ROWS))
        scale = 1.0 + 0.1 * np.arange(bends)
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
            labels_kind=labels_kind,  # type: ignore[arg-type]
            labels=labels.astype(np.uint8),
            train=np.flatnonzero(~validation & (deformation < bends - 1)),
            validation=np.flatnonzero(validation & (deformation < bends - 1)),
            held_out={"A": np.flatnonzero(validation & (deformation == bends - 1))},
            digest="toy",
            seed=seed,
        )

    return make
