"""A run's gate is fitted once, and again only when it is not of this run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin_training.gate import fit
from eitskin_training.gate.stored import NAME, gate_of_run, hand_on
from eitskin_training.gate.untouched import bends_of
from eitskin_training.samples.batches import TrainingData

pytestmark = [pytest.mark.heavy, pytest.mark.slow]


@pytest.fixture(scope="module")
def data(toy_data: Any) -> TrainingData:
    made: TrainingData = toy_data("area", bends=12, samples=1200)
    return made


@pytest.fixture(scope="module")
def folder(data: TrainingData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    where: Path = tmp_path_factory.mktemp("run")
    gate_of_run(where, data, 3, bends=bends_of)
    return where


def no_fit(*_: object, **__: object) -> None:
    raise AssertionError("fitted again")


def test_a_stored_gate_comes_back_as_it_was(folder: Path, data: TrainingData, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh = fit.fit(data, bends_of(data), seed=3)
    monkeypatch.setattr(fit, "fit", no_fit)
    again = gate_of_run(folder, data, 3)
    assert again.gate.measures == fresh.measures
    assert set(again.gate.arrays) == set(fresh.arrays)
    for name, value in fresh.arrays.items():
        np.testing.assert_allclose(again.gate.arrays[name], value, rtol=1e-4, atol=1e-6)
        assert again.gate.arrays[name].dtype == value.dtype
    np.testing.assert_array_equal(again.bends.measure, bends_of(data).measure)


@pytest.mark.parametrize("what", ["data", "damaged"])
def test_a_stale_gate_is_noticed_and_fitted_again(what: str, folder: Path, data: TrainingData, tmp_path: Path) -> None:
    hand_on(folder, tmp_path)
    if what == "damaged":
        (tmp_path / NAME).write_bytes((tmp_path / NAME).read_bytes()[:2000])
    changed = replace(data, digest="other") if what == "data" else data
    told: list[str] = []
    gate_of_run(tmp_path, changed, 3, tell=told.append, bends=bends_of)
    assert "gate: fitting" in told
    told.clear()
    gate_of_run(tmp_path, changed, 3, tell=told.append, bends=bends_of)
    assert told == []
