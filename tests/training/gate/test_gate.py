"""The touch gate: what it learns from, what it must tell apart, and that the runtime computes the same."""

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin.model.gate import Gate
from eitskin.pipeline.idle import PREFIX
from eitskin_proto.errors import SkinError
from eitskin_proto.wire.scan_rows import table_rows
from eitskin_training.gate import fit, idle, rates
from eitskin_training.gate.untouched import Bends, bends_of
from eitskin_training.samples.batches import TrainingData

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def data(toy_data: Any) -> TrainingData:
    made: TrainingData = toy_data("area", bends=12, samples=2400)
    return made


@pytest.fixture(scope="module")
def bends() -> Bends:
    """Return a toy's bends: one factor on all voltages, which every mirror image shares."""
    logs = np.log(np.random.default_rng(1).uniform(1.0, 1.1, 200))[:, None] * np.ones(104)
    return Bends(logs[:40], logs[40:120], logs[120:])


@pytest.fixture(scope="module")
def fitted(data: TrainingData, bends: Bends) -> fit.Gate:
    return fit.fit(data, bends)


def test_the_gate_tells_a_touch_from_a_bend_that_it_never_saw(fitted: fit.Gate) -> None:
    facts = fitted.facts()
    # 80 bends, each in 48 frames: 0.5 % is 19 frames, and one odd bend alone may give 48.
    assert facts["false_alarm_rate"] <= 0.02
    low, high = facts["false_alarm_interval_95"]
    assert low <= facts["false_alarm_rate"] <= high
    assert facts["missed_rate"] <= 0.1  # 19 touches at two bends, none of which was learned from
    assert facts["held_out_bends"] == 80
    assert set(facts["false_alarm_rate_by_noise"]) == {"N1", "N2", "N3"}


@pytest.mark.parametrize("prefix", ["", PREFIX])
def test_the_runtimes_gate_agrees_with_the_exported_one(fitted: fit.Gate, prefix: str) -> None:
    with np.load(io.BytesIO(fitted.to_npz()), allow_pickle=False) as archive:
        arrays = {name.removeprefix(prefix): archive[name] for name in archive.files if name.startswith(prefix)}
        drives = int(archive["idle_drives"])
    rows = table_rows(False, drives) if prefix else np.arange(104)
    runtime_gate = Gate(arrays, len(rows))
    rng = np.random.default_rng(0)
    dv = (0.1 * rng.standard_normal((50, len(rows)))).astype(np.float32)
    dv[0] = -2.0  # every voltage changed its sign
    expected = fit.logits(fitted.arrays, dv, prefix)
    found = []
    for row in dv:
        runtime_gate.change[:] = row
        assert runtime_gate.touched() == (runtime_gate.logit > runtime_gate.threshold)
        found.append(runtime_gate.logit)
    # The whitened sums run over terms a thousand times larger than their result, in float32.
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=2e-3 * np.abs(expected).max())


def test_a_gate_without_bends_to_measure_it_on_is_refused(data: TrainingData) -> None:
    with pytest.raises(SkinError, match="expected at least 1 of each"):
        fit.fit(data, replace(bends_of(data), choose=np.empty((0, 104))))


def test_a_threshold_lets_its_share_of_untouched_frames_through(data: TrainingData, bends: Bends) -> None:
    def size(dv: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.asarray(np.abs(dv).mean(axis=1))

    rng = np.random.default_rng(3)
    threshold = rates.threshold_at(0.2, size, bends.choose, data.reference, rng, data.skin)
    found = rates.untouched_logits(size, bends.choose, data.reference, rng, data.skin)
    tripped = np.mean([(logits > threshold).mean() for logits in found.values()])
    assert tripped == pytest.approx(0.2, abs=0.03)  # the same bends, other noise


def test_information_grows_with_rows_and_is_that_of_a_linear_measurement() -> None:
    rng = np.random.default_rng(0)
    covariance, pressed = np.diag(rng.uniform(1.0, 2.0, 104)), rng.standard_normal((5, 104))
    rows = np.arange(10)
    by_hand = 0.5 * np.log1p((pressed[:, rows] ** 2 / np.diag(covariance)[rows]).sum(axis=1)).mean()
    assert idle.information(covariance, pressed, rows) == pytest.approx(by_hand, rel=1e-12)
    assert idle.information(covariance, pressed, np.arange(20)) > by_hand
    # What a bend moves says nothing of a touch that moves the same.
    bend = pressed[0]
    nuisance = covariance + 1e8 * np.outer(bend, bend)
    assert idle.information(nuisance, bend[None], np.arange(104)) < 1e-3
