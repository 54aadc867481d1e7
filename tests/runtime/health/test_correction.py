"""The correction of filled-in rows: what is written here is multiplied out by hand, and nothing absurd comes of it."""

import numpy as np
import pytest

from eitskin.health.correction import INPUTS, NAMES, Correction, Layers
from eitskin.health.imputation import Imputation
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

RANGE = np.array([0.01, 8.0])
WIDTH = 12


def arrays(scale: float = 0.3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    shapes = ((INPUTS, WIDTH), (WIDTH,), (WIDTH, WIDTH), (WIDTH,), (WIDTH, N_ROWS), (N_ROWS,))
    return {
        name: (scale * rng.standard_normal(shape)).astype(np.float16) for name, shape in zip(NAMES, shapes, strict=True)
    }


def layers(scale: float = 0.3) -> Layers:
    found = Layers.of(arrays(scale))
    assert found is not None
    return found


def silu(x: np.ndarray) -> np.ndarray:
    return np.asarray(x / (1.0 + np.exp(-x)))


@pytest.mark.parametrize("electrodes", [(0,), (4, 5), (1, 8, 15)])
def test_the_correction_is_the_three_layers_multiplied_out(electrodes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    apart, predicted = 0.2 * rng.standard_normal(N_ROWS), 0.1 * rng.standard_normal(N_ROWS).astype(np.float32)
    weights = {name: value.astype(np.float64) for name, value in arrays().items()}
    gone = np.zeros(16)
    gone[list(electrodes)] = 1.0
    hidden = silu(np.concatenate([apart, gone, predicted]) @ weights["filling_first"] + weights["filling_first_bias"])
    hidden = silu(hidden @ weights["filling_second"] + weights["filling_second_bias"])
    expected = hidden @ weights["filling_third"] + weights["filling_third_bias"]
    rows = np.flatnonzero(rows_of(electrodes))
    found = Correction(layers(), rows, electrodes).of(apart, predicted)
    np.testing.assert_allclose(found, expected[rows], atol=1e-5)  # float32: 1e-7 of sums of 200 terms of size 0.1


def filled(change: np.ndarray, electrodes: tuple[int, ...], with_layers: Layers | None) -> np.ndarray:
    rng = np.random.default_rng(4)
    causes = 0.1 * rng.standard_normal((8, N_ROWS))
    precision = np.asarray(np.linalg.inv(causes.T @ causes + 1e-4 * np.eye(N_ROWS)), dtype=np.float64)
    filling = Imputation(np.zeros(N_ROWS), precision, RANGE, with_layers)
    filling.leave_out(rows_of(electrodes), precision, electrodes)
    found = change.astype(np.float32)
    filling.fill(found)
    return found


def test_it_is_added_to_the_logarithm_of_the_missing_rows_alone() -> None:
    change = np.expm1(0.1 * np.random.default_rng(2).standard_normal(N_ROWS))
    rows = rows_of((7,))
    plain, corrected = filled(change, (7,), None), filled(change, (7,), layers())
    apart = np.log1p(plain.astype(np.float64))
    step = Correction(layers(), np.flatnonzero(rows), (7,)).of(apart, np.zeros(N_ROWS, dtype=np.float32))
    np.testing.assert_allclose(np.log1p(corrected[rows]), apart[rows] + step, atol=1e-5)
    np.testing.assert_array_equal(corrected[~rows], plain[~rows])
    assert np.abs(step).max() > 0.01
