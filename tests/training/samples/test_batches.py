from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_training.recipes import recipe
from eitskin_training.samples.batches import assemble, in_order, noisy_change


def test_a_batch_holds_each_cloud_once_and_the_right_one_for_each_sample(toy_data: Any) -> None:
    data = toy_data("area", bends=5)
    rows = data.train[::7]
    batch = assemble(data, rows, np.zeros((len(rows), 104), np.float32), np.zeros((len(rows), 104), np.float32))
    assert len(batch.clouds) == len(set(data.deformation[rows].tolist()))
    for sample, row in enumerate(rows):
        np.testing.assert_array_equal(batch.clouds[batch.which[sample]], data.clouds[data.deformation[row]])
        np.testing.assert_allclose(batch.labels[sample], data.labels[data.touch_set[row]] / 255.0, atol=1e-6)


def test_batches_of_few_deformations_bring_every_sample_once_but_the_last_few(toy_data: Any) -> None:
    data = toy_data("area", samples=2000, bends=12)
    chosen = replace(recipe("tiny"), batch=32, together=3)
    few, later = (in_order(data, chosen, np.random.default_rng([0, epoch])) for epoch in (1, 2))
    assert few.shape == (len(data.train) // 32, 32)
    assert len(set(few.ravel().tolist())) == few.size
    assert set(few.ravel().tolist()) <= set(data.train.tolist())
    bends = [set(data.deformation[batch].tolist()) for batch in few]
    assert np.mean([len(own) <= 3 for own in bends]) > 0.8  # the others are made of what was left
    assert len({tuple(sorted(own)) for own in bends if len(own) == 3}) > 1
    assert not np.array_equal(few, later)


@pytest.mark.parametrize("kind", ["N1", "N2", "N3"])
def test_noise_has_the_level_that_its_definition_states(kind: Any, toy_data: Any) -> None:
    data = toy_data("units", samples=3000)
    rows = data.train
    clean = relative_change(data.voltages[rows], data.reference)
    error = noisy_change(data, rows, (kind,), 40.0, np.random.default_rng(0)) - clean
    volts = data.voltages[rows]
    level = {
        "N1": np.sqrt(np.mean(clean**2, axis=1, keepdims=True)) * np.ones_like(clean),
        "N2": np.abs(volts / data.reference),
        "N3": np.sqrt(np.mean(volts**2, axis=1, keepdims=True)) / np.abs(data.reference),
    }[kind]
    # 200,000 draws: the rms of a normal variable is known to 0.2 %; 1 % leaves room for nothing else.
    assert np.sqrt(np.mean((error / level) ** 2)) == pytest.approx(0.01, rel=0.01)
