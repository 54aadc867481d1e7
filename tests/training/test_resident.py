"""The steps of an epoch on the CPU, where they run without a graph; with a graph on a GPU."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eitskin_proto.sensor.normalise import inverse_reference, relative_change
from eitskin_sim.measurement.consistency import RowImputation
from eitskin_training import train
from eitskin_training.network.mirror import mirrors
from eitskin_training.recipes import recipe
from eitskin_training.resident import LostElectrodes, ResidentData, ResidentSteps, lose_rows, noisy_change
from eitskin_training.samples.batches import consistency_of

pytestmark = pytest.mark.heavy

CPU = torch.device("cpu")
QUIET = replace(recipe("tiny"), lost_rows=0.0, lost_electrode=0.0, predicted_dropout=0.0, noises=("N2",), snr_db=300.0)
"""Batches without noise to speak of, so that what they hold can be compared."""


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("kind", ["N1", "N2", "N3"])
@pytest.mark.parametrize("snr_db", [40.0, (40.0, 40.0)])
def test_noise_has_the_level_that_its_definition_states(kind: Any, snr_db: Any, toy_data: Any) -> None:
    data = toy_data("units", samples=3000)
    clean = relative_change(data.voltages, data.reference)
    moved = np.sqrt(np.mean(clean**2, axis=1)) > 1e-3  # single precision is coarser than 40 dB of nothing
    volts, clean = data.voltages[moved], clean[moved]
    inverse = torch.from_numpy(inverse_reference(data.reference).astype(np.float32))
    noisy = noisy_change(torch.from_numpy(volts), inverse, (kind,), snr_db, seeded()).numpy()
    level = {
        "N1": np.sqrt(np.mean(clean**2, axis=1, keepdims=True)) * np.ones_like(clean),
        "N2": np.abs(volts / data.reference),
        "N3": np.sqrt(np.mean(volts**2, axis=1, keepdims=True)) / np.abs(data.reference),
    }[kind]
    assert np.sqrt(np.mean(((noisy - clean) / level) ** 2)) == pytest.approx(0.01, rel=0.01)


def test_lost_rows_are_zero_and_as_frequent_as_asked_for() -> None:
    lost = (lose_rows(torch.ones(4000, 104), 0.2, seeded()) == 0).sum(dim=1)
    assert int(lost.max()) == 4
    assert float((lost > 0).float().mean()) == pytest.approx(0.2, abs=0.02)
    assert sorted(set(lost.tolist())) == [0, 1, 2, 3, 4]


def test_electrodes_are_filled_in_as_the_runtime_does(toy_data: Any) -> None:
    data = toy_data("area", samples=400)
    gaussian = consistency_of(data, QUIET)
    lost = LostElectrodes(gaussian, CPU)
    change = relative_change(data.voltages, data.reference).astype(np.float32)
    for electrodes in ((3,), (2, 9), (0, 7, 15)):
        known = change.copy()
        RowImputation(gaussian).fill(known, electrodes)
        own, every = torch.zeros(len(change), dtype=torch.int64), torch.ones(len(change), 1, dtype=torch.bool)
        chosen = torch.tensor([lost.sets.index(electrodes)])
        found = lost.fill(torch.from_numpy(change), chosen, own, every)
        np.testing.assert_allclose(found.numpy(), known, atol=2e-5)
        same = lost.fill(torch.from_numpy(change), chosen, own, ~every)
        assert torch.equal(same, torch.from_numpy(change))


def test_smaller_sets_of_electrodes_are_lost_more_often(toy_data: Any) -> None:
    lost = LostElectrodes(consistency_of(toy_data("area", samples=200), QUIET), CPU)
    assert len(lost.sets) == 16 + 120 + 560
    assert lost.sets[:16] == [(one,) for one in range(16)]
    assert float(lost.chances[-1]) == pytest.approx(1.0)
    drawn = torch.searchsorted(lost.chances, torch.rand(20000, generator=seeded()))
    sizes = np.bincount([len(lost.sets[one]) for one in drawn.clamp(max=695)], minlength=4)[1:] / 20000
    np.testing.assert_allclose(sizes, (0.7, 0.2, 0.1), atol=0.015)


@pytest.mark.parametrize(("together", "flips"), [(0, False), (3, False), (3, True)])
def test_a_table_names_each_sample_once_and_the_cloud_that_it_has(together: int, flips: bool, toy_data: Any) -> None:
    data = toy_data("area", samples=2000, bends=12)
    chosen = replace(QUIET, batch=32, together=together, flips=flips)
    stored = ResidentData(data, chosen, CPU)
    table = stored.table(np.random.default_rng(0))
    samples = table.samples.flatten()
    assert len(set(samples.tolist())) == len(samples) == len(data.train) // 32 * 32
    clouds = table.clouds.gather(1, table.which)
    assert torch.equal(clouds.flatten(), stored.deformation[samples])
    assert stored.slots == (10 if together == 0 else 6)
    assert int(table.images.max()) == (3 if flips else 0)
    for occurring, batch in zip(table.clouds, table.samples, strict=True):
        assert set(occurring.tolist()) == set(stored.deformation[batch].tolist())


def test_images_shown_are_the_mirror_images_of_the_skin(toy_data: Any) -> None:
    data = toy_data("area", samples=200)
    stored = ResidentData(data, replace(QUIET, flips=True), CPU)
    assert len(mirrors(data.skin)) == len(stored.clouds) == 4
    for image, mirror in enumerate(mirrors(data.skin)):
        np.testing.assert_array_equal(stored.clouds[image], mirror.clouds(data.clouds))
        np.testing.assert_array_equal(stored.rows_shown[image], mirror.rows)
        np.testing.assert_array_equal(stored.outputs_shown[image], mirror.pixels)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
@pytest.mark.parametrize("name", ["tiny", "units", "small"])
def test_a_captured_step_learns_what_a_plain_one_does(name: str, toy_data: Any, tmp_path: Path) -> None:
    base = recipe(name)
    data = toy_data(base.labels, samples=1500)
    chosen = replace(base, epochs=3, batch=64, lost_rows=0.0, lost_electrode=0.0, predicted_dropout=0.0, snr_db=300.0)
    captured = train.train(data, chosen, tmp_path / "captured")
    run = train._start(chosen, 0, data)
    plain = ResidentSteps(run, data, torch.device("cuda"), captured.step)
    plain._stream = None
    run.model.train()
    losses = [plain.epoch(number, lambda: None) for number in (1, 2, 3)]
    assert [one.training_loss for one in captured.history] == pytest.approx(losses, rel=0.02)
    train.train(data, chosen, tmp_path / "parts", stop_after=1)
    resumed = train.train(data, chosen, tmp_path / "parts", resume=True)
    assert resumed.history[-1].training_loss == pytest.approx(losses[-1], rel=0.02)
