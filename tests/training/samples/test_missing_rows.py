"""Training loses electrodes as often as the recipe says, and fills their rows in."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_sim.measurement.consistency import RowImputation, fit
from eitskin_training.recipes import recipe
from eitskin_training.samples.batches import batches, consistency_of, lose_electrodes


def test_the_stated_share_of_samples_loses_whole_electrodes() -> None:
    rng = np.random.default_rng(3)
    before = np.expm1(0.1 * rng.standard_normal((6000, 104))).astype(np.float32)
    filler = RowImputation(fit(before[:500]))
    after = before.copy()
    lose_electrodes(after, 0.2, filler, rng)
    changed = after != before
    # 6000 draws of 0.2: standard deviation 0.005.
    assert np.mean(changed.any(axis=1)) == pytest.approx(0.2, abs=0.025)
    one, three = rows_of((0,)).sum(), 3 * rows_of((0,)).sum()
    counts = changed.sum(axis=1)[changed.any(axis=1)]
    assert counts.min() >= one - 3  # a filled-in row may by chance equal what was there, to the last bit of float32
    assert counts.max() <= three


def test_batches_with_lost_electrodes_stay_finite_and_repeat(toy_data: Any) -> None:
    data = toy_data("units", samples=600)
    chosen = replace(recipe("tiny"), labels="units", lost_electrode=0.5)
    first, second = (next(batches(data, chosen, seed=1, epoch=0)) for _ in range(2))
    assert bool(first.dv.isfinite().all())
    assert bool((first.dv == second.dv).all())


def test_how_rows_go_together_is_the_same_at_every_call(toy_data: Any) -> None:
    data = toy_data("units", samples=600)
    first, second = consistency_of(data, recipe("tiny")), consistency_of(data, recipe("tiny"))
    np.testing.assert_array_equal(first.covariance, second.covariance)
