"""What a bundle says of healthy frames, from the data that its network learned from."""

import io
from typing import Any

import numpy as np
import pytest

from eitskin.electrodes import ElectrodeWatch
from eitskin.imputation import Consistency, without_rows
from eitskin.imputation import rows_of as deployed_rows
from eitskin_export.consistency import Healthy, evidence, healthy
from eitskin_export.projection import damped_inverse, tikhonov
from eitskin_export.untouched import bends_of
from eitskin_sim.consistency import Filler, rows_of
from eitskin_training.data import TrainingData, consistency_of, noisy_change
from eitskin_training.recipes import recipe

INVERSE = np.eye(104)


@pytest.fixture(scope="module")
def data(toy_data: Any) -> TrainingData:
    made: TrainingData = toy_data("units", bends=12, samples=2400)
    return made


@pytest.fixture(scope="module")
def found(data: TrainingData) -> Healthy:
    return healthy(data, recipe("tiny"), bends_of(data), INVERSE)


def test_the_runtime_reads_what_export_wrote(found: Healthy) -> None:
    with np.load(io.BytesIO(found.to_npz()), allow_pickle=False) as archive:
        deployed = Consistency.of(dict(archive))
    np.testing.assert_array_equal(deployed.covariance, found.arrays["covariance"])


def test_training_and_runtime_fill_in_the_same(data: TrainingData, found: Healthy) -> None:
    change = noisy_change(data, data.validation[:5], ("N2",), 50.0, np.random.default_rng(0))
    taught = change.copy()
    Filler(consistency_of(data, recipe("tiny"))).fill(taught, (3, 9))
    watch = ElectrodeWatch(Consistency.of(found.arrays), data.reference, np.zeros(104), excluded=(3, 9))
    for row in range(len(change)):
        watch.correct(change[row])
    # The same mathematics in another order of operations, rounded to float32.
    np.testing.assert_allclose(change, taught, atol=2e-5)
    assert np.array_equal(rows_of((3, 9)), deployed_rows((3, 9)))


def test_thresholds_hold_on_frames_that_did_not_choose_them(data: TrainingData, found: Healthy) -> None:
    assert (found.arrays["thresholds"] > 0).all()
    assert found.frames > 50
    # 1 in 10,000 is aimed at; the few frames of toy data say no more than "rare".
    assert found.false_alarm_rate < 0.1
    seen = evidence(
        Consistency.of(found.arrays), noisy_change(data, data.validation, ("N2",), 50.0, np.random.default_rng(1))
    )
    assert np.mean(seen > found.arrays["thresholds"]) < 0.1


def test_the_projection_loses_rows_as_if_built_without_them() -> None:
    jacobian = np.random.default_rng(2).standard_normal((104, 300))
    rows = rows_of((6,))
    left = jacobian[~rows]
    tau = 1e-3 * np.linalg.norm(jacobian, 2) ** 2
    anew = left.T @ np.linalg.inv(left @ left.T + tau * np.eye(len(left)))
    found = without_rows(tikhonov(jacobian), damped_inverse(jacobian), rows)
    np.testing.assert_allclose(found[:, ~rows], anew, atol=1e-6 * np.abs(anew).max())  # the matrix is float32
