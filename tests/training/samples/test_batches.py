from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from eitskin_proto.sensor.normalise import relative_change
from eitskin_training.network.mirror import mirrors
from eitskin_training.recipes import recipe
from eitskin_training.samples.batches import batches, lose_rows, noisy_change

CHOSEN = replace(recipe("tiny"), flips=True, lost_rows=0.0, lost_electrode=0.0, noises=("N2",), snr_db=300.0)
"""Batches without noise to speak of, so that what they hold can be compared."""


def test_an_epoch_depends_on_seed_and_number_alone(toy_data: Any) -> None:
    data = toy_data("area")
    first, again, later = (list(batches(data, recipe("tiny"), seed=3, epoch=number)) for number in (1, 1, 2))
    assert all(torch.equal(a.dv, b.dv) and torch.equal(a.labels, b.labels) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first[0].dv, later[0].dv)


def test_a_batch_holds_each_cloud_once_and_the_right_one_for_each_sample(toy_data: Any) -> None:
    data = toy_data("area", bends=5)
    flips = 0
    for batch in batches(data, CHOSEN, seed=0, epoch=1):
        assert len(batch.clouds) <= 4
        # The sample's own voltages say which bend and which mirror image it has.
        for sample in range(5):
            for mirror in mirrors(data.skin):
                change = batch.dv[sample].numpy()[mirror.rows]
                known = relative_change(data.voltages, data.reference)
                distance = np.abs(known - change).max(axis=1)
                row = int(distance.argmin())
                if distance[row] < 1e-5:
                    break
            assert distance[row] < 1e-5
            flips += mirror is not mirrors(data.skin)[0]
            image = mirror.clouds(data.clouds[data.deformation[row]][None])[0]
            np.testing.assert_array_equal(batch.clouds[batch.which[sample]].numpy(), image)
            label = data.labels[data.touch_set[row]][mirror.pixels] / 255.0
            np.testing.assert_allclose(batch.labels[sample].numpy(), label, atol=1e-6)
    assert flips


def test_batches_of_few_deformations_bring_every_sample_once_but_the_last_few(toy_data: Any) -> None:
    data = toy_data("area", samples=2000, bends=12)
    number = np.arange(len(data.voltages))[:, None]
    data = replace(data, voltages=(data.reference * (1.0 + 1e-3 * number)).astype(np.float32))  # dv tells the sample
    chosen = replace(CHOSEN, flips=False, batch=32)
    all_at_once, few = (list(batches(data, replace(chosen, together=n), seed=0, epoch=1)) for n in (0, 3))
    assert len(few) == len(all_at_once) == len(data.train) // 32
    rows = [np.rint(1e3 * batch.dv[:, 0].numpy()).astype(int) for batch in few]
    bends = [set(data.deformation[batch].tolist()) for batch in rows]
    seen = np.concatenate(rows)
    assert len(set(seen.tolist())) == len(seen)
    assert set(seen.tolist()) <= set(data.train.tolist())
    assert all(len(batch.clouds) == len(own) for batch, own in zip(few, bends, strict=True))
    assert np.mean([len(own) <= 3 for own in bends]) > 0.8  # the others are made of what was left
    assert len({tuple(sorted(own)) for own in bends if len(own) == 3}) > 1
    later = [batch.dv for batch in batches(data, replace(chosen, together=3), seed=0, epoch=2)]
    assert not torch.equal(few[0].dv, later[0])


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


def test_lost_rows_are_zero_and_as_frequent_as_the_recipe_says() -> None:
    dv = np.ones((4000, 104), dtype=np.float32)
    lose_rows(dv, replace(recipe("tiny"), lost_rows=0.2, lost_electrode=0.0), np.random.default_rng(0))
    lost = (dv == 0).sum(axis=1)
    assert lost.max() == 4
    assert np.mean(lost > 0) == pytest.approx(0.2, abs=0.02)
