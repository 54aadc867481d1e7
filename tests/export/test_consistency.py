"""What a bundle says of healthy frames, from the data that its network learned from."""

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from eitskin.health.electrodes import ElectrodeWatch
from eitskin.health.imputation import Consistency
from eitskin_export.consistency import MeasuredConsistency, evidence, healthy
from eitskin_proto.sensor.row_gaussian import log_of_change, rows_of
from eitskin_sim.measurement.consistency import RowImputation
from eitskin_training.gate.untouched import bends_of
from eitskin_training.network.filling import Filling
from eitskin_training.recipes import recipe
from eitskin_training.samples.batches import TrainingData, consistency_of, noisy_change

INVERSE = np.eye(104)


@pytest.fixture(scope="module")
def data(toy_data: Any) -> TrainingData:
    made: TrainingData = toy_data("units", bends=12, samples=2400)
    return made


@pytest.fixture(scope="module")
def found(data: TrainingData) -> MeasuredConsistency:
    return healthy(data, recipe("tiny"), bends_of(data), INVERSE)


def test_the_runtime_reads_what_export_wrote(found: MeasuredConsistency) -> None:
    with np.load(io.BytesIO(found.to_npz()), allow_pickle=False) as archive:
        deployed = Consistency.of(dict(archive))
    np.testing.assert_array_equal(deployed.covariance, found.arrays["covariance"])


def test_training_and_runtime_fill_in_the_same(data: TrainingData, found: MeasuredConsistency) -> None:
    change = noisy_change(data, data.validation[:5], ("N2",), 50.0, np.random.default_rng(0))
    taught = change.copy()
    RowImputation(consistency_of(data, recipe("tiny"))).fill(taught, (3, 9))
    watch = ElectrodeWatch(Consistency.of(found.arrays), data.reference, np.zeros(104), excluded=(3, 9))
    for row in range(len(change)):
        watch.correct(change[row])
    # The same mathematics in another order of operations, rounded to float32.
    np.testing.assert_allclose(change, taught, atol=2e-5)
    assert np.array_equal(rows_of((3, 9)), rows_of((3, 9)))


def test_an_adapted_run_and_the_runtime_fill_in_the_same(data: TrainingData) -> None:
    chosen = recipe("tiny")
    torch.manual_seed(1)
    filling = Filling(consistency_of(data, chosen), width=40)
    torch.nn.init.normal_(filling.out.weight, std=0.05)  # untaught it would add nothing
    found = healthy(data, chosen, bends_of(data), INVERSE, filling.arrays())
    with np.load(io.BytesIO(found.to_npz()), allow_pickle=False) as archive:
        deployed = Consistency.of(dict(archive))
    change = noisy_change(data, data.validation[:5], ("N2",), 50.0, np.random.default_rng(0))
    predicted = data.log_predicted[data.deformation[data.validation[:5]]]
    logs = torch.from_numpy(log_of_change(change).astype(np.float32))
    with torch.inference_mode():
        taught, _ = filling(logs, [(slice(0, 5), (3, 9))], torch.from_numpy(predicted))
    watch = ElectrodeWatch(deployed, data.reference, np.zeros(104), excluded=(3, 9))
    plain = change.copy()
    for row in range(len(change)):
        watch.correct(change[row], predicted[row])
        watch.imputation.fill(plain[row])
    rows = rows_of((3, 9))
    # Weights of eleven bits, summed 40 at a time: the corrections agree to a thousandth of their size.
    step = np.abs(np.log1p(change[:, rows]) - np.log1p(plain[:, rows]))
    assert step.max() > 0.0
    np.testing.assert_allclose(np.log1p(change[:, rows]), taught.numpy()[:, rows], atol=2e-3)
    assert found.facts()["filling"] == [[224, 40], [40], [40, 40], [40], [40, 104], [104]]


def test_weights_beyond_half_precision_are_refused(data: TrainingData) -> None:
    arrays = Filling(consistency_of(data, recipe("tiny")), width=4).arrays()
    arrays["filling_third_bias"] = np.full(104, 1e5, dtype=np.float32)
    with pytest.raises(ValueError, match="adapt again"):
        healthy(data, recipe("tiny"), bends_of(data), INVERSE, arrays)


def test_a_single_deformation_is_refused(data: TrainingData) -> None:
    deformation = data.deformation[data.train]
    single = replace(data, train=data.train[deformation == deformation[0]])
    with pytest.raises(ValueError, match="has 1 deformation, expected 2 or more"):
        healthy(single, recipe("tiny"), bends_of(data), INVERSE)


def test_thresholds_hold_on_frames_that_did_not_choose_them(data: TrainingData, found: MeasuredConsistency) -> None:
    assert (found.arrays["thresholds"] > 0).all()
    assert found.frames > 50
    # 1 in 10,000 is aimed at; the few frames of toy data say no more than "rare".
    assert found.false_alarm_rate < 0.1
    seen = evidence(
        Consistency.of(found.arrays), noisy_change(data, data.validation, ("N2",), 50.0, np.random.default_rng(1))
    )
    assert np.mean(seen > found.arrays["thresholds"]) < 0.1
