"""The second training: what it changes, what it leaves, and that it is of use."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eitskin_proto.sensor.row_gaussian import log_of_change, rows_of
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.measurement.consistency import RowImputation
from eitskin_training import run_files, train
from eitskin_training.adapt import Plan, adapt, write
from eitskin_training.network.filling import Filling
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe, recipe
from eitskin_training.samples.batches import consistency_of, noisy_change

pytestmark = pytest.mark.heavy

QUICK = Plan(fitting_steps=20, steps=20, batch=64, rate=3e-3, width=32)


def tiny(**changes: Any) -> Recipe:
    return replace(recipe("tiny"), labels="units", **changes)


def trained(data: Any) -> VD2T:
    torch.manual_seed(0)
    return VD2T(tiny().architecture, PAPER).eval()


def test_untaught_it_fills_in_what_the_gaussian_says(toy_data: Any) -> None:
    data = toy_data("units", samples=600)
    consistency = consistency_of(data, tiny())
    change = noisy_change(data, data.validation[:6], ("N2",), 50.0, np.random.default_rng(0))
    expected = change.copy()
    RowImputation(consistency).fill(expected[:4], (3, 9))
    logs = torch.from_numpy(log_of_change(change).astype(np.float32))
    filled, missing = Filling(consistency)(logs, [(slice(0, 4), (3, 9))], torch.zeros(6, 104))
    # P has a condition of up to 1e5 and is multiplied in float32 here.
    np.testing.assert_allclose(np.expm1(filled.detach().numpy()[:4]), expected[:4], atol=2e-4)
    assert torch.equal(filled[4:], logs[4:])
    np.testing.assert_array_equal(missing.numpy(), np.arange(6)[:, None] < 4 * rows_of((3, 9)))


def test_the_clouds_half_and_the_running_means_stay(toy_data: Any) -> None:
    data = toy_data("units", samples=600)
    model = trained(data)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    adapted = adapt(model, tiny(), data, QUICK)
    after = adapted.model.state_dict()
    for name, value in before.items():
        kept = name.startswith(("cloud.", "fusion_cloud.", "standardise.")) or "running" in name
        assert not kept or torch.equal(value, after[name]), name
    assert not torch.equal(before["out.weight"], after["out.weight"])
    assert all(parameter.requires_grad for parameter in adapted.model.parameters())


@pytest.mark.slow
def test_maps_without_an_electrode_gain(toy_data: Any, tmp_path: Path) -> None:
    data, chosen = toy_data("units", samples=1000), tiny(epochs=6, learning_rate=5e-3, lost_electrode=0.0)
    train.train(data, chosen, tmp_path / "run")
    content = run_files.read(tmp_path / "run" / "best.pt")
    model = run_files.network(chosen, content["weights"], PAPER)
    adapted = adapt(model, chosen, data, replace(QUICK, steps=80))
    before, after = adapted.facts["before"], adapted.facts["after"]
    assert after["two_lost"] > before["two_lost"]
    assert after["whole"] > before["whole"] - 0.05
    path = write(tmp_path / "adapted", content, adapted)
    again = run_files.read(path)
    assert again["adapted"] == adapted.facts
    network = run_files.network(chosen, again["weights"], PAPER)
    assert torch.equal(network.out.weight, adapted.model.out.weight)
    assert again["filling"]["filling_first"].shape[0] == 224
