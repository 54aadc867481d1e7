"""Training loses electrodes as often as the recipe says, and fills their rows in."""

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_sim.measurement.consistency import RowImputation, fit
from eitskin_training.samples.batches import lose_electrodes


def test_the_stated_share_of_samples_loses_whole_electrodes() -> None:
    rng = np.random.default_rng(3)
    before = np.expm1(0.1 * rng.standard_normal((1500, 104))).astype(np.float32)
    filler = RowImputation(fit(before[:500]))
    after = before.copy()
    lose_electrodes(after, 0.2, filler, rng)
    changed = after != before
    # 1500 draws of 0.2: standard deviation 0.01.
    assert np.mean(changed.any(axis=1)) == pytest.approx(0.2, abs=0.05)
    one, three = rows_of((0,)).sum(), 3 * rows_of((0,)).sum()
    counts = changed.sum(axis=1)[changed.any(axis=1)]
    assert counts.min() >= one - 3  # a filled-in row may by chance equal what was there, to the last bit of float32
    assert counts.max() <= three
